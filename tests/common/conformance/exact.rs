//! The diagram is the one of the reference, and one of its seeds.

use glam::{DVec3, dvec3};
use tessera::mesh::shapes::Shape;
use tessera::rvd::{PieceBatch, Serial, SessionOptions, Surface};

use super::input::{bumpy, seed_sets, soup, square, surface, weights};
use super::{Claims, Precision, compare, everything, open, reference, sums};
use crate::cases::alike;
use crate::points::{Slack, in_facet, noise, on_surface, outside_their_cells, rng};
use crate::surfaces;

/// How far two cells that are added up otherwise may be apart, relative.
const ROUNDING: f64 = 1e-11;

pub fn sums_are_those_of_the_reference(claims: &Claims) {
    let (sphere, soup) = (bumpy(5), soup(400));
    for (name, mesh, weighted, n, off) in [
        ("sphere", &sphere, false, 2000, 0.0),
        ("sphere, weights", &sphere, true, 700, 0.01),
        ("sphere, few seeds", &sphere, false, 3, 0.0),
        ("sphere, one seed", &sphere, false, 1, 0.3),
        ("soup", &soup, false, 1500, 0.0),
        ("soup, weights, off the surface", &soup, true, 300, 0.05),
    ] {
        let given = weights(mesh);
        let surface = surface(mesh, weighted.then_some(&given[..]));
        let seeds = noise(&surface, n, off, 3);
        let ((want, wanted), (got, stats)) =
            (sums(&Serial, &surface, &seeds), sums(claims.backend(), &surface, &seeds));
        compare(name, &surface, &got, &want, claims.by_precision(ROUNDING, 1e-5));
        let share = (stats.pairs as f64 / wanted.pairs as f64 - 1.0).abs();
        let slack = claims.by_precision(0.0, 1e-3);
        assert!(share <= slack, "{name}: {} pairs, {} in the reference", stats.pairs, wanted.pairs);
    }
}

pub fn pieces_are_those_of_the_reference(claims: &Claims) {
    for (name, mesh, n) in [("sphere", bumpy(4), 900), ("soup", soup(100), 2000)] {
        let surface = surface(&mesh, Some(&weights(&mesh)));
        let seeds = noise(&surface, n, 0.0, 11);
        let pieces = |session: &mut dyn tessera::rvd::Session| everything(session, &surface).1;
        let want = pieces(&mut *open(&Serial, &surface, &seeds, SessionOptions::new(n)));
        let got = pieces(&mut *open(claims.backend(), &surface, &seeds, SessionOptions::new(n)));
        match claims.precision() {
            Precision::Double => assert!(got == want, "{name}"),
            Precision::Single => nearly_the_same(name, &surface, &got, &want, n),
        }
    }
}

/// Pieces in the order of facets and seeds, whose areas and vertices are right to a rounding; those that are nearly nothing may
/// be missing.
fn nearly_the_same(name: &str, surface: &Surface, got: &PieceBatch, want: &PieceBatch, n: usize) {
    let key = |b: &PieceBatch, i: usize| (b.facet[i], b.seed[i]);
    assert!((1..got.len()).all(|i| key(got, i - 1) < key(got, i)), "{name}: order");
    let (mut i, mut missing) = (0, 0);
    for k in 0..want.len() {
        while i < got.len() && key(got, i) < key(want, k) {
            i += 1;
        }
        if i == got.len() || key(got, i) != key(want, k) {
            missing += 1;
            assert!(want.area(k) < 1e-9 * surface.area(), "{name}: missing piece of area {:e}", want.area(k));
            continue;
        }
        assert!((got.area(i) - want.area(k)).abs() < 1e-5 * want.area(k).max(surface.area() / n as f64));
        for v in got.vertices(i) {
            let near = want.vertices(k).map(|u| want.position[u].distance(got.position[v])).fold(1.0, f64::min);
            assert!(near < 1e-4, "{name}: a vertex is {near:e} from the reference");
        }
    }
    assert!(missing * 1000 <= want.len(), "{name}: {missing} of {} missing", want.len());
}

pub fn diagrams_of_every_shape_are_those_of_the_reference(claims: &Claims) {
    for (got, want) in claims.diagrams().iter().zip(reference()) {
        let (name, area) = (&got.name, got.surface.area());
        match claims.precision() {
            Precision::Double => {
                // Integrals are taken apart and put together differently: a cell's are off by some roundings of what
                // its facets have, which is at most all.
                let far = 2.0 + got.seeds.iter().map(|p| p.length()).fold(0.0, f64::max);
                assert_eq!(alike::unlike(&got.sums, &want.sums, 1e-13 * area, far), None, "{name}: sums");
                assert!(got.pieces == want.pieces, "{name}: pieces");
                assert_eq!(got.stats.pairs, want.stats.pairs, "{name}: pairs");
            }
            Precision::Single => {
                for i in 0..got.seeds.len() {
                    let apart = (got.sums.area[i] - want.sums.area[i]).abs();
                    // A boundary that is off by a rounding, along the whole cell.
                    assert!(apart <= 1e-4 * area.max(1.0), "{name}: cell {i} is off by {apart:e}");
                }
            }
        }
        assert_eq!(got.stats.duplicate_seeds, want.stats.duplicate_seeds, "{name}");
    }
}

pub fn pieces_tile_their_facets(claims: &Claims) {
    for answer in claims.diagrams() {
        let (name, surface, pieces) = (&answer.name, &answer.surface, &answer.pieces);
        let mut covered = vec![0.0; surface.facets().len()];
        let mut count = vec![0; surface.facets().len()];
        for i in 0..pieces.len() {
            covered[pieces.facet[i] as usize] += pieces.area(i);
            count[pieces.facet[i] as usize] += 1;
            assert!(pieces.vertices(i).len() >= 3);
        }
        let far = answer.seeds.iter().map(|p| p.length()).fold(1.0, f64::max);
        for (f, &covered) in covered.iter().enumerate().filter(|&(f, _)| !surface.skips(f)) {
            let [a, b, c] = surface.facets()[f].map(|v| surface.positions()[v as usize]);
            let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
            let error = (covered - surface.facet_area(f as u32)).abs();
            // An area is a difference of products as large as the longest edge squared; a boundary in single precision is a
            // strip as wide as a rounding of the farthest seed's distance.
            let allowed = claims.by_precision(1e-12 * longest, 1e-5 * far * longest.sqrt() * f64::from(count[f] + 1));
            assert!(error <= allowed, "{name}: facet {f} is off by {error:e} of {longest:e}");
        }
        let total: f64 = answer.sums.area.iter().sum();
        let off = (total / surface.area() - 1.0).abs();
        assert!(off < claims.by_precision(1e-11, 1e-4), "{name}: area {total}");
    }
}

pub fn every_point_lies_in_the_cell_of_its_nearest_seed(claims: &Claims) {
    for answer in claims.diagrams() {
        let (surface, seeds) = (&answer.surface, &answer.seeds);
        let mut rng = rng(3);
        let by_area = on_surface(surface, 300, &mut rng);
        let by_facet: Vec<(u32, DVec3)> = (0..surface.facets().len())
            .filter(|&f| !surface.skips(f))
            .step_by(1 + surface.facets().len() / 200)
            .map(|f| (f as u32, in_facet(surface, f, &mut rng)))
            .collect();
        let probes: Vec<_> = by_area.into_iter().chain(by_facet).collect();
        let far = seeds.iter().map(|p| p.length()).fold(1.0, f64::max);
        let double = Slack { margin: 1e-9, rounding: 1e-15 };
        let slack = claims.by_precision(double, Slack { margin: 1e-5 * far, rounding: 1e-6 * far });
        let outside = outside_their_cells(&answer.pieces, seeds, &probes, slack);
        let around = |&(f, p): &(u32, DVec3)| -> Vec<(u32, f64, f64)> {
            let of_facet = (0..answer.pieces.len()).filter(|&i| answer.pieces.facet[i] == f);
            let seed = |i: usize| answer.pieces.seed[i];
            of_facet.map(|i| (seed(i), seeds[seed(i) as usize].distance(p), answer.pieces.area(i))).collect()
        };
        let told = outside.first().map(|first| (first, around(first)));
        assert!(outside.is_empty(), "{}: {told:?}: in no cell (seed, distance, area) of a nearest seed", answer.name);
    }
}

pub fn mass_follows_the_weights(claims: &Claims) {
    for (name, mesh) in surfaces::all() {
        let weights: Vec<f64> = (0..mesh.positions().len()).map(|v| 0.1 + (v % 7) as f64).collect();
        let surface = surface(&mesh, Some(&weights));
        let want = mass_of(&surface);
        let (_, seeds) = seed_sets(&surface).swap_remove(2);
        let mass: f64 = sums(claims.backend(), &surface, &seeds).0.mass.iter().sum();
        let tolerance = claims.by_precision(1e-11, 1e-5);
        assert!((mass / want - 1.0).abs() < tolerance, "{name}: {mass} for {want}");
    }
}

/// ∫ w over the surface.
pub fn mass_of(surface: &Surface) -> f64 {
    let mass = |f: usize| {
        let w: f64 = surface.facets()[f].iter().map(|&v| surface.weights()[v as usize]).sum();
        surface.facet_area(f as u32) * w / 3.0
    };
    (0..surface.facets().len()).filter(|&f| !surface.skips(f)).map(mass).sum()
}

/// Few facets with very many cells each, and many facets with more seeds than facets.
pub fn many_more_seeds_than_facets(claims: &Claims) {
    for (name, mesh, count, tolerance) in [
        ("square", square(), 10_000, 3e-5),
        ("square, more", square(), claims.by_precision(20_000, 100_000), 1.5e-4),
        ("sphere", Shape::Sphere.build(80), claims.by_precision(8_000, 20_000), 1.5e-4),
    ] {
        let surface = surface(&mesh, None);
        let seeds = noise(&surface, count, 0.0, 13);
        if claims.precision() == Precision::Single {
            let (got, want) = (sums(claims.backend(), &surface, &seeds).0, sums(&Serial, &surface, &seeds).0);
            compare(name, &surface, &got, &want, tolerance);
            continue;
        }
        let mut session = open(claims.backend(), &surface, &seeds, SessionOptions::new(count));
        let mut reference = open(&Serial, &surface, &seeds, SessionOptions::new(count));
        let (got, want) = (everything(&mut *session, &surface), everything(&mut *reference, &surface));
        // A cell's few pieces are the same, and are added up in another order.
        let largest = want.0.area.iter().copied().fold(0.0, f64::max);
        assert_eq!(alike::unlike(&got.0, &want.0, 1e-15 * largest, 2.0), None, "{name}");
        assert!(got.1 == want.1, "{name}");
        assert!((want.0.area.iter().sum::<f64>() / surface.area() - 1.0).abs() < 1e-11, "{name}");
        let mut met = vec![false; count];
        want.1.seed.iter().for_each(|&i| met[i as usize] = true);
        assert!(met.into_iter().all(|m| m), "{name}: a seed on the surface has a cell");
        let probes = on_surface(&surface, 300, &mut rng(2));
        assert!(
            outside_their_cells(&want.1, &seeds, &probes, Slack { margin: 1e-9, rounding: 1e-15 }).is_empty(),
            "{name}"
        );
    }
}

pub fn a_cell_has_a_hundred_sides(claims: &Claims) {
    let surface = surface(&square(), None);
    let mut seeds = vec![dvec3(0.2, -0.1, 0.0)];
    for k in 0..100 {
        let (sin, cos) = (f64::from(k) / 100.0 * std::f64::consts::TAU).sin_cos();
        seeds.push(seeds[0] + 0.1 * dvec3(cos, sin, 0.0));
    }
    let (want, _) = sums(&Serial, &surface, &seeds);
    let (got, stats) = sums(claims.backend(), &surface, &seeds);
    compare("hundred sides", &surface, &got, &want, claims.by_precision(ROUNDING, 1e-5));
    if claims.precision() == Precision::Single {
        assert!(stats.f64_finished > 0 && stats.relaunched_polygon > 0, "{stats:?}");
    }
}
