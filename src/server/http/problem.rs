//! Errors as `application/problem+json` (RFC 9457).
//!
//! Purpose: [`Problem`] is a [`Fault`] in HTTP's words. Invariant: `reason` is the word that the details of gRPC have for the
//! same error. Whatever is worth another try says when, in the body and in `Retry-After`. Must not know: where an error arose.

use std::time::Duration;

use axum::http::header::{CONTENT_TYPE, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value, json};

use crate::metrics::Refused;
use crate::service::{Detail, Fault, FaultKind, RequestError};
use wire::{WireError, names};

#[derive(Debug)]
pub(super) struct Problem(pub(super) Fault);

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
        let mut body = Map::new();
        let mut add = |key: &str, value: Value| body.insert(key.to_owned(), value);
        add("type", json!(format!("urn:tessera:problem:{reason}")));
        add("title", json!(status.canonical_reason().unwrap_or_default()));
        add("status", json!(status.as_u16()));
        add("detail", json!(self.0.text));
        add("reason", json!(reason));
        if let Some(after) = self.retry() {
            add("retry_after_s", json!(after.as_secs_f64()));
        }
        let violations = self.0.details.iter().filter_map(|detail| match detail {
            Detail::Field { path, description } => Some(json!({ "field": path, "description": description })),
            _ => None,
        });
        let violations: Vec<Value> = violations.collect();
        if !violations.is_empty() {
            add("field_violations", Value::Array(violations));
        }
        Value::Object(body)
    }

    /// The answer, with a status that says more than the fault does.
    pub(super) fn with_status(self, status: StatusCode) -> Response {
        let mut headers = HeaderMap::new();
        headers.insert(CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
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
