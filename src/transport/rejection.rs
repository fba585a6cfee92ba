//! Why a request or its bytes are rejected.
//!
//! Invariant: each rejection names a cause that the client or time can mend. Must not know: statuses of any protocol; the
//! service gives each rejection its own.

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Rejection {
    #[error("{needed_bytes} more bytes do not fit now: {left_bytes} are left")]
    Memory { needed_bytes: u64, left_bytes: u64 },
    #[error("a message of {length} bytes came, where none is longer than {most}")]
    MessageTooLong { length: u64, most: u64 },
    #[error("a compressed message would have more than {most} bytes")]
    Unpacked { most: u64 },
    #[error("a message is not compressed as it says, or has a window above 8 MiB")]
    Damaged,
    #[error("the server is shutting down; try again, or try another server")]
    Draining,
}
