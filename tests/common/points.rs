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

/// The area of all facets up to each.
fn areas(surface: &Surface) -> Vec<f64> {
    let mut sum = 0.0;
    let up_to = |f| {
        sum += if surface.skips(f) { 0.0 } else { surface.facet_area(f as u32) };
        sum
    };
    (0..surface.facets().len()).map(up_to).collect()
}

/// A random point of the surface ∝ area, with its facet, unit frame.
fn on_areas(surface: &Surface, areas: &[f64], rng: &mut ChaCha8Rng) -> (u32, DVec3) {
    let at = rng.random::<f64>() * areas[areas.len() - 1];
    let f = areas.partition_point(|&c| c <= at).min(areas.len() - 1);
    (f as u32, in_facet(surface, f, rng))
}

/// `n` random points of the surface ∝ area, with their facets, unit frame.
pub fn on_surface(surface: &Surface, n: usize, rng: &mut ChaCha8Rng) -> Vec<(u32, DVec3)> {
    let areas = areas(surface);
    (0..n).map(|_| on_areas(surface, &areas, rng)).collect()
}

/// How far a point may be outside of a piece.
#[derive(Clone, Copy, Debug)]
pub struct Slack {
    /// From any edge, and its seed farther than the nearest by as much; unit frame.
    pub margin: f64,
    /// An edge that is hardly longer has no direction: its ends are right to about this.
    pub rounding: f64,
}

/// Those of `probes` (facet, point) that lie in no cell of a nearest seed, found by trying all seeds. `pieces` are sorted by facet.
pub fn outside_their_cells(
    pieces: &PieceBatch,
    seeds: &[DVec3],
    probes: &[(u32, DVec3)],
    slack: Slack,
) -> Vec<(u32, DVec3)> {
    outside_known(pieces, seeds, probes, &nearest(seeds, probes), slack)
}

/// How far the nearest seed is from each probe, found by trying all seeds.
pub fn nearest(seeds: &[DVec3], probes: &[(u32, DVec3)]) -> Vec<f64> {
    let of = |&(_, p): &(u32, DVec3)| seeds.iter().map(|s| s.distance_squared(p)).fold(f64::INFINITY, f64::min).sqrt();
    probes.par_iter().map(of).collect()
}

/// As [`outside_their_cells`], with what [`nearest`] found.
pub fn outside_known(
    pieces: &PieceBatch,
    seeds: &[DVec3],
    probes: &[(u32, DVec3)],
    nearest: &[f64],
    slack: Slack,
) -> Vec<(u32, DVec3)> {
    let missing = |(&(f, p), &nearest): (&(u32, DVec3), &f64)| -> Option<(u32, DVec3)> {
        let first = pieces.facet.partition_point(|&g| g < f);
        let found = (first..pieces.len())
            .take_while(|&i| pieces.facet[i] == f)
            .filter(|&i| contains(pieces, i, p, slack))
            .any(|i| seeds[pieces.seed[i] as usize].distance(p) <= nearest + slack.margin.max(1e-12 * nearest));
        (!found).then_some((f, p))
    };
    probes.par_iter().zip(nearest).filter_map(missing).collect()
}

/// Whether piece `i`, which is convex, holds `p`, a point of its facet.
fn contains(pieces: &PieceBatch, i: usize, p: DVec3, slack: Slack) -> bool {
    let polygon = &pieces.position[pieces.vertices(i)];
    let mut normal = DVec3::ZERO;
    for k in 2..polygon.len() {
        normal += (polygon[k - 1] - polygon[0]).cross(polygon[k] - polygon[0]);
    }
    let normal = normal.normalize_or_zero();
    (0..polygon.len()).all(|k| {
        let (a, b) = (polygon[k], polygon[(k + 1) % polygon.len()]);
        (b - a).cross(p - a).dot(normal) >= -slack.margin * (b - a).length() - slack.rounding
    })
}

/// White noise on the surface, moved off it by up to `off`, unit frame.
pub fn noise(surface: &Surface, n: usize, off: f64, seed: u64) -> Vec<DVec3> {
    let (mut rng, areas) = (rng(seed), areas(surface));
    let one = |_| {
        let (_, p) = on_areas(surface, &areas, &mut rng);
        let mut some = || rng.random::<f64>() - 0.5;
        p + dvec3(some(), some(), some()) * (2.0 * off)
    };
    (0..n).map(one).collect()
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
