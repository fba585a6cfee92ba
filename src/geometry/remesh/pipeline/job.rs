//! What all attempts at one remesh share.
//!
//! Purpose: [`Job`] has the surface, the backend, the listener and the clock.
//! Invariant: the times of the stages add up over all attempts. Must not know: what a stage does.

use std::time::Instant;

use crate::mesh::TriMesh;
use crate::mesh::measure::Topology;
use crate::remesh::Observer;
use crate::remesh::report::Timings;
use crate::rvd::Backend;
use crate::token::Token;

pub(super) struct Job<'a, 'b> {
    /// The input, preprocessed, its components apart.
    pub(super) separated: &'a TriMesh,
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
    /// Topology of the input.
    pub(super) topology: Topology,
}

impl Job<'_, '_> {
    pub(super) fn enter(&mut self, stage: &'static str) {
        self.token.enter(stage);
        self.observer.stage(stage);
    }
}

/// A stopwatch, and the times of the stages. All in milliseconds.
pub(super) struct Laps {
    begin: Instant,
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
        *stage(&mut self.timings) += self.last.elapsed().as_secs_f64() * 1e3;
        self.last = Instant::now();
    }

    pub(super) fn total(&self) -> f64 {
        self.begin.elapsed().as_secs_f64() * 1e3
    }
}
