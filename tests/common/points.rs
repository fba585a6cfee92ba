//! Points for tests: random ones, and brute-force answers about them.
#![allow(dead_code)]

use glam::{DVec3, dvec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use tessera::rvd::{PieceBatch, Surface};

/// The same stream everywhere.
pub fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// A random point of facet `f`, unit frame.
pub fn in_facet(surface: &Surface, f: usize, rng: &mut ChaCha8Rng) -> DVec3 {
    let [a, b, c] = surface.facets()[f].map(|v| surface.positions()[v as usize]);
    let (s, t) = (rng.random::<f64>().sqrt(), rng.random::<f64>());
    (1.0 - s) * a + s * (1.0 - t) * b + s * t * c
}

/// `n` random points of the surface ∝ area, with their facets, unit frame.
pub fn on_surface(surface: &Surface, n: usize, rng: &mut ChaCha8Rng) -> Vec<(u32, DVec3)> {
    let mut sum = 0.0;
    let cumulative: Vec<f64> = (0..surface.facets().len())
        .map(|f| {
            sum += if surface.skips(f) { 0.0 } else { surface.facet_area(f as u32) };
            sum
        })
        .collect();
    (0..n)
        .map(|_| {
            let at = rng.random::<f64>() * sum;
            let f = cumulative.partition_point(|&c| c <= at).min(cumulative.len() - 1);
            (f as u32, in_facet(surface, f, rng))
        })
        .collect()
}

/// Those of `probes` (facet, point) that lie in no cell of a nearest seed, found by trying all
/// seeds. `pieces` are sorted by facet.
pub fn outside_their_cells(pieces: &PieceBatch, seeds: &[DVec3], probes: &[(u32, DVec3)]) -> Vec<(u32, DVec3)> {
    outside_by(pieces, seeds, probes, 1e-9)
}

/// As [`outside_their_cells`]; a point may be outside a piece by `margin` (unit frame), and its seed
/// farther than the nearest by as much.
pub fn outside_by(pieces: &PieceBatch, seeds: &[DVec3], probes: &[(u32, DVec3)], margin: f64) -> Vec<(u32, DVec3)> {
    let missing = |&(f, p): &(u32, DVec3)| -> Option<(u32, DVec3)> {
        let nearest = seeds.iter().map(|s| s.distance_squared(p)).fold(f64::INFINITY, f64::min).sqrt();
        let first = pieces.facet.partition_point(|&g| g < f);
        let found = (first..pieces.len())
            .take_while(|&i| pieces.facet[i] == f)
            .filter(|&i| contains(pieces, i, p, margin))
            .any(|i| seeds[pieces.seed[i] as usize].distance(p) <= nearest + margin.max(1e-12 * nearest));
        (!found).then_some((f, p))
    };
    probes.par_iter().filter_map(missing).collect()
}

/// Whether piece `i` holds `p`, a point of its facet, to within `margin`. The piece is convex; an
/// edge whose length is itself rounding has no direction, which the last term allows for.
fn contains(pieces: &PieceBatch, i: usize, p: DVec3, margin: f64) -> bool {
    let polygon = &pieces.position[pieces.vertices(i)];
    let mut normal = DVec3::ZERO;
    for k in 2..polygon.len() {
        normal += (polygon[k - 1] - polygon[0]).cross(polygon[k] - polygon[0]);
    }
    let normal = normal.normalize_or_zero();
    (0..polygon.len()).all(|k| {
        let (a, b) = (polygon[k], polygon[(k + 1) % polygon.len()]);
        (b - a).cross(p - a).dot(normal) >= -margin * (b - a).length() - 1e-6 * margin
    })
}

/// White noise on the surface, moved off it by up to `off`, unit frame.
pub fn noise(surface: &Surface, n: usize, off: f64, seed: u64) -> Vec<DVec3> {
    let mut rng = rng(seed);
    let on = on_surface(surface, n, &mut rng);
    let mut some = || rng.random::<f64>() - 0.5;
    on.into_iter().map(|(_, p)| p + dvec3(some(), some(), some()) * (2.0 * off)).collect()
}

/// Seed sets that are hard in different ways.
pub fn many_sets(surface: &Surface, n: usize) -> Vec<(&'static str, Vec<DVec3>)> {
    let mut twins = noise(surface, n / 2, 0.0, 2);
    twins.extend_from_within(..);
    twins.extend_from_within(3..4);
    // Half of them in a ball a hundredth of the surface wide.
    let mut cluster = noise(surface, n / 2, 0.0, 3);
    let middle = cluster[0];
    cluster.extend(noise(surface, n - n / 2, 0.0, 4).iter().map(|&p| middle + (p - middle) * 0.01));
    let lattice = (0..n).map(|i| dvec3((i % 10) as f64, (i / 10 % 10) as f64, (i / 100) as f64) * 0.1 - 0.45);
    vec![
        ("noise", noise(surface, n, 0.0, 1)),
        ("few", noise(surface, 20, 0.0, 1)),
        ("one", noise(surface, 1, 0.2, 1)),
        ("off", noise(surface, n, 0.1, 5)),
        ("beside", noise(surface, n, 0.0, 6).iter().map(|&p| p + dvec3(0.9, 0.0, 0.0)).collect()),
        ("twins", twins),
        ("cluster", cluster),
        ("lattice", lattice.collect()),
        ("all in one place", vec![dvec3(0.1, 0.2, 0.3); n]),
        ("nearly in one place", noise(surface, n, 0.0, 7).iter().map(|&p| p * 1e-6).collect()),
        ("far", noise(surface, n, 0.0, 8).iter().map(|&p| p + dvec3(0.0, 100.0, 0.0)).collect()),
    ]
}
