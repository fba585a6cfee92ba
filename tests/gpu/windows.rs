//! Promise: a surface whose buffers are larger than what a shader can see of one is done window by window, with
//! the bits of a device that sees it whole; what no window can hold is refused by name.

use std::sync::{Arc, OnceLock};

use ::gpu::diagram::Gpu;
use ::gpu::{Device, DeviceOptions};
use glam::DVec3;
use needs::needs;
use rand::{RngExt, SeedableRng};
use tessera::mesh::shapes::Shape;
use tessera::rvd::{
    Backend, Capacities, CellSums, Evaluation, PassStats, PieceBatch, RvdError, SessionOptions, Strategy, Surface,
    Tuning,
};
use tessera::token::Token;

fn limited(most_buffer_bytes: Option<u64>) -> Gpu {
    let options = DeviceOptions { software: true, most_buffer_bytes, ..DeviceOptions::default() };
    Gpu::new(Device::open(&options).unwrap(), None).unwrap()
}

/// One that sees a mebibyte at once, and one that sees all.
pub fn backends() -> Option<&'static [Gpu; 2]> {
    static BOTH: OnceLock<Option<[Gpu; 2]>> = OnceLock::new();
    BOTH.get_or_init(|| crate::gpu::device().map(|_| [limited(Some(1 << 20)), limited(None)])).as_ref()
}

macro_rules! require_gpu {
    () => {
        match backends() {
            Some(both) => both,
            None => return,
        }
    };
}

pub(super) fn surface(facets: usize, weighted: bool) -> Arc<Surface> {
    let mesh = Shape::Torus.build(facets);
    let weights: Vec<f64> = mesh.positions().iter().map(|p| 1.5 + (3.0 * p.x).sin() * (2.0 * p.y).cos()).collect();
    Arc::new(Surface::new(&mesh, weighted.then_some(&weights[..])).unwrap())
}

/// Centroids of random facets, each moved a little.
pub(super) fn seeds(surface: &Surface, n: usize, seed: u64) -> Vec<DVec3> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut noise = move || (rng.random::<f64>() - 0.5, rng.random_range(0..surface.facets().len() as u32));
    (0..n).map(|_| surface.centroid(noise().1) + DVec3::new(noise().0, noise().0, noise().0) * 1e-3).collect()
}

pub(super) struct Outcome {
    sums: CellSums,
    pieces: PieceBatch,
    pub(super) stats: PassStats,
    evaluations: Vec<Evaluation>,
    moved: Vec<DVec3>,
}

/// Sums, pieces by parts, and some steps of the seeds.
pub(super) fn run(gpu: &dyn Backend, surface: &Arc<Surface>, seeds: &[DVec3], options: SessionOptions) -> Outcome {
    let token = Token::default();
    let mut session = gpu.session(Arc::clone(surface), options).unwrap();
    session.set_seeds(seeds).unwrap();
    let mut sums = CellSums::default();
    let stats = session.sums(&mut sums, &token).unwrap();
    let (mut pieces, mut part) = (PieceBatch::default(), PieceBatch::default());
    let facets = surface.facets().len() as u32;
    for first in (0..facets).step_by(facets as usize / 2 + 1) {
        session.pieces(first..(first + facets / 2 + 1).min(facets), &mut part, &token).unwrap();
        pieces.extend(&part);
    }
    let moving = session.resident().unwrap();
    let mut evaluations = vec![moving.evaluate(&token).unwrap()];
    for _ in 0..2 {
        moving.to_centroids().unwrap();
        evaluations.push(moving.evaluate(&token).unwrap());
    }
    moving.search_direction().unwrap();
    evaluations.push(moving.probe(0.1 / evaluations[2].gradient_squared.sqrt(), &token).unwrap());
    moving.accept().unwrap();
    let mut moved = Vec::new();
    moving.read(&mut moved).unwrap();
    Outcome { sums, pieces, stats, evaluations, moved }
}

pub(super) fn same(name: &str, a: &Outcome, b: &Outcome) {
    assert!(a.sums == b.sums, "{name}: sums");
    assert!(a.pieces == b.pieces, "{name}: pieces");
    assert_eq!(a.stats.pairs, b.stats.pairs, "{name}");
    assert!(a.moved == b.moved, "{name}: seeds");
    for (a, b) in a.evaluations.iter().zip(&b.evaluations) {
        assert_eq!((a.energy, a.gradient_squared, a.slope), (b.energy, b.gradient_squared, b.slope), "{name}");
    }
}

#[needs(gpu)]
#[test]
fn windows_change_no_bit() {
    let [small, whole] = require_gpu!();
    let tiny = Capacities::new().with_neighbours(5).with_polygon(5).with_cells(2).with_pairs_percent(10);
    // Records of 2.3 MB: three windows, at first.
    for weighted in [false, true] {
        let surface = surface(24_000, weighted);
        for (name, n, capacities) in [("usual", 1200, Capacities::default()), ("tiny", 1200, tiny), ("few", 7, tiny)] {
            let seeds = seeds(&surface, n, 1);
            let options = SessionOptions::new(n).with_capacities(capacities);
            let (a, b) = (run(small, &surface, &seeds, options), run(whole, &surface, &seeds, options));
            same(name, &a, &b);
            eprintln!("{name}: {:?}", a.stats);
        }
    }
}

#[needs(gpu)]
#[test]
fn facets_of_many_cells_and_seeds_that_the_host_searches() {
    let [small, whole] = require_gpu!();
    // Few facets, but their sets of cells are 4 MB.
    let surface = surface(500, false);
    let crowd = seeds(&surface, 2000, 2);
    let mut twins = seeds(&surface, 300, 3);
    twins.extend_from_within(..);
    // In one place, and farther than floats reach.
    let heap: Vec<DVec3> = seeds(&surface, 600, 4).iter().map(|&p| p * 1e-6).collect();
    let far: Vec<DVec3> = seeds(&surface, 50, 5).iter().map(|&p| p + DVec3::new(0.0, 100.0, 0.0)).collect();
    for (name, seeds) in [("crowd", crowd), ("twins", twins), ("heap", heap), ("far", far)] {
        for strategy in [Strategy::Auto, Strategy::Cell] {
            let tuning = Tuning::new().with_strategy(strategy);
            let capacities = Capacities::new().with_cells(2048);
            let options = SessionOptions::new(seeds.len()).with_tuning(tuning).with_capacities(capacities);
            same(name, &run(small, &surface, &seeds, options), &run(whole, &surface, &seeds, options));
        }
    }
}

#[needs(gpu)]
#[test]
fn rows_beyond_the_limit_are_finished_in_double() {
    let [small, whole] = require_gpu!();
    // Seeds of two spacings, so that many of them need rows that the table has no room for.
    let surface = surface(500, false);
    let mut crowd = seeds(&surface, 3500, 2);
    let middle = crowd[0];
    for p in seeds(&surface, 3500, 6).iter().map(|&p| middle + (p - middle) * 0.05) {
        // Nearer ones may have all of the pass done in double precision.
        if crowd.iter().all(|q| q.distance(p) > 1e-4) {
            crowd.push(p);
        }
    }
    let options = SessionOptions::new(crowd.len());
    let sums = |gpu: &Gpu| {
        let mut session = gpu.session(Arc::clone(&surface), options).unwrap();
        session.set_seeds(&crowd).unwrap();
        let mut sums = CellSums::default();
        let stats = session.sums(&mut sums, &Token::default()).unwrap();
        (sums, stats)
    };
    let ((a, by_small), (b, by_whole)) = (sums(small), sums(whole));
    eprintln!("{by_small:?}\n{by_whole:?}");
    assert!(by_small.f64_finished > by_whole.f64_finished);
    let mean = surface.area() / crowd.len() as f64;
    for (i, (a, b)) in a.area.iter().zip(&b.area).enumerate() {
        // A cell's area in single precision is good to that share of a mean one.
        assert!((a - b).abs() < 1e-4 * b.max(mean), "{i}: {a:e}, {b:e}");
    }
}

#[needs(gpu)]
#[test]
fn what_no_window_holds_is_refused() {
    let [small, _] = require_gpu!();
    let refused = |surface: Arc<Surface>, n| match small.session(surface, SessionOptions::new(n)) {
        Err(RvdError::NeverFits { needed_bytes, limit_bytes }) => (needed_bytes, limit_bytes),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("{n} seeds fit"),
    };
    // Seeds are not divided into windows: 96 bytes of sums each.
    let (needed, limit) = refused(surface(500, false), 20_000);
    assert!(limit == 1 << 20 && needed >= 20_000 * 96, "{needed}, {limit}");
}
