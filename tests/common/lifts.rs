//! Lifted surfaces for tests, and seeds on them.
#![allow(dead_code)]

use std::sync::Arc;

use glam::DVec3;
use rand::RngExt;
use tessera::mesh::TriMesh;
use tessera::rvd::{Lifted, Surface};
use tessera::token::Token;

use crate::points::rng;

/// The surface lifted by `share` of its diagonal times the normals of its vertices.
pub fn lifted(mesh: &TriMesh, weights: Option<&[f64]>, share: f64) -> Arc<Surface<Lifted>> {
    let mut normals = vec![DVec3::ZERO; mesh.positions().len()];
    for (f, facet) in mesh.facets().iter().enumerate() {
        let [a, b, c] = mesh.corners(f);
        facet.iter().for_each(|&v| normals[v as usize] += (b - a).cross(c - a));
    }
    let (low, high) = mesh.bounds();
    let length = share * (high - low).length();
    let lift: Vec<DVec3> = normals.iter().map(|n| length * n.normalize_or_zero()).collect();
    Arc::new(Surface::lifted(mesh, weights, &lift, &Token::default()).unwrap())
}

/// Random points of the lifted surface, some of which are moved away from it.
pub fn seeds_on(surface: &Surface<Lifted>, n: usize, seed: u64) -> Vec<Lifted> {
    let mut rng = rng(seed);
    let facets: Vec<u32> = (0..surface.facets().len() as u32).filter(|&f| !surface.skips(f as usize)).collect();
    let mut point = || {
        let [a, b, c] = surface.corners(facets[rng.random_range(0..facets.len())]);
        let (s, t) = (rng.random::<f64>().sqrt(), rng.random::<f64>());
        let away = if rng.random_bool(0.2) { 0.03 } else { 0.0 };
        let mut any = || away * DVec3::new(rng.random(), rng.random(), rng.random());
        a * (1.0 - s) + b * (s * (1.0 - t)) + c * (s * t) + Lifted { place: any(), lift: any() }
    };
    (0..n).map(|_| point()).collect()
}
