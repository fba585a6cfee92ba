//! Device bytes of a session, from numbers alone.
//!
//! Purpose: [`session_bytes`] fills the [`Plan`] that allocates with what a session would count, before there is a surface. Facets
//! are taken as equilateral, of one size and in one window. Long or uneven facets meet more cells; capacities grow then, and so
//! does the session.
//! Invariant: monotone in both counts; never overflows. The layout of buffers is the plan's alone.
//! Must not know: the device, the surface, jobs.

use super::layout::{LONGER, MOST_REQUEUED, STRIDE};
use super::neighbours::grid;
use super::pipelines::SLOTS;
use super::plan::{Counts, Moved, OptimizerPlan, Plan, grid_cells, grid_side};
use crate::SessionForecast;
use geometry::rvd::Capacities;

/// Pairs that a list of the session's first size has beside those that are expected.
const SPARE_PAIRS: u64 = 1024;
/// Pairs whose pieces one dispatch writes.
const EMITTED: u64 = 1 << 16;
/// Area of the surface in the unit box: that of a thin one, which needs a finer grid.
const AREA: f64 = 1.0;

pub(crate) fn session_bytes(forecast: &SessionForecast) -> u64 {
    let &SessionForecast { facets, seeds, graded, moved, lifted } = forecast;
    // Sessions of lifted surfaces leave room for some more seeds.
    let seeds = if lifted { seeds.saturating_add(seeds / 8) } else { seeds };
    let capacities = Capacities::default();
    let row = (capacities.neighbours as u64).max(STRIDE.into());
    let side = if graded || lifted { grid::finest_side(seeds) } else { grid_side(AREA, seeds) };
    let pairs = expected_pairs(facets, seeds);
    // A set of cells has room for twice the cells that are expected, made a power of two.
    let slots = pairs.saturating_mul(3).max(facets.saturating_mul(capacities.cells as u64));
    let pairs = pairs.saturating_add(pairs / 2).saturating_add(SPARE_PAIRS);
    let counts = Counts {
        lifted,
        facets,
        held: facets,
        window: facets,
        windows: 1,
        seeds,
        table: seeds
            .saturating_mul(row)
            .saturating_add((seeds / 4).saturating_mul(row))
            .saturating_add((MOST_REQUEUED * LONGER).into()),
        slots,
        pairs,
        emitted: pairs.min(EMITTED),
        polygon: SLOTS as u64,
        near: 0,
        cells: grid_cells(side),
        listed: if lifted { 0 } else { seeds },
    };
    let optimizer_bytes = if moved { OptimizerPlan::of(Moved { lifted, seeds }).total_bytes() } else { 0 };
    Plan::of(counts).total_bytes().saturating_add(optimizer_bytes)
}

/// What `records::expected_cells` adds up to over equilateral facets of one size: F + N + 4.1 √(F N).
fn expected_pairs(facets: u64, seeds: u64) -> u64 {
    let along_edges = 4.1 * (facets as f64).sqrt() * (seeds as f64).sqrt();
    facets.saturating_add(seeds).saturating_add(along_edges as u64)
}
