//! The queue of places to improve.
//!
//! Purpose: [`improve`] takes irregular vertices, then places far from the input by falling distance, and tries flips and relocations
//! around each. [`round_off`] does so where the worst facets are. [`recover_edge`] restores an edge of a curve that the dual lacks.
//! Invariant: nothing becomes farther from the input than it was, or than is allowed anywhere; no facet becomes worse than it
//! should be, or than the worst one there was; inner valences stay between 5 and 7 where they were. Independent places are
//! improved at the same time, with the same bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

use std::collections::{HashMap, HashSet};

use super::patch::Patch;
use super::trial::{Goal, Measure, Trial, best};
use super::{Context, MeshEditor, Place, Queue, distance_at};
use crate::mesh::facet_set::squared_distance;
use crate::remesh::constants::*;
use crate::remesh::manifold::Flip;
use crate::remesh::triangle::{Shapes, score};
use crate::tasks;

/// What is wrong at a place. The later ones come first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Defect {
    /// A facet there is worse than it could be; badness is what its score lacks.
    Poor,
    /// The result is far from the input; badness is the distance.
    Far,
    /// The valence is not from 5 to 7; badness is by how much.
    Irregular,
}

enum Outcome {
    Fine,
    /// It is less bad than it was; so much.
    Less(f64),
    Better(Box<Patch>),
    /// There is none. How bad the place is.
    Failed(f64),
}

/// Improves places while that helps: irregular vertices only where facets are to be round. `estimates` are about the distances
/// around each vertex. Returns how many it improved.
pub(crate) fn improve(editor: &mut MeshEditor<'_>, estimates: &[f64]) -> usize {
    let share = (MAX_IMPROVED_SHARE * estimates.len() as f64) as usize;
    let mut run = Run { far_left: MAX_IMPROVED + share, failures_left: MAX_FAILURES, ..Run::default() };
    run.push_far(first_far(&editor.context(), estimates), 0);
    for _ in 0..QUEUE_ROUNDS {
        let before = run.improved;
        if editor.context().shapes == Shapes::Round {
            run.queue.extend(irregular(&editor.context()).take(MAX_IRREGULAR));
        }
        run.take_all(editor);
        if run.improved == before {
            break;
        }
    }
    run.improved
}

/// Makes the worst facets of an even result better. Returns how many places it improved.
pub(crate) fn round_off(editor: &mut MeshEditor<'_>) -> usize {
    let mut poor: Vec<Place<Defect>> = poor(&editor.context()).collect();
    poor.sort_unstable_by(|a, b| b.cmp(a));
    let vertices = editor.context().mesh.positions.len();
    poor.truncate(MAX_POOR + (MAX_POOR_SHARE * vertices as f64) as usize);
    let mut run = Run { queue: poor.into(), ..Run::default() };
    run.take_all(editor);
    run.improved
}

/// Makes the edge between two vertices by one flip or two, and keeps it from then on. Returns whether it is there. An edge that `must` be
/// there may cost shape and distance.
pub(crate) fn recover_edge(editor: &mut MeshEditor<'_>, [a, b]: [u32; 2], must: bool) -> bool {
    recovered(editor, [a, b], false) || must && (recovered(editor, [a, b], true) || recovered(editor, [b, a], true))
}

/// As [`recover_edge`], in the patch around the first end.
fn recovered(editor: &mut MeshEditor<'_>, ends: [u32; 2], must: bool) -> bool {
    let Some(patch) = Patch::around(&editor.context(), ends[0]) else { return false };
    let Ok(to) = patch.vertices.binary_search(&ends[1]) else { return false };
    let valences = if must { NECESSARY_VALENCES } else { RECOVERY_VALENCES };
    let joins = |patch: &Patch, before: &[_]| {
        let joins = |flip: &Flip| [patch.centre, to as u32].iter().all(|end| flip.corners[0].contains(end));
        let flips = patch.flips(valences).into_iter().filter(joins);
        flips.map(|flip| Trial::Flip([before, &[flip]].concat())).collect::<Vec<Trial>>()
    };
    let mut trials = joins(&patch, &[]);
    for flip in patch.flips(valences) {
        let mut first = patch.clone();
        first.flip(&flip);
        trials.extend(joins(&first, &[flip]));
    }
    let (score, distance) = if must { (NECESSARY_SCORE, patch.mean_edge) } else { (RECOVERY_SCORE, 0.0) };
    let Some(better) = best_allowed(&patch, &trials, patch.worst_score().min(score), distance) else { return false };
    editor.put_back(&better);
    editor.mesh.keep(ends);
    true
}

/// The best of trials that keeps within what is allowed anywhere or a distance, with this least score.
fn best_allowed(patch: &Patch, trials: &[Trial], score: f64, distance: f64) -> Option<Patch> {
    let allowed = patch.start_distance.largest().max(FREE_DISTANCE * patch.mean_edge).max(distance);
    let goal = Goal { centre: allowed, rest: allowed, scores: [score; 2], cosine: patch.sharpest_cosine() };
    best(
        patch,
        trials,
        &goal,
        Measure { distance: allowed, floor: 1.0, score: patch.shapes.least_score() + SCORE_MARGIN },
    )
}

/// The queue, and what is left of the budgets.
#[derive(Default)]
struct Run {
    queue: Queue<Defect>,
    /// What is known of far places: their distance, and how many edits there were when it was measured.
    known: HashMap<u32, (f64, u32)>,
    /// Where nothing better was found, with the number of edits by then.
    exhausted: HashMap<(Defect, u32), u32>,
    /// Far places that could not be improved and are as they were.
    failed: Vec<Place<Defect>>,
    far_left: usize,
    failures_left: usize,
    improved: usize,
    /// Outcomes of far places that are not the next ones, each with the number of edits by then.
    ahead: HashMap<Place<Defect>, (u32, Outcome)>,
}

impl Run {
    fn push_far(&mut self, places: Vec<Place<Defect>>, edits: u32) {
        self.known.extend(places.iter().map(|place| (place.vertex(), (place.badness(), edits))));
        self.queue.extend(places);
    }

    /// Whether a place need not be looked at: nothing better was found there, or it is known to be another one by now.
    fn is_idle(&self, editor: &MeshEditor<'_>, place: &Place<Defect>) -> bool {
        let floor = self.failed.iter().map(|failed| FAILED_SHARE * failed.badness()).fold(0.0, f64::max);
        let is_old = |known: &(f64, u32)| known.0 != place.badness();
        let no_more = place.badness() < floor || self.far_left == 0 || self.failures_left == 0;
        place.kind == Defect::Far && (no_more || self.known.get(&place.vertex()).is_some_and(is_old))
            || is_exhausted(&self.exhausted, editor, place)
    }

    fn take_all(&mut self, editor: &mut MeshEditor<'_>) {
        loop {
            let mut batch = self.next_batch(editor);
            let Some(&first) = batch.first() else { return };
            if editor.context().token.is_stopped() {
                return;
            }
            self.ahead.retain(|place, (then, _)| !editor.has_changed(place.vertex(), *then));
            if !self.ahead.contains_key(&first) {
                let new: Vec<Place<Defect>> = batch.iter().copied().filter(|p| !self.ahead.contains_key(p)).collect();
                let made: Vec<Outcome> = tasks::alone(new.len(), |k| self.attempt(editor, &new[k]));
                self.ahead.extend(new.into_iter().zip(made.into_iter().map(|outcome| (editor.edits, outcome))));
            }
            // What a far place comes to may change which is the next one.
            self.queue.extend(batch.drain(if first.kind == Defect::Far { 1 } else { batch.len() }..));
            for place in batch {
                if let Some((_, outcome)) = self.ahead.remove(&place) {
                    self.take(editor, place, outcome);
                }
            }
        }
    }

    fn attempt(&self, editor: &MeshEditor<'_>, place: &Place<Defect>) -> Outcome {
        let (context, vertex) = (editor.context(), place.vertex());
        let then = self.known.get(&vertex).map_or(0, |known| known.1);
        if place.kind == Defect::Far && editor.has_changed(vertex, then) {
            let now = distance_at(&context, vertex).0;
            if now < STALE_SHARE * place.badness() {
                return Outcome::Less(now);
            }
        }
        let Some(patch) = Patch::around(&context, vertex) else { return Outcome::Fine };
        match place.kind {
            Defect::Irregular => attempt_irregular(&patch, place.badness()),
            Defect::Poor => attempt_poor(patch, place.badness()),
            Defect::Far => attempt_far(&patch, place.badness()),
        }
    }

    /// The worst places of one kind whose patches are independent. Far places are taken one by one: those after the first are
    /// for threads that would have nothing to do.
    fn next_batch(&mut self, editor: &MeshEditor<'_>) -> Vec<Place<Defect>> {
        let (mut claimed, mut batch, mut waiting) = (HashSet::new(), Vec::new(), Vec::new());
        let threads = rayon::current_num_threads();
        let mut kind = None;
        while let Some(&place) = self.queue.peek() {
            let first = *kind.get_or_insert(place.kind);
            let [most, look_ahead] =
                if first == Defect::Far { [threads, FAR_LOOK_AHEAD * threads] } else { [PATCHES_AT_ONCE, LOOK_AHEAD] };
            if place.kind != first || batch.len() == most || batch.len() + waiting.len() >= look_ahead {
                break;
            }
            self.queue.pop();
            let is_ahead = first == Defect::Far && !batch.is_empty();
            if self.is_idle(editor, &place) {
                kind = kind.filter(|_| !batch.is_empty());
                // It may not be idle any more when it is the first.
                waiting.extend(is_ahead.then_some(place));
            } else if editor.claim(place.vertex(), &mut claimed) {
                batch.push(place);
            } else {
                waiting.push(place);
            }
        }
        self.queue.extend(waiting);
        batch
    }

    fn take(&mut self, editor: &mut MeshEditor<'_>, place: Place<Defect>, outcome: Outcome) {
        let is_far = place.kind == Defect::Far;
        match outcome {
            Outcome::Fine => {}
            Outcome::Less(now) if is_far => {
                self.push_far(vec![Place::new(place.kind, place.vertex(), now)], editor.edits);
            }
            Outcome::Less(now) => self.queue.push(Place::new(place.kind, place.vertex(), now)),
            Outcome::Better(patch) => {
                editor.put_back(&patch);
                self.improved += 1;
                self.far_left = self.far_left.saturating_sub(usize::from(is_far));
                // Often a place that failed is improved from a neighbouring vertex.
                self.failed.retain(|failed| is_exhausted(&self.exhausted, editor, failed));
                if place.kind == Defect::Poor {
                    // What is left of it is tried once more.
                    self.queue.push(place);
                } else {
                    self.push_far(far(&editor.context(), patch.inner().collect()), editor.edits);
                }
            }
            Outcome::Failed(badness) => {
                self.exhausted.insert((place.kind, place.vertex()), editor.edits);
                if is_far {
                    self.failures_left = self.failures_left.saturating_sub(1);
                    self.failed.push(Place::new(place.kind, place.vertex(), badness));
                }
            }
        }
    }
}

/// Whether nothing better was found at a place, and nothing there has changed since.
fn is_exhausted(exhausted: &HashMap<(Defect, u32), u32>, editor: &MeshEditor<'_>, place: &Place<Defect>) -> bool {
    exhausted.get(&(place.kind, place.vertex())).is_some_and(|&then| !editor.has_changed(place.vertex(), then))
}

/// Tries to make a vertex more regular by a flip.
fn attempt_irregular(patch: &Patch, before: f64) -> Outcome {
    let irregularity = |patch: &Patch| patch.mesh.irregularity(patch.centre);
    let trials = patch.flips(VALENCES).into_iter().filter(|flip| {
        let mut flipped = patch.clone();
        flipped.flip(flip);
        irregularity(&flipped) < irregularity(patch)
    });
    let trials: Vec<Trial> = trials.map(|flip| Trial::Flip(vec![flip])).collect();
    let score = if patch.mesh.is_on_curve(patch.centre) { CURVE_SCORE } else { LEAST_SCORE };
    match best_allowed(patch, &trials, patch.worst_score().min(score), 0.0) {
        _ if irregularity(patch) == 0 => Outcome::Fine,
        Some(better) => Outcome::Better(Box::new(better)),
        None => Outcome::Failed(before),
    }
}

fn attempt_far(patch: &Patch, before: f64) -> Outcome {
    let now = patch.start_distance;
    let distance = now.centre;
    if distance < NEAR_SHARE * patch.mean_edge {
        return Outcome::Fine;
    }
    if distance < STALE_SHARE * before {
        // A neighbouring place was improved.
        return Outcome::Less(distance);
    }
    let centre = GAIN * distance;
    let score = patch.worst_score().min(patch.shapes.least_score());
    let goal = Goal { centre, rest: now.rest.max(centre), scores: [score; 2], cosine: patch.sharpest_cosine() };
    let measure = Measure { distance, floor: 0.0, score };
    let mut trials = vec![Trial::Relocate];
    trials.extend(now.farthest_point.map(Trial::Jump));
    let mut flips = patch.flips(VALENCES);
    if let Some(p) = now.farthest_point {
        let nearness = |t: [u32; 3]| squared_distance(p, patch.mesh.places(t));
        let nearness = |flip: &Flip| nearness(flip.corners[0]).min(nearness(flip.corners[1]));
        flips.sort_by(|a, b| nearness(a).total_cmp(&nearness(b)));
    }
    flips.truncate(MAX_FLIPS);
    trials.extend(flips.into_iter().map(|flip| Trial::Flip(vec![flip])));
    match best(patch, &trials, &goal, measure) {
        Some(better) => Outcome::Better(Box::new(better)),
        None => Outcome::Failed(distance),
    }
}

/// Tries to make the worst facet around a vertex better, and none worse than that.
fn attempt_poor(mut patch: Patch, before: f64) -> Outcome {
    let [centre, rest] = patch.worst_scores();
    let lack = GOOD_SCORE - centre;
    if lack <= 0.0 {
        return Outcome::Fine;
    }
    if lack < STALE_SHARE * before {
        return Outcome::Less(lack);
    }
    let largest = patch.start_distance.largest();
    if largest > POOR_FAR * patch.mean_edge {
        return Outcome::Failed(lack);
    }
    let allowed = largest.max(POOR_DISTANCE * patch.mean_edge);
    let better = (centre + LEAST_SCORE_GAIN).min(GOOD_SCORE);
    let goal =
        Goal { centre: allowed, rest: allowed, scores: [better, rest.min(better)], cosine: patch.sharpest_cosine() };
    patch.wanted_score = GOOD_SCORE + SCORE_MARGIN;
    let measure = Measure { distance: allowed, floor: 1.0, score: patch.wanted_score };
    // Flips are tried where a relocation is not enough.
    let flipped = || {
        let trials: Vec<Trial> = patch.flips(VALENCES).into_iter().map(|flip| Trial::Flip(vec![flip])).collect();
        best(&patch, &trials, &goal, measure)
    };
    match best(&patch, &[Trial::Relocate], &goal, measure).or_else(flipped) {
        Some(better) => Outcome::Better(Box::new(better)),
        None => Outcome::Failed(lack),
    }
}

/// Vertices that may move, have a facet that could be better, and no neighbour on a curve.
fn poor<'a>(context: &Context<'a>) -> impl Iterator<Item = Place<Defect>> + use<'a> {
    let Context { mesh, movable, .. } = *context;
    let worst = move |v: u32| mesh.ring(v).iter().map(|&f| score(mesh.corners(f))).fold(f64::INFINITY, f64::min);
    let is_apart = move |v: u32| !mesh.neighbours(v).into_iter().any(|u| mesh.is_on_curve(u));
    let all = (0..mesh.positions.len() as u32).filter(move |&v| movable[v as usize] && is_apart(v));
    let lacks = all.map(move |v| (v, GOOD_SCORE - worst(v))).filter(|(_, lack)| *lack > 0.0);
    lacks.map(|(v, lack)| Place::new(Defect::Poor, v, lack))
}

/// Inner vertices with less than 5 or more than 7 neighbours.
fn irregular<'a>(context: &Context<'a>) -> impl Iterator<Item = Place<Defect>> + use<'a> {
    let mesh = context.mesh;
    let off = (0..mesh.positions.len() as u32).map(|v| (v, mesh.irregularity(v))).filter(|(_, off)| *off > 0);
    off.map(|(vertex, off)| Place::new(Defect::Irregular, vertex, off as f64))
}

/// Vertices around which the result is far from the input, of those whose estimates are large.
fn first_far(context: &Context<'_>, estimates: &[f64]) -> Vec<Place<Defect>> {
    let mesh = context.mesh;
    let may_be_far = |(&badness, vertex): (&f64, u32)| {
        let p = mesh.positions[vertex as usize];
        let ring = mesh.ring(vertex).iter().flat_map(|&f| mesh.corners(f));
        let longest = ring.map(|q| q.distance(p)).fold(0.0, f64::max);
        (badness > ESTIMATE_SHARE * NEAR_SHARE * longest).then_some(Place::new(Defect::Far, vertex, badness))
    };
    let mut candidates: Vec<Place<Defect>> = estimates.iter().zip(0..).filter_map(may_be_far).collect();
    candidates.sort_unstable_by(|a, b| b.cmp(a));
    candidates.truncate(MAX_MEASURED);
    far(context, candidates.into_iter().map(|place| place.vertex()).collect())
}

/// Those of some vertices around which the result is far from the input.
fn far(context: &Context<'_>, vertices: Vec<u32>) -> Vec<Place<Defect>> {
    let measure = |k: usize| {
        let vertex = vertices[k];
        if context.token.is_stopped() {
            return None;
        }
        let (badness, edge) = distance_at(context, vertex);
        (badness > NEAR_SHARE * edge).then_some(Place::new(Defect::Far, vertex, badness))
    };
    tasks::flat_map(vertices.len(), measure)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::mesh::TriMesh;
    use crate::mesh::csr::Csr;
    use crate::remesh::distance::Reference;
    use crate::remesh::improve::shapes::Mobility;
    use crate::remesh::manifold::LocalMesh;
    use crate::rvd::Surface;
    use crate::token::Token;
    use glam::DVec3;

    #[test]
    fn an_edge_that_has_to_be_there_costs_shape() {
        // The edge 0-1 leaves a facet of 9 degrees.
        let places = [[0.0, 0.0], [2.0, 0.0], [1.0, 0.15], [1.0, -1.0]];
        let positions: Vec<DVec3> = places.map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec();
        let mesh = TriMesh::new(positions, vec![[0, 3, 2], [3, 1, 2]]).unwrap();
        let surface = Surface::new(&mesh, None).unwrap();
        let all: Vec<u32> = (0..8).map(|k| k / 2).collect();
        let facets = Csr::group(4, &all, |k| k as u32 % 2);
        let vertices = Csr::group(4, &[0, 1, 2, 3], |v| surface.positions()[v]);
        let (reference, token) = (Reference { surface: &surface, facets, vertices }, Token::default());
        for (must, ends) in [(false, [0, 1]), (true, [0, 1]), (true, [1, 0])] {
            let mut local = LocalMesh::new(surface.positions().to_vec(), mesh.facets().to_vec(), HashSet::new());
            let mut editor = MeshEditor::new(&mut local, &[Mobility::Fixed; 4], Shapes::Round, &reference, &token);
            assert_eq!(recover_edge(&mut editor, ends, must), must);
            assert_eq!(local.facets().iter().all(|t| t.contains(&0) && t.contains(&1)), must);
        }
    }
}
