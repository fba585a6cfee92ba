//! Promise: seeds that are moved on the device go where the host would move them, by rows, first cells,
//! energies and gradients that are the host's, with the same bits every time.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use crate::points::{many_sets, noise};
use crate::sessions::{self, evaluate, minimise, read};
use ::gpu::diagram::layout::ROW;
use ::gpu::diagram::{Found, Gpu};
use ::gpu::{Device, DeviceOptions};
use geometry::knn::{NeighbourRow, SeedIndex};
use glam::{DVec3, dvec3};
use needs::needs;
use rand::{RngExt, SeedableRng};
use tessera::mesh::sample::sample;
use tessera::mesh::shapes::Shape;
use tessera::rvd::Serial;
use tessera::rvd::{
    Backend, Capacities, CellSums, PassStats, RvdError, Session, SessionOptions, Surface, Together, Tuning,
};
use tessera::token::{Stopped, Token};

fn surface(shape: Shape, facets: usize, weighted: bool) -> Arc<Surface> {
    let mesh = shape.build(facets);
    let weights: Vec<f64> = mesh.positions().iter().map(|p| 1.5 + (3.0 * p.x).sin() * (2.0 * p.y).cos()).collect();
    Arc::new(Surface::new(&mesh, weighted.then_some(&weights[..])).unwrap())
}

/// A device on which traffic is counted: other tests use theirs at the same time, and those that count take turns.
fn counted() -> (&'static Gpu, MutexGuard<'static, ()>) {
    static COUNTED: OnceLock<Gpu> = OnceLock::new();
    static TURN: Mutex<()> = Mutex::new(());
    let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let open = || {
        let device = Device::open(&DeviceOptions { software: true, ..DeviceOptions::default() }).unwrap();
        Gpu::new(device, None).unwrap()
    };
    (COUNTED.get_or_init(open), turn)
}

fn search(gpu: &Gpu, surface: &Arc<Surface>, seeds: &[DVec3], neighbours: usize) -> Found {
    let capacities = Capacities::new().with_neighbours(neighbours);
    let options = SessionOptions::new(seeds.len()).with_capacities(capacities);
    gpu.search(Arc::clone(surface), &[seeds], options, &Token::default()).unwrap().remove(0)
}

#[needs(gpu)]
#[test]
fn rows_from_verlet_lists_are_those_of_a_search() {
    let gpu = require_gpu!();
    let surface = surface(Shape::Torus, 600, false);
    let never = Token::default();
    let options = || SessionOptions::new(1001);
    let h = (surface.area() / 1000.0).sqrt();
    for (name, seeds) in many_sets(&surface, 1000) {
        // Little moves, one seed that goes far, other seeds, a long way in small steps, twins that part.
        let moves =
            [0.0, 0.002, 0.0, 0.01, 0.01, 0.02, 1.0, 0.01, 0.03, 0.03, 0.03, 0.03, 0.03, 0.03, 1e-4, 1e-4, 1e-4];
        let mut sets = vec![seeds.clone()];
        for (k, by) in moves.into_iter().enumerate() {
            let away = noise(&surface, seeds.len(), 0.0, 20 + k as u64);
            let mut next: Vec<DVec3> = sets[k].iter().zip(&away).map(|(&p, &a)| p + a * (2.0 * by * h)).collect();
            if (k == 4 || k == 10) && seeds.len() > 9 {
                next[7] = next[300 % seeds.len()] + dvec3(1e-4, 0.0, 0.0);
            }
            if k == 14 && seeds.len() > 9 {
                next[9] = next[8];
            }
            sets.push(next);
        }
        sets.push(seeds[..seeds.len() / 2 + 1].to_vec());
        sets.push(seeds.clone());
        let refs: Vec<&[DVec3]> = sets.iter().map(|s| &s[..]).collect();
        let found = gpu.search(Arc::clone(&surface), &refs, options(), &never).unwrap();
        for (k, (found, seeds)) in found.iter().zip(&sets).enumerate() {
            let alone = gpu.search(Arc::clone(&surface), &[seeds], options(), &never).unwrap().remove(0);
            assert!(found.rows == alone.rows, "{name}, {k}: rows");
            assert_eq!(
                (&found.first, found.duplicates, found.by_host),
                (&alone.first, alone.duplicates, alone.by_host),
                "{name}"
            );
            assert_eq!(alone.from_lists, 0);
        }
        let from_lists: Vec<u64> = found.iter().map(|f| f.from_lists).collect();
        eprintln!("{name}: {from_lists:?} of {} from lists", seeds.len());
        if name == "noise" {
            assert!(from_lists[3] > 900, "little moves: {from_lists:?}");
        }
    }
}

#[needs(gpu)]
#[test]
fn rows_and_first_cells_are_the_hosts() {
    let gpu = require_gpu!();
    for (shape, facets) in [(Shape::Torus, 600), (Shape::Sphere, 2000)] {
        let surface = surface(shape, facets, false);
        for (name, seeds) in many_sets(&surface, 1000) {
            let found = search(gpu, &surface, &seeds, 24);
            let index = SeedIndex::new(&seeds);
            assert_eq!(found.duplicates, index.duplicates() as u64, "{name}");
            let mut longest = 0;
            for (i, row) in found.rows.iter().enumerate() {
                let mut want = NeighbourRow::default();
                index.row(i as u32, seeds.len(), &mut want);
                assert!(row.seeds.len() <= 24 && (!row.complete || row.seeds.len() == want.seeds.len()), "{name}, {i}");
                // The same distances in the same order; which of two at nearly one distance is first may
                // differ: a float's rounding, of the distance and of either end (2⁻³⁸).
                for (&got, &want) in row.seeds.iter().zip(&want.seeds) {
                    let (d, w) = (seeds[got as usize].distance(seeds[i]), seeds[want as usize].distance(seeds[i]));
                    let slack = if found.by_host && name == "far" { 0.0 } else { 2e-7 * w + 2e-11 };
                    assert!((d - w).abs() <= slack, "{name}: row of {i} has {d:e} for {w:e}");
                }
                longest = longest.max(row.seeds.len());
            }
            for &(f, first) in &found.first {
                let q = surface.centroid(f);
                let (d, w) = (q.distance(seeds[first as usize]), q.distance(seeds[index.nearest(q) as usize]));
                assert!(d <= w + 2e-7 * (w + 1.0), "{name}: first cell of {f} is {d:e} away, not {w:e}");
                assert!(!index.is_duplicate(first), "{name}: {first} is a later duplicate");
            }
            eprintln!("{shape}, {name}: by host {}, rows up to {longest}", found.by_host);
            // A shorter row is the beginning of a longer one.
            let short = search(gpu, &surface, &seeds, 5);
            for (short, long) in short.rows.iter().zip(&found.rows) {
                assert!(short.seeds.len() <= 5 && long.seeds.starts_with(&short.seeds), "{name}");
            }
            assert_eq!(short.first, found.first, "{name}");
        }
    }
}

#[needs(gpu)]
#[test]
fn the_device_searches_what_it_can() {
    let gpu = require_gpu!();
    let surface = surface(Shape::Torus, 2000, false);
    for n in [100, 3000, 20_000] {
        let found = search(gpu, &surface, &noise(&surface, n, 0.0, 1), 24);
        assert!(!found.by_host);
        // All but a few rows are full.
        let full = found.rows.iter().filter(|r| r.seeds.len() == ROW as usize).count();
        assert!(full * 100 >= n * 95, "{n}: {full}");
    }
}

fn open(gpu: &dyn Backend, surface: &Arc<Surface>, seeds: &[DVec3]) -> Box<dyn Session> {
    sessions::open(gpu, surface, seeds, SessionOptions::new(seeds.len()))
}

/// The same with so many steps a submission, however slow the device is.
fn open_together(gpu: &dyn Backend, surface: &Arc<Surface>, seeds: &[DVec3], most: usize) -> Box<dyn Session> {
    let tuning = Tuning::new().with_together(Together::AtMost(most));
    sessions::open(gpu, surface, seeds, SessionOptions::new(seeds.len()).with_tuning(tuning))
}

#[needs(gpu)]
#[test]
fn iterations_allocate_nothing_and_move_few_bytes() {
    require_gpu!();
    let (gpu, _turn) = counted();
    let surface = surface(Shape::Torus, 4000, false);
    let seeds = noise(&surface, 3000, 0.0, 8);
    let mut session = open(gpu, &surface, &seeds);
    let moving = session.resident().unwrap();
    minimise(moving, 20, 1);
    let (_, stats) = minimise(moving, 0, 4);
    eprintln!("{stats:?}");
    let evaluation = evaluate(moving);
    assert_eq!((stats.device_allocations, stats.host_searches, stats.relaunched()), (0, 0, 0));
    assert!(stats.device_submissions == 4 && stats.read_back_bytes <= 4 * 128, "{stats:?}");
    assert!(stats.uploaded_bytes <= 4 * 512 && evaluation.stats.uploaded_bytes <= 512, "{stats:?}");
}

/// Edges a twentieth as long at one point: cells three mean spacings wide would hold hundreds of seeds there.
#[needs(gpu)]
#[test]
fn seeds_that_crowd_where_weights_are_large_are_searched_on_the_device() {
    let gpu = require_gpu!();
    let mesh = Shape::Torus.build(20_000);
    let (p, size) = (mesh.positions(), mesh.positions()[0].length());
    let length = |q: &DVec3| (2.0 * q.distance(p[0]) / size).clamp(0.05, 1.0);
    let weights: Vec<f64> = p.iter().map(|q| length(q).powi(-4)).collect();
    let surface = Arc::new(Surface::new(&mesh, Some(&weights)).unwrap());
    let drawn = sample(&mesh, Some(&weights), 6000, 3);
    let seeds: Vec<DVec3> = drawn.iter().map(|s| surface.frame().to_unit(s.position)).collect();
    let mut session = open(gpu, &surface, &seeds);
    let mut reference = Serial.session(Arc::clone(&surface), SessionOptions::new(6000)).unwrap();
    let (mut sums, mut want) = (CellSums::default(), CellSums::default());
    let stats = session.sums(&mut sums, &Token::default()).unwrap();
    assert_eq!(stats.host_searches, 0);
    reference.set_seeds(&seeds).unwrap();
    reference.sums(&mut want, &Token::default()).unwrap();
    let energy = |sums: &CellSums| sums.energy.iter().sum::<f64>();
    // Pieces are floats, good to some 1e-7 of themselves, and their errors have either sign: 3e-8 of the sum was measured.
    assert!((energy(&sums) / energy(&want) - 1.0).abs() < 1e-6, "{} for {}", energy(&sums), energy(&want));
}

/// A crowd of seeds takes up the rows of those beside it, and an even ring around a seed makes more vertices than there
/// are registers for. The host sees to it once; from then on the device does, with the same bits.
#[needs(gpu)]
#[test]
fn cells_beside_a_crowd_and_within_a_ring_are_ended_on_the_device() {
    require_gpu!();
    let (gpu, _turn) = counted();
    let surface = surface(Shape::Sphere, 300, false);
    let mut seeds = noise(&surface, 300, 0.0, 9);
    let (crowded, ringed) = (seeds[0], surface.centroid(0));
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(10);
    let mut within = || 0.01 * (rng.random::<f64>() - 0.5);
    let towards = (seeds[1] - crowded).normalize() * 0.02;
    seeds.extend((0..60).map(|_| crowded + towards + dvec3(within(), within(), within())));
    let [a, b, c] = surface.facets()[0].map(|v| surface.positions()[v as usize]);
    let (across, normal) = ((b - a).normalize(), (b - a).cross(c - a).normalize());
    seeds.push(ringed);
    seeds.extend((0..12).map(|k| {
        let (sin, cos) = (f64::from(k) / 12.0 * std::f64::consts::TAU).sin_cos();
        ringed + 1e-3 * (across * cos + normal.cross(across) * sin)
    }));
    let mut session = open(gpu, &surface, &seeds);
    let mut passes = Vec::new();
    for _ in 0..3 {
        session.set_seeds(&seeds).unwrap();
        let moving = session.resident().unwrap();
        let evaluation = evaluate(moving);
        let stats = evaluation.stats;
        eprintln!("{stats:?}");
        assert!(stats.relaunched_neighbours > 0 && stats.relaunched_polygon > 0, "{stats:?}");
        passes.push((evaluation.energy.to_bits(), evaluation.gradient_squared.to_bits(), stats.device_submissions));
    }
    assert!(passes[0].2 > 1, "{passes:?}");
    assert_eq!(passes[1], (passes[0].0, passes[0].1, 1));
    assert_eq!(passes[2], passes[1]);
    let mut want = CellSums::default();
    let mut reference = Serial.session(Arc::clone(&surface), SessionOptions::new(seeds.len())).unwrap();
    reference.set_seeds(&seeds).unwrap();
    reference.sums(&mut want, &Token::default()).unwrap();
    let mut got = CellSums::default();
    session.sums(&mut got, &Token::default()).unwrap();
    for i in 0..seeds.len() {
        // What a cell's area may be off by is a rounding of its facets' corners, as seen from its seed.
        assert!((got.area[i] - want.area[i]).abs() < 1e-6, "{i}: {} for {}", got.area[i], want.area[i]);
    }
}

/// Energies and gradients of `steps` Lloyd steps, one by one or as the device likes, and where they lead.
fn relaxed(session: &mut dyn Session, steps: usize, together: bool) -> (Vec<[f64; 3]>, Vec<DVec3>, PassStats) {
    let moving = session.resident().unwrap();
    let mut evaluations = Vec::new();
    while evaluations.len() < steps {
        if together {
            let before = evaluations.len();
            moving.relax(steps - before, &mut evaluations, &Token::default()).unwrap();
            assert!(evaluations.len() > before && evaluations.len() <= steps);
            if evaluations.last().unwrap().empty_cells == 0 {
                continue;
            }
        } else {
            evaluations.push(evaluate(moving));
        }
        moving.to_centroids().unwrap();
    }
    let mut stats = PassStats::default();
    evaluations.iter().for_each(|evaluation| stats.add(&evaluation.stats));
    (evaluations.iter().map(|l| [l.energy, l.gradient_squared, l.area]).collect(), read(moving), stats)
}

#[needs(gpu)]
#[test]
fn steps_taken_together_have_the_bits_of_steps_taken_one_by_one() {
    require_gpu!();
    let (gpu, _turn) = counted();
    // The third has facets of more cells than one goes through at once.
    for (facets, weighted, n) in [(3000, false, 500), (1500, true, 400), (200, false, 600)] {
        let surface = surface(Shape::Torus, facets, weighted);
        for (name, seeds) in many_sets(&surface, n) {
            let (alone, alone_at, one) = relaxed(&mut *open(gpu, &surface, &seeds), 12, false);
            let (together, at, many) = relaxed(&mut *open_together(gpu, &surface, &seeds, 8), 12, true);
            assert_eq!(alone, together, "{name}");
            assert!(alone_at == at, "{name}: seeds");
            assert_eq!(
                (one.divided_facets + one.paired_facets) % surface.facets().len() as u64,
                0,
                "{name}: a facet is divided or goes pair by pair"
            );
            eprintln!(
                "{facets} facets, {name}: {} submissions together; {} facets divided, {} by pairs",
                many.device_submissions, many.divided_facets, many.paired_facets
            );
        }
    }
    let surface = surface(Shape::Torus, 3000, false);
    let held: Vec<bool> = (0..500).map(|i| i % 3 == 0).collect();
    let mut sessions = [0, 1].map(|_| open_together(gpu, &surface, &noise(&surface, 500, 0.0, 9), 8));
    sessions.iter_mut().for_each(|s| s.resident().unwrap().hold(&held).unwrap());
    let [one, many] = &mut sessions;
    assert!(relaxed(&mut **one, 12, false).1 == relaxed(&mut **many, 12, true).1, "held");
    // Settled seeds need nothing of the host: 1, 2, 4, 8, 8, ... at a time, twice that if a pass of these is not clean.
    let (_, _, stats) = relaxed(&mut **many, 30, true);
    eprintln!("{stats:?}");
    assert!(stats.device_submissions <= 12 && stats.device_allocations == 0, "{stats:?}");
    let cancelled = Token::default();
    cancelled.cancel();
    let moving = many.resident().unwrap();
    let before = read(moving);
    assert!(matches!(moving.relax(5, &mut Vec::new(), &cancelled), Err(RvdError::Stopped(Stopped::Cancelled))));
    assert!(before == read(moving));
}

#[needs(gpu)]
#[test]
fn the_next_session_of_the_same_plan_allocates_nothing_and_gives_the_same_bits() {
    require_gpu!();
    // Other tests allocate on theirs at the same time.
    let device = Device::open(&DeviceOptions { software: true, ..DeviceOptions::default() }).unwrap();
    let gpu = Gpu::new(device, None).unwrap();
    let surface = surface(Shape::Torus, 2_000, false);
    let seeds = noise(&surface, 300, 0.0, 11);
    let token = Token::default();
    let mut runs = Vec::new();
    for _ in 0..3 {
        let mut session = gpu.session(Arc::clone(&surface), SessionOptions::new(seeds.len())).unwrap();
        assert!(session.device_bytes() > 0);
        session.set_seeds(&seeds).unwrap();
        let mut evaluations = Vec::new();
        let resident = session.resident().unwrap();
        resident.relax(3, &mut evaluations, &token).unwrap();
        let mut moved = Vec::new();
        resident.read(&mut moved).unwrap();
        runs.push((session.device_work().device_allocations, moved));
    }
    assert!(runs[0].0 > 0, "the first allocates");
    assert_eq!((runs[1].0, runs[2].0), (0, 0));
    assert!(runs.iter().all(|run| run.1 == runs[0].1));
}
