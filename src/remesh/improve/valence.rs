//! Recovery of curve edges, and of valences.
//!
//! Purpose: [`recover_edge`] restores an edge of a curve that the dual lacks, by one flip or two. [`improve_valences`] flips edges
//! at vertices with less than five or more than seven neighbours.
//! Invariant: facets stay as good as they should be, or as the worst one around was. The same bits whatever the number of
//! threads.
//! Must not know: seeds, diagrams, files.

use rayon::prelude::*;

use super::context::Context;
use super::editor::{Exhausted, MeshEditor};
use super::patch::{LEAST_SCORE, Patch};

/// The score that facets around a recovered edge are to have, degrees.
const RECOVERY_SCORE: f64 = 30.0;
/// Passes of relocation after the flips.
const PASSES: usize = 10;
/// Passes before the best flips for a valence are chosen, and how many are.
const FIRST_PASSES: usize = 3;
const FINALISTS: usize = 2;
/// A facet that lacks so many degrees of score counts as much as the largest distance allowed.
const SCORE_SCALE: f64 = 10.0;
/// Distances below this share of the mean edge are allowed in any case.
const FREE_DISTANCE: f64 = 0.02;
/// Vertices whose valence is improved, at most.
const MAX_VERTICES: usize = 500;

/// Makes the edge between two vertices by one flip or two, and keeps it from then on. Returns whether it is there.
pub(in crate::remesh) fn recover_edge(editor: &mut MeshEditor<'_>, ends: [u32; 2]) -> bool {
    let Some(patch) = Patch::around(&editor.context(), ends[0]) else { return false };
    let (least, sharpest) = (patch.worst_score().min(RECOVERY_SCORE), patch.sharpest_cosine());
    let mut joined = Vec::new();
    let mut join = |patch: &Patch| {
        for (f, side) in patch.flips_joining(ends[1]) {
            let mut patch = patch.clone();
            if patch.flip_for_recovery(f, side) {
                joined.push(patch);
            }
        }
    };
    join(&patch);
    for (f, side) in patch.edges_around() {
        let mut first = patch.clone();
        if first.flip_for_recovery(f, side) {
            join(&first);
        }
    }
    let relax = |patch: Patch| {
        let most = allowed_distance(&patch);
        relaxed(patch, most, least, sharpest)
    };
    let Some((_, patch)) = first_best(joined, relax) else { return false };
    editor.put_back(&patch);
    editor.keep(ends);
    true
}

/// Flips edges for valences, except where that is exhausted. Returns how many vertices are better.
pub(in crate::remesh) fn improve_valences(editor: &mut MeshEditor<'_>, exhausted: &mut Exhausted) -> usize {
    let irregular: Vec<u32> = editor.context().irregular().take(MAX_VERTICES).collect();
    editor.change_each(&irregular, exhausted, more_regular)
}

/// The patch around a vertex after a flip for its valence.
fn more_regular(context: &Context<'_>, v: u32) -> Option<Patch> {
    let patch = Patch::around(context, v)?;
    if patch.is_regular() {
        return None;
    }
    let most = allowed_distance(&patch);
    let (least, sharpest) = (patch.worst_score().min(LEAST_SCORE), patch.sharpest_cosine());
    let begin = |&(f, side): &(usize, usize)| {
        let mut flipped = patch.clone();
        let can = flipped.flip(f, side) && flipped.is_more_regular_than(&patch);
        can.then(|| {
            flipped.relax(most, FIRST_PASSES);
            let distance = flipped.distance().largest();
            let lack = (least - flipped.worst_score()).max(0.0) / SCORE_SCALE;
            (lack + (distance / most).max(1.0), flipped)
        })
    };
    let begun: Vec<Option<(f64, Patch)>> = patch.flips().par_iter().with_max_len(1).map(begin).collect();
    let mut begun: Vec<(f64, Patch)> = begun.into_iter().flatten().collect();
    begun.sort_by(|a, b| a.0.total_cmp(&b.0));
    begun.truncate(FINALISTS);
    let begun = begun.into_iter().map(|(_, flipped)| flipped).collect();
    first_best(begun, |flipped| relaxed(flipped, most, least, sharpest)).map(|(_, patch)| patch)
}

/// The distance that a patch may have after a change.
fn allowed_distance(patch: &Patch) -> f64 {
    patch.distance().largest().max(FREE_DISTANCE * patch.mean_edge)
}

/// The patch with its vertices relocated, and its least score. `None` if it is farther from the input than `most`, or its
/// shape or its folds are worse than they may be.
fn relaxed(mut patch: Patch, most: f64, least: f64, sharpest: f64) -> Option<(f64, Patch)> {
    patch.relax(most, PASSES);
    let (distance, worst) = (patch.distance().largest(), patch.worst_score());
    (worst >= least && patch.sharpest_cosine() >= sharpest && distance <= most).then_some((worst, patch))
}

/// The patch of the highest score that `relax` makes of some; the first of equal ones.
fn first_best(
    patches: Vec<Patch>,
    relax: impl Fn(Patch) -> Option<(f64, Patch)> + Send + Sync,
) -> Option<(f64, Patch)> {
    let relaxed: Vec<Option<(f64, Patch)>> = patches.into_par_iter().with_max_len(1).map(relax).collect();
    relaxed.into_iter().flatten().reduce(|a, b| if b.0 > a.0 { b } else { a })
}
