//! The few places that are farthest from the input, brought nearer.
//!
//! Purpose: where a ridge that is no crease runs between two vertices, or a tip lies between some, the result is
//! much farther from the input than elsewhere, and seeds that are moved there leave another place behind. Here
//! edges around such a place are turned, and its vertices moved, the farthest place first.
//! Invariant: nothing gets farther than the place that was mended, no facet gets worse than it should be or
//! than the worst one there was, valences stay between 5 and 7 where they were. Deterministic.
//! Must not know: seeds, diagrams, files.

use std::collections::{BinaryHeap, HashMap, HashSet};

use glam::DVec3;
use rayon::prelude::*;

use super::ground::Ground;
use super::patch::{LEAST, Patch, Scene, distance_at};
use super::polish::Rail;
use super::stars::Stars;
use crate::mesh::csr::Csr;
use crate::mesh::edges::undirected;
use crate::token::Token;

/// Places nearer than this share of an edge are left alone,
const FAR: f64 = 0.06;
/// and of those nearer than this share so many are mended, at most.
const NOT_SO_FAR: f64 = 0.14;
const FEW: usize = 8;
/// A place is mended if it comes nearer by this factor.
const GAIN: f64 = 0.95;
/// Places that could not be mended, at most; and those that were: so many, and this share of the vertices.
const FAILURES: usize = 8;
const PLACES: usize = 4;
const SHARE: f64 = 0.001;
/// What is nearer than this share of a place that could not be mended is left alone, unless that is no longer as it was.
const ENOUGH: f64 = 0.8;
/// What seems nearer than this share of that is not looked at.
const SEEMS: f64 = 0.65;
/// Places that seem far and are looked at, at most.
const LOOKED_AT: usize = 1000;
/// Patches that are made at the same time.
const AT_ONCE: usize = 64;
/// Vertices among which those are looked for.
const AHEAD: usize = 128;
/// Passes over the vertices of a patch.
const SWEEPS: usize = 12;
/// before the most promising ones are chosen, so many of them.
const FIRST_SWEEPS: usize = 3;
const FINISHED: usize = 2;
/// One of these that comes nearer than this share by moving alone is not worth more trials.
const EASY: f64 = 0.85;
/// What has come no nearer by then than this share, with lacking angles added, will not.
const HOPELESS: f64 = 0.99;
/// An angle that a facet lacks, degrees, counts for as much as the distance of the place.
const PROMISE: f64 = 10.0;

/// A vertex and how far the result is from the input around it.
struct Place {
    far: f64,
    vertex: u32,
}

impl Ord for Place {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.far.total_cmp(&other.far).then(other.vertex.cmp(&self.vertex))
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

/// A triangulation that is worked on patch by patch.
pub(super) struct Bench<'a> {
    pub(super) positions: &'a mut [DVec3],
    pub(super) facets: &'a mut [[u32; 3]],
    stars: Stars,
    ground: &'a Ground<'a>,
    free: Vec<bool>,
    on_rim: Vec<bool>,
    /// Edges that stay, lower end first.
    curves: HashSet<[u32; 2]>,
    /// Patches that were put back so far, and by vertex the last of them that it was in; 0 if it was in none.
    edits: u32,
    edited: Vec<u32>,
    token: &'a Token,
}

impl<'a> Bench<'a> {
    /// Edges in `curves` (lower end first) stay.
    pub(super) fn new(
        positions: &'a mut [DVec3],
        facets: &'a mut [[u32; 3]],
        rails: &[Rail],
        (curves, ground): (HashSet<[u32; 2]>, &'a Ground<'a>),
        token: &'a Token,
    ) -> Self {
        let around = Csr::one_rings(positions.len(), facets);
        let on_rim = on_rim(facets, &around, positions.len());
        let free = rails.iter().zip(&on_rim).map(|(r, rim)| *r == Rail::Free && !rim).collect();
        let edited = vec![0; positions.len()];
        Self { positions, facets, stars: Stars::new(around), ground, free, on_rim, curves, edits: 0, edited, token }
    }

    pub(super) fn scene(&self) -> Scene<'_> {
        let Self { positions, facets, stars, ground, free, on_rim, curves, token, .. } = self;
        Scene { positions, facets, stars, ground, free, on_rim, curves, token }
    }

    pub(super) fn put_back(&mut self, patch: &Patch) {
        patch.apply(self.positions, self.facets, &mut self.stars);
        self.edits += 1;
        patch.vertices().iter().for_each(|&v| self.edited[v as usize] = self.edits);
    }

    /// From now on an edge stays.
    pub(super) fn keep(&mut self, ends: [u32; 2]) {
        self.curves.insert(undirected(ends));
    }

    /// Puts in what `better` makes of the patch around each of `middles`, one after the other, but for those that have
    /// nothing to do with others: these are made at the same time, and who comes behind one that it has to do with waits for
    /// it. So the result is the same whatever the number of threads. Returns how many were put in; what came to nothing is
    /// `vain` from then on, and is not tried again where nothing has changed.
    pub(super) fn change(
        &mut self,
        middles: &[u32],
        vain: &mut Vain,
        better: impl Fn(&Scene<'_>, u32) -> Option<Patch> + Sync,
    ) -> usize {
        let mut done = 0;
        let mut waiting = middles.to_vec();
        while !waiting.is_empty() && !self.token.is_stopped() {
            let next = self.take_apart(&mut waiting, vain);
            let scene = self.scene();
            let made: Vec<Option<Patch>> = next.par_iter().with_max_len(1).map(|&v| better(&scene, v)).collect();
            for (v, patch) in next.into_iter().zip(made) {
                if let Some(patch) = patch {
                    self.put_back(&patch);
                    done += 1;
                } else {
                    vain.0.insert(v, self.edits);
                }
            }
        }
        done
    }

    /// Takes the first ones out whose patches depend on nothing that those before them could change. Leaves out what is vain.
    fn take_apart(&self, waiting: &mut Vec<u32>, vain: &Vain) -> Vec<u32> {
        let scene = self.scene();
        let (mut claimed, mut next, mut looked_at) = (HashSet::new(), Vec::new(), 0);
        waiting.retain(|&v| {
            if looked_at == AHEAD || next.len() == AT_ONCE {
                return true;
            }
            looked_at += 1;
            let seen = seen(&scene, v);
            if vain.0.get(&v).is_some_and(|&then| !self.is_changed(&seen, then)) {
                return false;
            }
            let is_apart = seen.iter().all(|u| !claimed.contains(u));
            claimed.extend(seen);
            if is_apart {
                next.push(v);
            }
            !is_apart
        });
        next
    }

    /// Whether any of some vertices was in a patch that was put back after so many others.
    fn is_changed(&self, vertices: &[u32], edits: u32) -> bool {
        vertices.iter().any(|&v| self.edited[v as usize] > edits)
    }

    /// Whether nothing better was found around a vertex, and nothing there has changed since.
    fn is_vain(&self, v: u32, vain: &Vain) -> bool {
        vain.0.get(&v).is_some_and(|&then| !self.is_changed(&seen(&self.scene(), v), then))
    }

    /// Mends the places that are farthest from the input; the result is `far` from it around each vertex, about.
    /// Returns how many were mended.
    pub(super) fn mend(&mut self, far: &[f64]) -> usize {
        let mut heap = first_places(&self.scene(), far);
        // What could not be mended and is as it was.
        let mut failed: Vec<Place> = Vec::new();
        let mut few = FEW;
        let mut vain = Vain::default();
        let (mut left, mut failures, mut mended) = (PLACES + (SHARE * far.len() as f64) as usize, 0, 0);
        while let Some(place) = heap.pop() {
            let floor = failed.iter().map(|failed| ENOUGH * failed.far).fold(0.0, f64::max);
            if place.far < floor || left == 0 || failures == FAILURES || self.token.is_stopped() {
                break;
            }
            let v = place.vertex;
            if self.is_vain(v, &vain) {
                continue;
            }
            let Some(patch) = Patch::around(&self.scene(), v) else { continue };
            let now = patch.distance();
            if now.middle < FAR * patch.edge() {
                continue;
            }
            if now.middle < 0.98 * place.far {
                // Something else was changed beside it.
                heap.push(Place { far: now.middle, vertex: v });
                continue;
            }
            let is_near = now.middle < NOT_SO_FAR * patch.edge();
            if is_near && few == 0 {
                break;
            }
            if let Some(better) = better(&patch) {
                self.put_back(&better);
                mended += 1;
                left -= 1;
                few -= usize::from(is_near);
                // Often a place is mended from the vertex beside it.
                failed.retain(|failed| self.is_vain(failed.vertex, &vain));
                let inner: Vec<u32> = better.inner().collect();
                heap.extend(places(&self.scene(), inner));
            } else {
                vain.0.insert(v, self.edits);
                failures += 1;
                failed.push(Place { far: now.middle, vertex: v });
            }
        }
        mended
    }
}

/// Vertices around which nothing better was found, with how many patches had been put back by then.
#[derive(Default)]
pub(super) struct Vain(HashMap<u32, u32>);

/// Vertices that the patch around one depends on: its own and the corners of all facets around these.
fn seen(scene: &Scene<'_>, middle: u32) -> Vec<u32> {
    let ring = |vertices: &[u32]| {
        let facets = vertices.iter().flat_map(|&v| scene.stars.of(v));
        let mut ring: Vec<u32> = facets.flat_map(|&f| scene.facets[f as usize]).collect();
        ring.sort_unstable();
        ring.dedup();
        ring
    };
    ring(&ring(&ring(&[middle])))
}

/// Vertices around which the result is far from the input, of those that seem to be.
fn first_places(scene: &Scene<'_>, far: &[f64]) -> BinaryHeap<Place> {
    let seems = |(&far, vertex): (&f64, u32)| {
        let p = scene.positions[vertex as usize];
        let ring = scene.stars.of(vertex).iter().flat_map(|&f| scene.facets[f as usize]);
        let longest = ring.map(|u| scene.positions[u as usize].distance(p)).fold(0.0, f64::max);
        (far > SEEMS * FAR * longest).then_some(Place { far, vertex })
    };
    let mut seeming: Vec<Place> = far.iter().zip(0..).filter_map(seems).collect();
    seeming.sort_by(|a, b| b.cmp(a));
    seeming.truncate(LOOKED_AT);
    places(scene, seeming.into_iter().map(|place| place.vertex).collect()).collect()
}

/// Those of some vertices around which the result is far from the input.
fn places(scene: &Scene<'_>, vertices: Vec<u32>) -> impl Iterator<Item = Place> + use<> {
    let of = |vertex: u32| {
        if scene.token.is_stopped() {
            return None;
        }
        let (far, edge) = distance_at(scene, vertex);
        (far > FAR * edge).then_some(Place { far, vertex })
    };
    let places: Vec<Option<Place>> = vertices.into_par_iter().map(of).collect();
    places.into_iter().flatten()
}

/// What is done to a patch before its vertices move.
enum Trial {
    AsItIs,
    /// A vertex goes to the tip that is farthest off.
    Jump(DVec3),
    /// An edge is turned: facet and edge of it.
    Turn(usize, usize),
}

/// The patch with its middle nearer to the input, if that can be had.
fn better(patch: &Patch) -> Option<Patch> {
    let now = patch.distance();
    let least = patch.worst().min(LEAST);
    let (goal, sharpest) = (GAIN * now.middle, patch.sharpest());
    let mut trials = vec![Trial::AsItIs];
    trials.extend(now.tip.map(Trial::Jump));
    trials.extend(patch.turns().into_iter().map(|(f, e)| Trial::Turn(f, e)));
    let first = |trial: &Trial| {
        let mut patch = patch.clone();
        let can = match *trial {
            Trial::AsItIs => true,
            Trial::Jump(to) => patch.jump(to),
            Trial::Turn(f, e) => patch.turn(f, e),
        };
        if !can {
            return None;
        }
        patch.relax(now.middle, FIRST_SWEEPS);
        let then = patch.distance();
        let lack = (least - patch.worst()).max(0.0) / PROMISE;
        Some((then.middle.max(then.rest) / now.middle + lack, patch))
    };
    let last = |mut patch: Patch| {
        patch.relax(now.middle, SWEEPS);
        let then = patch.distance();
        let shaped = patch.worst() >= least && patch.sharpest() >= sharpest;
        let fine = shaped && then.middle <= goal && then.rest <= now.rest.max(goal);
        fine.then_some((patch, then.middle.max(then.rest)))
    };
    if now.middle < NOT_SO_FAR * patch.edge()
        && let Some((easy, _)) = first(&Trial::AsItIs).filter(|b| b.0 < EASY).and_then(|(_, patch)| last(patch))
    {
        return Some(easy);
    }
    let begun: Vec<Option<(f64, Patch)>> = trials.par_iter().with_max_len(1).map(first).collect();
    let mut begun: Vec<(f64, Patch)> = begun.into_iter().flatten().collect();
    // Where nothing moves at first nothing will.
    begun.retain(|b| b.0 < HOPELESS.max(now.rest / now.middle + 1e-9));
    begun.sort_by(|a, b| a.0.total_cmp(&b.0));
    begun.truncate(FINISHED);
    let done: Vec<Option<(Patch, f64)>> = begun.into_par_iter().with_max_len(1).map(|(_, patch)| last(patch)).collect();
    // The first of the best.
    done.into_iter().flatten().reduce(|a, b| if b.1 < a.1 { b } else { a }).map(|(patch, _)| patch)
}

/// Whether each vertex is on an edge with one facet.
fn on_rim(facets: &[[u32; 3]], around: &Csr<u32>, vertices: usize) -> Vec<bool> {
    let mut rim = vec![false; vertices];
    for t in facets {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let runs_back = |f: &u32| {
                let t = facets[*f as usize];
                (0..3).any(|k| t[k] == b && t[(k + 1) % 3] == a)
            };
            // Both ends have it; one of them may have very many.
            let end = if around.of(a).len() <= around.of(b).len() { a } else { b };
            if !around.of(end).iter().any(runs_back) {
                rim[a as usize] = true;
                rim[b as usize] = true;
            }
        }
    }
    rim
}
