//! The normal equations of the fit.
//!
//! Purpose: for a point s of the input with normal n and nearest facet point Σ λ_i x_i the residual is n·(Σ λ_i x_i - s),
//! as in the point-to-plane registration of Chen and Medioni (1992). For a curve it is the part of Σ λ_i x_i - s across the
//! edge. The moves solve a sparse system, a row of symmetric 3 x 3 blocks a vertex, by preconditioned conjugate gradients.
//! Invariant: sums have a fixed order: samples by vertex, facets of a one-ring ascending, vertices in runs. So the
//! moves have the same bits whatever the number of threads. Must not know: whether a move is allowed.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::Target;
use crate::remesh::constants::*;
use crate::remesh::distance::{RingQuery, SurfaceSample};
use crate::remesh::features::envelope::CurveSample;
use crate::remesh::manifold::LocalMesh;
use crate::remesh::triangle::Norm;
use crate::tasks;
use crate::token::Token;

pub(super) const NONE: u32 = u32::MAX;

/// A symmetric matrix: xx xy xz yy yz zz.
#[derive(Clone, Copy, Debug, Default)]
struct Symmetric([f64; 6]);

impl Symmetric {
    fn of(m: DMat3) -> Self {
        Self([m.x_axis.x, m.x_axis.y, m.x_axis.z, m.y_axis.y, m.y_axis.z, m.z_axis.z])
    }

    fn outer(n: DVec3) -> Self {
        Self([n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z])
    }

    fn add(&mut self, factor: f64, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(to, from)| *to += factor * from);
    }

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

/// By how much a facet's point is off the tangent plane of a sample.
pub(super) fn residual(sample: &SurfaceSample, corners: [DVec3; 3], weights: [f64; 3]) -> f64 {
    let point: DVec3 = (0..3).map(|i| weights[i] * corners[i]).sum();
    sample.normal.dot(point - sample.position)
}

/// Pairs of corners that have a block.
const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

impl Share {
    /// `counts` is by how much more the residual counts than its area says.
    fn add(&mut self, sample: &SurfaceSample, corners: [DVec3; 3], weights: [f64; 3], counts: f64) {
        let n = sample.normal;
        let residual = residual(sample, corners, weights);
        let plane = Symmetric::outer(n);
        self.normal += sample.area * n;
        for (i, weight) in weights.into_iter().enumerate() {
            self.right[i] -= counts * sample.area * weight * residual * n;
            self.area[i] += sample.area * weight;
        }
        for (block, (i, j)) in self.blocks.iter_mut().zip(PAIRS) {
            block.add(counts * sample.area * weights[i] * weights[j], &plane);
        }
    }

    fn block(&self, i: usize, j: usize) -> &Symmetric {
        let (i, j) = (i.min(j), i.max(j));
        &self.blocks[i * (5 - i) / 2 + j]
    }

    /// Stiffness between each two of its corners.
    fn stiffness(&self) -> f64 {
        STIFFNESS / 3.0 * (self.area[0] + self.area[1] + self.area[2])
    }
}

/// Share of a point of a curve in the equations of one end of its edge.
struct CurveShare {
    vertex: u32,
    other: u32,
    own: Symmetric,
    off: Symmetric,
    right: DVec3,
}

impl CurveShare {
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
        let weight = CURVE_WEIGHT * sample.area;
        [0, 1].map(|i| {
            let (mut own, mut off) = (Symmetric::default(), Symmetric::default());
            own.add(weight * weights[i] * weights[i], &across);
            off.add(weight * weights[0] * weights[1], &across);
            let right = -weight * weights[i] * residual;
            Self { vertex: sample.edge[i], other: sample.edge[1 - i], own, off, right }
        })
    }
}

/// The facet of the one-ring of its vertex that is nearest to each sample.
pub(super) struct NearestFacets {
    /// In the order of the samples; [`NONE`] for a vertex without facets.
    pub(super) facet: Vec<u32>,
    /// Of the nearest point, by corner.
    pub(super) weights: Vec<[f64; 3]>,
}

impl NearestFacets {
    pub(super) fn new(mesh: &LocalMesh, target: &Target, token: &Token) -> Self {
        let samples = &target.input.samples;
        let (mut facet, mut weights) = (vec![NONE; samples.all().len()], vec![[0.0; 3]; samples.all().len()]);
        let (mut facets, mut rest) = (facet.as_mut_slice(), weights.as_mut_slice());
        let count = mesh.positions.len() as u32;
        let mut runs = Vec::with_capacity(count as usize / VERTICES_PER_RUN + 1);
        for begin in (0..count).step_by(VERTICES_PER_RUN) {
            let vertices = begin..count.min(begin + VERTICES_PER_RUN as u32);
            let own = samples.range(vertices.end - 1).end - samples.range(begin).start;
            let (f, w);
            (f, facets) = facets.split_at_mut(own);
            (w, rest) = rest.split_at_mut(own);
            runs.push((vertices, f, w));
        }
        runs.into_par_iter().for_each_init(RingQuery::default, |query, (vertices, facet, weights)| {
            let mut to = facet.iter_mut().zip(weights);
            for v in vertices {
                query.move_to(mesh, v);
                for (k, (sample, (facet, weights))) in samples.of(v).iter().zip(&mut to).enumerate() {
                    // A one-ring may have many facets, and a cell many samples.
                    if token.check_at(WORK_PER_POINT * k).is_err() {
                        return;
                    }
                    let found = query.nearest(sample.position);
                    (*facet, *weights) = (found.facet, found.weights);
                }
            }
        });
        Self { facet, weights }
    }

    /// The sum over the samples that are nearest to facet `f`. `counts` says how much a residual counts.
    fn share(&self, mesh: &LocalMesh, target: &Target, f: u32, counts: impl Fn(f64) -> f64) -> Share {
        let mut share = Share::default();
        let corners = mesh.corners(f);
        for v in mesh.facets()[f as usize] {
            let range = target.input.samples.range(v);
            let of = self.facet[range.clone()].iter().zip(&self.weights[range]).zip(target.input.samples.of(v));
            for ((_, &weights), sample) in of.filter(|((facet, _), _)| **facet == f) {
                share.add(sample, corners, weights, counts(residual(sample, corners, weights)));
            }
        }
        share
    }

    /// The mean of the squared residuals.
    fn mean_square(&self, mesh: &LocalMesh, target: &Target) -> f64 {
        let of = self.facet.iter().zip(&self.weights).zip(target.input.samples.all());
        let of = of.filter(|((facet, _), _)| **facet != NONE);
        let squares = of.map(|((&facet, &weights), sample)| {
            let off = residual(sample, mesh.corners(facet), weights);
            (sample.area * off * off, sample.area)
        });
        let (sum, area) = squares.fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
        if area > 0.0 { sum / area } else { 0.0 }
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

struct Parts<'a> {
    mesh: &'a LocalMesh,
    /// Where vertices were before the fit.
    start: &'a [DVec3],
    damping: f64,
    shares: Vec<Share>,
    /// By vertex.
    curves: Vec<CurveShare>,
    /// For each vertex the number of its unknown.
    unknown: Vec<u32>,
}

impl Parts<'_> {
    fn moved(&self, v: u32) -> DVec3 {
        self.mesh.positions[v as usize] - self.start[v as usize]
    }

    fn rows(&self, vertices: &[u32]) -> Rows {
        let mut rows = Rows::default();
        rows.diagonal.reserve_exact(vertices.len());
        rows.inverse.reserve_exact(vertices.len());
        rows.right.reserve_exact(vertices.len());
        rows.ends.reserve_exact(vertices.len());
        // Most have as many neighbours, and some have more.
        rows.blocks.reserve((REGULAR_VALENCE + 1) * vertices.len());
        vertices.iter().for_each(|&v| self.add_row(&mut rows, v));
        rows
    }

    fn add_row(&self, rows: &mut Rows, v: u32) {
        let mesh = self.mesh;
        let begin = rows.blocks.len();
        let (mut own, mut right, mut area, mut normal) = (Symmetric::default(), DVec3::ZERO, 0.0, DVec3::ZERO);
        let mut couple = |other: u32, block: &Symmetric, stiffness: f64| {
            if other != NONE {
                let known = rows.blocks[begin..].iter().position(|b| b.0 == other).map(|k| begin + k);
                let at = known.unwrap_or_else(|| {
                    rows.blocks.push((other, Symmetric::default()));
                    rows.blocks.len() - 1
                });
                rows.blocks[at].1.add(1.0, block);
                rows.blocks[at].1.widen(-stiffness);
            }
        };
        for &f in mesh.ring(v) {
            let t = mesh.facets()[f as usize];
            let share = &self.shares[f as usize];
            let moved = t.map(|u| self.moved(u));
            let (sum, k) = (moved[0] + moved[1] + moved[2], self.damping * share.stiffness());
            for (i, _) in t.iter().enumerate().filter(|(_, u)| **u == v) {
                own.add(1.0, share.block(i, i));
                own.widen(2.0 * k);
                // Stiffness acts on the whole move since the start, not on that of this round.
                right += share.right[i] - k * (3.0 * moved[i] - sum);
                area += share.area[i];
                normal += share.normal;
                (0..3).filter(|&j| j != i).for_each(|j| couple(self.unknown[t[j] as usize], share.block(i, j), k));
            }
        }
        let curves = self.curves.partition_point(|c| c.vertex < v);
        for curve in self.curves[curves..].iter().take_while(|c| c.vertex == v) {
            own.add(1.0, &curve.own);
            right += curve.right;
            couple(self.unknown[curve.other as usize], &curve.off, 0.0);
        }
        let mut extra = Symmetric::default();
        extra.widen(self.damping * TANGENT_DAMPING * area);
        extra.add(
            self.damping * (NORMAL_DAMPING - TANGENT_DAMPING) * area,
            &Symmetric::outer(normal.normalize_or_zero()),
        );
        // So does damping.
        right -= extra.times(self.moved(v));
        own.add(1.0, &extra);
        let has_area = area > 0.0;
        rows.diagonal.push(own);
        rows.inverse.push(if has_area { own.inverse() } else { Symmetric::default() });
        rows.right.push(if has_area { right } else { DVec3::ZERO });
        rows.ends.push(rows.blocks.len() as u32);
    }
}

pub(super) struct NormalEquations {
    vertices: usize,
    /// The vertices that may move.
    unknowns: Vec<u32>,
    rows: Vec<Rows>,
}

impl NormalEquations {
    /// For the vertices that are not fixed. They were at `start` before the fit. `damping` is a share of that of round facets.
    pub(super) fn new(
        mesh: &LocalMesh,
        target: &Target,
        (start, damping): (&[DVec3], f64),
        norm: Norm,
        token: &Token,
    ) -> Self {
        let found = NearestFacets::new(mesh, target, token);
        let facets = mesh.facets().len();
        let shares = match norm {
            Norm::MeanSquare => tasks::map(facets, |f| found.share(mesh, target, f as u32, |_| 1.0)),
            Norm::Largest => {
                // Reweighted least squares.
                let mean = found.mean_square(mesh, target).max(f64::MIN_POSITIVE);
                let counts =
                    |off: f64| (off * off / mean).powi(LARGEST_POWER).clamp(LARGEST_WEIGHT.recip(), LARGEST_WEIGHT);
                tasks::map(facets, |f| found.share(mesh, target, f as u32, counts))
            }
        };
        let mut curves: Vec<_> = target.curves.iter().flat_map(|s| CurveShare::both(&mesh.positions, s)).collect();
        curves.sort_by_key(|c| c.vertex);
        let unknowns: Vec<u32> = (0..mesh.positions.len() as u32).filter(|&v| !target.fixed[v as usize]).collect();
        let mut unknown = vec![NONE; mesh.positions.len()];
        unknowns.iter().zip(0..).for_each(|(&v, i)| unknown[v as usize] = i);
        let parts = Parts { mesh, start, damping, shares, curves, unknown };
        let rows = unknowns.par_chunks(VERTICES_PER_RUN).map(|vertices| parts.rows(vertices)).collect();
        Self { vertices: mesh.positions.len(), unknowns, rows }
    }

    /// The moves, by conjugate gradients.
    pub(super) fn solve(&self, token: &Token) -> Vec<DVec3> {
        let n = self.unknowns.len();
        let (mut x, mut q) = (vec![DVec3::ZERO; n], vec![DVec3::ZERO; n]);
        let mut r: Vec<DVec3> = self.rows.iter().flat_map(|rows| rows.right.iter().copied()).collect();
        let inverses = self.rows.iter().flat_map(|rows| &rows.inverse);
        let mut p: Vec<DVec3> = inverses.zip(&r).map(|(m, &r)| m.times(r)).collect();
        let mut rz: f64 = r.iter().zip(&p).map(|(r, z)| r.dot(*z)).sum();
        let enough = RESIDUAL_SHARE * rz;
        for _ in 0..GRADIENT_STEPS {
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
        let mut moves = vec![DVec3::ZERO; self.vertices];
        self.unknowns.iter().zip(x).for_each(|(&v, x)| moves[v as usize] = x);
        moves
    }

    /// Computes `q = A p`. Returns `p·q`.
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
        let runs = self.rows.par_iter().zip(q.par_chunks_mut(VERTICES_PER_RUN)).zip(p.par_chunks(VERTICES_PER_RUN));
        let products: Vec<f64> = runs.map(run).collect();
        products.iter().sum()
    }

    /// Moves `x` and `r` one step along `p`. `q` has `A p`, then `z`, the residual divided by the diagonal. Returns `r·z`.
    fn advance(&self, step: f64, p: &[DVec3], q: &mut [DVec3], x: &mut [DVec3], r: &mut [DVec3]) -> f64 {
        let runs = self.rows.par_iter().zip(q.par_chunks_mut(VERTICES_PER_RUN)).zip(x.par_chunks_mut(VERTICES_PER_RUN));
        let runs = runs.zip(r.par_chunks_mut(VERTICES_PER_RUN)).zip(p.par_chunks(VERTICES_PER_RUN)).map(
            |((((rows, q), x), r), p)| {
                let mut product = 0.0;
                for (i, inverse) in rows.inverse.iter().enumerate() {
                    x[i] += step * p[i];
                    r[i] -= step * q[i];
                    q[i] = inverse.times(r[i]);
                    product += r[i].dot(q[i]);
                }
                product
            },
        );
        let products: Vec<f64> = runs.collect();
        products.iter().sum()
    }
}
