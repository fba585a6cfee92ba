//! The moves that bring a triangulation nearest to its samples.
//!
//! Purpose: for a point s of the input with normal n and nearest facet point Σ λ_i x_i the residual is
//! n·(Σ λ_i x_i - s), as in the point-to-plane registration of Chen and Medioni (1992); for a point of a
//! curve it is the part of Σ λ_i x_i - s across the edge. The moves solve a sparse system, a row of symmetric 3 x 3
//! blocks a vertex, by conjugate gradients.
//! Invariant: sums have a fixed order: samples by vertex, facets around a vertex ascending, vertices in runs. So the
//! moves have the same bits whatever the number of threads. Must not know: whether a move is allowed.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::super::fan::Fan;
use super::region::{NONE, Region};
use super::{CurveSample, Draft, Sample, Target};
use crate::token::Token;

/// Steps of conjugate gradients a round: moves reach a few facets far.
const STEPS: usize = 14;
/// A move within the tangent plane by so much is as costly as a residual of the same length: a vertex has
/// nothing to gain by sliding. On rocker-arm with 5,000 points 0.05 leaves 4 % more RMS distance; 0.01 costs 0.002 of
/// mean quality.
const DAMPING: f64 = 0.02;
/// Neighbours that move apart by so much, likewise: who is pulled away takes them along.
const STIFFNESS: f64 = 0.02;
/// What keeps the system solvable where samples are few.
const FLOOR: f64 = 0.01;
/// Curves are lines that the eye follows: a residual there counts for this many of the surface's.
const CURVES: f64 = 20.0;
/// A tip pulls a vertex as strongly as this many of the vertex's own areas.
const TIP_PULL: f64 = 20.0;
/// Vertices that are one task, and facets that are not worth one.
const RUN: usize = 256;
/// Samples between two looks at the token.
const ASKED: usize = 64;

/// Neighbours of a vertex in the mean, and some room.
const BESIDE: usize = 7;

/// A symmetric matrix: xx xy xz yy yz zz.
#[derive(Clone, Copy, Debug, Default)]
struct Symmetric([f64; 6]);

impl Symmetric {
    fn of(m: DMat3) -> Self {
        Self([m.x_axis.x, m.x_axis.y, m.x_axis.z, m.y_axis.y, m.y_axis.z, m.z_axis.z])
    }

    /// n nᵀ.
    fn outer(n: DVec3) -> Self {
        Self([n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z])
    }

    fn add(&mut self, factor: f64, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(to, from)| *to += factor * from);
    }

    /// Adds a multiple of the identity.
    fn widen(&mut self, by: f64) {
        [0, 3, 5].into_iter().for_each(|k| self.0[k] += by);
    }

    fn times(&self, p: DVec3) -> DVec3 {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        DVec3::new(xx * p.x + xy * p.y + xz * p.z, xy * p.x + yy * p.y + yz * p.z, xz * p.x + yz * p.y + zz * p.z)
    }

    fn inverse(&self) -> Self {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        Self::of(DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]).inverse())
    }
}

/// One facet's share of the normal equations: blocks (i, j) of Σ a λ_i λ_j n nᵀ, and of -Σ a λ_i r n.
#[derive(Clone, Copy, Default)]
struct Share {
    /// (0, 0) (0, 1) (0, 2) (1, 1) (1, 2) (2, 2); the others are the same, since all are symmetric.
    blocks: [Symmetric; 6],
    right: [DVec3; 3],
    /// Area for each corner, and ∫ n.
    area: [f64; 3],
    normal: DVec3,
}

/// Pairs of corners that have a block.
const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

impl Share {
    fn add(&mut self, sample: &Sample, corners: [DVec3; 3], weights: [f64; 3]) {
        let point: DVec3 = (0..3).map(|i| weights[i] * corners[i]).sum();
        let n = sample.normal;
        let residual = n.dot(point - sample.position);
        let plane = Symmetric::outer(n);
        self.normal += sample.area * n;
        for (i, weight) in weights.into_iter().enumerate() {
            self.right[i] -= sample.area * weight * residual * n;
            self.area[i] += sample.area * weight;
        }
        for (block, (i, j)) in self.blocks.iter_mut().zip(PAIRS) {
            block.add(sample.area * weights[i] * weights[j], &plane);
        }
    }

    fn block(&self, i: usize, j: usize) -> &Symmetric {
        let (i, j) = (i.min(j), i.max(j));
        &self.blocks[i * (5 - i) / 2 + j]
    }

    /// Of the springs between its corners.
    fn stiffness(&self) -> f64 {
        STIFFNESS / 3.0 * (self.area[0] + self.area[1] + self.area[2])
    }
}

/// What a point of a curve asks of one end of its edge.
struct Pull {
    vertex: u32,
    /// The other end.
    other: u32,
    own: Symmetric,
    off: Symmetric,
    right: DVec3,
}

impl Pull {
    fn both(positions: &[DVec3], sample: &CurveSample) -> [Self; 2] {
        let [a, b] = sample.edge.map(|v| positions[v as usize]);
        let along = b - a;
        let length = along.length_squared();
        let t = if length > 0.0 { ((sample.position - a).dot(along) / length).clamp(0.0, 1.0) } else { 0.5 };
        let weights = [1.0 - t, t];
        let mut across = Symmetric::default();
        across.widen(1.0);
        across.add(-1.0, &Symmetric::outer(along.normalize_or_zero()));
        let residual = across.times(a + t * along - sample.position);
        let weight = CURVES * sample.area;
        [0, 1].map(|i| {
            let (mut own, mut off) = (Symmetric::default(), Symmetric::default());
            own.add(weight * weights[i] * weights[i], &across);
            off.add(weight * weights[0] * weights[1], &across);
            let right = -weight * weights[i] * residual;
            Self { vertex: sample.edge[i], other: sample.edge[1 - i], own, off, right }
        })
    }
}

/// Nearest facets of the samples of a region's vertices.
struct Found {
    /// For each of the region's vertices the first of its samples; and the total.
    first: Vec<u32>,
    facet: Vec<u32>,
    weights: Vec<[f64; 3]>,
}

impl Found {
    fn new(draft: &Draft<'_>, target: &Target, region: &Region, token: &Token) -> Self {
        let mut first = Vec::with_capacity(region.reached.len() + 1);
        let mut total = 0;
        first.push(0);
        first.extend(region.reached.iter().map(|&v| {
            total += target.samples.of(v).len() as u32;
            total
        }));
        let (mut facet, mut weights) = (vec![NONE; total as usize], vec![[0.0; 3]; total as usize]);
        let (mut facets, mut rest) = (facet.as_mut_slice(), weights.as_mut_slice());
        let mut runs = Vec::with_capacity(region.reached.len() / RUN + 1);
        for (k, vertices) in region.reached.chunks(RUN).enumerate() {
            let count = (first[k * RUN + vertices.len()] - first[k * RUN]) as usize;
            let (f, w);
            (f, facets) = facets.split_at_mut(count);
            (w, rest) = rest.split_at_mut(count);
            runs.push((vertices, f, w));
        }
        runs.into_par_iter().for_each_init(Fan::default, |fan, (vertices, facet, weights)| {
            let mut to = facet.iter_mut().zip(weights);
            for &v in vertices {
                fan.turn_to(draft.positions, draft.facets, draft.around, v);
                for (k, (sample, (facet, weights))) in target.samples.of(v).iter().zip(&mut to).enumerate() {
                    // A vertex may have many facets, and many samples.
                    if k.is_multiple_of(ASKED) && token.is_stopped() {
                        return;
                    }
                    let found = fan.nearest(sample.position);
                    (*facet, *weights) = (found.facet, found.weights);
                }
            }
        });
        Self { first, facet, weights }
    }

    /// Adds up the samples that are nearest to facet `f`.
    fn share(&self, draft: &Draft<'_>, target: &Target, region: &Region, f: u32) -> Share {
        let mut share = Share::default();
        let corners = draft.corners(f);
        for v in draft.facets[f as usize] {
            let slot = region.slot(v) as usize;
            let range = self.first[slot] as usize..self.first[slot + 1] as usize;
            let of = self.facet[range.clone()].iter().zip(&self.weights[range]).zip(target.samples.of(v));
            of.filter(|((facet, _), _)| **facet == f).for_each(|((_, &w), sample)| share.add(sample, corners, w));
        }
        share
    }
}

/// Rows of a run of unknowns.
#[derive(Default)]
struct Rows {
    diagonal: Vec<Symmetric>,
    inverse: Vec<Symmetric>,
    right: Vec<DVec3>,
    /// Other blocks, with the unknown that they belong to, and where those of each row end.
    blocks: Vec<(u32, Symmetric)>,
    ends: Vec<u32>,
}

/// What the rows are made of.
struct Parts<'a> {
    draft: &'a Draft<'a>,
    region: &'a Region,
    /// Where vertices were at first.
    start: &'a [DVec3],
    shares: Vec<Share>,
    /// By vertex.
    curves: Vec<Pull>,
    tips: Vec<(u32, DVec3)>,
    /// The number of each unknown, by the region's places.
    unknown: Vec<u32>,
}

impl Parts<'_> {
    fn moved(&self, v: u32) -> DVec3 {
        self.draft.positions[v as usize] - self.start[v as usize]
    }

    fn unknown(&self, v: u32) -> u32 {
        self.unknown[self.region.slot(v) as usize]
    }

    fn rows(&self, vertices: &[u32]) -> Rows {
        let mut rows = Rows::default();
        rows.diagonal.reserve_exact(vertices.len());
        rows.inverse.reserve_exact(vertices.len());
        rows.right.reserve_exact(vertices.len());
        rows.ends.reserve_exact(vertices.len());
        rows.blocks.reserve(BESIDE * vertices.len());
        vertices.iter().for_each(|&v| self.add_row(&mut rows, v));
        rows
    }

    fn add_row(&self, rows: &mut Rows, v: u32) {
        let draft = self.draft;
        let begin = rows.blocks.len();
        let (mut own, mut right, mut area, mut normal) = (Symmetric::default(), DVec3::ZERO, 0.0, DVec3::ZERO);
        let mut couple = |other: u32, block: &Symmetric, less: f64| {
            if other != NONE {
                let known = rows.blocks[begin..].iter().position(|b| b.0 == other).map(|k| begin + k);
                let at = known.unwrap_or_else(|| {
                    rows.blocks.push((other, Symmetric::default()));
                    rows.blocks.len() - 1
                });
                rows.blocks[at].1.add(1.0, block);
                rows.blocks[at].1.widen(-less);
            }
        };
        for &f in draft.around.of(v) {
            let t = draft.facets[f as usize];
            let share = &self.shares[self.region.place(f) as usize];
            let from = t.map(|u| self.moved(u));
            let (sum, k) = (from[0] + from[1] + from[2], share.stiffness());
            for (i, _) in t.iter().enumerate().filter(|(_, u)| **u == v) {
                own.add(1.0, share.block(i, i));
                own.widen(2.0 * k);
                // Against moving apart counts all that they have moved so far.
                right += share.right[i] - k * (3.0 * from[i] - sum);
                area += share.area[i];
                normal += share.normal;
                (0..3).filter(|&j| j != i).for_each(|j| couple(self.unknown(t[j]), share.block(i, j), k));
            }
        }
        let curves = self.curves.partition_point(|c| c.vertex < v);
        for curve in self.curves[curves..].iter().take_while(|c| c.vertex == v) {
            own.add(1.0, &curve.own);
            right += curve.right;
            couple(self.unknown(curve.other), &curve.off, 0.0);
        }
        let mut extra = Symmetric::default();
        extra.widen(DAMPING * area);
        extra.add((FLOOR - DAMPING) * area, &Symmetric::outer(normal.normalize_or_zero()));
        // So it does against sliding.
        right -= extra.times(self.moved(v));
        let tips = self.tips.partition_point(|t| t.0 < v);
        for &(_, to) in self.tips[tips..].iter().take_while(|t| t.0 == v) {
            extra.widen(TIP_PULL * area);
            right += TIP_PULL * area * (to - draft.positions[v as usize]);
        }
        own.add(1.0, &extra);
        let has_area = area > 0.0;
        rows.diagonal.push(own);
        rows.inverse.push(if has_area { own.inverse() } else { Symmetric::default() });
        rows.right.push(if has_area { right } else { DVec3::ZERO });
        rows.ends.push(rows.blocks.len() as u32);
    }
}

/// See the module's head.
pub(super) struct Equations {
    vertices: usize,
    /// The vertices that may move.
    unknowns: Vec<u32>,
    rows: Vec<Rows>,
}

impl Equations {
    /// For the vertices inside the region that are not fixed. They were at `start` at first; `tips` pull some.
    pub(super) fn new(
        draft: &Draft<'_>,
        target: &Target,
        region: &Region,
        (start, tips): (&[DVec3], &[(u32, DVec3)]),
        token: &Token,
    ) -> Self {
        let found = Found::new(draft, target, region, token);
        let share = |&f: &u32| found.share(draft, target, region, f);
        let shares = region.facets.par_iter().with_min_len(RUN).map(share).collect();
        let in_region = target.curves.iter().filter(|s| s.edge.iter().all(|&v| region.reaches(v)));
        let mut curves: Vec<Pull> = in_region.flat_map(|s| Pull::both(draft.positions, s)).collect();
        curves.sort_by_key(|c| c.vertex);
        let mut tips = tips.to_vec();
        tips.sort_by_key(|t| t.0);
        let unknowns: Vec<u32> = region.inside().filter(|&v| !target.fixed[v as usize]).collect();
        let mut unknown = vec![NONE; region.reached.len()];
        unknowns.iter().zip(0..).for_each(|(&v, i)| unknown[region.slot(v) as usize] = i);
        let parts = Parts { draft, region, start, shares, curves, tips, unknown };
        let rows = unknowns.par_chunks(RUN).map(|vertices| parts.rows(vertices)).collect();
        Self { vertices: draft.positions.len(), unknowns, rows }
    }

    /// The moves, one a vertex.
    pub(super) fn solve(&self, token: &Token) -> Vec<DVec3> {
        let mut moves = vec![DVec3::ZERO; self.vertices];
        let x = self.conjugate_gradients(token);
        self.unknowns.iter().zip(x).for_each(|(&v, x)| moves[v as usize] = x);
        moves
    }

    fn conjugate_gradients(&self, token: &Token) -> Vec<DVec3> {
        let n = self.unknowns.len();
        let (mut x, mut q) = (vec![DVec3::ZERO; n], vec![DVec3::ZERO; n]);
        let mut r: Vec<DVec3> = self.rows.iter().flat_map(|rows| rows.right.iter().copied()).collect();
        let inverses = self.rows.iter().flat_map(|rows| &rows.inverse);
        let mut p: Vec<DVec3> = inverses.zip(&r).map(|(m, &r)| m.times(r)).collect();
        let mut rz: f64 = r.iter().zip(&p).map(|(r, z)| r.dot(*z)).sum();
        let enough = 1e-8 * rz;
        for _ in 0..STEPS {
            if rz <= enough || rz.is_nan() || token.is_stopped() {
                break;
            }
            let curvature = self.apply(&p, &mut q);
            if curvature <= 0.0 || curvature.is_nan() {
                break;
            }
            let next = self.advance(rz / curvature, &p, &mut q, &mut x, &mut r);
            let beta = next / rz;
            rz = next;
            p.iter_mut().zip(&q).for_each(|(p, &z)| *p = z + beta * *p);
        }
        x
    }

    /// q = A p. Returns p·q.
    fn apply(&self, p: &[DVec3], q: &mut [DVec3]) -> f64 {
        let run = |((rows, q), own): ((&Rows, &mut [DVec3]), &[DVec3])| {
            let (mut begin, mut product) = (0, 0.0);
            for (i, q) in q.iter_mut().enumerate() {
                let end = rows.ends[i] as usize;
                let of_others = rows.blocks[begin..end].iter().map(|(u, block)| block.times(p[*u as usize]));
                *q = of_others.fold(rows.diagonal[i].times(own[i]), |sum, part| sum + part);
                product += own[i].dot(*q);
                begin = end;
            }
            product
        };
        let runs = self.rows.par_iter().zip(q.par_chunks_mut(RUN)).zip(p.par_chunks(RUN));
        let products: Vec<f64> = runs.map(run).collect();
        products.iter().sum()
    }

    /// x and r one step along p; q comes with A p and leaves with z, the residual divided by the diagonal. Returns r·z.
    fn advance(&self, step: f64, p: &[DVec3], q: &mut [DVec3], x: &mut [DVec3], r: &mut [DVec3]) -> f64 {
        let runs = self.rows.par_iter().zip(q.par_chunks_mut(RUN)).zip(x.par_chunks_mut(RUN));
        let runs = runs.zip(r.par_chunks_mut(RUN)).zip(p.par_chunks(RUN)).map(|((((rows, q), x), r), p)| {
            let mut product = 0.0;
            for (i, inverse) in rows.inverse.iter().enumerate() {
                x[i] += step * p[i];
                r[i] -= step * q[i];
                q[i] = inverse.times(r[i]);
                product += r[i].dot(q[i]);
            }
            product
        });
        let products: Vec<f64> = runs.collect();
        products.iter().sum()
    }
}
