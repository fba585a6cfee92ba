//! One restricted Voronoi diagram, in pieces that a caller can take at its own pace.
//!
//! Purpose: [`Diagram`] opens a session and hands out sums and batches of pieces in the caller's coordinates; the command
//! line and the engine both drive it. Invariant: facets are visited once and in order. What comes out is the same whether
//! or not it [rests](Diagram::rest) between two batches. Must not know: queues, messages, files.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use serde::Serialize;

use crate::executor::prepared::Prepared;
use crate::{BackendInfo, JobError};
use geometry::cvt::{Iteration, StepKind};
use geometry::remesh::report::{DeviceFigures, InputFigures, IterationFigures, MemoryFigures, RvdFigures, Timings};
use geometry::rvd::{Backend, CellSums, DeviceWork, PassStats, PieceBatch, RvdError, Session, SessionOptions, Surface};
use geometry::token::Token;

pub use geometry::rvd::Cells as WorldSums;

/// Pieces that a batch aims at: a few MiB.
const BATCH_PIECES: usize = 32_768;

/// The report of `tessera rvd`, and of the service's `ComputeRvd`.
#[derive(Clone, Debug, Serialize)]
pub struct RvdReport {
    /// "serial", "parallel" or "gpu".
    pub backend: &'static str,
    pub adapter: Option<String>,
    pub threads: usize,
    pub seed: Option<u64>,
    pub seeds: usize,
    /// Always false: steps are counted, and not judged.
    pub converged: bool,
    pub input: InputFigures,
    pub rvd: RvdFigures,
    pub iterations: Vec<IterationFigures>,
    /// `iterations` is the time for the diagram.
    pub timings_ms: Timings,
    pub memory: MemoryFigures,
    /// What a GPU was kept busy with.
    pub device: DeviceFigures,
}

pub struct Diagram {
    /// `None` while it rests.
    session: Option<Box<dyn Session>>,
    /// Of sessions that are over.
    past: DeviceWork,
    device_bytes: u64,
    surface: Arc<Surface>,
    seeds: Arc<Vec<DVec3>>,
    next: u32,
    step: u32,
    pass: PassStats,
    pieces_area: f64,
    met: Vec<bool>,
    figures: RvdFigures,
    steps: Vec<IterationFigures>,
    compute_ms: f64,
}

impl Diagram {
    /// Allocates for the surface and sets the seeds.
    pub fn open(prepared: &Prepared, backend: &dyn Backend) -> Result<Self, JobError> {
        let start = Instant::now();
        let surface = Arc::clone(&prepared.surface);
        let seeds = Arc::clone(&prepared.seeds);
        let session = open(&surface, &seeds, backend)?;
        let facets = surface.facets().len();
        let pieces_per_facet = 1 + 6 * seeds.len() / facets.max(1);
        Ok(Self {
            device_bytes: session.device_bytes(),
            session: Some(session),
            past: DeviceWork::default(),
            surface,
            next: 0,
            step: (BATCH_PIECES / pieces_per_facet).clamp(1, BATCH_PIECES) as u32,
            pass: PassStats::default(),
            pieces_area: 0.0,
            met: vec![false; seeds.len()],
            seeds,
            figures: RvdFigures::default(),
            steps: Vec::new(),
            compute_ms: start.elapsed().as_secs_f64() * 1e3,
        })
    }

    /// The session, a new one if it rested.
    fn session(&mut self, backend: &dyn Backend) -> Result<&mut dyn Session, JobError> {
        let session = match self.session.take() {
            Some(session) => session,
            None => open(&self.surface, &self.seeds, backend)?,
        };
        self.device_bytes = self.device_bytes.max(session.device_bytes());
        Ok(self.session.insert(session).as_mut())
    }

    /// Gives up what the backend holds for this: some hundred bytes for each seed. The next batch needs a moment more.
    pub fn rest(&mut self) -> Option<Box<dyn Session>> {
        let session = self.session.take()?;
        self.past += session.device_work();
        Some(session)
    }

    /// One Lloyd step: every seed to the centroid of its cell; one without a cell stays. Returns the energy before it, over that of
    /// a hexagonal tiling.
    pub fn lloyd(&mut self, backend: &dyn Backend, token: &Token) -> Result<f64, JobError> {
        let start = Instant::now();
        let (frame, count) = (self.surface.frame(), self.seeds.len());
        let none = || RvdError::Internal("this session moves no seeds".to_owned());
        let session = self.session(backend)?;
        let mut seeds = Vec::new();
        let resident = session.resident().ok_or_else(none)?;
        let evaluation = resident.evaluate(token)?;
        resident.to_centroids()?;
        resident.read(&mut seeds)?;
        session.set_seeds(&seeds)?;
        seeds.iter_mut().for_each(|p| *p = frame.to_world(*p));
        self.seeds = Arc::new(seeds);
        self.figures.add_pass(&evaluation.stats);
        let ms = start.elapsed().as_secs_f64() * 1e3;
        self.compute_ms += ms;
        let energy_ratio = evaluation.energy / self.surface.hexagonal_energy(count);
        let scale = frame.scale;
        self.steps.push(IterationFigures::of(&Iteration {
            index: self.steps.len(),
            kind: StepKind::Lloyd,
            energy: evaluation.energy / scale / scale / scale / scale,
            energy_ratio,
            gradient_norm: evaluation.gradient_squared.sqrt() / scale / scale / scale,
            evaluations: 1,
            empty_cells: evaluation.empty_cells,
            area: evaluation.area / scale / scale,
            ms,
            stats: evaluation.stats,
        }));
        Ok(energy_ratio)
    }

    /// The seeds where they are now, caller's coordinates.
    pub fn seeds(&self) -> Arc<Vec<DVec3>> {
        Arc::clone(&self.seeds)
    }

    /// Sums over all cells.
    pub fn sums(&mut self, backend: &dyn Backend, token: &Token) -> Result<WorldSums, JobError> {
        let start = Instant::now();
        let mut unit = CellSums::default();
        let stats = self.session(backend)?.sums(&mut unit, token)?;
        let sums = WorldSums::new(&unit, &self.seeds, self.surface.frame());
        self.figures.add_pass(&stats);
        self.figures.pairs = stats.pairs;
        self.figures.area = sums.areas.iter().sum();
        self.figures.empty_cells = sums.areas.iter().filter(|a| **a <= 0.0).count();
        self.compute_ms += start.elapsed().as_secs_f64() * 1e3;
        Ok(sums)
    }

    /// The next batch of pieces, positions in the caller's coordinates; `None` after the last.
    pub fn batch(&mut self, backend: &dyn Backend, token: &Token) -> Result<Option<PieceBatch>, JobError> {
        let facets = self.surface.facets().len() as u32;
        if self.next >= facets {
            return Ok(None);
        }
        let start = Instant::now();
        let end = facets.min(self.next.saturating_add(self.step));
        let mut batch = PieceBatch::default();
        let facets_of_batch = self.next..end;
        let stats = self.session(backend)?.pieces(facets_of_batch, &mut batch, token)?;
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
    pub fn progress(&self) -> (u64, u64) {
        (u64::from(self.next), self.surface.facets().len() as u64)
    }

    /// The report, once everything wanted was taken.
    pub fn report(&self, prepared: &Prepared, by: &BackendInfo) -> RvdReport {
        let mut timings_ms = prepared.timings.clone();
        timings_ms.iterations = self.compute_ms;
        let mut work = self.past;
        if let Some(session) = &self.session {
            work += session.device_work();
        }
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
            iterations: self.steps.clone(),
            timings_ms,
            memory: MemoryFigures { host_peak_bytes: None, device_bytes: self.device_bytes },
            device: DeviceFigures::new(work, &[]),
        }
    }
}

fn open(surface: &Arc<Surface>, seeds: &[DVec3], backend: &dyn Backend) -> Result<Box<dyn Session>, JobError> {
    let mut session = backend.session(Arc::clone(surface), SessionOptions::new(seeds.len()))?;
    let unit: Vec<DVec3> = seeds.iter().map(|&p| surface.frame().to_unit(p)).collect();
    session.set_seeds(&unit)?;
    Ok(session)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::executor::prepared::Input;
    use geometry::cvt::density::DensityOptions;
    use geometry::mesh::shapes::Shape;
    use geometry::remesh::Seeds;
    use geometry::rvd::{Parallel, Serial};

    #[test]
    fn a_diagram_that_rests_is_the_same() {
        let input = Input {
            mesh: Shape::Torus.build(3_000),
            density: DensityOptions::default(),
            seeds: Seeds::Sample { points: 700, seed: 1 },
            creases: Vec::new(),
            attributes: None,
        };
        let prepared = Prepared::new(input, &Token::default()).unwrap();
        let backends: [Box<dyn Backend>; 2] = [Box::new(Serial), Box::new(Parallel::new(Some(2)).unwrap())];
        for backend in backends {
            let token = Token::default();
            let take = |rests: bool| {
                let mut diagram = Diagram::open(&prepared, backend.as_ref()).unwrap();
                diagram.step = 500;
                let sums = diagram.sums(backend.as_ref(), &token).unwrap();
                let mut batches = Vec::new();
                while let Some(batch) = diagram.batch(backend.as_ref(), &token).unwrap() {
                    batches.push(batch);
                    assert_eq!(rests, rests && diagram.rest().is_some());
                }
                let figures = diagram.figures;
                (format!("{sums:?}"), batches, (figures.area, figures.pairs, figures.empty_cells))
            };
            let (one, other) = (take(false), take(true));
            assert!(one.1.len() > 4 && one.2.1 > 0);
            assert_eq!(one, other);
        }
    }
}
