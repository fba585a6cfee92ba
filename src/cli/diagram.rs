//! What is asked of a diagram, and what comes back.
//!
//! Purpose: the same for one that is computed here and for a server's. Invariant: pieces are not collected; a [`Sink`] takes them.
//! Must not know: where it is computed.

use anyhow::Result;
use glam::DVec3;
use serde_json::Value;

use geometry::rvd::PieceBatch;

/// Takes each batch of pieces as it comes, caller's coordinates.
pub(crate) type Sink<'a> = &'a mut dyn FnMut(&PieceBatch) -> Result<()>;

/// What is to be computed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wants {
    pub(crate) cells: bool,
    pub(crate) centroids: bool,
}

/// What came out, wherever it was computed.
pub(crate) struct RvdResult {
    /// One a seed; empty if not wanted.
    pub(crate) centroids: Vec<DVec3>,
    pub(crate) report: Value,
}
