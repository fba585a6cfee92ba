//! What must come of bad input that is a surface all the same.
#![allow(dead_code)]

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use glam::DVec3;
use tessera::internals::rvd::Gpu;
use tessera::mesh::TriMesh;
use tessera::mesh::measure::topology;
use tessera::remesh::{Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::{Backend, BackendKind, CellSums, PassStats, RvdError, SessionOptions, Surface};
use tessera::rvd::{Parallel, Serial};

use super::{cases, gpu};
use tessera::token::Token;

/// Serial, parallel, and the GPU where there is one; with the relative error of a sum that its arithmetic allows.
/// The GPU's is what its own cover check allows.
pub fn backends() -> Vec<(&'static dyn Backend, f64)> {
    static PARALLEL: OnceLock<Parallel> = OnceLock::new();
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    let parallel: &'static Parallel = PARALLEL.get_or_init(|| Parallel::new(Some(2)).unwrap());
    let gpu = GPU.get_or_init(|| gpu::device().map(|device| Gpu::new(device, Some(2)).unwrap()));
    let mut all: Vec<(&'static dyn Backend, f64)> = vec![(&Serial, 1e-10), (parallel, 1e-10)];
    all.extend(gpu.as_ref().map(|gpu| (gpu as &dyn Backend, 1e-4)));
    all
}

/// A device is one thread's at a time, as in the service; tests that need it wait for each other.
pub fn turn(backend: &dyn Backend) -> Option<MutexGuard<'static, ()>> {
    static DEVICE: Mutex<()> = Mutex::new(());
    (backend.kind() == BackendKind::Gpu).then(|| DEVICE.lock().unwrap_or_else(PoisonError::into_inner))
}

pub fn sums(backend: &dyn Backend, surface: &Arc<Surface>, seeds: &[DVec3]) -> Result<(CellSums, PassStats), RvdError> {
    let _turn = turn(backend);
    let mut session = backend.session(Arc::clone(surface), SessionOptions::new(seeds.len().max(1)))?;
    session.set_seeds(seeds)?;
    let mut out = CellSums::default();
    let stats = session.sums(&mut out, &Token::default())?;
    Ok((out, stats))
}

/// The cells cover the surface and carry its mass, on every backend, and backends agree cell by cell. Seeds in the
/// unit frame.
pub fn covered(name: &str, surface: &Arc<Surface>, seeds: &[DVec3]) {
    let mass: f64 = (0..surface.facets().len())
        .filter(|&f| !surface.skips(f))
        .map(|f| {
            let weights = surface.facets()[f].map(|v| surface.weights()[v as usize]);
            surface.facet_area(f as u32) * weights.iter().sum::<f64>() / 3.0
        })
        .sum();
    let mut first: Option<CellSums> = None;
    for (backend, tolerance) in backends() {
        let who = format!("{name}, {}", backend.kind().name());
        let (got, _) = sums(backend, surface, seeds).unwrap_or_else(|e| panic!("{who}: {e}"));
        let off = |x: f64, y: f64| (x - y).abs() > tolerance * y;
        let (area, total): (f64, f64) = (got.area.iter().sum(), got.mass.iter().sum());
        assert!(!off(area, surface.area()), "{who}: area {area:e} of {:e}", surface.area());
        assert!(!off(total, mass), "{who}: mass {total:e} of {mass:e}");
        let Some(want) = &first else {
            first = Some(got);
            continue;
        };
        for i in 0..seeds.len() {
            let apart = (got.area[i] - want.area[i]).abs();
            // A boundary that is off by a rounding, along the whole cell.
            assert!(apart <= tolerance * surface.area().max(1.0), "{who}: cell {i} is off by {apart:e}");
        }
    }
}

pub fn options(seeds: Seeds, lloyd: usize) -> RemeshOptions {
    RemeshOptions::plain(seeds, lloyd)
}

pub fn run(mesh: &TriMesh, options: &RemeshOptions, backend: &dyn Backend) -> Result<Remesh, RemeshError> {
    let _turn = turn(backend);
    remesh(mesh, options, backend, &mut (), &Token::default())
}

/// An oriented 2-manifold comes out on every backend, for whoever reads indices and for whoever welds positions.
pub fn remeshed(name: &str, mesh: &TriMesh, options: &RemeshOptions) -> Vec<Remesh> {
    let each = backends().into_iter().map(|(backend, tolerance)| {
        let who = format!("{name}, {}", backend.kind().name());
        let out = run(mesh, options, backend).unwrap_or_else(|e| panic!("{who}: {e}"));
        cases::manifold(out.mesh.facets(), out.mesh.positions().len()).unwrap_or_else(|e| panic!("{who}: {e}"));
        let seen = topology(&out.mesh);
        assert_eq!((seen.non_manifold_edges, seen.non_manifold_vertices), (0, 0), "{who}: {seen:?}");
        let area = out.report.rvd.area;
        // Of facets that are there twice one is taken.
        let input = &out.report.input;
        let whole = if input.coincident_facets > 0 { input.area } else { mesh.area() };
        // The dual's diagram is double precision on every backend; the caller's units may cost digits.
        assert!((area / whole - 1.0).abs() < 1e-6, "{who}: {area:e} of {whole:e}, {tolerance}");
        out
    });
    each.collect()
}
