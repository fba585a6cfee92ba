//! Why there is no density.
//!
//! Invariant: a variant names what the caller gave, and what it may be. Must not know: surfaces.

use crate::token::Stopped;

/// Why there is no density.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DensityError {
    /// The list of edge lengths is not as long as the list of vertices.
    #[error("{given} edge lengths for {vertices} vertices; give one per vertex")]
    SizeCount {
        /// How many were given.
        given: usize,
        /// How many vertices there are.
        vertices: usize,
    },
    /// An edge length is not one.
    #[error("the edge length of vertex {vertex} is {value}; lengths are finite and above 0")]
    BadSize {
        /// The vertex, from 0.
        vertex: usize,
        /// What was given.
        value: f64,
    },
    /// An option is outside its range.
    #[error("{name} is {value}; it must be {range}")]
    BadOption {
        /// "edge length", "adaptivity", "gradation", "clamp" or "ratio".
        name: &'static str,
        /// What was given.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// Neither a number of points nor anything that implies one.
    #[error("nothing says how many points there should be; give their number, an edge length, or one per vertex")]
    NoCount,
    /// The lengths need more points than are allowed.
    #[error("these edge lengths need about {implied:.3e} points, and at most {limit} are allowed; make them longer")]
    TooManyPoints {
        /// How many they need.
        implied: f64,
        /// How many there may be.
        limit: usize,
    },
    /// More points than are allowed.
    #[error("{points} points, and at most {limit} are allowed; give fewer")]
    PointLimit {
        /// How many were asked for.
        points: usize,
        /// How many there may be.
        limit: usize,
    },
    /// The caller asked to stop, or a limit was reached.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}
