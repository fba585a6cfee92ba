//! What server and client both speak: messages, and our own types made of them and into them.
//!
//! Purpose: `proto` holds the generated messages. `codec`, `density`, `options` and `attributes` translate values. `chunks`
//! and `cells` cut arrays into messages; `assemble` (at the server) and `arrays` (at a client) put them together again.
//! `pieces` are those of blobs at a client. `counts`, `headers` and `upload` check what a request announces, and the order of its messages.
//! `names` has what the command, HTTP and Python call the fields.
//! Invariant: an unknown enum value is an error, never a default. What is refused is named by its path in the message.
//! Must not know: handlers, streams, queues, status codes, the server's half of the transport, the command line.

#![warn(unreachable_pub)]
// Fields and variants that their names explain; the callers are crates of this house.
#![allow(missing_docs)]
pub mod arrays;
pub mod assemble;
pub mod attributes;
pub mod cells;
pub mod chunks;
pub mod codec;
pub mod counts;
pub mod density;
mod headers;
pub mod names;
pub mod options;
pub mod pieces;
pub mod proto;
pub mod upload;

use geometry::remesh::RemeshError;

/// Why a message is refused.
#[derive(Clone, Debug, thiserror::Error)]
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
    /// Options that the library refuses.
    #[error(transparent)]
    Options(#[from] RemeshError),
    /// What a server sent is damaged or incomplete. Clients alone meet it.
    #[error("{0}")]
    Answer(String),
}

impl WireError {
    pub fn field(path: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Field { path: path.into(), reason: reason.into() }
    }

    pub fn unknown_enum(path: &str, value: i32) -> Self {
        Self::field(path, format!("is {value}, which is no value of this enum"))
    }
}
