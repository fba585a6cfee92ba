//! What must come of bad input that is a surface all the same.
#![allow(dead_code)]

use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use ::gpu::diagram::Gpu;
use tessera::mesh::TriMesh;
use tessera::mesh::measure::topology;
use tessera::remesh::{Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::{Backend, BackendKind};
use tessera::rvd::{Parallel, Serial};

use super::cases;
use tessera::token::Token;

/// Serial, parallel, and the GPU where there is one; with the relative error of a sum that its arithmetic allows.
/// The GPU's is what its own cover check allows.
pub fn backends() -> Vec<(&'static dyn Backend, f64)> {
    static PARALLEL: OnceLock<Parallel> = OnceLock::new();
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    let parallel: &'static Parallel = PARALLEL.get_or_init(|| Parallel::new(Some(2)).unwrap());
    let gpu = GPU.get_or_init(|| crate::gpu::device().map(|device| Gpu::new(device, Some(2)).unwrap()));
    let mut all: Vec<(&'static dyn Backend, f64)> = vec![(&Serial, 1e-10), (parallel, 1e-10)];
    all.extend(gpu.as_ref().map(|gpu| (gpu as &dyn Backend, 1e-4)));
    all
}

/// A device is one thread's at a time, as in the service; tests that need it wait for each other.
pub fn turn(backend: &dyn Backend) -> Option<MutexGuard<'static, ()>> {
    static DEVICE: Mutex<()> = Mutex::new(());
    (backend.kind() == BackendKind::Gpu).then(|| DEVICE.lock().unwrap_or_else(PoisonError::into_inner))
}

pub fn options(seeds: Seeds, lloyd: usize) -> RemeshOptions {
    RemeshOptions::plain(seeds, lloyd)
}

pub fn run(mesh: &TriMesh, options: &RemeshOptions, backend: &dyn Backend) -> Result<Remesh, RemeshError> {
    let _turn = turn(backend);
    remesh(mesh, options, backend, &mut (), &Token::default())
}

/// An oriented 2-manifold comes out on every backend, by indices and by positions.
pub fn remeshed(name: &str, mesh: &TriMesh, options: &RemeshOptions) -> Vec<Remesh> {
    let each = backends().into_iter().map(|(backend, tolerance)| {
        let who = format!("{name}, {}", backend.kind().name());
        let out = run(mesh, options, backend).unwrap_or_else(|e| panic!("{who}: {e}"));
        cases::manifold(out.mesh.facets(), out.mesh.positions().len()).unwrap_or_else(|e| panic!("{who}: {e}"));
        let (seen, input) = (topology(&out.mesh), &out.report.input);
        // Sheets that touch do so in the result too.
        let touch = input.sheets > input.topology.components;
        assert!(touch || (seen.non_manifold_edges, seen.non_manifold_vertices) == (0, 0), "{who}: {seen:?}");
        let area = out.report.rvd.area;
        // Of facets that are there twice one is taken.
        let whole = if input.coincident_facets > 0 { input.area } else { mesh.area() };
        // The dual's diagram is double precision on every backend; the caller's units may cost digits.
        assert!((area / whole - 1.0).abs() < 1e-6, "{who}: {area:e} of {whole:e}, {tolerance}");
        out
    });
    each.collect()
}
