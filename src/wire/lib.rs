//! The messages of the interface, and the library's types made of them and into them.
//!
//! Purpose: `proto` holds the generated messages, `json` writes them as JSON and says what that looks like. `options` has all
//! checks of options, for streams, jobs and the command; `names` and `fields` call options by the names that the command, HTTP
//! and Python share. `codec` and `attributes` translate values. `chunks` and `cells` cut arrays into messages; `assemble` puts
//! them together again. `pieces` are those of blobs at a client. `counts` and `upload` check what a request announces, and the
//! order of its messages. Invariant: an unknown enum value is an error, never a default. A refusal has the path of the field in
//! the message. Must not know: handlers, streams, queues, status codes, the server's half of the transport, the command line.

#![warn(unreachable_pub)]
// Fields and variants that their names explain; the callers are crates of this workspace.
#![allow(missing_docs)]
pub mod assemble;
pub mod attributes;
pub mod cells;
pub mod chunks;
pub mod codec;
pub mod counts;
pub mod fields;
pub mod json;
pub mod names;
pub mod options;
pub mod pieces;
pub mod proto;
pub mod upload;

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// A field has a value that it must not have.
    #[error("{path} {reason}")]
    Field {
        /// Where in the message, or in the arrays that came after it.
        path: String,
        /// What is wrong, and what to send instead.
        reason: String,
    },
    /// A message that must not come now.
    #[error("{0}")]
    Order(&'static str),
    /// What a server sent is damaged or incomplete. Clients alone meet it.
    #[error("{0}")]
    Answer(String),
}

impl WireError {
    pub fn field(path: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Field { path: path.into(), reason: reason.into() }
    }

    /// The same of a field of the message at `place`.
    #[must_use]
    pub fn under(self, place: &str) -> Self {
        match self {
            Self::Field { path, reason } if path.is_empty() => Self::field(place, reason),
            Self::Field { path, reason } => Self::field(format!("{place}.{path}"), reason),
            other => other,
        }
    }
}

fn unknown_enum(path: impl Into<String>, value: i32) -> WireError {
    WireError::field(path, format!("is {value}, which is no value of this enum"))
}
