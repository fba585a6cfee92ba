//! What all stages of one run share.
//!
//! Purpose: [`Job`] has the surface and what may be done with it, the backend, the observer and the token; [`Laps`] has the times.
//! Invariant: none of a stage's results. Must not know: what a stage does.

use std::time::Instant;

use super::prepare::Asked;
use crate::mesh::TriMesh;
use crate::mesh::apart::Apart;
use crate::mesh::measure::Topology;
use crate::remesh::Observer;
use crate::remesh::report::Timings;
use crate::rvd::{Backend, elapsed_ms};
use crate::token::Token;

pub(super) struct Job<'a, 'b> {
    /// The input, preprocessed.
    pub(super) clean: &'a TriMesh,
    /// What was moved to have its sheets apart, if there are several, and whether they meet along curves.
    pub(super) apart: Option<&'a Apart>,
    pub(super) meet: bool,
    /// `clean` with its sheets apart.
    pub(super) separated: &'a TriMesh,
    pub(super) asked: Asked<'a>,
    pub(super) backend: &'b dyn Backend,
    pub(super) token: &'b Token,
    pub(super) observer: &'b mut dyn Observer,
    pub(super) laps: Laps,
    /// Whether edges become shorter where the surface is too thin for its cells.
    pub(super) keep_thin: bool,
    /// Whether seeds become fewer, for the number of vertices that was asked for.
    pub(super) scales_seeds: bool,
    /// Diagonal of the input's bounding box, caller's units.
    pub(super) diagonal: f64,
    /// What the result is to have.
    pub(super) topology: Topology,
    /// Whether the surface may be divided along its creases where it is too thin for its cells, and whether it is to be.
    pub(super) may_divide: bool,
    pub(super) wants_division: bool,
}

impl Job<'_, '_> {
    pub(super) fn enter(&mut self, stage: &'static str) {
        self.token.enter(stage);
        self.observer.stage(stage);
    }
}

/// A stopwatch, and the times of the stages. All in milliseconds.
pub(super) struct Laps {
    pub(super) begin: Instant,
    last: Instant,
    pub(super) timings: Timings,
}

impl Laps {
    pub(super) fn start() -> Self {
        let now = Instant::now();
        Self { begin: now, last: now, timings: Timings::default() }
    }

    /// Adds the time since the last call to a stage.
    pub(super) fn end(&mut self, stage: impl Fn(&mut Timings) -> &mut f64) {
        *stage(&mut self.timings) += elapsed_ms(self.last);
        self.last = Instant::now();
    }
}
