//! The strategies of \[HYWZ17\] that exist to be measured.
//!
//! Purpose: selects them, in every build with a GPU: [`Tuning`](geometry::rvd::Tuning) in the library, `tessera bench rvd
//! --strategy cell|auto --accumulate two-phase` at the command. [`by_cell`] chooses the facets whose pairs are found by cell
//! (`clip/by_cell.rs`, shaders `clip/reach` and `clip/verify`), [`adding`] how pieces reach the sums of their cells
//! (`shaders/shared/accumulate.wgsl`). [`Gpu::measure_accumulation`] times each way of adding.
//! Invariant: no strategy changes a bit of a result. Passes that are compared clip the same pairs; those that add directly and
//! not at all are one program. Must not know: what is printed.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use super::Gpu;
use super::layout::accumulate::{DIRECT, NOWHERE, TWO_PHASE};
use super::session::GpuSession;
use geometry::rvd::{Accumulate, CELLS_PER_FACET, RvdError, Session, SessionOptions, Strategy, Surface, elapsed_ms};
use geometry::token::Token;

/// Facets whose pairs are found by cell.
pub(super) fn by_cell(expected: &[f64], strategy: Strategy) -> Vec<u32> {
    let least = match strategy {
        Strategy::Facet => return Vec::new(),
        Strategy::Cell => 0.0,
        Strategy::Auto => CELLS_PER_FACET,
    };
    (0..expected.len() as u32).filter(|&f| expected[f as usize] > least).collect()
}

/// Code of the way in which pieces are added.
pub(super) fn adding(how: Accumulate) -> u32 {
    match how {
        Accumulate::Direct | Accumulate::Auto => DIRECT,
        Accumulate::TwoPhase => TWO_PHASE,
    }
}

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
    ///
    /// # Errors
    /// Those of a pass.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strategies_choose_facets() {
        let expected = [0.0, 3.0, 20.0, 20.5];
        assert!(by_cell(&expected, Strategy::Facet).is_empty());
        assert_eq!(by_cell(&expected, Strategy::Cell), [1, 2, 3]);
        assert_eq!(by_cell(&expected, Strategy::Auto), [3]);
    }
}
