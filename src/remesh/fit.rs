//! Vertices where the surface through them is nearest to the input.
//!
//! Purpose: a triangulation whose vertices lie on a curved surface lies on one side of it, off by
//! a share of κh² everywhere. This moves the vertices so that the mean square distance from the
//! input to the facets is least, tangent plane by tangent plane: along the normals where the surface
//! is smooth, and towards a ridge where samples of its two sides ask for it.
//! Invariant: no facet turns over and none becomes a sliver; held vertices stay; deterministic.
//! Must not know: seeds, diagrams, files.
//!
//! The quadrature is given: points of the input, each with its tangent plane, its area, and a vertex
//! around which the facet nearest to it lies. For a point s with normal n and nearest facet point
//! Σ λ_i x_i the residual is n·(Σ λ_i x_i - s), as in the point-to-plane registration of Chen and Medioni
//! (1992); the displacements solve a sparse system, facet by facet 9 x 9, by conjugate gradients.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::measure::facet_quality;

/// A point of the input with its share of the area.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Where it is.
    pub position: DVec3,
    /// Unit normal of the input there.
    pub normal: DVec3,
    /// Area it stands for.
    pub area: f64,
    /// A result vertex; the nearest facet is one of those around it.
    pub vertex: u32,
}

/// Times that nearest points are found anew.
const ROUNDS: usize = 3;
/// Steps of conjugate gradients a round: displacements reach a few facets far.
const STEPS: usize = 12;
/// A move by so much against the pull of the residuals is as costly as a residual of the same length. It
/// keeps vertices from sliding within a plane, where they have nothing to gain.
const DAMPING: f64 = 0.05;
/// Facets keep at least this quality (1 is equilateral), or what they had.
const LEAST_SHAPE: f64 = 0.62;
/// A facet's normal turns by at most this cosine from that before the fit.
const LEAST_COSINE: f64 = 0.5;

/// Moves `positions`, of which `held` stay.
pub fn fit(positions: &mut [DVec3], facets: &[[u32; 3]], held: &[bool], samples: &[Sample]) {
    let around = Around::new(positions.len(), facets);
    let first: Vec<Facet> = facets.iter().map(|&t| Facet::of(positions, t)).collect();
    for _ in 0..ROUNDS {
        let systems = assemble(positions, facets, &around, samples);
        let mut moves = solve(&systems, facets, held);
        restrain(positions, facets, &first, &mut moves);
        positions.iter_mut().zip(&moves).for_each(|(p, m)| *p += *m);
    }
}

/// Facets around each vertex.
struct Around {
    first: Vec<u32>,
    facets: Vec<u32>,
}

impl Around {
    fn new(vertices: usize, facets: &[[u32; 3]]) -> Self {
        let mut first = vec![0u32; vertices + 1];
        facets.iter().flatten().for_each(|&v| first[v as usize + 1] += 1);
        (0..vertices).for_each(|v| first[v + 1] += first[v]);
        let mut next = first.clone();
        let mut list = vec![0u32; 3 * facets.len()];
        for (f, t) in facets.iter().enumerate() {
            for &v in t {
                list[next[v as usize] as usize] = f as u32;
                next[v as usize] += 1;
            }
        }
        Self { first, facets: list }
    }

    fn of(&self, v: u32) -> &[u32] {
        &self.facets[self.first[v as usize] as usize..self.first[v as usize + 1] as usize]
    }
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
        Self {
            normal: (b - a).cross(c - a).normalize_or_zero(),
            shape: facet_quality(corners),
            angle: least_angle(corners),
        }
    }
}

fn least_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let at = |p: DVec3, q: DVec3, r: DVec3| (q - p).cross(r - p).length().atan2((q - p).dot(r - p)).to_degrees();
    at(a, b, c).min(at(b, c, a)).min(at(c, a, b))
}

/// One facet's share of the normal equations: blocks (i, j) of Σ a λ_i λ_j n nᵀ, and of -Σ a λ_i r n.
#[derive(Clone, Copy)]
struct System {
    blocks: [[DMat3; 3]; 3],
    right: [DVec3; 3],
    area: [f64; 3],
    normal: DVec3,
}

fn env(k: &str, d: f64) -> f64 {
    std::env::var(k).ok().and_then(|v| v.parse().ok()).unwrap_or(d)
}

fn assemble(positions: &[DVec3], facets: &[[u32; 3]], around: &Around, samples: &[Sample]) -> Vec<System> {
    let nearest: Vec<(u32, [f64; 3])> = samples.par_iter().map(|s| nearest(positions, facets, around, s)).collect();
    let mut order: Vec<u32> = (0..samples.len() as u32).filter(|&k| nearest[k as usize].0 != u32::MAX).collect();
    order.par_sort_unstable_by_key(|&k| (nearest[k as usize].0, k));
    let mut begin = vec![0u32; facets.len() + 1];
    order.iter().for_each(|&k| begin[nearest[k as usize].0 as usize + 1] += 1);
    (0..facets.len()).for_each(|f| begin[f + 1] += begin[f]);
    facets
        .par_iter()
        .enumerate()
        .map(|(f, t)| {
            let corners = t.map(|v| positions[v as usize]);
            let mut system =
                System { blocks: [[DMat3::ZERO; 3]; 3], right: [DVec3::ZERO; 3], area: [0.0; 3], normal: DVec3::ZERO };
            for &k in &order[begin[f] as usize..begin[f + 1] as usize] {
                let (sample, lambda) = (&samples[k as usize], nearest[k as usize].1);
                let point: DVec3 = (0..3).map(|i| lambda[i] * corners[i]).sum();
                let n = sample.normal;
                let residual = n.dot(point - sample.position);
                let plane = DMat3::from_cols(n * n.x, n * n.y, n * n.z);
                system.normal += sample.area * n;
                for i in 0..3 {
                    system.right[i] -= sample.area * lambda[i] * residual * n;
                    system.area[i] += sample.area * lambda[i];
                    for j in 0..3 {
                        system.blocks[i][j] += plane * (sample.area * lambda[i] * lambda[j]);
                    }
                }
            }
            system
        })
        .collect()
}

/// The facet around the sample's vertex that is nearest to it, and barycentric coordinates there.
fn nearest(positions: &[DVec3], facets: &[[u32; 3]], around: &Around, sample: &Sample) -> (u32, [f64; 3]) {
    let mut best = (f64::INFINITY, u32::MAX, [0.0; 3]);
    for &f in around.of(sample.vertex) {
        let t = facets[f as usize];
        let corners = t.map(|v| positions[v as usize]);
        let (squared, lambda) = closest_on_facet(sample.position, corners, t);
        if squared < best.0 {
            best = (squared, f, lambda);
        }
    }
    (best.1, best.2)
}

/// Conjugate gradients, preconditioned by each vertex's own 3 x 3 block.
fn solve(systems: &[System], facets: &[[u32; 3]], held: &[bool]) -> Vec<DVec3> {
    let n = held.len();
    let (mut own, mut right, mut area) = (vec![DMat3::ZERO; n], vec![DVec3::ZERO; n], vec![0.0; n]);
    let mut normal = vec![DVec3::ZERO; n];
    for (system, t) in systems.iter().zip(facets) {
        for (i, &v) in t.iter().enumerate() {
            own[v as usize] += system.blocks[i][i];
            right[v as usize] += system.right[i];
            area[v as usize] += system.area[i];
            normal[v as usize] += system.normal;
        }
    }
    // The planes' own mean direction counts as the normal.
    let damping: Vec<DMat3> = (0..n)
        .map(|v| {
            let n = normal[v].normalize_or_zero();
            let along = DMat3::from_cols(n * n.x, n * n.y, n * n.z);
            (DMat3::IDENTITY * env("DT", 0.3) - along * env("DT", 0.3) + along * env("DN", 0.01)) * area[v]
        })
        .collect();
    let inverse: Vec<DMat3> =
        (0..n).map(|v| if held[v] || area[v] <= 0.0 { DMat3::ZERO } else { (own[v] + damping[v]).inverse() }).collect();
    let mut x = vec![DVec3::ZERO; n];
    let mut r: Vec<DVec3> = (0..n).map(|v| if held[v] { DVec3::ZERO } else { right[v] }).collect();
    let precondition = |r: &[DVec3]| -> Vec<DVec3> { inverse.iter().zip(r).map(|(m, &r)| *m * r).collect() };
    let dot = |a: &[DVec3], b: &[DVec3]| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum() };
    let mut z = precondition(&r);
    let mut p = z.clone();
    let mut rz = dot(&r, &z);
    let damp = ();
    let _ = damp;
    let enough = 1e-8 * rz;
    let mut q = vec![DVec3::ZERO; n];
    for _ in 0..STEPS {
        if rz <= enough || rz == 0.0 {
            break;
        }
        (0..n).for_each(|v| q[v] = damping[v] * p[v]);
        for (system, t) in systems.iter().zip(facets) {
            let from = t.map(|v| p[v as usize]);
            for (i, &v) in t.iter().enumerate() {
                q[v as usize] +=
                    system.blocks[i][0] * from[0] + system.blocks[i][1] * from[1] + system.blocks[i][2] * from[2];
            }
        }
        (0..n).filter(|&v| held[v]).for_each(|v| q[v] = DVec3::ZERO);
        let alpha = rz / dot(&p, &q);
        for v in 0..n {
            x[v] += alpha * p[v];
            r[v] -= alpha * q[v];
        }
        z = precondition(&r);
        let next = dot(&r, &z);
        let beta = next / rz;
        rz = next;
        (0..n).for_each(|v| p[v] = z[v] + beta * p[v]);
    }
    x
}

/// Shortens moves until no facet turns or becomes a sliver.
fn restrain(positions: &[DVec3], facets: &[[u32; 3]], first: &[Facet], moves: &mut [DVec3]) {
    for round in 0.. {
        let spoilt: Vec<u32> = facets
            .par_iter()
            .zip(first)
            .filter(|(t, before)| {
                let after = Facet::of(&[0, 1, 2].map(|i| positions[t[i] as usize] + moves[t[i] as usize]), [0, 1, 2]);
                after.normal.dot(before.normal) < LEAST_COSINE
                    || after.shape < before.shape.min(LEAST_SHAPE)
                    || after.angle < before.angle.min(env("LA", 34.0))
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
        if round == 8 {
            // Facets that were spoilt before any move: nothing more can be done for them.
            return;
        }
    }
}
