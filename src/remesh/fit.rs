//! Vertices where the surface through them is nearest to the input.
//!
//! Purpose: a triangulation whose vertices lie on a curved surface lies on one side of it, off by a
//! share of κh² everywhere. This moves the vertices so that the mean square distance from the input to the
//! facets is least, tangent plane by tangent plane: along the normals where the surface is smooth, and
//! towards a ridge where samples of its two sides ask for it. Tips that still stick out pull the
//! nearest vertex to them.
//! Invariant: no facet turns over and none becomes a sliver; fixed vertices stay; deterministic.
//! Must not know: seeds, diagrams, files.
//!
//! For a point s of the input with normal n and nearest facet point Σ λ_i x_i the residual is
//! n·(Σ λ_i x_i - s), as in the point-to-plane registration of Chen and Medioni (1992); for a point of a
//! curve it is the part of Σ λ_i x_i - s across the edge. The displacements solve a sparse system, facet by
//! facet 9 x 9, by conjugate gradients.

use std::collections::HashSet;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::around::Around;
use super::flips;
use super::tips::{Offset, Offsets, Tip, nearest};
use crate::mesh::measure::{facet_quality, least_angle};

/// A point of the input with its share of the area.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Where it is.
    pub(super) position: DVec3,
    /// Unit normal of the input there.
    pub(super) normal: DVec3,
    /// Area it stands for.
    pub(super) area: f64,
    /// A result vertex; the nearest facet is one of those around it.
    pub(super) vertex: u32,
}

/// A point of an input curve.
#[derive(Clone, Copy, Debug)]
pub(super) struct CurveSample {
    /// Where it is.
    pub(super) position: DVec3,
    /// The result's edge for its stretch of the curve.
    pub(super) edge: [u32; 2],
    /// Area it stands for: its share of the curve's length times the length of the edge.
    pub(super) area: f64,
}

/// What there is to fit to.
#[derive(Debug, Default)]
pub(super) struct Target {
    pub(super) samples: Vec<Sample>,
    pub(super) curves: Vec<CurveSample>,
    pub(super) tips: Vec<Tip>,
    /// Vertices that stay.
    pub(super) fixed: Vec<bool>,
}

/// Times that nearest points are found anew,
const ROUNDS: usize = 2;
/// and after these around tips alone, which then pull.
const TIP_ROUNDS: usize = 6;
/// A tip moves vertices that are so many edges away from it, with it.
const RINGS: usize = 3;
/// Tips that stick out at least this share as far as the worst one pull next.
const FARTHEST: f64 = 0.6;
/// Steps of conjugate gradients a round: displacements reach a few facets far.
const STEPS: usize = 14;
/// A move within the tangent plane by so much is as costly as a residual of the same length: a vertex has
/// nothing to gain by sliding.
const DAMPING: f64 = 0.05;
/// Neighbours that move apart by so much, likewise: who is pulled away takes them along.
const STIFFNESS: f64 = 0.02;
/// What keeps the system solvable where samples are few.
const FLOOR: f64 = 0.01;
/// Curves are lines that the eye follows: a residual there counts for this many of the surface's.
const CURVES: f64 = 20.0;
/// A tip sticks out if it is farther from the facets than this share of an edge,
pub(super) const TIP: f64 = 0.08;
/// and pulls a vertex that is not farther away than this share of it,
const TIP_REACH: f64 = 0.75;
/// as strongly as this many of the vertex's own areas.
const TIP_PULL: f64 = 20.0;
/// What is farther from the facets than the second share of an edge was missed, if something is farther than the
/// first.
const MISSED: [f64; 2] = [0.25, 0.17];
/// Facets keep at least this quality (1 is equilateral) and this smallest angle in degrees, or what they had.
const LEAST_SHAPE: f64 = 0.63;
const LEAST_ANGLE: f64 = 35.0;
/// A facet's normal turns by at most this cosine from that before the fit.
const LEAST_COSINE: f64 = 0.5;

/// Moves `positions`, and turns edges that lie across a ridge.
pub(super) fn fit(positions: &mut [DVec3], facets: &mut [[u32; 3]], target: &Target) {
    let mut around = Around::new(positions.len(), facets);
    let first: Vec<Facet> = facets.par_iter().map(|&t| Facet::of(positions, t)).collect();
    let mut state = State { start: positions.to_vec(), first, pulls: Vec::new() };
    let everywhere = vec![true; positions.len()];
    for _ in 0..ROUNDS {
        state.round(positions, facets, &around, target, &everywhere);
    }
    let mut offsets = Offsets::new(positions, facets, &around, &target.tips);
    let curves: HashSet<[u32; 2]> = target.curves.iter().map(|s| flips::sorted(s.edge)).collect();
    for _ in 0..TIP_ROUNDS {
        let flipped = flips::along_ridges(positions, facets, &around, &offsets, &curves);
        if !flipped.is_empty() {
            around = Around::new(positions.len(), facets);
            flipped.iter().for_each(|&f| state.first[f as usize] = Facet::of(positions, facets[f as usize]));
        }
        state.find_pulls(positions, facets, &around, target, &offsets);
        let mut front: Vec<u32> = flipped.iter().flat_map(|&f| facets[f as usize]).collect();
        front.extend(state.pulls.iter().map(|p| p.0));
        if front.is_empty() {
            break;
        }
        let region = neighbourhood(facets, &around, front, positions.len());
        state.round(positions, facets, &around, target, &region);
        let wider =
            neighbourhood(facets, &around, (0..).zip(&region).filter(|r| *r.1).map(|r| r.0).collect(), positions.len());
        offsets.update(positions, facets, &around, &wider);
    }
}

/// Places of the input that are farther from the result than `tolerance`, or than a share of an edge where that is
/// `None`: (vertex nearest to the place, the place), the farthest first, none beside another; and how far
/// apart the two are anywhere, both ways.
pub(super) fn missed(
    positions: &[DVec3],
    facets: &[[u32; 3]],
    target: &Target,
    tolerance: Option<f64>,
) -> (Vec<(u32, DVec3)>, f64) {
    let around = Around::new(positions.len(), facets);
    let offsets = Offsets::new(positions, facets, &around, &target.tips);
    let mut missed = offsets.far(|o| tolerance.map_or(o.share > MISSED[1], |t| o.distance > t));
    if tolerance.is_none() && missed.first().is_some_and(|(_, o)| o.share <= MISSED[0]) {
        missed.clear();
    }
    let mut taken = vec![false; positions.len()];
    let mut found = Vec::new();
    for (k, o) in missed {
        if !taken[o.corner as usize] {
            around.of(o.corner).iter().flat_map(|&f| facets[f as usize]).for_each(|u| taken[u as usize] = true);
            found.push((o.corner, target.tips[k].position));
        }
    }
    (found, strayed(positions, facets, target).into_iter().fold(offsets.deviation(), f64::max))
}

/// How far the result is from the input around each vertex, both ways, about.
pub(super) fn far(positions: &[DVec3], facets: &[[u32; 3]], target: &Target) -> Vec<f64> {
    let around = Around::new(positions.len(), facets);
    let mut far = Offsets::new(positions, facets, &around, &target.tips).by_vertex(positions.len());
    for (t, d) in facets.iter().zip(strayed(positions, facets, target)) {
        t.iter().for_each(|&v| far[v as usize] = far[v as usize].max(d));
    }
    far
}

/// How far a vertex or the middle of each facet is from the input at most: from the plane of the nearest sample around
/// it, or from the sample where that is not below it.
fn strayed(positions: &[DVec3], facets: &[[u32; 3]], target: &Target) -> Vec<f64> {
    let mut first = vec![0u32; positions.len() + 1];
    target.samples.iter().for_each(|s| first[s.vertex as usize + 1] += 1);
    (0..positions.len()).for_each(|v| first[v + 1] += first[v]);
    let mut next = first.clone();
    let mut order = vec![0u32; target.samples.len()];
    for (k, s) in target.samples.iter().enumerate() {
        order[next[s.vertex as usize] as usize] = k as u32;
        next[s.vertex as usize] += 1;
    }
    let distance = |p: DVec3, corners: &[u32; 3]| {
        let near = corners.iter().flat_map(|&v| &order[first[v as usize] as usize..first[v as usize + 1] as usize]);
        let squared = |k: &&u32| target.samples[**k as usize].position.distance_squared(p);
        near.min_by(|a, b| squared(a).total_cmp(&squared(b))).map_or(0.0, |&k| {
            let s = &target.samples[k as usize];
            let (height, reach) = (s.normal.dot(p - s.position).abs(), s.area.sqrt());
            let aside = (p.distance_squared(s.position) - height * height).max(0.0).sqrt();
            height.max(aside - 2.0 * reach)
        })
    };
    let of = |t: &[u32; 3]| {
        let corners = t.map(|v| positions[v as usize]);
        let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
        corners.iter().chain([&middle]).map(|&p| distance(p, t)).fold(0.0, f64::max)
    };
    facets.par_iter().map(of).collect()
}

/// What the rounds share.
struct State {
    start: Vec<DVec3>,
    first: Vec<Facet>,
    /// Vertices that tips pull, and where to.
    pulls: Vec<(u32, DVec3)>,
}

impl State {
    /// Moves the vertices of a region once.
    fn round(&self, positions: &mut [DVec3], facets: &[[u32; 3]], around: &Around, target: &Target, region: &[bool]) {
        let elements = Elements::new(positions, facets, around, target, region);
        let moved: Vec<DVec3> = positions.iter().zip(&self.start).map(|(p, s)| *p - *s).collect();
        let free: Vec<bool> = region.iter().zip(&target.fixed).map(|(&inside, &fixed)| inside && !fixed).collect();
        let mut moves = elements.solve(positions, around, &free, &self.pulls, &moved);
        restrain(positions, facets, &self.first, region, &mut moves);
        positions.iter_mut().zip(&moves).for_each(|(p, m)| *p += *m);
    }

    /// More vertices that tips pull: those that stick out most first, none beside another.
    fn find_pulls(
        &mut self,
        positions: &[DVec3],
        facets: &[[u32; 3]],
        around: &Around,
        target: &Target,
        offsets: &Offsets<'_>,
    ) {
        let reaches = |k: usize, o: &Offset| {
            let edge = o.distance / o.share;
            positions[o.corner as usize].distance(target.tips[k].position) < TIP_REACH * edge
        };
        let out: Vec<(usize, Offset)> = offsets
            .far(|o| o.share > TIP && !target.fixed[o.corner as usize])
            .into_iter()
            .filter(|(k, o)| reaches(*k, o))
            .collect();
        let enough = FARTHEST * out.first().map_or(0.0, |o| o.1.share);
        let mut taken = vec![false; positions.len()];
        let take = |v: u32, taken: &mut Vec<bool>| {
            around.of(v).iter().flat_map(|&f| facets[f as usize]).for_each(|u| taken[u as usize] = true);
        };
        self.pulls.iter().for_each(|&(v, _)| take(v, &mut taken));
        for (k, o) in out.into_iter().take_while(|o| o.1.share >= enough) {
            if !taken[o.corner as usize] {
                take(o.corner, &mut taken);
                self.pulls.push((o.corner, target.tips[k].position));
            }
        }
    }
}

/// Vertices within a few edges of `front`.
fn neighbourhood(facets: &[[u32; 3]], around: &Around, mut front: Vec<u32>, vertices: usize) -> Vec<bool> {
    let mut inside = vec![false; vertices];
    front.iter().for_each(|&v| inside[v as usize] = true);
    for _ in 0..RINGS {
        let mut next = Vec::new();
        for u in front.iter().flat_map(|&v| around.of(v)).flat_map(|&f| facets[f as usize]) {
            if !std::mem::replace(&mut inside[u as usize], true) {
                next.push(u);
            }
        }
        front = next;
    }
    inside
}

/// What a facet was before.
struct Facet {
    normal: DVec3,
    shape: f64,
    angle: f64,
}

impl Facet {
    fn of(positions: &[DVec3], t: [u32; 3]) -> Self {
        let corners = t.map(|v| positions[v as usize]);
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        Self { normal, shape: facet_quality(corners), angle: least_angle(corners) }
    }
}

/// One facet's share of the normal equations: blocks (i, j) of Σ a λ_i λ_j n nᵀ, and of -Σ a λ_i r n.
#[derive(Clone, Copy)]
struct System {
    blocks: [Symmetric; 6],
    right: [DVec3; 3],
    /// Area for each corner, and ∫ n.
    area: [f64; 3],
    normal: DVec3,
}

/// Pairs of corners that have a block; the others are the same, since all are symmetric.
const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

/// A symmetric matrix: xx xy xz yy yz zz.
#[derive(Clone, Copy)]
struct Symmetric([f64; 6]);

impl Symmetric {
    fn times(&self, p: DVec3) -> DVec3 {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        DVec3::new(xx * p.x + xy * p.y + xz * p.z, xy * p.x + yy * p.y + yz * p.z, xz * p.x + yz * p.y + zz * p.z)
    }
}

/// An edge's share likewise.
struct Rod {
    ends: [u32; 2],
    blocks: [[DMat3; 2]; 2],
    right: [DVec3; 2],
}

/// The normal equations of the facets that have a vertex in a region.
struct Elements<'a> {
    facets: &'a [[u32; 3]],
    /// The place of each facet in `systems`; [`NONE`] where it has none.
    place: Vec<u32>,
    systems: Vec<System>,
    /// The facet of each system.
    of: Vec<u32>,
    rods: Vec<Rod>,
}

const NONE: u32 = u32::MAX;

fn outer(n: DVec3) -> DMat3 {
    DMat3::from_cols(n * n.x, n * n.y, n * n.z)
}

impl<'a> Elements<'a> {
    fn new(positions: &[DVec3], facets: &'a [[u32; 3]], around: &Around, target: &Target, region: &[bool]) -> Self {
        let inside = |t: &[u32; 3]| t.iter().any(|&v| region[v as usize]);
        let of: Vec<u32> = (0..facets.len() as u32).filter(|&f| inside(&facets[f as usize])).collect();
        let mut place = vec![NONE; facets.len()];
        of.iter().enumerate().for_each(|(k, &f)| place[f as usize] = k as u32);
        let in_reach: Vec<bool> =
            (0..region.len() as u32).map(|v| around.of(v).iter().any(|&f| place[f as usize] != NONE)).collect();
        let samples: Vec<&Sample> = target.samples.iter().filter(|s| in_reach[s.vertex as usize]).collect();
        let nearest: Vec<(u32, [f64; 3])> = samples
            .par_iter()
            .map(|s| {
                let (_, facet, lambda) = nearest(positions, facets, around, s.position, s.vertex);
                (place.get(facet as usize).copied().unwrap_or(NONE), lambda)
            })
            .collect();
        let mut begin = vec![0u32; of.len() + 1];
        let found = || nearest.iter().enumerate().filter(|(_, n)| n.0 != NONE);
        found().for_each(|(_, n)| begin[n.0 as usize + 1] += 1);
        (0..of.len()).for_each(|f| begin[f + 1] += begin[f]);
        let mut next = begin.clone();
        let mut order = vec![0u32; begin[of.len()] as usize];
        for (k, n) in found() {
            order[next[n.0 as usize] as usize] = k as u32;
            next[n.0 as usize] += 1;
        }
        let system = |(k, &f): (usize, &u32)| {
            let corners = facets[f as usize].map(|v| positions[v as usize]);
            let mut system = System::ZERO;
            for &s in &order[begin[k] as usize..begin[k + 1] as usize] {
                system.add(samples[s as usize], corners, nearest[s as usize].1);
            }
            system
        };
        let systems = of.par_iter().enumerate().map(system).collect();
        let in_region = target.curves.iter().filter(|s| s.edge.iter().any(|&v| region[v as usize]));
        let rods = in_region.map(|s| Rod::new(positions, s)).collect();
        Self { facets, place, systems, of, rods }
    }

    /// Displacements of the vertices that are `free`.
    fn solve(
        &self,
        positions: &[DVec3],
        around: &Around,
        free: &[bool],
        pulls: &[(u32, DVec3)],
        moved: &[DVec3],
    ) -> Vec<DVec3> {
        let n = positions.len();
        let (mut own, mut right) = (vec![DMat3::ZERO; n], vec![DVec3::ZERO; n]);
        let (mut area, mut normal) = (vec![0.0; n], vec![DVec3::ZERO; n]);
        for (system, &f) in self.systems.iter().zip(&self.of) {
            let t = self.facets[f as usize];
            let from = t.map(|v| moved[v as usize]);
            let (sum, k) = (from[0] + from[1] + from[2], system.stiffness());
            for (i, &v) in t.iter().enumerate() {
                let v = v as usize;
                own[v] += system.block(i, i) + DMat3::from_diagonal(DVec3::splat(2.0 * k));
                // Against moving apart counts all that they have moved so far.
                right[v] += system.right[i] - k * (3.0 * from[i] - sum);
                area[v] += system.area[i];
                normal[v] += system.normal;
            }
        }
        for rod in &self.rods {
            for (i, &v) in rod.ends.iter().enumerate() {
                own[v as usize] += rod.blocks[i][i];
                right[v as usize] += rod.right[i];
            }
        }
        let mut extra: Vec<DMat3> = (0..n)
            .map(|v| {
                let along = outer(normal[v].normalize_or_zero());
                (DMat3::IDENTITY * DAMPING + along * (FLOOR - DAMPING)) * area[v]
            })
            .collect();
        // So it does against sliding.
        (0..n).for_each(|v| right[v] -= extra[v] * moved[v]);
        for &(v, to) in pulls {
            let v = v as usize;
            extra[v] += DMat3::IDENTITY * (TIP_PULL * area[v]);
            right[v] += TIP_PULL * area[v] * (to - positions[v]);
        }
        let free = |v: usize| free[v] && area[v] > 0.0;
        let inverse: Vec<DMat3> =
            (0..n).map(|v| if free(v) { (own[v] + extra[v]).inverse() } else { DMat3::ZERO }).collect();
        right.iter_mut().enumerate().filter(|(v, _)| !free(*v)).for_each(|(_, r)| *r = DVec3::ZERO);
        let mut shares = vec![[DVec3::ZERO; 3]; self.systems.len()];
        let apply = |p: &[DVec3], q: &mut [DVec3]| {
            self.apply(around, &extra, p, &mut shares, q);
            q.iter_mut().enumerate().filter(|(v, _)| !free(*v)).for_each(|(_, q)| *q = DVec3::ZERO);
        };
        conjugate_gradients(&inverse, right, apply)
    }

    /// q = (extra + this) p: every facet's share first, then every vertex adds its own up, in order.
    fn apply(&self, around: &Around, extra: &[DMat3], p: &[DVec3], shares: &mut [[DVec3; 3]], q: &mut [DVec3]) {
        shares.par_iter_mut().zip(&self.systems).zip(&self.of).with_min_len(512).for_each(|((share, system), &f)| {
            let from = self.facets[f as usize].map(|v| p[v as usize]);
            let (sum, k) = (from[0] + from[1] + from[2], system.stiffness());
            *share = system.times(from);
            (0..3).for_each(|i| share[i] += k * (3.0 * from[i] - sum));
        });
        q.par_iter_mut().enumerate().with_min_len(512).for_each(|(v, q)| {
            *q = extra[v] * p[v];
            for &f in around.of(v as u32) {
                let place = self.place[f as usize];
                if place != NONE {
                    let corner = self.facets[f as usize].iter().position(|&u| u as usize == v).unwrap_or(0);
                    *q += shares[place as usize][corner];
                }
            }
        });
        for rod in &self.rods {
            let from = rod.ends.map(|v| p[v as usize]);
            for (i, &v) in rod.ends.iter().enumerate() {
                q[v as usize] += rod.blocks[i][0] * from[0] + rod.blocks[i][1] * from[1];
            }
        }
    }
}

impl System {
    const ZERO: Self =
        Self { blocks: [Symmetric([0.0; 6]); 6], right: [DVec3::ZERO; 3], area: [0.0; 3], normal: DVec3::ZERO };

    fn add(&mut self, sample: &Sample, corners: [DVec3; 3], lambda: [f64; 3]) {
        let point: DVec3 = (0..3).map(|i| lambda[i] * corners[i]).sum();
        let n = sample.normal;
        let residual = n.dot(point - sample.position);
        let plane = [n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z];
        self.normal += sample.area * n;
        for (i, weight) in lambda.into_iter().enumerate() {
            self.right[i] -= sample.area * weight * residual * n;
            self.area[i] += sample.area * weight;
        }
        for (block, (i, j)) in self.blocks.iter_mut().zip(PAIRS) {
            let weight = sample.area * lambda[i] * lambda[j];
            block.0.iter_mut().zip(plane).for_each(|(to, from)| *to += weight * from);
        }
    }

    fn block(&self, i: usize, j: usize) -> DMat3 {
        // 00 01 02 11 12 22
        let (i, j) = (i.min(j), i.max(j));
        let [xx, xy, xz, yy, yz, zz] = self.blocks[i * (5 - i) / 2 + j].0;
        DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
    }

    fn times(&self, p: [DVec3; 3]) -> [DVec3; 3] {
        let mut q = [DVec3::ZERO; 3];
        for (block, (i, j)) in self.blocks.iter().zip(PAIRS) {
            q[i] += block.times(p[j]);
            if i != j {
                q[j] += block.times(p[i]);
            }
        }
        q
    }

    /// Of the springs between its corners.
    fn stiffness(&self) -> f64 {
        STIFFNESS / 3.0 * (self.area[0] + self.area[1] + self.area[2])
    }
}

impl Rod {
    fn new(positions: &[DVec3], sample: &CurveSample) -> Self {
        let [a, b] = sample.edge.map(|v| positions[v as usize]);
        let along = b - a;
        let length = along.length_squared();
        let t = if length > 0.0 { ((sample.position - a).dot(along) / length).clamp(0.0, 1.0) } else { 0.5 };
        let lambda = [1.0 - t, t];
        let across = DMat3::IDENTITY - outer(along.normalize_or_zero());
        let residual = across * (a + t * along - sample.position);
        let weight = CURVES * sample.area;
        let block = |i: usize, j: usize| across * (weight * lambda[i] * lambda[j]);
        Self {
            ends: sample.edge,
            blocks: [[block(0, 0), block(0, 1)], [block(1, 0), block(1, 1)]],
            right: lambda.map(|l| -weight * l * residual),
        }
    }
}

fn conjugate_gradients(
    inverse: &[DMat3],
    mut r: Vec<DVec3>,
    mut apply: impl FnMut(&[DVec3], &mut [DVec3]),
) -> Vec<DVec3> {
    let n = r.len();
    let dot = |a: &[DVec3], b: &[DVec3]| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum() };
    let precondition = |r: &[DVec3]| -> Vec<DVec3> { inverse.iter().zip(r).map(|(m, &r)| *m * r).collect() };
    let (mut x, mut q) = (vec![DVec3::ZERO; n], vec![DVec3::ZERO; n]);
    let mut p = precondition(&r);
    let mut rz = dot(&r, &p);
    let enough = 1e-8 * rz;
    for _ in 0..STEPS {
        if rz <= enough || rz.is_nan() {
            break;
        }
        apply(&p, &mut q);
        let curvature = dot(&p, &q);
        if curvature <= 0.0 || curvature.is_nan() {
            break;
        }
        let alpha = rz / curvature;
        for v in 0..n {
            x[v] += alpha * p[v];
            r[v] -= alpha * q[v];
        }
        let z = precondition(&r);
        let next = dot(&r, &z);
        let beta = next / rz;
        rz = next;
        (0..n).for_each(|v| p[v] = z[v] + beta * p[v]);
    }
    x
}

/// Shortens moves until no facet turns or becomes a sliver.
fn restrain(positions: &[DVec3], facets: &[[u32; 3]], first: &[Facet], region: &[bool], moves: &mut [DVec3]) {
    for round in 0..8 {
        let spoilt: Vec<u32> = facets
            .par_iter()
            .zip(first)
            .filter(|(t, _)| t.iter().any(|&v| region[v as usize]))
            .filter(|(t, before)| {
                let moved = t.map(|v| positions[v as usize] + moves[v as usize]);
                let after = Facet::of(&moved, [0, 1, 2]);
                after.normal.dot(before.normal) < LEAST_COSINE
                    || after.shape < before.shape.min(LEAST_SHAPE)
                    || after.angle < before.angle.min(LEAST_ANGLE)
            })
            .flat_map_iter(|(t, _)| *t)
            .collect();
        if spoilt.is_empty() {
            return;
        }
        let factor = if round < 4 { 0.5 } else { 0.0 };
        let mut shortened = vec![false; moves.len()];
        for v in spoilt {
            if !std::mem::replace(&mut shortened[v as usize], true) {
                moves[v as usize] *= factor;
            }
        }
    }
}
