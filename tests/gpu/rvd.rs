//! Promise: the GPU backend computes the diagram of the f64 reference, with the same bits on
//! every run, whatever its capacities, strategy and way of adding.

use std::sync::Arc;

use glam::{DVec3, dvec3};
use needs::needs;
use rand::{RngExt, SeedableRng};
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;
use tessera::rvd::Serial;
use tessera::rvd::{
    Accumulate, Backend, Capacities, CellSums, PassStats, PieceBatch, RvdError, SessionOptions, Strategy, Surface,
    Tuning,
};
use tessera::token::{Stopped, Token};

fn rng(seed: u64) -> rand_chacha::ChaCha8Rng {
    rand_chacha::ChaCha8Rng::seed_from_u64(seed)
}

/// A sphere with bumps, from an octahedron whose edges are halved `depth` times.
fn bumpy(depth: u32) -> TriMesh {
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
fn soup(count: usize) -> TriMesh {
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

fn square() -> TriMesh {
    let corners = vec![dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(1., 1., 0.), dvec3(0., 1., 0.)];
    TriMesh::new(corners, vec![[0, 1, 2], [0, 2, 3]]).unwrap()
}

/// White noise on the surface, moved off it by up to `off`, in the unit frame.
fn seeds_on(surface: &Surface, n: usize, off: f64, seed: u64) -> Vec<DVec3> {
    let mut rng = rng(seed);
    let mut sums = Vec::new();
    let mut total = 0.0;
    for (f, corners) in surface.facets().iter().enumerate() {
        let [a, b, c] = corners.map(|v| surface.positions()[v as usize]);
        total += if surface.skips(f) { 0.0 } else { (b - a).cross(c - a).length() };
        sums.push(total);
    }
    (0..n)
        .map(|_| {
            let at = rng.random::<f64>() * total;
            let f = sums.partition_point(|s| *s <= at).min(sums.len() - 1);
            let [a, b, c] = surface.facets()[f].map(|v| surface.positions()[v as usize]);
            let (s, t) = (rng.random::<f64>().sqrt(), rng.random::<f64>());
            let noise = dvec3(rng.random::<f64>() - 0.5, rng.random::<f64>() - 0.5, rng.random::<f64>() - 0.5);
            a * (1.0 - s) + b * (s * (1.0 - t)) + c * (s * t) + noise * (2.0 * off)
        })
        .collect()
}

fn sums(
    backend: &dyn Backend,
    surface: &Arc<Surface>,
    seeds: &[DVec3],
    capacities: Capacities,
) -> (CellSums, PassStats) {
    let options = SessionOptions::new(seeds.len()).with_capacities(capacities);
    let mut session = backend.session(Arc::clone(surface), options).unwrap();
    session.set_seeds(seeds).unwrap();
    let mut out = CellSums::default();
    let stats = session.sums(&mut out, &Token::default()).unwrap();
    (out, stats)
}

fn pieces(backend: &dyn Backend, surface: &Arc<Surface>, seeds: &[DVec3]) -> PieceBatch {
    let mut session = backend.session(Arc::clone(surface), SessionOptions::new(seeds.len())).unwrap();
    session.set_seeds(seeds).unwrap();
    let mut out = PieceBatch::default();
    session.pieces(0..surface.facets().len() as u32, &mut out, &Token::default()).unwrap();
    out
}

/// Sums and all pieces of one session.
fn both(
    backend: &dyn Backend,
    surface: &Arc<Surface>,
    seeds: &[DVec3],
    options: SessionOptions,
) -> (CellSums, PieceBatch, PassStats) {
    let mut session = backend.session(Arc::clone(surface), options).unwrap();
    session.set_seeds(seeds).unwrap();
    let (mut sums, mut pieces) = (CellSums::default(), PieceBatch::default());
    let stats = session.sums(&mut sums, &Token::default()).unwrap();
    session.pieces(0..surface.facets().len() as u32, &mut pieces, &Token::default()).unwrap();
    (sums, pieces, stats)
}

/// Seed sets that are hard in different ways.
fn seed_sets(surface: &Surface, n: usize) -> [(&'static str, Vec<DVec3>); 3] {
    let noise = seeds_on(surface, n, 0.0, 21);
    let mut twins = seeds_on(surface, n / 2, 0.0, 22);
    twins.extend_from_within(..);
    // Half of them in a ball a hundredth of the surface wide: 100 : 1 in spacing.
    let mut cluster = seeds_on(surface, n / 2, 0.0, 23);
    let middle = cluster[0];
    cluster.extend(seeds_on(surface, n - n / 2, 0.0, 24).iter().map(|&p| middle + (p - middle) * 0.01));
    [("white noise", noise), ("twins", twins), ("cluster", cluster)]
}

/// Every cell within `tolerance` of the reference, relative to the mean cell and to the cell.
fn compare(name: &str, surface: &Surface, got: &CellSums, want: &CellSums, tolerance: f64) {
    let n = want.mass.len();
    let total: f64 = want.mass.iter().sum();
    let mean = total / n as f64;
    let h = (surface.area() / n as f64).sqrt();
    let (mut worst, mut worst_moment, mut worst_energy) = (0f64, 0f64, 0f64);
    for i in 0..n {
        let scale = want.mass[i].max(mean);
        worst = worst.max((got.mass[i] - want.mass[i]).abs() / scale);
        let reach = (want.energy[i] / want.mass[i].max(1e-300)).sqrt().max(h);
        worst_moment = worst_moment.max((got.moment[i] - want.moment[i]).length() / (scale * reach));
        worst_energy = worst_energy.max((got.energy[i] - want.energy[i]).abs() / (scale * reach * reach));
    }
    let area = (got.area.iter().sum::<f64>() / surface.area() - 1.0).abs();
    eprintln!("{name}: mass {worst:.1e}, moment {worst_moment:.1e}, energy {worst_energy:.1e}, area {area:.1e}");
    assert!(worst < tolerance && worst_moment < tolerance && worst_energy < 2.0 * tolerance, "{name}");
    assert!(area < 1e-6, "{name}: total area off by {area:e}");
}

/// Like `assert_eq`, but with a short message.
fn same_bits(name: &str, a: &CellSums, b: &CellSums) {
    let bits = |s: &CellSums, i: usize| {
        let m = s.moment[i];
        [s.mass[i], m.x, m.y, m.z, s.energy[i], s.area[i]].map(f64::to_bits)
    };
    assert_eq!(a.mass.len(), b.mass.len(), "{name}");
    let other: Vec<usize> = (0..a.mass.len()).filter(|&i| bits(a, i) != bits(b, i)).collect();
    let shown: Vec<_> = other.iter().take(5).map(|&i| (i, a.mass[i], b.mass[i] - a.mass[i])).collect();
    assert!(other.is_empty(), "{name}: {} cells differ, e.g. (cell, mass, change) {shown:?}", other.len());
}

fn weights(mesh: &TriMesh) -> Vec<f64> {
    mesh.positions().iter().map(|p| 1.5 + (3.0 * p.x).sin() * (2.0 * p.y).cos()).collect()
}

#[needs(gpu)]
#[test]
fn sums_are_those_of_the_reference() {
    let gpu = require_gpu!();
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
        let surface = Arc::new(Surface::new(mesh, weighted.then_some(&given[..])).unwrap());
        let seeds = seeds_on(&surface, n, off, 3);
        let (want, wanted) = sums(&Serial, &surface, &seeds, Capacities::default());
        let (got, stats) = sums(gpu, &surface, &seeds, Capacities::default());
        eprintln!("{name}: {stats:?}");
        compare(name, &surface, &got, &want, 1e-5);
        let share = stats.pairs as f64 / wanted.pairs as f64;
        assert!((share - 1.0).abs() < 1e-3, "{name}: {} pairs, {} in the reference", stats.pairs, wanted.pairs);
    }
}

#[needs(gpu)]
#[test]
fn capacities_and_runs_do_not_change_a_bit() {
    let gpu = require_gpu!();
    let mesh = bumpy(4);
    let surface = Arc::new(Surface::new(&mesh, Some(&weights(&mesh))).unwrap());
    let seeds = seeds_on(&surface, 3000, 0.0, 5);
    let (first, stats) = sums(gpu, &surface, &seeds, Capacities::default());
    same_bits("again", &first, &sums(gpu, &surface, &seeds, Capacities::default()).0);
    let tiny = Capacities::new().with_neighbours(4).with_cells(2).with_pairs_percent(10);
    let (small, relaunched) = sums(gpu, &surface, &seeds, tiny);
    eprintln!("default {stats:?}\ntiny {relaunched:?}");
    same_bits("tiny", &first, &small);
    assert!(relaunched.relaunched_neighbours > 0 && relaunched.relaunched_cells > 0);
    let narrow = Capacities::new().with_neighbours(4).with_polygon(4).with_cells(1).with_pairs_percent(1);
    let (narrow, relaunched) = sums(gpu, &surface, &seeds, narrow);
    assert!(relaunched.relaunched_polygon > 0);
    same_bits("narrow", &first, &narrow);
}

#[needs(gpu)]
#[test]
fn a_session_takes_other_seeds_and_keeps_its_answers() {
    let gpu = require_gpu!();
    let surface = Arc::new(Surface::new(&bumpy(3), None).unwrap());
    let mut session = gpu.session(Arc::clone(&surface), SessionOptions::new(2000)).unwrap();
    assert!(session.device_bytes() > 0);
    let token = Token::default();
    let mut out = CellSums::default();
    for (n, seed) in [(500, 1), (2000, 2), (17, 3), (500, 1)] {
        let seeds = seeds_on(&surface, n, 0.0, seed);
        session.set_seeds(&seeds).unwrap();
        session.sums(&mut out, &token).unwrap();
        same_bits(&format!("{n} seeds"), &out, &sums(gpu, &surface, &seeds, Capacities::default()).0);
    }
    let many = vec![DVec3::ZERO; 2001];
    assert!(matches!(session.set_seeds(&many), Err(RvdError::TooManySeeds { given: 2001, limit: 2000 })));
    token.cancel();
    assert!(matches!(session.sums(&mut out, &token), Err(RvdError::Stopped(Stopped::Cancelled))));
    session.sums(&mut out, &Token::default()).unwrap();
}

#[needs(gpu)]
#[test]
fn pieces_are_those_of_the_reference() {
    let gpu = require_gpu!();
    for (name, mesh, n) in [("sphere", bumpy(4), 900), ("soup", soup(100), 2000)] {
        let surface = Arc::new(Surface::new(&mesh, Some(&weights(&mesh))).unwrap());
        let seeds = seeds_on(&surface, n, 0.0, 11);
        let (want, got) = (pieces(&Serial, &surface, &seeds), pieces(gpu, &surface, &seeds));
        let key = |b: &PieceBatch, i: usize| (b.facet[i], b.seed[i]);
        assert!((1..got.len()).all(|i| key(&got, i - 1) < key(&got, i)), "{name}: order");
        let (mut i, mut missing) = (0, 0);
        for k in 0..want.len() {
            while i < got.len() && key(&got, i) < key(&want, k) {
                i += 1;
            }
            if i == got.len() || key(&got, i) != key(&want, k) {
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
        let mut session = gpu.session(Arc::clone(&surface), SessionOptions::new(n)).unwrap();
        session.set_seeds(&seeds).unwrap();
        let mut parts = PieceBatch::default();
        let mut part = PieceBatch::default();
        let facets = surface.facets().len() as u32;
        for first in (0..facets).step_by(37) {
            session.pieces(first..(first + 37).min(facets), &mut part, &Token::default()).unwrap();
            parts.extend(&part);
        }
        assert_eq!(got, parts, "{name}: by ranges");
    }
}

#[needs(gpu)]
#[test]
fn two_triangles_with_many_seeds() {
    let gpu = require_gpu!();
    let surface = Arc::new(Surface::new(&square(), None).unwrap());
    for (n, tolerance) in [(10_000, 3e-5), (100_000, 1.5e-4)] {
        let seeds = seeds_on(&surface, n, 0.0, 13);
        let (want, _) = sums(&Serial, &surface, &seeds, Capacities::default());
        let (got, stats) = sums(gpu, &surface, &seeds, Capacities::default());
        eprintln!("{n}: {stats:?}");
        compare(&format!("square, {n}"), &surface, &got, &want, tolerance);
    }
}

#[needs(gpu)]
#[test]
fn a_lattice_has_no_gap() {
    // All vertices of the diagram are ties of four seeds, and facet edges run through them.
    let gpu = require_gpu!();
    let surface = Arc::new(Surface::new(&square(), None).unwrap());
    let seeds: Vec<DVec3> =
        (0..1024).map(|i| dvec3(f64::from(i % 32) / 31.0 - 0.5, f64::from(i / 32) / 31.0 - 0.5, 0.0)).collect();
    let (want, _) = sums(&Serial, &surface, &seeds, Capacities::default());
    let (got, _) = sums(gpu, &surface, &seeds, Capacities::default());
    compare("lattice", &surface, &got, &want, 1e-5);
}

#[needs(gpu)]
#[test]
fn far_and_duplicate_seeds_are_finished_in_double() {
    let gpu = require_gpu!();
    let surface = Arc::new(Surface::new(&bumpy(2), None).unwrap());
    let mut seeds = vec![dvec3(1000.0, 0.0, 0.0), dvec3(-1000.0, 3.0, 0.0), dvec3(0.0, 1000.5, 0.0)];
    let (want, _) = sums(&Serial, &surface, &seeds, Capacities::default());
    let (got, stats) = sums(gpu, &surface, &seeds, Capacities::default());
    assert!(stats.f64_finished > 0);
    for i in 0..seeds.len() {
        assert!((got.mass[i] - want.mass[i]).abs() < 1e-9, "{} {}", got.mass[i], want.mass[i]);
        assert!((got.energy[i] - want.energy[i]).abs() < 1e-9 * want.energy[i].max(1.0));
    }
    seeds.extend(seeds_on(&surface, 50, 0.0, 1));
    seeds.extend_from_within(10..20);
    let (want, _) = sums(&Serial, &surface, &seeds, Capacities::default());
    let (got, _) = sums(gpu, &surface, &seeds, Capacities::default());
    compare("duplicates", &surface, &got, &want, 1e-5);
    assert!(got.mass[53..].iter().all(|m| *m == 0.0));
}

#[needs(gpu)]
#[test]
fn one_cell_with_a_hundred_sides() {
    let gpu = require_gpu!();
    let surface = Arc::new(Surface::new(&square(), None).unwrap());
    let mut seeds = vec![dvec3(0.2, -0.1, 0.0)];
    for k in 0..100 {
        let (sin, cos) = (f64::from(k) / 100.0 * std::f64::consts::TAU).sin_cos();
        seeds.push(seeds[0] + 0.1 * dvec3(cos, sin, 0.0));
    }
    let (want, _) = sums(&Serial, &surface, &seeds, Capacities::default());
    let (got, stats) = sums(gpu, &surface, &seeds, Capacities::default());
    eprintln!("{stats:?}");
    assert!(stats.f64_finished > 0 && stats.relaunched_polygon > 0);
    compare("hundred sides", &surface, &got, &want, 1e-5);
}

#[needs(gpu)]
#[test]
fn capacities_change_no_sum_and_no_piece_of_any_shape() {
    let gpu = require_gpu!();
    let tiny = Capacities::new().with_neighbours(4).with_polygon(5).with_cells(2).with_pairs_percent(10);
    let mut total = PassStats::default();
    for shape in Shape::ALL {
        let surface = Arc::new(Surface::new(&shape.build(250), None).unwrap());
        for (set, seeds) in seed_sets(&surface, 500) {
            let name = format!("{shape}, {set}");
            let options = SessionOptions::new(seeds.len());
            let (sums, pieces, _) = both(gpu, &surface, &seeds, options);
            let small = options.with_capacities(tiny);
            let (small_sums, small_pieces, stats) = both(gpu, &surface, &seeds, small);
            same_bits(&name, &sums, &small_sums);
            assert!(pieces == small_pieces, "{name}: pieces differ");
            assert!(stats.relaunched_neighbours > 0, "{name}: {stats:?}");
            assert!(stats.relaunched_polygon > 0, "{name}: {stats:?}");
            assert!(stats.relaunched_cells > 0, "{name}: {stats:?}");
            total.add(&stats);
        }
    }
    eprintln!("{total:?}");
}

#[needs(gpu)]
#[test]
fn strategies_and_accumulation_change_no_bit() {
    let gpu = require_gpu!();
    let mut total = PassStats::default();
    for shape in Shape::ALL {
        // From some cells per facet to hundreds.
        let mesh = shape.build(60);
        let weights = weights(&mesh);
        let surface = Arc::new(Surface::new(&mesh, (shape != Shape::Torus).then_some(&weights[..])).unwrap());
        for (set, seeds) in seed_sets(&surface, 1500) {
            let with = |strategy, accumulate| {
                let tuning = Tuning::new().with_strategy(strategy).with_accumulate(accumulate);
                both(gpu, &surface, &seeds, SessionOptions::new(seeds.len()).with_tuning(tuning))
            };
            let (sums, pieces, _) = with(Strategy::Facet, Accumulate::Direct);
            for (strategy, accumulate) in [
                (Strategy::Facet, Accumulate::TwoPhase),
                (Strategy::Cell, Accumulate::TwoPhase),
                (Strategy::Auto, Accumulate::Auto),
            ] {
                let name = format!("{shape}, {set}, {strategy:?}, {accumulate:?}");
                let (other_sums, other_pieces, stats) = with(strategy, accumulate);
                same_bits(&name, &sums, &other_sums);
                assert!(pieces == other_pieces, "{name}: pieces differ");
                total.add(&stats);
            }
        }
    }
    eprintln!("{total:?}");
}

#[needs(gpu)]
#[test]
fn cells_find_the_facets_of_two_triangles() {
    let gpu = require_gpu!();
    let surface = Arc::new(Surface::new(&square(), None).unwrap());
    let mut proved = 0;
    for sample in 31..34 {
        let seeds = seeds_on(&surface, 5000, 0.0, sample);
        let with = |strategy| {
            let tuning = Tuning::new().with_strategy(strategy);
            both(gpu, &surface, &seeds, SessionOptions::new(seeds.len()).with_tuning(tuning))
        };
        let (by_facet, by_cell, chosen) = (with(Strategy::Facet), with(Strategy::Cell), with(Strategy::Auto));
        same_bits("cell", &by_facet.0, &by_cell.0);
        same_bits("auto", &by_facet.0, &chosen.0);
        assert!(by_facet.1 == by_cell.1 && by_facet.1 == chosen.1);
        proved += u32::from(by_cell.2.relaunched_facets == 0);
    }
    // Falling back is for what rounding broke, not the rule.
    assert!(proved > 0);
}

#[needs(gpu)]
#[test]
fn what_cells_cannot_prove_is_left_to_propagation() {
    let gpu = require_gpu!();
    let surface = Arc::new(Surface::new(&square(), None).unwrap());
    let [a, b, c] = surface.facets()[0].map(|v| surface.positions()[v as usize]);
    let centroid = (a + b + c) / 3.0;
    // All as far from the centroid, so that none is the nearer one.
    let ring: Vec<DVec3> = (0..40)
        .map(|k| {
            let (sin, cos) = (f64::from(k) / 40.0 * std::f64::consts::TAU).sin_cos();
            centroid + 0.2 * dvec3(cos, sin, 0.0)
        })
        .collect();
    // Out of the range of floats, so that the host ends the pairs.
    let mut far = seeds_on(&surface, 40, 0.0, 1);
    for p in &mut far {
        p.z += 1000.0;
    }
    for (name, seeds) in [("ring", ring), ("far", far)] {
        let with = |strategy| {
            let tuning = Tuning::new().with_strategy(strategy);
            both(gpu, &surface, &seeds, SessionOptions::new(seeds.len()).with_tuning(tuning))
        };
        let (by_facet, by_cell) = (with(Strategy::Facet), with(Strategy::Cell));
        assert!(by_cell.2.relaunched_facets > 0, "{name}: {:?}", by_cell.2);
        same_bits(name, &by_facet.0, &by_cell.0);
        assert!(by_facet.1 == by_cell.1, "{name}: pieces differ");
    }
}
