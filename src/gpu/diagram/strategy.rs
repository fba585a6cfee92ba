//! The strategies of \[HYWZ17\] that exist to be measured.
//!
//! Purpose: selects them, in every build with a GPU: [`Tuning`](geometry::rvd::Tuning) in the library, `tessera bench rvd
//! --strategy cell|auto --accumulate two-phase` at the command. [`by_cell`] chooses the facets whose pairs are found by cell
//! (`clip/by_cell.rs`, shaders `clip/reach` and `clip/verify`), [`adding`] how pieces reach the sums of their cells
//! (`shaders/shared/accumulate.wgsl`). `Gpu::measure_accumulation` times each way of adding.
//! Invariant: no strategy changes a bit of a result. Must not know: sessions.

use super::layout::accumulate::{DIRECT, TWO_PHASE};
use geometry::rvd::{Accumulate, CELLS_PER_FACET, Strategy};

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
