//! A queue of places to improve, by falling distance from the input.
//!
//! Purpose: where a ridge that is no crease runs between two vertices, the result is much farther from the input than
//! elsewhere, and a seed moved there leaves another place behind. [`improve_farthest`] flips edges and relocates vertices
//! around such a place.
//! Invariant: nothing becomes farther than the place was; no facet becomes worse than it should be, or than the worst one
//! there was; inner valences stay between 5 and 7 where they were. The same bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

use std::collections::BinaryHeap;

use glam::DVec3;
use rayon::prelude::*;

use super::context::{Context, distance_at};
use super::editor::{Exhausted, MeshEditor};
use super::patch::{LEAST_SCORE, Patch};

/// Places nearer than this share of the mean edge are left alone.
const NEAR_SHARE: f64 = 0.06;
/// Of places nearer than this share of the mean edge, [`MAX_MODERATE`] are improved at most.
const MODERATE_SHARE: f64 = 0.14;
const MAX_MODERATE: usize = 8;
/// A place is improved if its distance falls to this share of what it was.
const GAIN: f64 = 0.95;
/// The queue ends after so many places that could not be improved,
const MAX_FAILURES: usize = 8;
/// and after so many that were, plus this share of the vertices.
const MAX_IMPROVED: usize = 4;
const MAX_IMPROVED_SHARE: f64 = 0.001;
/// It also ends at places nearer than this share of one that could not be improved, as long as nothing changes there.
const FAILED_SHARE: f64 = 0.8;
/// A vertex is measured if its estimated distance is at least this share of [`NEAR_SHARE`] of its longest edge,
const ESTIMATE_SHARE: f64 = 0.65;
/// so many vertices at most.
const MAX_MEASURED: usize = 1000;
/// A place enters the queue again if its distance has fallen below this share of what it was when it entered.
const STALE_SHARE: f64 = 0.98;

/// Passes of relocation in a trial,
const PASSES: usize = 12;
/// of which so many come before the best trials are chosen, so many of them.
const FIRST_PASSES: usize = 3;
const FINALISTS: usize = 2;
/// If relocation alone brings a moderately far place nearer than this share, nothing else is tried there.
const EASY_SHARE: f64 = 0.85;
/// Trials that the first passes left at more than this share, lacking scores added, are dropped.
const HOPELESS_SHARE: f64 = 0.99;
/// A facet that lacks so many degrees of score counts as much as the distance of the place.
const SCORE_SCALE: f64 = 10.0;

/// A vertex, and how far the result is from the input around it.
struct Place {
    distance: f64,
    vertex: u32,
}

impl Ord for Place {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.distance.total_cmp(&other.distance).then(other.vertex.cmp(&self.vertex))
    }
}

impl PartialOrd for Place {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Place {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Place {}

/// Improves the places that are farthest from the input. `estimates` are the distances around each vertex, about. Returns how
/// many were improved.
pub(in crate::remesh) fn improve_farthest(editor: &mut MeshEditor<'_>, estimates: &[f64]) -> usize {
    let mut queue = first_places(&editor.context(), estimates);
    // Places that could not be improved and are as they were.
    let mut failed: Vec<Place> = Vec::new();
    let mut moderate_left = MAX_MODERATE;
    let mut exhausted = Exhausted::default();
    let mut left = MAX_IMPROVED + (MAX_IMPROVED_SHARE * estimates.len() as f64) as usize;
    let (mut failures, mut improved) = (0, 0);
    while let Some(place) = queue.pop() {
        let floor = failed.iter().map(|failed| FAILED_SHARE * failed.distance).fold(0.0, f64::max);
        if place.distance < floor || left == 0 || failures == MAX_FAILURES || editor.is_stopped() {
            break;
        }
        let v = place.vertex;
        if editor.is_exhausted(v, &exhausted) {
            continue;
        }
        let Some(patch) = Patch::around(&editor.context(), v) else { continue };
        let now = patch.distance().centre;
        if now < NEAR_SHARE * patch.mean_edge {
            continue;
        }
        if now < STALE_SHARE * place.distance {
            // A neighbouring place was improved.
            queue.push(Place { distance: now, vertex: v });
            continue;
        }
        let is_moderate = now < MODERATE_SHARE * patch.mean_edge;
        if is_moderate && moderate_left == 0 {
            break;
        }
        if let Some(better) = better(&patch) {
            editor.put_back(&better);
            improved += 1;
            left -= 1;
            moderate_left -= usize::from(is_moderate);
            // Often a place that failed is improved from a neighbouring vertex.
            failed.retain(|failed| editor.is_exhausted(failed.vertex, &exhausted));
            let inner: Vec<u32> = better.inner().collect();
            queue.extend(far_places(&editor.context(), inner));
        } else {
            editor.give_up(v, &mut exhausted);
            failures += 1;
            failed.push(Place { distance: now, vertex: v });
        }
    }
    improved
}

/// Vertices around which the result is far from the input, of those whose estimates are large.
fn first_places(context: &Context<'_>, estimates: &[f64]) -> BinaryHeap<Place> {
    let may_be_far = |(&distance, vertex): (&f64, u32)| {
        let p = context.positions[vertex as usize];
        let ring = context.rings.of(vertex).iter().flat_map(|&f| context.facets[f as usize]);
        let longest = ring.map(|u| context.positions[u as usize].distance(p)).fold(0.0, f64::max);
        (distance > ESTIMATE_SHARE * NEAR_SHARE * longest).then_some(Place { distance, vertex })
    };
    let mut candidates: Vec<Place> = estimates.iter().zip(0..).filter_map(may_be_far).collect();
    candidates.sort_by(|a, b| b.cmp(a));
    candidates.truncate(MAX_MEASURED);
    far_places(context, candidates.into_iter().map(|place| place.vertex).collect()).collect()
}

/// Those of some vertices around which the result is far from the input.
fn far_places(context: &Context<'_>, vertices: Vec<u32>) -> impl Iterator<Item = Place> + use<> {
    let measure = |vertex: u32| {
        if context.token.is_stopped() {
            return None;
        }
        let (distance, edge) = distance_at(context, vertex);
        (distance > NEAR_SHARE * edge).then_some(Place { distance, vertex })
    };
    let places: Vec<Option<Place>> = vertices.into_par_iter().map(measure).collect();
    places.into_iter().flatten()
}

/// What is done to a patch before its vertices are relocated.
enum Trial {
    /// Nothing.
    Relocate,
    /// A vertex goes to the input point that is farthest off.
    Jump(DVec3),
    /// An edge is flipped: facet and side of it.
    Flip(usize, usize),
}

/// The patch with its centre nearer to the input, if that can be had.
fn better(patch: &Patch) -> Option<Patch> {
    let now = patch.distance();
    let least = patch.worst_score().min(LEAST_SCORE);
    let (goal, sharpest) = (GAIN * now.centre, patch.sharpest_cosine());
    let mut trials = vec![Trial::Relocate];
    trials.extend(now.farthest_point.map(Trial::Jump));
    trials.extend(patch.flips().into_iter().map(|(f, side)| Trial::Flip(f, side)));
    let begin = |trial: &Trial| {
        let mut patch = patch.clone();
        let can = match *trial {
            Trial::Relocate => true,
            Trial::Jump(to) => patch.jump(to),
            Trial::Flip(f, side) => patch.flip(f, side),
        };
        if !can {
            return None;
        }
        patch.relax(now.centre, FIRST_PASSES);
        let then = patch.distance();
        let lack = (least - patch.worst_score()).max(0.0) / SCORE_SCALE;
        Some((then.largest() / now.centre + lack, patch))
    };
    let finish = |mut patch: Patch| {
        patch.relax(now.centre, PASSES);
        let then = patch.distance();
        let shaped = patch.worst_score() >= least && patch.sharpest_cosine() >= sharpest;
        let fine = shaped && then.centre <= goal && then.rest <= now.rest.max(goal);
        fine.then_some((patch, then.largest()))
    };
    if now.centre < MODERATE_SHARE * patch.mean_edge
        && let Some((easy, _)) =
            begin(&Trial::Relocate).filter(|b| b.0 < EASY_SHARE).and_then(|(_, patch)| finish(patch))
    {
        return Some(easy);
    }
    let begun: Vec<Option<(f64, Patch)>> = trials.par_iter().with_max_len(1).map(begin).collect();
    let mut begun: Vec<(f64, Patch)> = begun.into_iter().flatten().collect();
    // What the first passes do not move, later passes do not move either.
    begun.retain(|b| b.0 < HOPELESS_SHARE.max(now.rest / now.centre + 1e-9));
    begun.sort_by(|a, b| a.0.total_cmp(&b.0));
    begun.truncate(FINALISTS);
    let done: Vec<Option<(Patch, f64)>> =
        begun.into_par_iter().with_max_len(1).map(|(_, patch)| finish(patch)).collect();
    // The first of the best.
    done.into_iter().flatten().reduce(|a, b| if b.1 < a.1 { b } else { a }).map(|(patch, _)| patch)
}
