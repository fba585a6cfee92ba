//! `/v1/blobs`: bytes in, bytes out, by their digests.
//!
//! Invariant: an upload that names its digest and its length is stored as it comes; any other is held in memory, counted,
//! until its digest is known. A blob's tag is its digest: what a client has of it never changes. Must not know: what blobs
//! are of.

use std::ops::Range;
use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::{Extension, Path, Request, State};
use axum::http::header::{
    ACCEPT_RANGES, CACHE_CONTROL, CONTENT_LENGTH, CONTENT_RANGE, CONTENT_TYPE, ETAG, HeaderName, IF_NONE_MATCH,
    IF_RANGE, LOCATION, RANGE,
};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::IntoResponse;
use futures_util::{StreamExt as _, TryStreamExt as _};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::json;

use super::body::{Arriving, Coding, coding, length, whole};
use super::form::one_file;
use super::guard::Whose;
use super::options::Asked;
use super::problem::{Answered, wrong};
use super::schema::{self, BYTES, JSON};
use crate::service::{Caller, Desk, EmptyUpload, RequestError, check_owned, timely};
use jobs::blob::{BlobError, BlobInfo, BlobStore, Chunk, Digest, Owner, UploadId, put_of};
use transport::Share;

/// Bytes of an upload that are stored at once.
const PIECE: usize = 1 << 20;

/// A stored blob, as answers have it.
#[derive(Serialize, JsonSchema)]
pub(super) struct Blob {
    #[schemars(schema_with = "schema::digest")]
    digest: Digest,
    size_bytes: u64,
}

fn digest(text: &str) -> Result<Digest, RequestError> {
    text.parse().map_err(|error: jobs::blob::DigestError| wrong("digest", format!("is no digest: {error}")))
}

pub(super) async fn upload(State(desk): State<Desk>, Extension(client): Whose, request: Request) -> Answered {
    let mut asked = Asked::of_query(request.uri().query())?;
    let named = asked.digest("digest")?;
    asked.finish()?;
    let (parts, body) = one_file(&desk, request).await?.into_parts();
    // The length of what is packed is not known.
    let length = length(&parts.headers).filter(|_| matches!(coding(&parts.headers), Ok(Coding::Plain)));
    let info = match (named, length) {
        (Some(digest), Some(length)) => {
            stream(&desk, &client, UploadId::new(digest, length), Arriving::new(&desk, body)).await?
        }
        (named, _) => {
            let (info, _) = store(&desk, &client, &parts.headers, body).await?;
            if let Some(expected) = named
                && expected != info.digest
            {
                return Err(BlobError::DigestMismatch { expected, actual: info.digest }.into());
            }
            info
        }
    };
    let BlobInfo { digest, size_bytes } = info;
    let headers = [(LOCATION, format!("/v1/blobs/{digest}")), (CONTENT_TYPE, JSON.to_owned())];
    Ok((StatusCode::CREATED, headers, json!(Blob { digest, size_bytes }).to_string()).into_response())
}

/// Keeps a body as a blob; gives its first bytes too.
pub(super) async fn store(
    desk: &Desk,
    client: &Caller,
    headers: &HeaderMap,
    body: Body,
) -> Result<(BlobInfo, Bytes), RequestError> {
    let (bytes, _share): (Bytes, Share) = whole(desk, &client.tenant, headers, body).await?;
    let info = put_of(&*desk.blobs, &client.tenant, client.bytes, bytes.clone()).await?;
    Ok((info, bytes))
}

/// Stores a body as it comes. What is stored of one that is cut stays, and the same upload goes on from there.
async fn stream(
    desk: &Desk,
    client: &Caller,
    upload: UploadId,
    mut arriving: Arriving<'_>,
) -> Result<BlobInfo, RequestError> {
    let upload = upload.of(&client.tenant);
    let info = BlobInfo { digest: upload.digest, size_bytes: upload.size_bytes };
    let mut status = timely(desk.blobs.begin_within(upload, client.bytes)).await?;
    if status.complete {
        return Ok(info);
    }
    let _empty = EmptyUpload::new(&desk.blobs, upload);
    // Bytes of the body that an earlier upload has stored already.
    let mut skip = status.kept_bytes;
    let (mut piece, mut share) = (Vec::new(), desk.budget.upload_of(&client.tenant));
    loop {
        let come = arriving.next().await?;
        let is_last = come.is_none();
        if let Some(mut bytes) = come {
            let known = skip.min(bytes.len() as u64);
            skip -= known;
            let bytes = bytes.split_off(known as usize);
            share.grow(bytes.len() as u64)?;
            piece.extend_from_slice(&bytes);
        }
        while piece.len() >= PIECE || (is_last && !piece.is_empty()) {
            let rest = piece.split_off(piece.len().min(PIECE));
            let chunk = Chunk::new(status.kept_bytes, std::mem::replace(&mut piece, rest).into());
            status = timely(desk.blobs.write(upload, chunk)).await?;
        }
        share.hold(piece.len() as u64);
        if is_last {
            break;
        }
    }
    timely(desk.blobs.finish(upload, None)).await
}

pub(super) async fn read(
    State(desk): State<Desk>,
    Extension(client): Whose,
    Path(named): Path<String>,
    request: Request,
) -> Answered {
    Asked::of_query(request.uri().query())?.finish()?;
    send(&desk, &client.tenant, digest(&named)?, request.headers(), BYTES, ()).await
}

pub(super) async fn remove(State(desk): State<Desk>, Extension(client): Whose, Path(named): Path<String>) -> Answered {
    timely(desk.blobs.disown(Owner::of(&client.tenant), digest(&named)?)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// Sends a blob, or what of it is wanted. `until` is held until the answer is over.
pub(super) async fn send(
    desk: &Desk,
    tenant: &str,
    digest: Digest,
    headers: &HeaderMap,
    media_type: &'static str,
    until: impl Send + 'static,
) -> Answered {
    let store: &Arc<dyn BlobStore> = &desk.blobs;
    check_owned(&**store, Owner::of(tenant), digest).await?;
    let size = timely(store.stat(digest)).await?.size_bytes;
    let tag = format!("\"{digest}\"");
    let mut answer = HeaderMap::new();
    let mut set = |name: HeaderName, value: &str| {
        // All of them are plain.
        HeaderValue::from_str(value).map(|value| answer.insert(name, value)).ok();
    };
    set(ETAG, &tag);
    set(ACCEPT_RANGES, "bytes");
    // Its bytes never change; whether a caller may have it does.
    set(CACHE_CONTROL, "private, no-cache");
    if is_known(headers, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, answer).into_response());
    }
    set(CONTENT_TYPE, media_type);
    let (status, range) = match wanted(headers, &tag, size) {
        Wanted::All => (StatusCode::OK, 0..size),
        Wanted::Part(range) => {
            set(CONTENT_RANGE, &format!("bytes {}-{}/{size}", range.start, range.end - 1));
            (StatusCode::PARTIAL_CONTENT, range)
        }
        Wanted::Nowhere => {
            let mut problem =
                super::problem::Problem::from(BlobError::OutOfRange { offset: size, size_bytes: size }).into_response();
            if let Ok(value) = HeaderValue::from_str(&format!("bytes */{size}")) {
                problem.headers_mut().insert(CONTENT_RANGE, value);
            }
            return Ok(problem);
        }
    };
    set(CONTENT_LENGTH, &(range.end - range.start).to_string());
    if range.is_empty() {
        return Ok((status, answer).into_response());
    }
    let bytes = timely(store.read(digest, range)).await?.bytes;
    let bytes = bytes.inspect_err(|error| tracing::error!(%error, "a blob could not be read to its end"));
    let bytes = bytes.map(move |piece| {
        let _held = &until;
        piece
    });
    Ok((status, answer, Body::from_stream(bytes)).into_response())
}

/// The range that is wanted of `total` bytes. Of several ranges, and of what is no range, all bytes are given, as the RFC
/// allows (RFC 9110, sections 13 and 14).
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Wanted {
    All,
    Part(Range<u64>),
    /// A range that begins after the end.
    Nowhere,
}

/// Whether the client has what has this tag.
pub(super) fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    let given = headers.get_all(IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    given
        .flat_map(|all| all.split(','))
        .map(|one| one.trim().trim_start_matches("W/"))
        .any(|one| one == "*" || one == tag)
}

/// The range that is wanted of a resource with this tag and length.
pub(super) fn wanted(headers: &HeaderMap, tag: &str, size: u64) -> Wanted {
    if headers.get(IF_RANGE).is_some_and(|value| value.as_bytes() != tag.as_bytes()) {
        return Wanted::All;
    }
    headers.get(RANGE).and_then(|value| range(value.to_str().ok()?, size)).unwrap_or(Wanted::All)
}

fn range(text: &str, size: u64) -> Option<Wanted> {
    let (begin, end) = text.strip_prefix("bytes=")?.split_once('-')?;
    let number = |text: &str| text.trim().parse::<u64>().ok();
    let range = match (begin.trim().is_empty(), end.trim().is_empty()) {
        (true, true) => return None,
        // The last bytes.
        (true, false) => size.saturating_sub(number(end)?)..size,
        (false, true) => number(begin)?..size,
        (false, false) => {
            let (begin, end) = (number(begin)?, number(end)?);
            if end < begin {
                return None;
            }
            begin..end.saturating_add(1).min(size)
        }
    };
    Some(if range.start < size && !range.is_empty() { Wanted::Part(range) } else { Wanted::Nowhere })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Wanted {
        let headers = HeaderMap::from_iter([(RANGE, text.parse().unwrap())]);
        wanted(&headers, "\"a\"", 100)
    }

    #[test]
    fn ranges_are_read() {
        for (text, range) in
            [("bytes=0-9", 0..10), ("bytes=90-", 90..100), ("bytes=-5", 95..100), ("bytes=5-999", 5..100)]
        {
            assert_eq!(of(text), Wanted::Part(range), "{text}");
        }
        for text in ["bytes=100-", "bytes=100-200", "bytes=-0"] {
            assert_eq!(of(text), Wanted::Nowhere, "{text}");
        }
        for text in ["", "bytes=", "bytes=-", "bytes=9-0", "bytes=0-1,4-5", "lines=0-1", "bytes=a-b"] {
            assert_eq!(of(text), Wanted::All, "{text}");
        }
    }

    #[test]
    fn a_range_of_something_else_is_all_of_this() {
        let headers =
            |tag: &str| HeaderMap::from_iter([(RANGE, "bytes=0-9".parse().unwrap()), (IF_RANGE, tag.parse().unwrap())]);
        assert_eq!(wanted(&headers("\"a\""), "\"a\"", 100), Wanted::Part(0..10));
        assert_eq!(wanted(&headers("\"b\""), "\"a\"", 100), Wanted::All);
    }

    #[test]
    fn what_is_known_is_not_sent_again() {
        let known = |tags: &str| is_known(&HeaderMap::from_iter([(IF_NONE_MATCH, tags.parse().unwrap())]), "\"a\"");
        assert!(known("\"a\"") && known("\"b\", \"a\"") && known("*") && known("W/\"a\""));
        assert!(!known("\"b\"") && !known("a"));
    }
}
