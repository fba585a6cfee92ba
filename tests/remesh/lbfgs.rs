//! Promise: quasi-Newton steps. The gradient is that of the energy, the energy never rises, the steps end, and a run
//! has the same bits every time.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::{gpu, surfaces};
use glam::DVec3;
use tessera::cvt::{Cvt, CvtOptions, Iteration, StepKind};
use tessera::internals::rvd::Gpu;
use tessera::mesh::TriMesh;
use tessera::mesh::sample::sample;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{RemeshOptions, Seeds, remesh};
use tessera::rvd::{
    Backend, BackendKind, CellSums, Evaluation, PassStats, PieceBatch, Resident, RvdError, Session, SessionOptions,
    Surface,
};
use tessera::rvd::{Parallel, Serial};
use tessera::token::{Stopped, Token};

/// Every backend there is.
fn backends() -> Vec<Box<dyn Backend>> {
    let mut all: Vec<Box<dyn Backend>> = vec![Box::new(Serial), Box::new(Parallel::new(Some(2)).unwrap())];
    all.extend(gpu::device().map(|device| Box::new(Gpu::new(device, None).unwrap()) as Box<dyn Backend>));
    all
}

fn drawn(mesh: &TriMesh, n: usize) -> Vec<DVec3> {
    sample(mesh, None, n, 1).into_iter().map(|p| p.position).collect()
}

fn weights(mesh: &TriMesh) -> Vec<f64> {
    mesh.positions().iter().map(|p| 1.5 + (3.0 * p.x).sin() * (2.0 * p.y).cos()).collect()
}

fn open(backend: &dyn Backend, mesh: &TriMesh, seeds: &[DVec3]) -> Cvt {
    Cvt::new(backend, Arc::new(Surface::new(mesh, None).unwrap()), seeds, CvtOptions::default()).unwrap()
}

fn lloyd(cvt: &mut Cvt, steps: usize) {
    (0..steps).for_each(|_| {
        cvt.lloyd(&Token::default()).unwrap();
    });
}

fn lbfgs(cvt: &mut Cvt) -> Iteration {
    cvt.lbfgs(&Token::default()).unwrap()
}

fn energy(cvt: &mut Cvt) -> f64 {
    cvt.present(&Token::default()).unwrap().energy
}

/// Along the way to the centroids of all seeds, and of every third one alone.
#[test]
fn the_gradient_is_that_of_the_energy() {
    let never = Token::default();
    for backend in backends() {
        let single = backend.kind() == BackendKind::Gpu;
        for (shape, n) in [(Shape::Torus, 60), (Shape::Block, 80), (Shape::Hills, 50)] {
            let mesh = shape.build(600);
            for weighted in [false, true] {
                let given = weights(&mesh);
                let surface = Arc::new(Surface::new(&mesh, weighted.then_some(&given[..])).unwrap());
                let seeds: Vec<DVec3> = drawn(&mesh, n).iter().map(|&p| surface.frame().to_unit(p)).collect();
                let mut session = backend.session(Arc::clone(&surface), SessionOptions::new(n)).unwrap();
                session.set_seeds(&seeds).unwrap();
                let moving = session.resident().unwrap();
                for every in [1, 3] {
                    let held: Vec<bool> = (0..n).map(|i| i % every != 0).collect();
                    moving.hold(&held).unwrap();
                    let here = moving.evaluate(&never).unwrap();
                    let slope = moving.search_direction().unwrap();
                    // Seeds move by this share of a cell's width in the mean. Truncation is up to 17 times the square
                    // of it (beside sharp edges); in single precision the energies are known to 1e-6 or better,
                    // and the step has to be long against that.
                    let share = if single { 1e-2 } else { 1e-4 };
                    let width = (surface.area() / n as f64).sqrt();
                    let mut sums = CellSums::default();
                    moving.read_sums(&mut sums).unwrap();
                    let free = || (0..n).filter(|i| i % every == 0);
                    let way = |i: usize| sums.moment[i].length_squared() / sums.mass[i] / sums.mass[i];
                    let step = share * width * ((n / every) as f64 / free().map(way).sum::<f64>()).sqrt();
                    let ahead = moving.probe(step, &never).unwrap();
                    let behind = moving.probe(-step, &never).unwrap();
                    let found = (ahead.energy - behind.energy) / (2.0 * step);
                    let tolerance = if single { 5e-3 } else { 1e-6 };
                    let off = (found / slope - 1.0).abs();
                    let name = format!("{}, {shape}, weighted {weighted}, one in {every}", backend.kind().name());
                    println!("{name}: off by {off:e}");
                    assert!(off < tolerance, "{name}: {found:e}, not {slope:e}");
                    // Without a history the direction is -g over twice the masses; what is held has no part in it.
                    let rounding = if single { 1e-5 } else { 1e-12 };
                    let part = |i: usize| 2.0 * sums.moment[i].length_squared();
                    let squared: f64 = free().map(|i| 2.0 * part(i)).sum();
                    assert!((here.gradient_squared / squared - 1.0).abs() < rounding, "{name}");
                    let want: f64 = free().map(|i| part(i) / sums.mass[i]).sum();
                    assert!((slope / want + 1.0).abs() < rounding, "{name}: {slope:e}, not {want:e}");
                }
            }
        }
    }
}

/// Component by component, against the moments of the sums.
#[test]
fn every_component_of_the_gradient_is_right() {
    let never = Token::default();
    let mesh = Shape::Torus.build(400);
    let given = weights(&mesh);
    for weighted in [None, Some(&given[..])] {
        let surface = Arc::new(Surface::new(&mesh, weighted).unwrap());
        let seeds: Vec<DVec3> = drawn(&mesh, 12).iter().map(|&p| surface.frame().to_unit(p)).collect();
        let mut session = Serial.session(Arc::clone(&surface), SessionOptions::new(12)).unwrap();
        let mut sums = CellSums::default();
        session.set_seeds(&seeds).unwrap();
        session.sums(&mut sums, &never).unwrap();
        let gradient: Vec<DVec3> = sums.moment.iter().map(|&m| -2.0 * m).collect();
        let norm = gradient.iter().map(|g| g.length_squared()).sum::<f64>().sqrt();
        let mut energy = |seeds: &[DVec3]| {
            session.set_seeds(seeds).unwrap();
            session.sums(&mut sums, &never).unwrap();
            sums.energy.iter().sum::<f64>()
        };
        for i in 0..seeds.len() {
            for axis in 0..3 {
                let step = 1e-5;
                let mut moved = seeds.clone();
                moved[i][axis] = seeds[i][axis] + step;
                let ahead = energy(&moved);
                moved[i][axis] = seeds[i][axis] - step;
                let found = (ahead - energy(&moved)) / (2.0 * step);
                // Rounding of E over the step, and its square.
                assert!((found - gradient[i][axis]).abs() < 1e-7 * norm, "seed {i}, axis {axis}: {found:e}");
            }
        }
    }
}

#[test]
fn the_energy_never_rises() {
    for backend in backends() {
        for (name, mesh) in surfaces::all() {
            let mut cvt = open(backend.as_ref(), &mesh, &drawn(&mesh, 50));
            lloyd(&mut cvt, 1);
            let mut before: Option<Iteration> = None;
            let mut newton = 0;
            for _ in 0..8 {
                let step = lbfgs(&mut cvt);
                newton += usize::from(step.kind == StepKind::Lbfgs);
                if let Some(before) = before {
                    // An accepted step was compared in the same numbers; one of Lloyd's, where a search failed, is as
                    // good as the energy's sum is.
                    let slack = match (before.kind, backend.kind()) {
                        (StepKind::Lbfgs, _) => 0.0,
                        (StepKind::Lloyd, BackendKind::Gpu) => 2e-6,
                        _ => 1e-13,
                    };
                    let limit = before.energy * (1.0 + slack);
                    assert!(step.energy <= limit, "{name}: {} after {before:?}", step.energy);
                }
                before = Some(step);
            }
            assert!(newton >= 4, "{}, {name}: {newton} quasi-Newton steps", backend.kind().name());
        }
    }
}

#[test]
fn quasi_newton_steps_get_farther_than_lloyds() {
    let mesh = Shape::Torus.build(1500);
    let seeds = drawn(&mesh, 200);
    for backend in backends() {
        let mut slow = open(backend.as_ref(), &mesh, &seeds);
        lloyd(&mut slow, 35);
        let mut fast = open(backend.as_ref(), &mesh, &seeds);
        lloyd(&mut fast, 5);
        (0..30).for_each(|_| {
            lbfgs(&mut fast);
        });
        let (fast, slow) = (energy(&mut fast), energy(&mut slow));
        println!("{}: {fast:e} against {slow:e}", backend.kind().name());
        assert!(fast < slow, "{}: {fast:e} against {slow:e}", backend.kind().name());
    }
}

#[test]
fn the_steps_converge_and_stop() {
    let mesh = Shape::Torus.build(1000);
    for backend in backends() {
        let mut cvt = open(backend.as_ref(), &mesh, &drawn(&mesh, 20));
        assert!(!cvt.converged());
        let first = lbfgs(&mut cvt);
        let mut steps = 1;
        while !cvt.converged() {
            lbfgs(&mut cvt);
            steps += 1;
            assert!(steps < 300, "{}", backend.kind().name());
        }
        let last = cvt.present(&Token::default()).unwrap();
        println!(
            "{}: {steps} steps, ‖∇E‖ {:e} of {:e}",
            backend.kind().name(),
            last.gradient_norm,
            first.gradient_norm
        );
        // A standstill may come before the gradient has shrunk to a thousandth, but not long before.
        assert!(last.gradient_norm < 0.05 * first.gradient_norm);

        // A pipeline takes no more of them.
        let options = RemeshOptions::plain(Seeds::Sample { points: 20, seed: 1 }, 2).with_newton(300);
        let out = remesh(&mesh, &options, backend.as_ref(), &mut (), &Token::default()).unwrap();
        assert!(out.report.converged);
        let taken = out.report.iterations.len();
        assert!((3..302).contains(&taken), "{taken}");
        let kinds = out.report.iterations.iter().map(|i| i.kind).collect::<Vec<_>>();
        assert_eq!(kinds[..2], ["lloyd"; 2]);
        assert_eq!(kinds[2], "lbfgs");
    }
}

#[test]
fn a_run_has_the_same_bits_every_time() {
    let mesh = Shape::Torus.build(1500);
    let seeds = drawn(&mesh, 200);
    let run = |backend: &dyn Backend| {
        let mut cvt = open(backend, &mesh, &seeds);
        lloyd(&mut cvt, 2);
        let energies: Vec<u64> = (0..10).map(|_| lbfgs(&mut cvt).energy.to_bits()).collect();
        (cvt.seeds().unwrap(), energies)
    };
    assert!(run(&Serial) == run(&Serial), "two runs of the reference");
    let want = run(&Parallel::new(Some(2)).unwrap());
    for threads in [1, 3] {
        assert!(run(&Parallel::new(Some(threads)).unwrap()) == want, "{threads} threads");
    }
    if let Some(device) = gpu::device() {
        let gpu = Gpu::new(device, None).unwrap();
        assert!(run(&gpu) == run(&gpu), "two runs on the GPU");
    }
}

#[test]
fn held_seeds_stay() {
    let mesh = Shape::Sphere.build(800);
    let seeds = drawn(&mesh, 60);
    for backend in backends() {
        let mut cvt = open(backend.as_ref(), &mesh, &seeds);
        let held: Vec<bool> = (0..60).map(|i| i % 4 == 0).collect();
        cvt.hold(held.clone()).unwrap();
        let before = cvt.seeds().unwrap();
        lloyd(&mut cvt, 1);
        (0..5).for_each(|_| {
            lbfgs(&mut cvt);
        });
        let after = cvt.seeds().unwrap();
        for i in 0..60 {
            // The GPU keeps a place as two floats, good to 2⁻⁴⁸ of the box.
            let moved = before[i].distance(after[i]);
            assert_eq!(moved < 1e-9, held[i], "{}, seed {i} moved by {moved:e}", backend.kind().name());
        }
        assert!(cvt.hold(vec![true; 59]).is_err());
    }
}

#[test]
fn seeds_without_a_cell_are_placed_anew() {
    let mesh = Shape::Sphere.build(1200);
    let mut seeds = drawn(&mesh, 30);
    seeds.extend(vec![seeds[0]; 10]);
    seeds.extend(vec![DVec3::splat(300.0); 10]);
    for backend in backends() {
        let mut cvt = open(backend.as_ref(), &mesh, &seeds);
        let first = lbfgs(&mut cvt);
        assert_eq!((first.kind, first.empty_cells), (StepKind::Lloyd, 20), "{}", backend.kind().name());
        let mut last = first;
        for _ in 0..15 {
            last = lbfgs(&mut cvt);
        }
        assert_eq!((last.kind, last.empty_cells), (StepKind::Lbfgs, 0), "{}", backend.kind().name());
        assert!(last.energy_ratio < 1.2, "{}", last.energy_ratio);
    }
}

/// Cells without mass have no part in a gradient, and give none a scale.
#[test]
fn weights_of_zero_stop_no_step() {
    let mesh = Shape::Torus.build(1500);
    // Weight is there on one side alone, and on a single vertex.
    let half: Vec<f64> = mesh.positions().iter().map(|p| p.x.max(0.0)).collect();
    let mut one = vec![0.0; mesh.positions().len()];
    one[17] = 1.0;
    for weights in [half, one] {
        for backend in backends() {
            let surface = Arc::new(Surface::new(&mesh, Some(&weights)).unwrap());
            let mut cvt = Cvt::new(backend.as_ref(), surface, &drawn(&mesh, 100), CvtOptions::default()).unwrap();
            let energies: Vec<f64> = (0..15).map(|_| lbfgs(&mut cvt).energy).collect();
            let name = backend.kind().name();
            assert!(energies.windows(2).all(|e| e[1] <= e[0] * (1.0 + 1e-5)), "{name}: {energies:?}");
            assert!(cvt.seeds().unwrap().iter().all(|p| p.is_finite()), "{name}");
        }
    }
}

#[test]
fn cancelling_leaves_the_seeds_as_they_were() {
    let mesh = Shape::Torus.build(800);
    let seeds = drawn(&mesh, 60);
    for backend in backends() {
        let mut cvt = open(backend.as_ref(), &mesh, &seeds);
        lloyd(&mut cvt, 1);
        lbfgs(&mut cvt);
        let before = cvt.seeds().unwrap();
        let token = Token::default();
        token.cancel();
        assert!(matches!(cvt.lbfgs(&token), Err(RvdError::Stopped(Stopped::Cancelled))), "{}", backend.kind().name());
        assert_eq!(cvt.seeds().unwrap(), before);
        assert!(!cvt.converged());
    }
}

/// A search that was broken off is taken up as if nothing had been.
#[test]
fn a_cancelled_search_can_be_repeated() {
    let mesh = Shape::Torus.build(800);
    let seeds = drawn(&mesh, 60);
    let token = Token::default();
    let stopping = Stopping { after: Arc::new(AtomicUsize::new(usize::MAX)), token: token.clone() };
    let mut plain = open(&Serial, &mesh, &seeds);
    let mut cvt = open(&stopping, &mesh, &seeds);
    for cvt in [&mut plain, &mut cvt] {
        lloyd(cvt, 1);
        (0..3).for_each(|_| {
            lbfgs(cvt);
        });
    }
    let before = cvt.seeds().unwrap();
    assert_eq!(before, plain.seeds().unwrap());
    stopping.after.store(0, Ordering::SeqCst);
    assert!(matches!(cvt.lbfgs(&token), Err(RvdError::Stopped(Stopped::Cancelled))));
    assert!(token.is_stopped(), "in the middle of a search");
    assert_eq!(cvt.seeds().unwrap(), before);
    stopping.after.store(usize::MAX, Ordering::SeqCst);
    for cvt in [&mut plain, &mut cvt] {
        (0..3).for_each(|_| {
            lbfgs(cvt);
        });
    }
    assert_eq!(cvt.seeds().unwrap(), plain.seeds().unwrap());
}

/// The serial backend; sets a flag when so many more probes were taken.
struct Stopping {
    after: Arc<AtomicUsize>,
    token: Token,
}

impl Backend for Stopping {
    fn kind(&self) -> BackendKind {
        BackendKind::Serial
    }
    fn threads(&self) -> usize {
        1
    }
    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        let real = Serial.session(surface, options)?;
        Ok(Box::new(StoppingSession { after: Arc::clone(&self.after), token: self.token.clone(), real }))
    }
}

struct StoppingSession {
    after: Arc<AtomicUsize>,
    token: Token,
    real: Box<dyn Session>,
}

impl StoppingSession {
    fn inner(&mut self) -> &mut dyn Resident {
        self.real.resident().unwrap()
    }
}

impl Session for StoppingSession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        self.real.set_seeds(seeds)
    }
    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        self.real.sums(out, token)
    }
    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        self.real.pieces(facets, out, token)
    }
    fn resident(&mut self) -> Option<&mut dyn Resident> {
        Some(self)
    }
}

impl Resident for StoppingSession {
    fn hold(&mut self, held: &[bool]) -> Result<(), RvdError> {
        self.inner().hold(held)
    }
    fn evaluate(&mut self, token: &Token) -> Result<Evaluation, RvdError> {
        self.inner().evaluate(token)
    }
    fn to_centroids(&mut self) -> Result<(), RvdError> {
        self.inner().to_centroids()
    }
    fn search_direction(&mut self) -> Result<f64, RvdError> {
        self.inner().search_direction()
    }
    fn probe(&mut self, step: f64, token: &Token) -> Result<Evaluation, RvdError> {
        let left = self.after.load(Ordering::SeqCst);
        if left == 0 {
            self.token.cancel();
        } else if left < usize::MAX {
            self.after.store(left - 1, Ordering::SeqCst);
        }
        self.inner().probe(step, token)
    }
    fn accept(&mut self) -> Result<(), RvdError> {
        self.inner().accept()
    }
    fn clear_history(&mut self) {
        self.inner().clear_history();
    }
    fn read(&mut self, out: &mut Vec<DVec3>) -> Result<(), RvdError> {
        self.inner().read(out)
    }
    fn read_sums(&mut self, out: &mut CellSums) -> Result<(), RvdError> {
        self.inner().read_sums(out)
    }
}
