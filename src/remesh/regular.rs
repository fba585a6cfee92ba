//! Edges that the result should have, and valences.
//!
//! Purpose: a curve whose seeds the dual did not join gets its edge where turning one edge, or two, makes it; and
//! vertices with less than five or more than seven neighbours lose or win one where an edge can be turned for it.
//! Invariant: facets stay as good as they should be, or as the worst one around was. Deterministic.
//! Must not know: seeds, diagrams, files.

use rayon::prelude::*;

use super::mend::{Bench, Vain};
use super::patch::{LEAST, Patch, Scene};

/// Around an edge that was put in facets have at least this score, no angle below it.
const LEAST_AT_CURVES: f64 = 30.0;
/// Passes over the vertices of a patch,
const SWEEPS: usize = 10;
/// of which so many before the most promising ones of several are chosen, so many of them.
const FIRST_SWEEPS: usize = 3;
const FINISHED: usize = 2;
/// There an angle that a facet lacks, degrees, counts for as much as the farthest that a patch may be off.
const PROMISE: f64 = 10.0;
/// Distances below this share of an edge are nothing that a patch need mind.
const NEAR: f64 = 0.02;
/// Vertices whose valence is looked at, at most.
const MOST: usize = 500;

/// Puts the edge between two vertices in, if turning two edges does it, and keeps it. Returns whether it is there.
pub(super) fn insert(bench: &mut Bench<'_>, ends: [u32; 2]) -> bool {
    let Some(patch) = Patch::around(&bench.scene(), ends[0]) else { return false };
    let (least, sharpest) = (patch.worst().min(LEAST_AT_CURVES), patch.sharpest());
    let mut joined = Vec::new();
    let mut join = |patch: &Patch| {
        for (f, e) in patch.turns_to(ends[1]) {
            let mut patch = patch.clone();
            if patch.turn_anyhow(f, e) {
                joined.push(patch);
            }
        }
    };
    join(&patch);
    for (f, e) in patch.edges_around() {
        let mut first = patch.clone();
        if first.turn_anyhow(f, e) {
            join(&first);
        }
    }
    let settled: Vec<Option<(f64, Patch)>> =
        joined.into_par_iter().with_max_len(1).map(|patch| settled(patch, least, sharpest)).collect();
    // The first of the best.
    let best = settled.into_iter().flatten().reduce(|a, b| if b.0 > a.0 { b } else { a });
    let Some((_, patch)) = best else { return false };
    bench.put_back(&patch);
    bench.keep(ends);
    true
}

/// The patch after its vertices have settled and its least score, if that is fine.
fn settled(patch: Patch, least: f64, sharpest: f64) -> Option<(f64, Patch)> {
    let now = patch.distance();
    let most = now.middle.max(now.rest).max(NEAR * patch.edge());
    settled_within(patch, most, least, sharpest)
}

/// The same, no farther off than `most`.
fn settled_within(mut patch: Patch, most: f64, least: f64, sharpest: f64) -> Option<(f64, Patch)> {
    patch.relax(most, SWEEPS);
    let (then, worst) = (patch.distance(), patch.worst());
    (worst >= least && patch.sharpest() >= sharpest && then.middle.max(then.rest) <= most).then_some((worst, patch))
}

/// Turns edges for valences, not where that was `vain` before. Returns how many vertices are better.
pub(super) fn valences(bench: &mut Bench<'_>, vain: &mut Vain) -> usize {
    let irregular: Vec<u32> = bench.scene().irregular().take(MOST).collect();
    bench.change(&irregular, vain, more_regular)
}

/// The patch around a vertex after an edge was turned for its valence.
fn more_regular(scene: &Scene<'_>, v: u32) -> Option<Patch> {
    let patch = Patch::around(scene, v)?;
    if patch.is_regular() {
        return None;
    }
    let now = patch.distance();
    let most = now.middle.max(now.rest).max(NEAR * patch.edge());
    let (least, sharpest) = (patch.worst().min(LEAST), patch.sharpest());
    let begin = |&(f, e): &(usize, usize)| {
        let mut turned = patch.clone();
        let can = turned.turn(f, e) && turned.is_more_regular_than(&patch);
        can.then(|| {
            turned.relax(most, FIRST_SWEEPS);
            let far = turned.distance();
            ((least - turned.worst()).max(0.0) / PROMISE + (far.middle.max(far.rest) / most).max(1.0), turned)
        })
    };
    let begun: Vec<Option<(f64, Patch)>> = patch.turns().par_iter().with_max_len(1).map(begin).collect();
    let mut begun: Vec<(f64, Patch)> = begun.into_iter().flatten().collect();
    begun.sort_by(|a, b| a.0.total_cmp(&b.0));
    begun.truncate(FINISHED);
    let settled: Vec<Option<(f64, Patch)>> = begun
        .into_par_iter()
        .with_max_len(1)
        .map(|(_, turned)| settled_within(turned, most, least, sharpest))
        .collect();
    let best = settled.into_iter().flatten().reduce(|a, b| if b.0 > a.0 { b } else { a });
    best.map(|(_, patch)| patch)
}
