//! One restricted Voronoi diagram, in pieces that a caller can take at its own pace.
//!
//! Purpose: [`Diagram`] opens a session and hands out sums and batches of pieces in the caller's
//! coordinates; the command line and the engine both drive it.
//! Invariant: facets are visited once and in order. Must not know: queues, messages, files.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use serde::Serialize;

use super::spec::Prepared;
use super::{BackendInfo, JobError};
use crate::remesh::report::{DeviceFigures, InputFigures, IterationFigures, MemoryFigures, RvdFigures, Timings};
use crate::rvd::{Backend, CellSums, PassStats, PieceBatch, Session, SessionOptions, Surface};
use crate::token::Token;

pub(crate) use crate::rvd::Cells as WorldSums;

/// Pieces that a batch aims at: a few MiB.
const BATCH_PIECES: usize = 32_768;

/// The report of `tessera rvd`, and of the service's `ComputeRvd`.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct RvdReport {
    /// "serial", "parallel" or "gpu".
    pub backend: &'static str,
    /// The GPU adapter's name.
    pub adapter: Option<String>,
    /// Threads of the CPU pool.
    pub threads: usize,
    /// Random seed, if the seeds were drawn.
    pub seed: Option<u64>,
    /// Number of seeds.
    pub seeds: usize,
    /// Always false: nothing is iterated.
    pub converged: bool,
    /// The surface that came in.
    pub input: InputFigures,
    /// The diagram.
    pub rvd: RvdFigures,
    /// Empty.
    pub iterations: Vec<IterationFigures>,
    /// `iterations` is the time for the diagram.
    pub timings_ms: Timings,
    /// Memory.
    pub memory: MemoryFigures,
    /// What a GPU was kept busy with.
    pub device: DeviceFigures,
}

/// See the module's head.
pub(crate) struct Diagram {
    session: Box<dyn Session>,
    surface: Arc<Surface>,
    seeds: Arc<Vec<DVec3>>,
    next: u32,
    step: u32,
    pass: PassStats,
    pieces_area: f64,
    met: Vec<bool>,
    figures: RvdFigures,
    compute_ms: f64,
}

impl Diagram {
    /// Allocates for the surface and sets the seeds.
    ///
    /// # Errors
    /// What the backend says.
    pub(crate) fn open(prepared: &Prepared, backend: &dyn Backend) -> Result<Self, JobError> {
        let start = Instant::now();
        let surface = Arc::clone(&prepared.surface);
        let seeds = Arc::clone(&prepared.seeds);
        let mut session = backend.session(Arc::clone(&surface), SessionOptions::new(seeds.len()))?;
        let unit: Vec<DVec3> = seeds.iter().map(|&p| surface.frame().to_unit(p)).collect();
        session.set_seeds(&unit)?;
        let facets = surface.facets().len();
        let pieces_per_facet = 1 + 6 * seeds.len() / facets.max(1);
        Ok(Self {
            session,
            surface,
            next: 0,
            step: (BATCH_PIECES / pieces_per_facet).clamp(1, BATCH_PIECES) as u32,
            pass: PassStats::default(),
            pieces_area: 0.0,
            met: vec![false; seeds.len()],
            seeds,
            figures: RvdFigures::default(),
            compute_ms: start.elapsed().as_secs_f64() * 1e3,
        })
    }

    /// Sums over all cells.
    ///
    /// # Errors
    /// `Stopped`, or what the backend says.
    pub(crate) fn sums(&mut self, token: &Token) -> Result<WorldSums, JobError> {
        let start = Instant::now();
        let mut unit = CellSums::default();
        let stats = self.session.sums(&mut unit, token)?;
        let sums = WorldSums::new(&unit, &self.seeds, self.surface.frame());
        self.figures.add_pass(&stats);
        self.figures.pairs = stats.pairs;
        self.figures.area = sums.areas.iter().sum();
        self.figures.empty_cells = sums.areas.iter().filter(|a| **a <= 0.0).count();
        self.compute_ms += start.elapsed().as_secs_f64() * 1e3;
        Ok(sums)
    }

    /// The next batch of pieces, positions in the caller's coordinates; `None` after the last.
    ///
    /// # Errors
    /// `Stopped`, or what the backend says.
    pub(crate) fn batch(&mut self, token: &Token) -> Result<Option<PieceBatch>, JobError> {
        let facets = self.surface.facets().len() as u32;
        if self.next >= facets {
            return Ok(None);
        }
        let start = Instant::now();
        let end = facets.min(self.next.saturating_add(self.step));
        let mut batch = PieceBatch::default();
        let stats = self.session.pieces(self.next..end, &mut batch, token)?;
        self.next = end;
        self.pass.add(&stats);
        self.figures.add_pass(&stats);
        let frame = self.surface.frame();
        for i in 0..batch.len() {
            self.pieces_area += batch.area(i);
            if let Some(met) = self.met.get_mut(batch.seed[i] as usize) {
                *met = true;
            }
        }
        batch.position.iter_mut().for_each(|p| *p = frame.to_world(*p));
        if end == facets {
            self.figures.pairs = self.pass.pairs;
            self.figures.area = self.pieces_area / (frame.scale * frame.scale);
            self.figures.empty_cells = self.met.iter().filter(|met| !**met).count();
        }
        self.compute_ms += start.elapsed().as_secs_f64() * 1e3;
        Ok(Some(batch))
    }

    /// Facets visited, and all.
    pub(crate) fn progress(&self) -> (u64, u64) {
        (u64::from(self.next), self.surface.facets().len() as u64)
    }

    /// The report, once everything wanted was taken.
    pub(crate) fn report(&self, prepared: &Prepared, by: &BackendInfo) -> RvdReport {
        let mut timings_ms = prepared.timings.clone();
        timings_ms.iterations = self.compute_ms;
        timings_ms.total = timings_ms.prepare + timings_ms.sample + timings_ms.iterations;
        RvdReport {
            backend: by.kind.name(),
            adapter: by.adapter.clone(),
            threads: by.threads,
            seed: prepared.random_seed,
            seeds: self.seeds.len(),
            converged: false,
            input: prepared.figures.clone(),
            rvd: self.figures.clone(),
            iterations: Vec::new(),
            timings_ms,
            memory: MemoryFigures { host_peak_bytes: None, device_bytes: self.session.device_bytes() },
            device: DeviceFigures::new(self.session.device_work(), &[]),
        }
    }
}
