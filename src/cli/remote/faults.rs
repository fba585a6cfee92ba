//! What can go wrong with a server, in one sentence each.
//!
//! Purpose: statuses and wrong answers become errors that say what to do. Invariant: of a stream only INVALID_ARGUMENT is
//! the user's input (65), of a call about a job or a blob also what names none (66) or one in another state (70); all else is
//! the server or the way to it (69). Text of a server is shown plain, and once. Must not know: calls, arrays.

use std::error::Error;
use std::fmt::Display;

use tonic::{Code, Status};

use crate::exit::{Absent, BadInput, NoResult, Unavailable};
use crate::remesh::args::flag;
use crate::say::plain;
use crate::server::ServerUrl;
use wire::names;

/// How tonic begins what it says itself of an answer that it cannot read.
const UNREADABLE: &[&str] =
    &["failed to decode", "Error, decoded message", "Error decompressing", "protocol error: received"];
/// How tonic begins what it says itself of an answer that ends before its status.
const CUT_SHORT: &[&str] = &["Unexpected EOF", "protocol error: missing grpc-status", "Missing response message"];
/// What tonic says itself of an answer that is HTTP, and no gRPC.
const NO_GRPC: &str = "grpc-status header missing, mapped from HTTP status code ";

/// The error for how the stream of a piece of work ended.
pub(super) fn of_status(url: &ServerUrl, status: &Status) -> anyhow::Error {
    cut(status).map_or_else(|| said(url, status), |cause| lost(url, cause))
}

#[derive(Debug)]
pub(super) enum Fault {
    /// The connection was lost, or the server is away: the same call may succeed soon.
    Lost(anyhow::Error),
    /// An answer that another try would not change.
    Final(anyhow::Error),
}

impl From<anyhow::Error> for Fault {
    fn from(error: anyhow::Error) -> Self {
        Self::Final(error)
    }
}

impl From<Fault> for anyhow::Error {
    fn from(fault: Fault) -> Self {
        match fault {
            Fault::Lost(error) | Fault::Final(error) => error,
        }
    }
}

/// The fault for how a call about a job or a blob ended.
pub(super) fn of_call(url: &ServerUrl, status: &Status) -> Fault {
    if let Some(cause) = cut(status) {
        let cause = plain(&cause);
        return Fault::Lost(Unavailable(format!("the connection to {url} was lost: {cause}; try again")).into());
    }
    let words = format!("the server says: {}", words(status));
    match status.code() {
        Code::Unavailable => Fault::Lost(said(url, status)),
        Code::NotFound => Fault::Final(Absent(words).into()),
        Code::AlreadyExists => Fault::Final(BadInput(words).into()),
        Code::Unimplemented => {
            Fault::Final(Unavailable(format!("{words}; {url} may be of a version without jobs and blobs")).into())
        }
        Code::Cancelled => Fault::Final(Unavailable(words).into()),
        _ => Fault::Final(said(url, status)),
    }
}

/// The same, of a call that only a job in the right state allows.
pub(super) fn of_state(url: &ServerUrl, status: &Status) -> Fault {
    match status.code() {
        Code::FailedPrecondition => Fault::Final(NoResult(format!("the server says: {}", words(status))).into()),
        _ => of_call(url, status),
    }
}

/// Whether a status is of this side: the connection was lost before the server's own status came.
pub(crate) fn is_lost(status: &Status) -> bool {
    cut(status).is_some()
}

/// What cut an answer short, if it has no end of its own.
fn cut(status: &Status) -> Option<String> {
    if status.source().is_some() {
        return Some(innermost(status));
    }
    let cut = CUT_SHORT.iter().any(|begin| status.message().starts_with(begin));
    cut.then(|| "the answer ended before it was whole".to_owned())
}

/// What a status says, fit to be shown.
fn words(status: &Status) -> String {
    match plain(status.message()) {
        said if said.is_empty() => status.code().description().to_owned(),
        said => said,
    }
}

/// The error for a status that came whole.
fn said(url: &ServerUrl, status: &Status) -> anyhow::Error {
    let text = status.message();
    let begins = |all: &[&str]| all.iter().any(|begin| text.starts_with(begin));
    if let Some(code) = text.strip_prefix(NO_GRPC) {
        let code = plain(code);
        let hint = "is a tessera server running behind it?";
        return Unavailable(format!("{url} answers with HTTP status {code} and without gRPC; {hint}")).into();
    }
    if begins(UNREADABLE) || (status.code() == Code::Internal && text.contains("flag")) {
        return wrong(text);
    }
    let said = words(status);
    match status.code() {
        Code::InvalidArgument => {
            let said = names::in_text(&said, flag).unwrap_or(said);
            BadInput(format!("the server says: {said}")).into()
        }
        Code::Unauthenticated => {
            Unavailable(format!("the server says: {said}; --key-file FILE names the file of the key")).into()
        }
        // Not cancelled by this side, which would not have waited for a status.
        Code::Cancelled => Unavailable(format!("the server cancelled the job: {said}; try again")).into(),
        _ => Unavailable(format!("the server says: {said}")).into(),
    }
}

/// A connection that ended before the job did.
pub(super) fn lost(url: &ServerUrl, cause: impl Display) -> anyhow::Error {
    let cause = plain(&cause.to_string());
    Unavailable(format!("the connection to {url} was lost: {cause}; the job was not finished; try again")).into()
}

/// An answer that cannot be: the server's fault, whatever the error that `what` was.
pub(super) fn wrong(what: impl Display) -> anyhow::Error {
    Unavailable(format!("the server's answer is wrong: {}", plain(&format!("{what:#}")))).into()
}

/// The first cause of all, in words: it says the most, those above it that something went wrong.
pub(super) fn innermost(error: &(dyn Error + 'static)) -> String {
    let mut cause = error;
    while let Some(deeper) = cause.source() {
        cause = deeper;
    }
    match cause.to_string() {
        // HTTP/2's word for a connection that is closed on purpose.
        text if text.ends_with("not a result of an error") => "the server closed it".to_owned(),
        text => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exit::code;

    fn url() -> ServerUrl {
        "http://127.0.0.1:1".parse().unwrap()
    }

    #[test]
    fn only_a_bad_request_is_the_user_s() {
        for (status, exit, words) in [
            (Status::invalid_argument("mesh.facets: \u{1b}[31mno"), 65, "the server says: mesh.facets: \u{fffd}[31mno"),
            (Status::internal("a fault"), 69, "the server says: a fault"),
            (Status::cancelled("I stop"), 69, "the server cancelled the job: I stop"),
            (Status::deadline_exceeded("late"), 69, "the server says: late"),
            (Status::unimplemented(""), 69, "the server says: Operation is not implemented"),
            (Status::out_of_range("Error, decoded message length too large: found 9"), 69, "answer is wrong"),
            (Status::unavailable(format!("{NO_GRPC}502 Bad Gateway")), 69, "with HTTP status 502"),
            (Status::unknown("protocol error: missing grpc-status trailer"), 69, "was lost"),
            (Status::from_error(Box::new(std::io::Error::other("broken wire"))), 69, "was lost: broken wire"),
        ] {
            let error = of_status(&url(), &status);
            let said = format!("{error:#}");
            assert!(code(&error) == exit && said.contains(words), "{status:?}: {said}");
            assert_eq!(said.matches(words).count(), 1, "{said}");
        }
    }

    #[test]
    fn a_call_says_whether_another_try_helps() {
        for (status, exit, again) in [
            (Status::not_found("no job x"), 66, false),
            (Status::failed_precondition("no GPU"), 69, false),
            (Status::already_exists("another body"), 65, false),
            (Status::invalid_argument("no"), 65, false),
            (Status::resource_exhausted("full"), 69, false),
            (Status::unimplemented(""), 69, false),
            (Status::unavailable("I go"), 69, true),
            (Status::from_error(Box::new(std::io::Error::other("broken wire"))), 69, true),
        ] {
            let fault = of_call(&url(), &status);
            assert_eq!(matches!(fault, Fault::Lost(_)), again, "{status:?}");
            assert_eq!(code(&fault.into()), exit, "{status:?}");
        }
        assert_eq!(code(&of_state(&url(), &Status::failed_precondition("it runs")).into()), 70);
    }

    #[test]
    fn a_wrong_answer_is_never_the_user_s_mesh() {
        let broken = geometry::mesh::TriMesh::new(Vec::new(), Vec::new()).unwrap_err();
        assert_eq!(code(&wrong(broken)), 69);
    }
}
