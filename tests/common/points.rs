//! Points for tests: random ones, and brute-force answers about them.
#![allow(dead_code)]

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::rvd::Surface;

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

/// Squared distance to the nearest seed, by trying all.
pub fn nearest_distance2(seeds: &[DVec3], p: DVec3) -> f64 {
    seeds.iter().map(|s| s.distance_squared(p)).fold(f64::INFINITY, f64::min)
}
