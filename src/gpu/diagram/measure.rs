//! Times the ways of adding pieces to the sums of their cells.
//!
//! Purpose: [`Gpu::measure_accumulation`]. Invariant: passes that are compared clip the same pairs; those that add directly and not
//! at all are one program. Must not know: what is printed.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use super::Gpu;
use super::layout::accumulate::{DIRECT, NOWHERE, TWO_PHASE};
use super::session::GpuSession;
use geometry::rvd::{RvdError, Session, SessionOptions, Surface, elapsed_ms};
use geometry::token::Token;

/// Milliseconds of each clip pass, by how its pieces were added.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AccumulationMs {
    /// Atomics to global memory.
    pub direct: Vec<f64>,
    /// Partial sums within workgroups first.
    pub two_phase: Vec<f64>,
    /// Clipped and integrated, but not added.
    pub without: Vec<f64>,
}

impl Gpu {
    /// Times `passes` passes of each kind over the same seeds (unit frame), in turn, so that what
    /// else the machine does falls on all alike. One more of each goes before.
    pub fn measure_accumulation(
        &self,
        surface: Arc<Surface>,
        seeds: &[DVec3],
        options: SessionOptions,
        passes: usize,
        token: &Token,
    ) -> Result<AccumulationMs, RvdError> {
        self.pool.install(|| {
            let mut session = GpuSession::new(self, surface, options);
            session.set_seeds(seeds)?;
            // Facets that are done as a whole are added directly only.
            session.clip.divides = false;
            let mut stats = session.begin_pass(token)?;
            let mut out = AccumulationMs::default();
            for pass in 0..=passes {
                let kinds = [(DIRECT, &mut out.direct), (TWO_PHASE, &mut out.two_phase), (NOWHERE, &mut out.without)];
                for (code, times) in kinds {
                    session.clip.accumulate = code;
                    let begin = Instant::now();
                    session.run_sums(token, &mut stats)?;
                    if pass > 0 {
                        times.push(elapsed_ms(begin));
                    }
                }
            }
            Ok(out)
        })
    }
}
