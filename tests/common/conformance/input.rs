//! Surfaces and seeds on which backends are compared.

use std::sync::Arc;

use glam::{DVec3, dvec3};
use rand::RngExt;
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{Backend, CellSums, PassStats, PieceBatch, SessionOptions, Surface};

use super::{everything, open};
use crate::points::{self, noise, on_surface, rng};
use crate::surfaces;

/// What a backend says of one surface and one seed set.
pub struct Answer {
    /// Shape and seed set.
    pub name: String,
    pub surface: Arc<Surface>,
    pub seeds: Vec<DVec3>,
    pub sums: CellSums,
    pub pieces: PieceBatch,
    pub stats: PassStats,
}

/// The answers for one of each shape and every seed set.
pub fn answers(backend: &dyn Backend) -> Vec<Answer> {
    let mut all = Vec::new();
    for (shape, mesh) in surfaces::all() {
        let surface = Arc::new(Surface::new(&mesh, None).unwrap());
        for (set, seeds) in seed_sets(&surface) {
            let mut session = open(backend, &surface, &seeds, SessionOptions::new(seeds.len()));
            let (sums, pieces, stats) = everything(&mut *session, &surface);
            all.push(Answer {
                name: format!("{shape}, {set}"),
                surface: Arc::clone(&surface),
                seeds,
                sums,
                pieces,
                stats,
            });
        }
    }
    all
}

/// Seed sets that a surface is tried with, unit frame.
pub fn seed_sets(surface: &Surface) -> Vec<(&'static str, Vec<DVec3>)> {
    let mut rng = rng(7);
    let mut on = |n: usize| -> Vec<DVec3> { on_surface(surface, n, &mut rng).into_iter().map(|x| x.1).collect() };
    let (one, few, many) = (on(1), on(20), on(600));
    let mut twins = on(60);
    twins.extend_from_within(10..40);
    let corners: Vec<DVec3> = surface.positions().iter().copied().step_by(3).collect();
    // A hundred seeds in one spot, the rest spread: spacings of 1 to 1000.
    let mut cluster = on(100);
    let centre = cluster[0];
    cluster.extend((0..100).map(|k| centre + 1e-3 * DVec3::new((k as f64).sin(), (k as f64 * 1.7).cos(), 0.1)));
    let mut box_rng = points::rng(8);
    let mut random = || box_rng.random::<f64>() - 0.5;
    let off: Vec<DVec3> = (0..200).map(|_| DVec3::new(random(), random(), random())).collect();
    let far: Vec<DVec3> = (0..50).map(|_| 40.0 * DVec3::new(random(), random(), random())).collect();
    vec![
        ("one", one),
        ("few", few),
        ("many", many),
        ("twins", twins),
        ("corners", corners),
        ("cluster", cluster),
        ("off the surface", off),
        ("far off", far),
    ]
}

/// Seed sets of `n` seeds that need more of every capacity.
pub fn hard_sets(surface: &Surface, n: usize) -> [(&'static str, Vec<DVec3>); 3] {
    let white = noise(surface, n, 0.0, 21);
    let mut twins = noise(surface, n / 2, 0.0, 22);
    twins.extend_from_within(..);
    // Half of them in a ball a hundredth of the surface wide: 100 : 1 in spacing.
    let mut cluster = noise(surface, n / 2, 0.0, 23);
    let middle = cluster[0];
    cluster.extend(noise(surface, n - n / 2, 0.0, 24).iter().map(|&p| middle + (p - middle) * 0.01));
    [("white noise", white), ("twins", twins), ("cluster", cluster)]
}

/// Weights that vary over the surface.
pub fn weights(mesh: &TriMesh) -> Vec<f64> {
    mesh.positions().iter().map(|p| 1.5 + (3.0 * p.x).sin() * (2.0 * p.y).cos()).collect()
}

pub fn surface(mesh: &TriMesh, weights: Option<&[f64]>) -> Arc<Surface> {
    Arc::new(Surface::new(mesh, weights).unwrap())
}

/// A shape, with weights or without.
pub fn shape(shape: Shape, facets: usize, weighted: bool) -> Arc<Surface> {
    let mesh = shape.build(facets);
    let given = weights(&mesh);
    surface(&mesh, weighted.then_some(&given[..]))
}

/// A sphere with bumps, from an octahedron whose edges are halved `depth` times.
pub fn bumpy(depth: u32) -> TriMesh {
    let n = 1usize << depth;
    let (mut positions, mut facets) = (Vec::new(), Vec::new());
    for face in 0..8u32 {
        let signs = dvec3(
            if face & 1 == 0 { 1. } else { -1. },
            if face & 2 == 0 { 1. } else { -1. },
            if face & 4 == 0 { 1. } else { -1. },
        );
        let flip = signs.x * signs.y * signs.z < 0.0;
        let base = positions.len() as u32;
        let index = |i: usize, j: usize| base + ((i * (i + 1)) / 2 + j) as u32;
        for i in 0..=n {
            for j in 0..=i {
                let p = dvec3((n - i) as f64, (i - j) as f64, j as f64) / n as f64 * signs;
                let p = p.normalize();
                positions.push(p * (1.0 + 0.1 * (5.0 * p.x).sin() * (4.0 * p.y).cos()));
            }
        }
        let mut add = |a: u32, b: u32, c: u32| facets.push(if flip { [a, c, b] } else { [a, b, c] });
        for i in 0..n {
            for j in 0..=i {
                add(index(i, j), index(i + 1, j), index(i + 1, j + 1));
                if j < i {
                    add(index(i, j), index(i + 1, j + 1), index(i, j + 1));
                }
            }
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// Unconnected triangles of many sizes and shapes, some of them slivers, far from the origin.
pub fn soup(count: usize) -> TriMesh {
    let mut rng = rng(7);
    let mut point = move |scale: f64| {
        dvec3(rng.random::<f64>() - 0.5, rng.random::<f64>() - 0.5, rng.random::<f64>() - 0.5) * scale
    };
    let (mut positions, mut facets) = (Vec::new(), Vec::new());
    for k in 0..count {
        let centre = point(10.0) + DVec3::splat(1000.0);
        let size = [0.1, 0.5, 2.0][k % 3];
        let (a, b) = (point(size), point(size));
        let c = if k % 7 == 0 { a + (b - a) * 0.3 + point(size * 0.01) } else { point(size) };
        let first = positions.len() as u32;
        positions.extend([centre + a, centre + b, centre + c]);
        facets.push([first, first + 1, first + 2]);
    }
    TriMesh::new(positions, facets).unwrap()
}

/// Two triangles.
pub fn square() -> TriMesh {
    let corners = vec![dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(1., 1., 0.), dvec3(0., 1., 0.)];
    TriMesh::new(corners, vec![[0, 1, 2], [0, 2, 3]]).unwrap()
}

/// One triangle.
pub fn triangle(corners: [DVec3; 3]) -> TriMesh {
    TriMesh::new(corners.into(), vec![[0, 1, 2]]).unwrap()
}
