//! Errors as `application/problem+json` (RFC 9457).
//!
//! Purpose: [`Problem`] is a [`Fault`] in HTTP's words. Invariant: `reason` is the word that the details of gRPC have for the
//! same error. Whatever is worth another try says when, in the body and in `Retry-After`. Must not know: where an error arose.

use std::time::Duration;

use axum::http::header::{CONTENT_TYPE, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Value, json};

use super::schema::PROBLEM;
use crate::metrics::Refused;
use crate::service::{Detail, Fault, FaultKind, RequestError};
use wire::{WireError, names};

#[derive(Debug)]
pub(super) struct Problem(pub(super) Fault);

/// The body of an answer that is a problem.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Problem")]
pub(super) struct ProblemBody {
    r#type: String,
    /// The name of the status.
    title: &'static str,
    status: u16,
    /// For people.
    detail: String,
    /// For programs: the word that the gRPC details have for the same error, else the name of its code.
    reason: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    retry_after_s: Option<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    field_violations: Vec<Violation>,
}

#[derive(Serialize, JsonSchema)]
#[schemars(inline)]
struct Violation {
    /// The option or field, as the request names it.
    field: String,
    description: String,
}

pub(super) type Answered = Result<Response, Problem>;

impl<E: Into<RequestError>> From<E> for Problem {
    fn from(error: E) -> Self {
        Self::of(error.into().into())
    }
}

impl Problem {
    /// A fault, with the names that options have here.
    pub(super) fn of(mut fault: Fault) -> Self {
        let plain = |name: &str| name.to_owned();
        if let Some(text) = names::in_text(&fault.text, plain) {
            fault.text = text;
        }
        for detail in &mut fault.details {
            let Detail::Field { path, description } = detail else { continue };
            if let Some((name, rest)) = names::of(path) {
                *path = format!("{name}{rest}");
            }
            if let Some(text) = names::in_text(description, plain) {
                *description = text;
            }
        }
        Self(fault)
    }

    pub(super) fn status(&self) -> StatusCode {
        let fault = &self.0;
        let has_quota = || fault.details.iter().any(|detail| matches!(detail, Detail::Quota { .. }));
        match (fault.kind, fault.refused) {
            (_, Some(Refused::TooLarge | Refused::MessageSize)) => StatusCode::PAYLOAD_TOO_LARGE,
            (FaultKind::InvalidArgument, _) => StatusCode::BAD_REQUEST,
            (FaultKind::Unauthenticated, _) => StatusCode::UNAUTHORIZED,
            (FaultKind::PermissionDenied, _) => StatusCode::FORBIDDEN,
            (FaultKind::NotFound | FaultKind::Unimplemented, _) => StatusCode::NOT_FOUND,
            (FaultKind::DeadlineExceeded, _) => StatusCode::REQUEST_TIMEOUT,
            (FaultKind::AlreadyExists | FaultKind::FailedPrecondition, _) => StatusCode::CONFLICT,
            (FaultKind::Aborted | FaultKind::Cancelled, _) => StatusCode::CONFLICT,
            (FaultKind::OutOfRange, _) => StatusCode::RANGE_NOT_SATISFIABLE,
            (FaultKind::ResourceExhausted, _) => match (has_quota(), self.retry()) {
                // A limit of the caller's key,
                (true, Some(_)) => StatusCode::TOO_MANY_REQUESTS,
                // one that the same work would meet again,
                (true, None) => StatusCode::UNPROCESSABLE_ENTITY,
                // or one of the server.
                (false, _) => StatusCode::SERVICE_UNAVAILABLE,
            },
            (FaultKind::Unavailable, _) => StatusCode::SERVICE_UNAVAILABLE,
            (FaultKind::Internal | FaultKind::DataLoss, _) => StatusCode::INTERNAL_SERVER_ERROR,
        }
    }

    fn retry(&self) -> Option<Duration> {
        self.0.details.iter().find_map(|detail| if let Detail::Retry(after) = detail { Some(*after) } else { None })
    }

    pub(super) fn json(&self, status: StatusCode) -> Value {
        let reason = self.0.reason();
        let violations = self.0.details.iter().filter_map(|detail| match detail {
            Detail::Field { path, description } => {
                Some(Violation { field: path.clone(), description: description.clone() })
            }
            _ => None,
        });
        json!(ProblemBody {
            r#type: format!("urn:tessera:problem:{reason}"),
            title: status.canonical_reason().unwrap_or_default(),
            status: status.as_u16(),
            detail: self.0.text.clone(),
            reason,
            retry_after_s: self.retry().map(|after| after.as_secs_f64()),
            field_violations: violations.collect(),
        })
    }

    /// The answer, with a status that says more than the fault does.
    pub(super) fn with_status(self, status: StatusCode) -> Response {
        let mut headers = HeaderMap::new();
        headers.insert(CONTENT_TYPE, HeaderValue::from_static(PROBLEM));
        if let Some(after) = self.retry() {
            let seconds = after.as_secs_f64().ceil().max(1.0) as u64;
            headers.insert(RETRY_AFTER, HeaderValue::from(seconds));
        }
        if self.0.kind == FaultKind::Unauthenticated {
            headers.insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        let mut response = (status, headers, self.json(status).to_string()).into_response();
        if let Some(refused) = self.0.refused {
            // For metrics.
            response.extensions_mut().insert(refused);
        }
        response
    }
}

pub(super) fn wrong(field: impl Into<String>, reason: impl Into<String>) -> RequestError {
    WireError::field(field, reason).into()
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = self.status();
        self.with_status(status)
    }
}
