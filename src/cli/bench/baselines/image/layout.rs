//! A disk laid out on the unit square.
//!
//! Purpose: the boundary goes around the square by its length, the other vertices to weighted means of their neighbours
//! (Tutte 1963), with the weights of a harmonic map where these are positive; solved by conjugate gradients.
//! Invariant: weights are above 0 and the square is convex, so that no facet is turned over (one with all corners on a side
//! has no area there). Must not know: texels, seeds.

use std::collections::BTreeMap;
use std::collections::HashMap;

use geometry::mesh::TriMesh;
use geometry::mesh::adjacency::{Adjacency, EdgeKind};
use geometry::mesh::measure::topology;
use geometry::rvd::RvdError;
use geometry::token::Token;

/// Least weight of an edge: cotangents are below 0 where angles are obtuse.
const LEAST_WEIGHT: f64 = 1e-2;
/// Residual at which a solution is good enough, of the first one.
const RESIDUAL: f64 = 1e-10;
/// Steps of conjugate gradients, per root of the number of vertices.
const STEPS: f64 = 100.0;

/// Why a surface has no geometry image.
#[derive(Debug, thiserror::Error)]
#[error("the surface is no disk: {0}")]
pub(in super::super) struct NotADisk(String);

/// A place in the unit square for each vertex; vertices without facets are at the origin.
pub(super) fn square(mesh: &TriMesh, token: &Token) -> Result<Result<Vec<[f64; 2]>, NotADisk>, RvdError> {
    let is = topology(mesh);
    if (is.components, is.boundary_loops, is.euler, is.non_manifold_vertices) != (1, 1, 1, 0) {
        let (parts, loops, euler, bad) = (is.components, is.boundary_loops, is.euler, is.non_manifold_vertices);
        let has = format!("components {parts}, boundaries {loops}, Euler number {euler}, non-manifold vertices {bad}");
        return Ok(Err(NotADisk(format!("{has}; a disk has 1, 1, 1 and 0"))));
    }
    let Some(boundary) = boundary(mesh) else {
        return Ok(Err(NotADisk("its boundary is in no order; orient the facets alike".to_owned())));
    };
    let fixed = around(mesh, &boundary);
    let weights = weights(mesh);
    token.check()?;
    let vertices = mesh.positions().len();
    let mut system =
        System { free: vec![false; vertices], diagonal: vec![0.0; vertices], rows: vec![vec![]; vertices] };
    for (&[a, b], &weight) in &weights {
        for (from, to) in [(a, b), (b, a)] {
            system.free[from as usize] = !fixed.contains_key(&from);
            system.diagonal[from as usize] += weight;
            system.rows[from as usize].push((to, weight));
        }
    }
    let mut places = vec![[0.0; 2]; vertices];
    for axis in 0..2 {
        let mut x = vec![0.5; vertices];
        fixed.iter().for_each(|(&v, place)| x[v as usize] = place[axis]);
        system.solve(&mut x, token)?;
        places.iter_mut().zip(x).for_each(|(place, x)| place[axis] = x.clamp(0.0, 1.0));
    }
    Ok(Ok(places))
}

/// Vertices of the boundary in their order; `None` if it has none.
fn boundary(mesh: &TriMesh) -> Option<Vec<u32>> {
    let adjacency = Adjacency::new(mesh);
    let halves = (0..3 * mesh.facets().len()).filter(|&half| adjacency.kind(half) == EdgeKind::Boundary);
    let ends = |half: usize| {
        let corners = mesh.facets()[half / 3];
        (corners[half % 3], corners[(half % 3 + 1) % 3])
    };
    let next: HashMap<u32, u32> = halves.map(ends).collect();
    let first = *next.keys().min()?;
    let mut boundary = vec![first];
    let mut at = *next.get(&first)?;
    while at != first && boundary.len() <= next.len() {
        boundary.push(at);
        at = *next.get(&at)?;
    }
    (boundary.len() == next.len() && boundary.len() >= 3).then_some(boundary)
}

/// Places on the sides of the square, by length. Corners are vertices, those nearest to quarters of it.
fn around(mesh: &TriMesh, boundary: &[u32]) -> BTreeMap<u32, [f64; 2]> {
    let at = |k: usize| mesh.positions()[boundary[k % boundary.len()] as usize];
    let mut length = vec![0.0];
    for k in 0..boundary.len() {
        length.push(length[k] + at(k).distance(at(k + 1)));
    }
    let total = length[boundary.len()];
    let nearest = |quarter: usize| {
        let wanted = total * quarter as f64 / 4.0;
        let off = |&k: &usize| (length[k] - wanted).abs();
        (0..boundary.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
    };
    let mut corners = [0, nearest(1), nearest(2), nearest(3), boundary.len()];
    // Each at least one after the one before, as far as there are vertices.
    for k in 1..4 {
        corners[k] = corners[k].max(corners[k - 1] + 1).min(boundary.len().saturating_sub(4 - k));
    }
    let mut places = BTreeMap::new();
    for side in 0..4 {
        let (from, to) = (corners[side], corners[side + 1]);
        for k in from..to {
            let share = (length[k] - length[from]) / (length[to] - length[from]).max(f64::MIN_POSITIVE);
            let place = match side {
                0 => [share, 0.0],
                1 => [1.0, share],
                2 => [1.0 - share, 1.0],
                _ => [0.0, 1.0 - share],
            };
            places.insert(boundary[k], place);
        }
    }
    places
}

/// Weights of the edges: half the cotangents of the angles that face them, in a fixed order.
fn weights(mesh: &TriMesh) -> BTreeMap<[u32; 2], f64> {
    let mut weights = BTreeMap::new();
    for (f, corners) in mesh.facets().iter().enumerate() {
        let at = mesh.corners(f);
        for c in 0..3 {
            let (a, b) = ((c + 1) % 3, (c + 2) % 3);
            let (u, v) = (at[a] - at[c], at[b] - at[c]);
            let cotangent = u.dot(v) / u.cross(v).length().max(f64::MIN_POSITIVE);
            let edge = [corners[a].min(corners[b]), corners[a].max(corners[b])];
            if edge[0] != edge[1] {
                *weights.entry(edge).or_insert(0.0) += 0.5 * cotangent.clamp(-1e6, 1e6);
            }
        }
    }
    weights.values_mut().for_each(|weight| *weight = weight.max(LEAST_WEIGHT));
    weights
}

/// Each free vertex is the weighted mean of its neighbours.
struct System {
    free: Vec<bool>,
    diagonal: Vec<f64>,
    rows: Vec<Vec<(u32, f64)>>,
}

impl System {
    /// Conjugate gradients from `x`, whose other values stay; scaled by the diagonal.
    fn solve(&self, x: &mut [f64], token: &Token) -> Result<(), RvdError> {
        let all: Vec<usize> = (0..x.len()).filter(|&v| self.free[v]).collect();
        let row = |v: usize, p: &[f64]| {
            let around = self.rows[v].iter().map(|&(to, weight)| weight * p[to as usize]);
            self.diagonal[v] * p[v] - around.sum::<f64>()
        };
        let dot = |a: &[f64], b: &[f64]| all.iter().map(|&v| a[v] * b[v]).sum::<f64>();
        let mut r = vec![0.0; x.len()];
        all.iter().for_each(|&v| r[v] = -row(v, x));
        let scaled = |r: &[f64]| -> Vec<f64> {
            let of = |(v, &r): (usize, &f64)| if self.free[v] { r / self.diagonal[v] } else { 0.0 };
            r.iter().enumerate().map(of).collect()
        };
        let mut z = scaled(&r);
        let mut p = z.clone();
        let mut along = dot(&r, &z);
        let enough = along * RESIDUAL * RESIDUAL;
        for _ in 0..(STEPS * (x.len() as f64).sqrt()) as usize {
            token.check()?;
            if along <= enough || along == 0.0 {
                break;
            }
            let mut q = vec![0.0; x.len()];
            all.iter().for_each(|&v| q[v] = row(v, &p));
            let step = along / dot(&p, &q);
            for &v in &all {
                x[v] += step * p[v];
                r[v] -= step * q[v];
            }
            z = scaled(&r);
            let before = std::mem::replace(&mut along, dot(&r, &z));
            let turn = along / before;
            all.iter().for_each(|&v| p[v] = z[v] + turn * p[v]);
        }
        Ok(())
    }
}
