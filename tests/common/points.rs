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

/// `n` random points in a cube twice as wide as `width`.
pub fn cluster(middle: DVec3, n: usize, width: f64, seed: u64) -> Vec<DVec3> {
    let mut rng = rng(seed);
    let mut off = || width * (2.0 * rng.random::<f64>() - 1.0);
    (0..n).map(|_| middle + dvec3(off(), off(), off())).collect()
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

/// Seeds of which later ones lie on earlier ones, and how many do.
pub fn duplicate_sets(single: &[DVec3]) -> [(&'static str, Vec<DVec3>, usize); 4] {
    [
        ("all the same", vec![single[3]; 500], 499),
        ("pairs", single.iter().flat_map(|&p| [p, p]).collect(), single.len()),
        ("a hundred times two", [single[0], single[1]].repeat(100), 198),
        // -0 is 0.
        ("signs of zero", [&[dvec3(0.4, 0.0, 0.0), dvec3(0.4, -0.0, -0.0)], single].concat(), 1),
    ]
}

/// The seeds and, beside each, one that is `gap` away.
pub fn nearly_twice(single: &[DVec3], gap: f64) -> Vec<DVec3> {
    single.iter().flat_map(|&p| [p, p + gap * dvec3(0.3, -0.5, 0.8)]).collect()
}

/// The corners of a unit square's grid, `side` cells a side, moved by so much of a cell: the facets' own corners, or their
/// middles.
pub fn square_lattice(side: usize, shift: f64) -> Vec<DVec3> {
    (0..(side + 1) * (side + 1))
        .map(|k| dvec3((k % (side + 1)) as f64, (k / (side + 1)) as f64, 0.0))
        .map(|p| (p + dvec3(shift, shift, 0.0)) / side as f64 - dvec3(0.5, 0.5, 0.0))
        .collect()
}

/// On a circle, all as far from its middle.
pub fn on_circle(count: usize) -> Vec<DVec3> {
    (0..count)
        .map(|k| (k as f64 / count as f64 * std::f64::consts::TAU).sin_cos())
        .map(|(sin, cos)| 0.25 * dvec3(cos, sin, 0.0))
        .collect()
}

/// All corners of cubes, through the whole unit box.
pub fn cube_lattice() -> Vec<DVec3> {
    (0..343).map(|k| dvec3((k % 7) as f64, (k / 7 % 7) as f64, (k / 49) as f64) / 6.0 - DVec3::splat(0.5)).collect()
}

/// Seeds on the mesh itself, unit frame.
pub fn on_the_mesh(surface: &Surface) -> [(&'static str, Vec<DVec3>); 4] {
    let corners = |f: usize| surface.facets()[f].map(|v| surface.positions()[v as usize]);
    let facets = 0..surface.facets().len();
    [
        ("vertices", surface.positions().to_vec()),
        ("middles of edges", facets.clone().map(|f| 0.5 * (corners(f)[0] + corners(f)[1])).collect()),
        ("middles of facets", facets.clone().map(|f| surface.centroid(f as u32)).collect()),
        // More seeds than facets, on every corner of every facet.
        ("corners", facets.flat_map(corners).collect()),
    ]
}

/// Seeds `far` from the surface, all of them or half: cells that the surface meets at all angles, and cells that it does not
/// meet.
pub fn far_sets(near: &[DVec3], far: f64) -> [(&'static str, Vec<DVec3>); 2] {
    let away = |p: &DVec3| (p.normalize() * far).clamp(DVec3::splat(-far), DVec3::splat(far));
    let away: Vec<DVec3> = near.iter().map(away).collect();
    let half = [&near[..near.len() / 2], &away[..near.len() / 2]].concat();
    [("all", away), ("half", half)]
}
