//! A small part of a result, changed for itself.
//!
//! Purpose: [`Patch`] is a vertex with the facets around it and around its neighbours. Its edges can be turned
//! and its inner vertices moved, one at a time, to where the patch is both near to the input and well shaped.
//! Invariant: facets outside stay as they are; what may not move stays; no facet turns over. Nothing
//! changes in the result before the patch is put back. Deterministic.
//! Must not know: which patches there are, seeds, diagrams.

mod rock;
mod view;

use std::sync::Arc;

use glam::DVec3;

pub(super) use rock::distance_at;
use rock::{Rocks, samples, squared_distance};
use view::View;

use super::ground::Ground;
use super::stars::Stars;
use super::triangle::{score, unit_normal};
use crate::token::Token;

/// The score that facets of a patch are to have, degrees.
pub(super) const LEAST: f64 = 34.3;
/// Facets' normals turn by at most this cosine from the first ones, and those of a turned edge differ by no less from
/// the mean of the two before.
const LEAST_COSINE: f64 = 0.5;
const TURNED_COSINE: f64 = 0.3;
/// Neighbours may meet at this cosine between their normals; the input may have such edges.
const SHARP: f64 = -0.75;
/// First step, as a share of the mean edge, and how often it is halved.
const STEP: f64 = 0.2;
const HALVINGS: i32 = 4;
/// Vertices go no farther than this share of it in all.
const FARTHEST: f64 = 0.6;
/// Middles of the input's edges are looked at if these are longer than this share of a mean edge,
const LONG: f64 = 0.3;
/// and by the vertex that is no farther than this share.
const BESIDE: f64 = 0.65;
/// Directions of a step beside up and down.
const DIRECTIONS: usize = 8;

/// A patch is no larger: it knows the distance of each of its facets from each vertex of the input there, and is copied for each
/// change that is tried. Vertices with seven neighbours have patches of sixty facets.
const MOST_FACETS: usize = 512;

/// See the module's head. Vertices and facets have numbers of the patch's own; the middle vertex is `middle`.
#[derive(Clone)]
pub(super) struct Patch {
    /// Numbers in the result, ascending.
    vertices: Vec<u32>,
    facet_ids: Vec<u32>,
    facets: Vec<[usize; 3]>,
    at: Vec<DVec3>,
    start: Vec<DVec3>,
    normals: Vec<DVec3>,
    /// Facets of the patch around each vertex.
    star: Vec<Vec<usize>>,
    /// How many facets are around each vertex outside.
    outside: Vec<usize>,
    /// Whether a vertex has all its facets inside and may move.
    free: Vec<bool>,
    /// How often the step of each was halved.
    halved: Vec<i32>,
    rim: Vec<bool>,
    /// Edges that stay, ends ascending.
    kept: Vec<[usize; 2]>,
    middle: usize,
    edge: f64,
    /// How far anything is from the other surface, at the beginning.
    worst: f64,
    /// Input vertices: where, of whose cell, squared distance to the facets outside around that.
    tips: Vec<(DVec3, usize, f64)>,
    /// Squared distance of tip t from facet f at t * facets + f.
    apart: Vec<f64>,
    /// The input, which clones have together.
    rocks: Arc<Rocks>,
    token: Token,
}

/// How far a patch is from the input.
#[derive(Clone, Copy, Debug)]
pub(super) struct Distance {
    /// In and around its middle vertex's cell.
    pub(super) middle: f64,
    /// Elsewhere.
    pub(super) rest: f64,
    /// The tip that is farthest in the middle, if it is what is farthest there.
    pub(super) tip: Option<DVec3>,
}

/// The result as it is, and what the input is to it.
pub(super) struct Scene<'a> {
    pub(super) positions: &'a [DVec3],
    pub(super) facets: &'a [[u32; 3]],
    pub(super) stars: &'a Stars,
    pub(super) ground: &'a Ground<'a>,
    /// Vertices that may move.
    pub(super) free: &'a [bool],
    pub(super) on_rim: &'a [bool],
    /// Edges of curves, lower end first.
    pub(super) curves: &'a std::collections::HashSet<[u32; 2]>,
    /// Patches change no more where it is stopped, and are then of no use.
    pub(super) token: &'a Token,
}

impl Scene<'_> {
    /// Inner vertices with less than 5 or more than 7 neighbours.
    pub(super) fn irregular(&self) -> impl Iterator<Item = u32> + '_ {
        let inner = (0..self.positions.len() as u32).filter(|&v| !self.on_rim[v as usize]);
        inner.filter(|&v| !(5..=7).contains(&self.stars.of(v).len()))
    }
}

impl Patch {
    /// The patch around `middle`; `None` if that has more than [`MOST_FACETS`], as around the middle of a fan of thousands.
    pub(super) fn around(scene: &Scene<'_>, middle: u32) -> Option<Self> {
        let stars = scene.stars;
        let star = |v: u32| stars.of(v).iter().copied();
        let mut inner: Vec<u32> = star(middle).flat_map(|f| scene.facets[f as usize]).collect();
        inner.sort_unstable();
        inner.dedup();
        let mut facet_ids: Vec<u32> = inner.iter().flat_map(|&v| star(v)).collect();
        facet_ids.sort_unstable();
        facet_ids.dedup();
        if facet_ids.len() > MOST_FACETS {
            return None;
        }
        let mut vertices: Vec<u32> = facet_ids.iter().flat_map(|&f| scene.facets[f as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let local = |v: u32| vertices.binary_search(&v).unwrap_or(0);
        let facets: Vec<[usize; 3]> = facet_ids.iter().map(|&f| scene.facets[f as usize].map(local)).collect();
        let at: Vec<DVec3> = vertices.iter().map(|&v| scene.positions[v as usize]).collect();
        let mut star = vec![Vec::new(); vertices.len()];
        facets.iter().enumerate().for_each(|(f, t)| t.iter().for_each(|&v| star[v].push(f)));
        let outside: Vec<usize> = vertices.iter().zip(&star).map(|(&v, s)| stars.of(v).len() - s.len()).collect();
        let mut kept = Vec::new();
        let mut edge = 0.0;
        for t in &facets {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                edge += at[a].distance(at[b]);
                let (low, high) = (a.min(b), a.max(b));
                if scene.curves.contains(&[vertices[low], vertices[high]]) {
                    kept.push([low, high]);
                }
            }
        }
        let free = |(k, &v): (usize, &u32)| scene.free[v as usize] && outside[k] == 0 && inner.contains(&v);
        let mut patch = Self {
            free: vertices.iter().enumerate().map(free).collect(),
            rim: vertices.iter().map(|&v| scene.on_rim[v as usize]).collect(),
            normals: facets.iter().map(|t| unit_normal(t.map(|v| at[v]))).collect(),
            middle: local(middle),
            edge: edge / (3 * facets.len()) as f64,
            start: at.clone(),
            halved: vec![0; at.len()],
            worst: f64::INFINITY,
            facet_ids,
            facets,
            at,
            star,
            outside,
            kept,
            tips: Vec::new(),
            apart: Vec::new(),
            rocks: Arc::new(Rocks::new(std::iter::empty())),
            token: scene.token.clone(),
            vertices,
        };
        patch.look_at(scene);
        Some(patch)
    }

    /// Takes in the input.
    fn look_at(&mut self, scene: &Scene<'_>) {
        let mut rocks: Vec<u32> = self.vertices.iter().flat_map(|&v| scene.ground.facets(v)).copied().collect();
        rocks.sort_unstable();
        rocks.dedup();
        self.rocks = Arc::new(Rocks::new(rocks.iter().map(|&f| scene.ground.corners(f))));
        let mut tips: Vec<(DVec3, usize)> = Vec::new();
        for (k, &v) in self.vertices.iter().enumerate() {
            tips.extend(scene.ground.tips(v).iter().map(|&p| (p, k)));
        }
        self.take_middles(&mut tips);
        for (p, k) in tips {
            let v = self.vertices[k];
            let outer = scene.stars.of(v).iter().filter(|f| self.facet_ids.binary_search(f).is_err());
            let corners = |f: &u32| scene.facets[*f as usize].map(|u| scene.positions[u as usize]);
            let outer = outer.map(|f| squared_distance(p, corners(f)));
            self.tips.push((p, k, outer.fold(f64::INFINITY, f64::min)));
        }
        self.apart = vec![0.0; self.tips.len() * self.facets.len()];
        (0..self.facets.len()).for_each(|f| self.update_apart(f));
        let far = self.distance();
        self.worst = far.middle.max(far.rest);
    }

    /// Middles of the input's longer edges, each with the nearest vertex that has a facet on its side of the surface, if that
    /// is near: across a sharp crease, and on a thin sheet, the other side is as near, and none of its.
    fn take_middles(&self, tips: &mut Vec<(DVec3, usize)>) {
        let mut middles = Vec::new();
        for [a, b, c] in self.rocks.corners() {
            let normal = unit_normal([a, b, c]);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                if p.distance(q) > LONG * self.edge {
                    middles.push(((p + q) / 2.0, normal));
                }
            }
        }
        middles.sort_by(|(p, _), (q, _)| p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)));
        // Both facets of an edge have it; one of them has its ends the other way round.
        for same in middles.chunk_by(|a, b| a.0 == b.0) {
            let (p, normal) = (same[0].0, same.iter().map(|m| m.1).sum::<DVec3>());
            let to = |v: usize| self.at[v].distance_squared(p);
            let faces = |&v: &usize| self.star[v].iter().any(|&f| self.normals[f].dot(normal) >= 0.0);
            let nearest = (0..self.at.len()).filter(faces).min_by(|&u, &v| to(u).total_cmp(&to(v)));
            tips.extend(nearest.filter(|&v| to(v) < (BESIDE * self.edge).powi(2)).map(|v| (p, v)));
        }
    }

    /// Distances of the tips from facet `f`; of those that are far from it that they are.
    fn update_apart(&mut self, f: usize) {
        let corners = self.corners(f);
        let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
        let reach = corners.iter().map(|c| c.distance_squared(centre)).fold(0.0, f64::max).sqrt() + 2.0 * self.worst;
        for (t, tip) in self.tips.iter().enumerate() {
            let close = tip.0.distance_squared(centre) <= reach * reach;
            self.apart[t * self.facets.len() + f] =
                if close { squared_distance(tip.0, corners) } else { f64::INFINITY };
        }
    }

    fn corners(&self, f: usize) -> [DVec3; 3] {
        self.facets[f].map(|v| self.at[v])
    }

    fn valence(&self, v: usize) -> usize {
        self.star[v].len() + self.outside[v]
    }

    /// The least score of its facets.
    pub(super) fn worst(&self) -> f64 {
        (0..self.facets.len()).map(|f| score(self.corners(f))).fold(f64::INFINITY, f64::min)
    }

    /// The least cosine between the normals of two neighbours, or [`SHARP`] if all are above that.
    pub(super) fn sharpest(&self) -> f64 {
        let mut least = SHARP;
        for (f, t) in self.facets.iter().enumerate() {
            for e in 0..3 {
                let (a, b) = (t[e], t[(e + 1) % 3]);
                let beside = self.star[a].iter().filter(|&&g| g < f && self.facets[g].contains(&b));
                let n = unit_normal(self.corners(f));
                least = beside.map(|&g| n.dot(unit_normal(self.corners(g)))).fold(least, f64::min);
            }
        }
        least
    }

    /// Mean edge.
    pub(super) fn edge(&self) -> f64 {
        self.edge
    }

    /// Groups of the input's facets that may be nearest to something within `reach` of `p`.
    fn near(&self, p: DVec3, reach: f64) -> Vec<u32> {
        self.rocks.near(p, reach + 2.0 * self.worst)
    }

    /// Squared distance of tip `t`.
    fn tip_distance(&self, t: usize) -> f64 {
        let row = &self.apart[t * self.facets.len()..(t + 1) * self.facets.len()];
        row.iter().copied().fold(self.tips[t].2, f64::min)
    }

    /// How far it is from the input, both ways.
    pub(super) fn distance(&self) -> Distance {
        // Squared, in and around the middle's cell and elsewhere.
        let (mut far, mut tip) = ([0.0f64; 2], None);
        for (t, &(p, of, _)) in self.tips.iter().enumerate() {
            let squared = self.tip_distance(t);
            let side = &mut far[usize::from(of != self.middle)];
            if squared > *side {
                *side = squared;
                tip = if of == self.middle { Some(p) } else { tip };
            }
        }
        let of_tips = far[0];
        for (f, t) in self.facets.iter().enumerate() {
            let [a, b, c] = self.corners(f);
            let centre = (a + b + c) / 3.0;
            let near = self.near(centre, [a, b, c].map(|p| p.distance(centre)).into_iter().fold(0.0, f64::max));
            let side = &mut far[usize::from(!t.contains(&self.middle))];
            let mut hint = 0;
            // What is not as far as something else already need not be known.
            samples([a, b, c]).for_each(|p| *side = side.max(self.rocks.distance(p, &near, &mut hint, *side)));
        }
        let [middle, rest] = far.map(f64::sqrt);
        Distance { middle, rest, tip: tip.filter(|_| of_tips == far[0]) }
    }

    /// Edges that may be turned so that valences stay or become fine: facet and edge of it. Of the middle's facets.
    pub(super) fn turns(&self) -> Vec<(usize, usize)> {
        self.edges_around().into_iter().filter(|&(f, e)| self.turned(f, e).is_some()).collect()
    }

    /// The other facet at edge `e` of `f` and what the two become.
    fn turned(&self, f: usize, e: usize) -> Option<(usize, [[usize; 3]; 2])> {
        self.turned_within(f, e, [5, 7])
    }

    /// The same with other valences that inner vertices may have afterwards.
    fn turned_within(&self, f: usize, e: usize, valences: [usize; 2]) -> Option<(usize, [[usize; 3]; 2])> {
        let t = self.facets[f];
        let (a, b, c) = (t[e], t[(e + 1) % 3], t[(e + 2) % 3]);
        let runs_back = |g: &&usize| (0..3).any(|k| self.facets[**g][k] == b && self.facets[**g][(k + 1) % 3] == a);
        let &g = self.star[a].iter().find(runs_back)?;
        let d = *self.facets[g].iter().find(|&&v| v != a && v != b)?;
        let joined = self.star[c].iter().any(|&h| self.facets[h].contains(&d));
        // What is outside may join them too.
        let hidden = self.outside[c] > 0 && self.outside[d] > 0;
        if joined || hidden || self.kept.contains(&[a.min(b), a.max(b)]) {
            return None;
        }
        let lose = |v: usize| self.rim[v] || self.valence(v) > valences[0];
        let win = |v: usize| self.rim[v] || self.valence(v) < valences[1];
        if !(lose(a) && lose(b) && win(c) && win(d)) {
            return None;
        }
        let new = [[a, d, c], [d, b, c]];
        let mean = (unit_normal(self.corners(f)) + unit_normal(self.corners(g))).normalize_or_zero();
        let fine = new.iter().all(|t| unit_normal(t.map(|v| self.at[v])).dot(mean) >= TURNED_COSINE);
        fine.then_some((g, new))
    }

    /// Turns an edge, if that is allowed.
    pub(super) fn turn(&mut self, f: usize, e: usize) -> bool {
        let turned = self.turned(f, e);
        self.replace(f, turned)
    }

    /// Turns an edge whose ends may come to have four neighbours and those opposite eight.
    pub(super) fn turn_anyhow(&mut self, f: usize, e: usize) -> bool {
        let turned = self.turned_within(f, e, [4, 8]);
        self.replace(f, turned)
    }

    /// Edges of the middle's facets, each once (spokes where they end in the middle): facet and edge of it.
    pub(super) fn edges_around(&self) -> Vec<(usize, usize)> {
        let all = self.star[self.middle].iter().flat_map(|&f| (0..3).map(move |e| (f, e)));
        all.filter(|&(f, e)| self.facets[f][e] != self.middle).collect()
    }

    /// Edges that, turned, join the middle and vertex `to` of the result.
    pub(super) fn turns_to(&self, to: u32) -> Vec<(usize, usize)> {
        let Ok(to) = self.vertices.binary_search(&to) else { return Vec::new() };
        let joins = |&(f, e): &(usize, usize)| {
            self.facets[f][(e + 2) % 3] == self.middle
                && self.turned_within(f, e, [4, 8]).is_some_and(|(_, new)| new[0].contains(&to))
        };
        self.edges_around().into_iter().filter(joins).collect()
    }

    /// Whether the middle has 5 to 7 neighbours.
    pub(super) fn is_regular(&self) -> bool {
        (5..=7).contains(&self.valence(self.middle))
    }

    /// Whether the middle's valence is nearer to six than it was.
    pub(super) fn is_more_regular_than(&self, before: &Self) -> bool {
        self.valence(self.middle).abs_diff(6) < before.valence(self.middle).abs_diff(6)
    }

    fn replace(&mut self, f: usize, turned: Option<(usize, [[usize; 3]; 2])>) -> bool {
        let Some((g, new)) = turned else { return false };
        for (h, t) in [(f, new[0]), (g, new[1])] {
            for v in self.facets[h] {
                self.star[v].retain(|&x| x != h);
            }
            self.facets[h] = t;
        }
        for h in [f, g] {
            for v in self.facets[h] {
                self.star[v].push(h);
                self.star[v].sort_unstable();
            }
            self.normals[h] = unit_normal(self.corners(h));
            self.update_apart(h);
        }
        true
    }

    /// Puts the middle vertex, or another free one that is nearer, to `p`, whatever becomes of the shapes.
    pub(super) fn jump(&mut self, p: DVec3) -> bool {
        let free = (0..self.at.len()).filter(|&v| self.free[v]);
        let nearest = free.min_by(|&a, &b| self.at[a].distance_squared(p).total_cmp(&self.at[b].distance_squared(p)));
        let Some(v) = nearest.filter(|&v| self.at[v].distance(p) < FARTHEST * self.edge) else { return false };
        self.put(v, p);
        self.star[v].iter().all(|&f| unit_normal(self.corners(f)).dot(self.normals[f]) >= LEAST_COSINE)
    }

    fn put(&mut self, v: usize, p: DVec3) {
        self.at[v] = p;
        for k in 0..self.star[v].len() {
            self.update_apart(self.star[v][k]);
        }
    }

    /// Moves the free vertices, the middle one first, so that what is as far as `worst` comes nearer and facets have a
    /// good shape.
    pub(super) fn relax(&mut self, worst: f64, sweeps: usize) {
        let mut order: Vec<usize> = (0..self.at.len()).filter(|&v| self.free[v]).collect();
        order.sort_by_key(|&v| (v != self.middle, v));
        for _ in 0..sweeps {
            let mut tried = false;
            for &v in &order {
                if self.token.is_stopped() {
                    return;
                }
                if self.halved[v] < HALVINGS {
                    tried = true;
                    let step = STEP * self.edge * 0.5f64.powi(self.halved[v]);
                    self.halved[v] += i32::from(!self.improve(v, worst, step));
                }
            }
            if !tried {
                return;
            }
        }
    }

    /// Moves one vertex by one step to where it costs least. Returns whether it moved.
    fn improve(&mut self, v: usize, worst: f64, step: f64) -> bool {
        let mut view = View::new(self, v, worst, step);
        let here = self.at[v];
        let mut best = (view.cost_here(step), here);
        if best.0 <= 0.0 {
            return false;
        }
        let up = self.star[v].iter().map(|&f| unit_normal(self.corners(f))).sum::<DVec3>().normalize_or(DVec3::Z);
        let (x, y) = up.any_orthonormal_pair();
        let aside = (0..DIRECTIONS).map(|k| {
            let (sin, cos) = (k as f64 / DIRECTIONS as f64 * std::f64::consts::TAU).sin_cos();
            cos * x + sin * y
        });
        for way in aside.chain([0.5 * up, -0.5 * up]) {
            let to = here + step * way;
            if to.distance(self.start[v]) <= FARTHEST * self.edge {
                let cost = view.cost(to, best.0);
                if cost < best.0 - 1e-4 {
                    best = (cost, to);
                }
            }
        }
        if best.1 == here {
            return false;
        }
        self.put(v, best.1);
        true
    }

    /// All its vertices, numbers in the result.
    pub(super) fn vertices(&self) -> &[u32] {
        &self.vertices
    }

    /// Vertices of the result that have all their facets in it.
    pub(super) fn inner(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.vertices.len()).filter(|&v| self.outside[v] == 0).map(|v| self.vertices[v])
    }

    /// Puts it back into the result.
    pub(super) fn apply(&self, positions: &mut [DVec3], facets: &mut [[u32; 3]], stars: &mut Stars) {
        for (v, &id) in self.vertices.iter().enumerate() {
            positions[id as usize] = self.at[v];
        }
        for (t, &id) in self.facets.iter().zip(&self.facet_ids) {
            let new = t.map(|v| self.vertices[v]);
            if facets[id as usize] != new {
                stars.replace(id, facets[id as usize], new);
                facets[id as usize] = new;
            }
        }
    }
}
