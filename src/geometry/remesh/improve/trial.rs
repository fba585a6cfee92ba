//! Trials on a patch.
//!
//! Purpose: a patch is changed in several ways ([`Trial`]), its vertices are relocated each time, and the best that reaches a
//! [`Goal`] is taken ([`best`]). After a few passes the most promising go on, until one is there.
//! Invariant: a patch that does not reach the goal is never taken. The same bits whatever the number of threads.
//! Must not know: why a patch is to be changed.

use glam::DVec3;
use rayon::prelude::*;

use super::objective::VertexObjective;
use super::patch::{Patch, PatchDistance};
use super::{cheapest, places_around};
use crate::remesh::constants::*;
use crate::remesh::manifold::Flip;

/// What is done to a patch before its vertices are relocated.
#[derive(Clone, Debug)]
pub(super) enum Trial {
    Relocate,
    /// A vertex goes to the input point that is farthest off.
    Jump(DVec3),
    /// Edges are flipped, one after the other.
    Flip(Vec<Flip>),
}

/// What a changed patch has to come to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Goal {
    /// Distances from the input, at most.
    pub(super) centre: f64,
    pub(super) rest: f64,
    /// The least score, at least: around the centre, and elsewhere.
    pub(super) scores: [f64; 2],
    /// The least cosine between two neighbours, at least.
    pub(super) cosine: f64,
}

impl Goal {
    fn is_reached(&self, patch: &Patch) -> bool {
        let distance = patch.distance();
        distance.centre <= self.centre
            && distance.rest <= self.rest
            && patch.worst_scores().iter().zip(self.scores).all(|(score, least)| *score >= least)
            && patch.sharpest_cosine() >= self.cosine
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Measure {
    /// The distance that counts as 1 beside what the worst facet lacks.
    pub(super) distance: f64,
    /// Distances below this share of it count as if they were as large.
    pub(super) floor: f64,
    /// What the worst facet lacks of this score counts.
    pub(super) score: f64,
}

/// A changed patch, and its measure. Lower is better.
struct Tried {
    measure: f64,
    distance: PatchDistance,
    patch: Patch,
}

/// Relocates the vertices of a patch, the centre first, in at most `passes` passes. `worst` is the distance that costs 1.
fn relax(patch: &mut Patch, worst: f64, passes: usize) {
    for _ in 0..passes {
        let mut tried = false;
        for k in 0..patch.movable.len() {
            let v = patch.movable[k];
            let Some(share) = patch.steps.next(v) else { continue };
            if patch.token.is_stopped() {
                return;
            }
            tried = true;
            let to = better_place(patch, v, worst, share * FIRST_STEP * patch.mean_edge);
            if to == patch.mesh.positions[v as usize] {
                patch.steps.halve(v);
            } else {
                patch.put(v, to);
            }
        }
        if !tried {
            return;
        }
    }
}

fn better_place(patch: &Patch, v: u32, worst: f64, step: f64) -> DVec3 {
    let mut objective = VertexObjective::new(patch, v, worst, step);
    let (here, start) = (patch.mesh.positions[v as usize], patch.start[v as usize]);
    let (x, y) = patch.mesh.vertex_normal(v).any_orthonormal_pair();
    let within = |p: &DVec3| p.distance(start) <= FARTHEST_MOVE * patch.mean_edge;
    let places = places_around(here, step, [x, y]).filter(within);
    cheapest((objective.cost_here(step), here), LEAST_GAIN, places, |p, most| objective.cost(p, most)).1
}

/// The patch as a trial begins with it. `None` if the trial is impossible.
fn begin(patch: &Patch, trial: &Trial) -> Option<Patch> {
    let mut patch = patch.clone();
    match trial {
        Trial::Jump(to) if !patch.jump(*to) => return None,
        Trial::Relocate | Trial::Jump(_) => {}
        Trial::Flip(flips) => flips.iter().for_each(|flip| patch.flip(flip)),
    }
    Some(patch)
}

/// What the most promising trial makes of a patch that reaches the goal. `None` if none does.
pub(super) fn best(patch: &Patch, trials: &[Trial], goal: &Goal, measure: Measure) -> Option<Patch> {
    // The best first.
    let relaxed = |patches: Vec<Patch>, passes: usize| {
        let relaxed = |mut patch: Patch| {
            relax(&mut patch, measure.distance, passes);
            let distance = patch.distance();
            let lack = (measure.score - patch.worst_score()).max(0.0) / TRIAL_SCORE_SCALE;
            Tried { measure: lack + (distance.largest() / measure.distance).max(measure.floor), distance, patch }
        };
        let mut tried: Vec<Tried> = patches.into_par_iter().with_max_len(1).map(relaxed).collect();
        tried.sort_by(|a, b| a.measure.total_cmp(&b.measure));
        tried
    };
    let begun = trials.iter().filter_map(|trial| begin(patch, trial)).collect();
    let promising = relaxed(begun, FIRST_PASSES).into_iter().take(PROMISING_TRIALS).map(|tried| tried.patch);
    let tried = relaxed(promising.collect(), FURTHER_PASSES);
    let hopeless = HOPELESS_SHARE.max(goal.centre.max(goal.rest) / measure.distance);
    let is_hopeful = |tried: &Tried| tried.distance.largest() <= hopeless * measure.distance;
    let mut finalists = tried.into_iter().filter(is_hopeful).take(FINALISTS);
    finalists.find_map(|Tried { mut patch, .. }| {
        relax(&mut patch, measure.distance, LAST_PASSES);
        goal.is_reached(&patch).then_some(patch)
    })
}
