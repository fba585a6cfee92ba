//! Promises of the blob store, on a folder, in memory, and on a store that processes share.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
