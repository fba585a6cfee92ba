//! Bodies of forms: `multipart/form-data` with one file.
//!
//! Purpose: [`one_file`] makes a request whose body is the file of a form. Invariant: the file is passed on as it comes, within the
//! limits of any body; a form without a file, or with a second part, is refused. Must not know: what the file is.

use std::io::{self, ErrorKind};

use axum::body::Body;
use axum::extract::Request;
use axum::http::HeaderValue;
use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE};
use futures_util::stream::try_unfold;
use multer::{Field, Multipart};

use super::body::{Coding, coding};
use super::problem::wrong;
use crate::service::{Desk, RequestError};

/// The request, or the same with the file of its form as the body.
pub(super) async fn one_file(desk: &Desk, request: Request) -> Result<Request, RequestError> {
    let media = request.headers().get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    if !media.trim_start().to_ascii_lowercase().starts_with("multipart/") {
        return Ok(request);
    }
    let Ok(boundary) = multer::parse_boundary(media) else {
        return Err(wrong("content-type", "is no form with a boundary; send multipart/form-data, or the file itself"));
    };
    if coding(request.headers())? != Coding::Plain {
        return Err(wrong("content-encoding", "is given for a form; compress the file in it instead"));
    }
    let (mut parts, body) = request.into_parts();
    let mut form = Multipart::new(body.into_data_stream(), boundary);
    let idle = desk.limits.upload_idle;
    let first = tokio::time::timeout(idle, form.next_field()).await.map_err(|_| RequestError::Idle(idle))?;
    let Some(file) = first.map_err(|error| wrong("body", format!("is no form: {error}")))? else {
        return Err(wrong("body", "is a form without a file"));
    };
    // The length is that of the form.
    parts.headers.remove(CONTENT_LENGTH);
    let media = file.content_type().and_then(|media| HeaderValue::from_str(media.as_ref()).ok());
    match media {
        Some(media) => parts.headers.insert(CONTENT_TYPE, media),
        None => parts.headers.remove(CONTENT_TYPE),
    };
    let pieces = try_unfold((form, Some(file)), async |(form, file)| next(form, file).await);
    Ok(Request::from_parts(parts, Body::from_stream(pieces)))
}

type Rest = (Multipart<'static>, Option<Field<'static>>);

/// The next bytes of the file, and what is left. After the file the form must end.
async fn next(mut form: Multipart<'static>, file: Option<Field<'static>>) -> io::Result<Option<(bytes::Bytes, Rest)>> {
    // Malformed, unless the client has gone.
    let broken = |error: multer::Error| match error {
        multer::Error::StreamReadFailed(cause) => io::Error::other(cause),
        error => io::Error::new(ErrorKind::InvalidData, error),
    };
    if let Some(mut file) = file {
        if let Some(bytes) = file.chunk().await.map_err(broken)? {
            return Ok(Some((bytes, (form, Some(file)))));
        }
        drop(file);
    }
    match form.next_field().await.map_err(broken)? {
        None => Ok(None),
        Some(_) => Err(io::Error::new(ErrorKind::InvalidData, "a form has one file and nothing else")),
    }
}
