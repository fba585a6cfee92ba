//! Surfaces larger than memory, as the diagram sees them.
//!
//! Purpose: [`Plan`] says what memory a diagram takes whose facets are read in windows, before any is allocated. [`FacetFile`] is the
//! surface: its facets with area in a scratch file, in the order in which [`super::parallel`] takes them, and frame and area of the
//! whole. A pass reads them from one end to the other, window by window; seeds, their rows and their sums stay in memory.
//! Invariant: sums have the bits of the surface in memory: facets come in one order, and windows begin where blocks of it do.
//! Must not know: how facets are divided, files of surfaces.

mod draws;
mod ordered;
mod plan;
#[cfg(test)]
mod tests;

pub use ordered::FacetFile;
pub use plan::{Plan, Wanted};

use super::RvdError;
use crate::mesh::out_of_core::MeshFileError;
use crate::token::Stopped;

/// Why a diagram could not be computed in windows.
#[derive(Debug, thiserror::Error)]
pub enum OutOfCoreError {
    /// The surface cannot be read.
    #[error(transparent)]
    File(#[from] MeshFileError),
    /// The diagram cannot be computed.
    #[error(transparent)]
    Rvd(#[from] RvdError),
    /// Even the smallest windows take more memory than is allowed.
    #[error(
        "{needed_bytes} bytes of memory are needed with the smallest windows, and {limit_bytes} are allowed; allow more, or use fewer seeds"
    )]
    DoesNotFit {
        /// The least that does.
        needed_bytes: u64,
        /// What is allowed.
        limit_bytes: u64,
    },
}

impl From<Stopped> for OutOfCoreError {
    fn from(stopped: Stopped) -> Self {
        Self::Rvd(stopped.into())
    }
}
