//! Creases and boundaries that a remesh keeps.
//!
//! Purpose: [`curves`] finds them and places their seeds; [`envelope`] bounds how far the result's edges may leave them.
//! Invariant: what could not be kept is counted. Must not know: backends, iterations, how a result is improved.

pub(super) mod curves;
pub(super) mod envelope;
