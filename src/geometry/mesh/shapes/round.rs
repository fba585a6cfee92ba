//! Spheres and tori.

use std::collections::HashMap;
use std::f64::consts::TAU;

use glam::{DVec3, dvec3};

use super::Draft;
use crate::mesh::TriMesh;

/// A regular solid, each face divided into n² triangles and blown up: 20 n² or, where that is
/// much nearer to the target, 8 n² or 4 n² facets.
pub(super) fn sphere(facets: usize) -> TriMesh {
    let phi = (1.0 + 5f64.sqrt()) / 2.0;
    // Coordinates of the corners, and the corners of the faces.
    let solids: [(&[f64], &[u32]); 3] = [
        (
            &[
                -1., phi, 0., 1., phi, 0., -1., -phi, 0., 1., -phi, 0., 0., -1., phi, 0., 1., phi, 0., -1., -phi, 0.,
                1., -phi, phi, 0., -1., phi, 0., 1., -phi, 0., -1., -phi, 0., 1.,
            ],
            &[
                0, 11, 5, 0, 5, 1, 0, 1, 7, 0, 7, 10, 0, 10, 11, 1, 5, 9, 5, 11, 4, 11, 10, 2, 10, 7, 6, 7, 1, 8, 3, 9,
                4, 3, 4, 2, 3, 2, 6, 3, 6, 8, 3, 8, 9, 4, 9, 5, 2, 4, 11, 6, 2, 10, 8, 6, 7, 9, 8, 1,
            ],
        ),
        (
            &[1., 0., 0., 0., 1., 0., -1., 0., 0., 0., -1., 0., 0., 0., 1., 0., 0., -1.],
            &[0, 1, 4, 1, 2, 4, 2, 3, 4, 3, 0, 4, 1, 0, 5, 2, 1, 5, 3, 2, 5, 0, 3, 5],
        ),
        (&[1., 1., 1., 1., -1., -1., -1., 1., -1., -1., -1., 1.], &[0, 1, 2, 0, 3, 1, 0, 2, 3, 1, 3, 2]),
    ];
    let solids = solids.map(|(corners, faces)| (corners.as_chunks().0, faces.as_chunks().0));
    let target = facets as f64;
    let mut best = (f64::INFINITY, 0, 1);
    for (solid, (_, faces)) in solids.iter().enumerate() {
        let n = (target / faces.len() as f64).sqrt().round().max(1.0);
        // How far off; the rounder solid wins unless another is nearer by a tenth.
        let off = (faces.len() as f64 * n * n / target).ln().abs();
        if off < best.0 - 0.1 || solid == 0 {
            best = (off, solid, n as u32);
        }
    }
    let (corners, faces) = solids[best.1];
    divide(corners, faces, best.2)
}

/// Divides each face into n² triangles. A lattice point is known by the corners that weigh in
/// it, so that faces share the points of their edges.
fn divide(corners: &[[f64; 3]], faces: &[[u32; 3]], n: u32) -> TriMesh {
    let mut draft = Draft::default();
    let mut numbers: HashMap<[(u32, u32); 3], u32> = HashMap::new();
    for face in faces {
        let mut point = |i: u32, j: u32| {
            let mut key = [(face[0], n - i - j), (face[1], i), (face[2], j)];
            key.iter_mut().filter(|(_, weight)| *weight == 0).for_each(|entry| *entry = (u32::MAX, 0));
            key.sort_unstable();
            *numbers.entry(key).or_insert_with(|| {
                let sum: DVec3 = key
                    .iter()
                    .filter(|e| e.1 > 0)
                    .map(|&(v, w)| DVec3::from_array(corners[v as usize]) * f64::from(w))
                    .sum();
                draft.positions.push(sum.normalize());
                (draft.positions.len() - 1) as u32
            })
        };
        for j in 0..n {
            for i in 0..n - j {
                let (a, b, c) = (point(i, j), point(i + 1, j), point(i, j + 1));
                let far = (i + j + 1 < n).then(|| point(i + 1, j + 1));
                draft.facets.push([a, b, c]);
                draft.facets.extend(far.map(|d| [b, d, c]));
            }
        }
    }
    draft.finish()
}

/// Radii 1 and 0.4. Rings stand `ratio` : 1 apart in turn.
pub(super) fn torus(facets: usize, ratio: f64) -> TriMesh {
    const TUBE: f64 = 0.4;
    let quads = facets as f64 / 2.0;
    let around = ((quads * TUBE).sqrt().round() as usize).max(3);
    let pairs = ((quads / around as f64 / 2.0).round() as usize).max(3);
    let rings = 2 * pairs;
    let mut draft = Draft::default();
    for ring in 0..rings {
        let pair = TAU / pairs as f64;
        let angle = pair * (ring / 2) as f64 + if ring % 2 == 1 { pair * ratio / (1.0 + ratio) } else { 0.0 };
        let (sin, cos) = angle.sin_cos();
        for step in 0..around {
            let (s, c) = (TAU * step as f64 / around as f64).sin_cos();
            let r = 1.0 + TUBE * c;
            draft.positions.push(dvec3(r * cos, r * sin, TUBE * s));
        }
    }
    let vertex = |ring: usize, step: usize| (ring % rings * around + step % around) as u32;
    for ring in 0..rings {
        for step in 0..around {
            draft.quad([
                vertex(ring, step),
                vertex(ring + 1, step),
                vertex(ring + 1, step + 1),
                vertex(ring, step + 1),
            ]);
        }
    }
    draft.finish()
}
