//! Warnings of a result, as headers of its answer.
//!
//! Invariant: an answer has at most [`MOST_WARNINGS`] of them, the last of which tells of more. Must not know: what is asked for.

use axum::body::Bytes;
use axum::http::HeaderValue;
use futures_util::TryStreamExt;
use serde::Deserialize;

use crate::service::{Desk, RequestError, timely};
use jobs::record::{Job, JobId, Outcome};

/// The figures among the results of a job.
pub(super) const REPORT: &str = "report";

/// A warning of the report, as `CODE: MESSAGE`; one header for each.
pub(super) const WARNING: &str = "tessera-warning";

/// The most warnings of an answer, the last of which tells of more, and the most characters of one: clients limit the size of
/// headers.
const MOST_WARNINGS: usize = 16;
const MOST_CHARACTERS: usize = 400;

/// The warnings of a job that succeeded. The report may be deleted with the job, so that the answer carries them. There are
/// none if the report cannot be read: the surface is of use without it.
pub(super) async fn warnings(desk: &Desk, job: &Job) -> Vec<HeaderValue> {
    match report(desk, job).await {
        Ok(report) => headers(&report, job.id),
        Err(error) => {
            tracing::debug!(job = %job.id, ?error, "the report cannot be read");
            Vec::new()
        }
    }
}

/// The bytes of the report; none if the job has no result.
async fn report(desk: &Desk, job: &Job) -> Result<Vec<u8>, RequestError> {
    let Some(Outcome::Succeeded(results)) = &job.status.outcome else { return Ok(Vec::new()) };
    let Some(&digest) = results.blobs.get(REPORT) else { return Ok(Vec::new()) };
    let read = timely(desk.blobs.read(digest, 0..u64::MAX)).await?;
    let report: Vec<Bytes> = read.bytes.try_collect().await?;
    Ok(report.concat())
}

fn headers(report: &[u8], id: JobId) -> Vec<HeaderValue> {
    #[derive(Deserialize)]
    struct Report {
        #[serde(default)]
        warnings: Vec<Warning>,
    }
    #[derive(Deserialize)]
    struct Warning {
        code: String,
        message: String,
    }
    let Ok(Report { warnings }) = serde_json::from_slice(report) else { return Vec::new() };
    let mut said: Vec<String> =
        warnings.into_iter().map(|Warning { code, message }| format!("{code}: {message}")).collect();
    if said.len() > MOST_WARNINGS {
        let more = said.split_off(MOST_WARNINGS - 1).len();
        said.push(format!("more: the report of job {id} has {more} more"));
    }
    let header = |text: String| {
        let text = text.chars().take(MOST_CHARACTERS).map(|c| if c.is_control() { ' ' } else { c });
        HeaderValue::from_bytes(text.collect::<String>().as_bytes()).ok()
    };
    said.into_iter().filter_map(header).collect()
}
