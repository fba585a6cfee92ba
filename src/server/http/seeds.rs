//! `/v1/jobs/{id}/seeds`: where the seeds of a job at work are, for drawing its cells.
//!
//! Invariant: an answer has the newest seeds, after more steps than the caller has seen; steps between may be left out. A
//! request waits for a limited time and holds memory that is counted. Must not know: how seeds get here, what is drawn.

use std::convert::Infallible;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::{Extension, Path, Request, State};
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE, HeaderName};
use axum::response::IntoResponse;

use super::guard::Client;
use super::options::Asked;
use super::problem::Answered;
use crate::service::{Desk, Phase, RequestError, job_id};

/// How long a request waits for seeds.
const WAIT: Duration = Duration::from_secs(20);

/// Bytes that are handed to the connection at once.
const PIECE: usize = 64 << 10;

/// How many steps have been taken.
const STEPS: HeaderName = HeaderName::from_static("tessera-steps");

/// Whether the job has ended: there will be no more.
const ENDED: HeaderName = HeaderName::from_static("tessera-ended");

/// `GET /v1/jobs/{id}/seeds`.
pub(super) async fn seeds(
    State(desk): State<Desk>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
    request: Request,
) -> Answered {
    let mut asked = Asked::of_query(request.uri().query())?;
    let after: u64 = asked.whole("after")?.unwrap_or(0);
    asked.finish()?;
    let mut receiver = desk.api.preview(&client.tenant, job_id(&id)?).await?;
    let newer = receiver.wait_for(|shown| shown.as_ref().is_some_and(|shown| shown.steps > after));
    let found = tokio::select! {
        found = tokio::time::timeout(WAIT, newer) => found,
        () = desk.gate.reached(Phase::Draining) => return Err(RequestError::Draining.into()),
    };
    let uncached = (CACHE_CONTROL, "no-store".to_owned());
    let preview = match found {
        Ok(Ok(shown)) => shown.clone(),
        // The job has ended.
        Ok(Err(_)) => {
            return Ok((StatusCode::NO_CONTENT, [uncached, (ENDED, "true".to_owned())]).into_response());
        }
        Err(_) => return Ok((StatusCode::NO_CONTENT, [uncached]).into_response()),
    };
    let Some(preview) = preview else { return Ok((StatusCode::NO_CONTENT, [uncached]).into_response()) };
    let bytes = preview.seeds;
    let mut share = desk.budget.share();
    share.grow(bytes.len() as u64)?;
    let headers = [
        uncached,
        (CONTENT_TYPE, "application/octet-stream".to_owned()),
        (CONTENT_LENGTH, bytes.len().to_string()),
        (STEPS, preview.steps.to_string()),
    ];
    let pieces = futures_util::stream::unfold((bytes, share), |(mut rest, share)| async move {
        let piece: Bytes = rest.split_to(rest.len().min(PIECE));
        (!piece.is_empty()).then_some((Ok::<_, Infallible>(piece), (rest, share)))
    });
    Ok((headers, Body::from_stream(pieces)).into_response())
}
