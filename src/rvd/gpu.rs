//! f32 on a wgpu device, exact as the others.
//!
//! Purpose: the GPU backend. The device works on a list of (facet, cell) pairs (\[HYWZ17\],
//! Algorithms 1 and 2): the nearest seed of each facet begins it, each clipped piece appends the
//! cells across its bisectors, a hash set per facet keeps them apart, and the sums are added in
//! fixed point. Indirect dispatches follow the list; the host reads one small block between
//! submissions and does again, with more of what they lacked, the pairs that did not end.
//! Invariant: every pair ends `Done` here or in f64; a full set or list means growing and
//! repeating the pass from zero. Integer sums have no order, so every run has the same bits.
//! Must not know: iterations, jobs, files.

mod fallback;
mod fixed;
mod measure;
mod pack;
mod pass;
mod pieces;
mod pipelines;
mod reach;
mod relaunch;

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use glam::{DVec3, dvec3};

use super::incident::{Diagram, FacetWalker};
use super::parallel::Parallel;
use super::start::Starts;
use super::{
    Accumulate, Backend, BackendKind, CancelFlag, Capacities, CellSums, PassStats, PieceBatch, RvdError, Session,
    SessionOptions, Surface, elapsed_ms, take_seeds,
};
use crate::gpu::buffers::{self, Buffers};
use crate::gpu::layout::{self, Params, SUM_WORDS};
use crate::gpu::plan::{BATCH, Counts, EXTRA_PROPOSALS, Limits, Plan};
use crate::gpu::{Device, GpuError};
use crate::knn::{NeighbourTable, SeedIndex, Threads};
use crate::mesh::TriMesh;
pub use measure::AccumulationMs;
use pass::Wants;
use pipelines::{Bindings, Pipelines};

impl From<GpuError> for RvdError {
    fn from(error: GpuError) -> Self {
        match error {
            GpuError::OutOfMemory { needed_bytes, limit_bytes, .. } => Self::OutOfMemory { needed_bytes, limit_bytes },
            GpuError::NeverFits { needed_bytes, limit_bytes, .. } => Self::NeverFits { needed_bytes, limit_bytes },
            GpuError::Lost(why) => Self::DeviceLost(why),
            GpuError::Timeout { .. } => Self::DeviceLost(error.to_string()),
            GpuError::NoAdapter { .. } | GpuError::Unsupported { .. } | GpuError::Failed(_) | GpuError::Shader(_) => {
                Self::Device(error.to_string())
            }
        }
    }
}

/// The GPU backend: a device, its compiled stages, and a pool for what the CPU prepares.
#[derive(Debug)]
pub struct Gpu {
    device: Arc<Device>,
    pool: Arc<rayon::ThreadPool>,
    pipelines: Arc<Pipelines>,
}

impl Gpu {
    /// Compiles the stages and proves them on a tiny diagram whose sums are known. `threads`
    /// is for neighbour rows and first cells on the CPU; `None` is one a core.
    ///
    /// # Errors
    /// `Device` or `DeviceLost` if the device cannot do it; `Internal` if its sums are wrong.
    pub fn new(device: Arc<Device>, threads: Option<usize>) -> Result<Self, RvdError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads.unwrap_or(0))
            .thread_name(|i| format!("tessera-gpu-host-{i}"))
            .build()
            .map_err(|e| RvdError::Internal(format!("no thread pool: {e}")))?;
        let pipelines = Arc::new(Pipelines::new(&device, SLOTS)?);
        let gpu = Self { device, pool: Arc::new(pool), pipelines };
        gpu.warm_up()?;
        Ok(gpu)
    }

    /// One seed amid a ring of 24, so that both polygon variants run, on a square of area 1. Some
    /// drivers compile at the first dispatch, which the first caller should not pay for.
    fn warm_up(&self) -> Result<(), RvdError> {
        let corners = vec![dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(1., 1., 0.), dvec3(0., 1., 0.)];
        let mesh = TriMesh::new(corners, vec![[0, 1, 2], [0, 2, 3]]).map_err(|e| RvdError::Internal(e.to_string()))?;
        let surface = Arc::new(Surface::new(&mesh, None)?);
        let mut seeds = vec![dvec3(0.2, -0.1, 0.0)];
        for k in 0..24 {
            let (sin, cos) = (f64::from(k) / 24.0 * std::f64::consts::TAU).sin_cos();
            seeds.push(seeds[0] + 0.1 * dvec3(cos, sin, 0.0));
        }
        let mut session = self.session(surface, SessionOptions::new(seeds.len()))?;
        session.set_seeds(&seeds)?;
        let (mut sums, cancel) = (CellSums::default(), CancelFlag::default());
        session.sums(&mut sums, &cancel)?;
        let mut batch = PieceBatch::default();
        session.pieces(0..2, &mut batch, &cancel)?;
        // The middle cell is a regular 24-gon of inradius 0.05.
        let polygon = 24.0 * 0.05 * 0.05 * (std::f64::consts::PI / 24.0).tan();
        let area: f64 = (0..batch.len()).map(|i| batch.area(i)).sum();
        if (sums.area[0] - polygon).abs() > 1e-6 * polygon || (area - 1.0).abs() > 1e-5 {
            let (name, found) = (&self.device.adapter().name, sums.area[0]);
            return Err(RvdError::Internal(format!("{name} computes {found} for {polygon}, and {area} for 1")));
        }
        Ok(())
    }
}

/// Polygon slots of the register variant. The same for all capacities: other slots would be
/// another program, which a driver may round differently in the last bit. A smaller capacity is
/// a limit below it, a larger one goes to the large variant.
const SLOTS: usize = 10;

impl Backend for Gpu {
    fn kind(&self) -> BackendKind {
        BackendKind::Gpu
    }

    fn adapter(&self) -> Option<String> {
        Some(self.device.adapter().name.clone())
    }

    fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    fn exact_session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        Parallel::on(Arc::clone(&self.pool)).session(surface, options)
    }

    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        let pool = Arc::clone(&self.pool);
        let mut session = pool.install(|| GpuSession::new(self, surface, options));
        session.resident()?;
        Ok(Box::new(super::on_host::OnHost::new(session)))
    }
}

/// What lies on the device.
struct Resident {
    buffers: Buffers,
    bindings: Bindings,
}

struct GpuSession {
    device: Arc<Device>,
    pool: Arc<rayon::ThreadPool>,
    pipelines: Arc<Pipelines>,
    slots: usize,
    first_polygon: u32,
    surface: Arc<Surface>,
    mass: f64,
    max_seeds: usize,
    capacities: Capacities,

    /// Capacities on the device, which grow, and the sets of cells they are made of.
    counts: Counts,
    slots_log2: Vec<u8>,
    facets: Vec<layout::Facet>,
    /// Where cells look for facets, and the facets that are left to propagation for these seeds.
    grid: reach::Grid,
    demoted: Vec<u32>,
    /// Code in [`layout::accumulate`].
    accumulate: u32,
    /// `None` before the first use and while capacities grow.
    resident: Option<Resident>,

    seeds: Vec<DVec3>,
    index: SeedIndex,
    table: NeighbourTable,
    /// The table and the seeds as on the device, longer rows appended.
    packed: Vec<u32>,
    records: Vec<layout::Seed>,
    scales: fixed::Scales,
    /// Nearest seed of each facet; kept as a guess when the seeds move.
    starts: Starts,
    starts_fresh: bool,
    /// (facet, first cell) of every facet that is not degenerate, by facet.
    roots: Vec<[u32; 2]>,
    /// The tree, the table and the device's copy are not those of `seeds` yet.
    stale: bool,
    walker: FacetWalker,
    pass: pass::PassResult,
}

impl GpuSession {
    fn new(gpu: &Gpu, surface: Arc<Surface>, options: SessionOptions) -> Self {
        let SessionOptions { max_seeds, capacities, tuning, flat_pieces: _ } = options;
        let expected = pack::expected_cells(&surface, max_seeds);
        let slots_log2 = pack::first_slots(&expected, capacities.cells, Capacities::default().cells);
        let mut facets = pack::facets(&surface, &slots_log2);
        let celled = reach::celled(&expected, tuning.strategy);
        reach::mark(&mut facets, &celled);
        let grid = reach::Grid::new(&surface, &celled, max_seeds);
        // Half as many again for pairs that turn out empty and for pairs done again.
        let percent = capacities.pairs_percent as f64 / 100.0;
        let pairs = (1.5 * expected.iter().sum::<f64>() * percent) as u64 + 1024;
        let k = capacities.neighbours.clamp(1, max_seeds.max(1)) as u64;
        let counts = Counts {
            facets: facets.len() as u64,
            seeds: max_seeds as u64,
            table: max_seeds as u64 * k * 5 / 4 + 4096,
            slots: pack::slot_count(&slots_log2),
            pairs,
            emitted: pairs.min(1 << 16),
            polygon: SLOTS as u64,
            near: grid.near.len() as u64,
        };
        Self {
            device: Arc::clone(&gpu.device),
            pool: Arc::clone(&gpu.pool),
            pipelines: Arc::clone(&gpu.pipelines),
            slots: SLOTS,
            first_polygon: capacities.polygon.clamp(4, SLOTS) as u32,
            mass: fixed::total_mass(&surface),
            surface,
            max_seeds,
            capacities,
            counts,
            slots_log2,
            facets,
            grid,
            demoted: Vec::new(),
            accumulate: match tuning.accumulate {
                Accumulate::Direct | Accumulate::Auto => layout::accumulate::DIRECT,
                Accumulate::TwoPhase => layout::accumulate::TWO_PHASE,
            },
            resident: None,
            seeds: Vec::new(),
            index: SeedIndex::new(&[]),
            table: NeighbourTable::default(),
            packed: Vec::new(),
            records: Vec::new(),
            scales: fixed::Scales::default(),
            starts: Starts::default(),
            starts_fresh: false,
            roots: Vec::new(),
            stale: false,
            walker: FacetWalker::default(),
            pass: pass::PassResult::default(),
        }
    }

    /// The buffers; allocated, and filled with all that the host knows, if they are not there.
    fn resident(&mut self) -> Result<&Resident, RvdError> {
        if self.resident.is_none() {
            let plan = Plan::new(self.counts, Limits::of(&self.device.limits()))?;
            let buffers = Buffers::new(&self.device, plan)?;
            let bindings = Bindings::new(&self.device, &self.pipelines, &buffers)?;
            buffers::write(&self.device, &buffers.facets, 0, &self.facets)?;
            buffers::write(&self.device, &buffers.seeds, 0, &self.records)?;
            buffers::write(&self.device, &buffers.table, 0, &self.packed)?;
            buffers::write(&self.device, &buffers.proposals, 0, &self.roots)?;
            buffers::write(&self.device, &buffers.near, 0, &self.grid.near)?;
            self.resident = Some(Resident { buffers, bindings });
        }
        self.resident.as_ref().ok_or_else(|| RvdError::Internal("no buffers".to_owned()))
    }

    /// Frees the buffers; [`Self::resident`] makes larger ones.
    fn release(&mut self) -> Result<(), RvdError> {
        self.resident = None;
        // Memory comes back once the device has seen that nothing uses it.
        Ok(self.device.run(self.device.encoder())?)
    }

    fn params(&self) -> Params {
        Params {
            mass_scale: self.scales.mass as f32,
            moment_scale: self.scales.moment as f32,
            energy_scale: self.scales.energy as f32,
            area_scale: self.scales.area as f32,
            uniform_weights: u32::from(self.surface.is_uniform()),
            list_capacity: self.counts.pairs.min(u64::from(layout::INDEX)) as u32,
            batch: BATCH,
            polygon: self.pass.polygon,
            accumulate: self.accumulate,
            grid: self.grid.side,
            ..Params::default()
        }
    }

    fn diagram(&self) -> Diagram<'_> {
        Diagram { surface: &self.surface, seeds: &self.seeds, index: &self.index, table: &self.table }
    }

    /// The tree, the table and the device's copy of new seeds.
    fn refresh(&mut self, cancel: &CancelFlag, stats: &mut PassStats) -> Result<(), RvdError> {
        if self.seeds.is_empty() {
            return Err(RvdError::NoSeeds);
        }
        if !self.stale {
            return Ok(());
        }
        let begin = Instant::now();
        self.index = SeedIndex::new(&self.seeds);
        if !self.table.fill(&self.index, self.capacities.neighbours, Threads::Pool, &|| cancel.is_cancelled()) {
            return Err(RvdError::Cancelled);
        }
        self.walker.reset();
        self.promote()?;
        stats.neighbours_ms = elapsed_ms(begin);
        let begin = Instant::now();
        pack::seeds(&self.seeds, &self.table, &mut self.records, &mut self.packed);
        self.scales = fixed::Scales::new(self.mass, self.surface.area(), fixed::covering_radius(&self.seeds));
        self.starts_fresh = false;
        self.resident()?;
        if let Some(Resident { buffers, .. }) = &self.resident {
            buffers::write(&self.device, &buffers.seeds, 0, &self.records)?;
            buffers::write(&self.device, &buffers.table, 0, &self.packed)?;
        }
        self.stale = false;
        stats.update_ms = elapsed_ms(begin);
        Ok(())
    }

    /// Statistics of a pass that begins: new seeds' tables, and the first cells.
    fn begin_pass(&mut self, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        let mut stats = PassStats::default();
        self.refresh(cancel, &mut stats)?;
        stats.duplicate_seeds = self.index.duplicates() as u64;
        if !self.starts_fresh {
            let begin = Instant::now();
            let mut starts = std::mem::take(&mut self.starts);
            starts.find(self.diagram(), 0..self.facets.len() as u32);
            self.starts = starts;
            self.roots.clear();
            let live = self.starts.seeds().iter().enumerate().filter(|&(f, _)| !self.surface.skips(f));
            self.roots.extend(live.map(|(f, &start)| [f as u32, start]));
            stats.start_ms = elapsed_ms(begin);
            self.resident()?;
            if let Some(Resident { buffers, .. }) = &self.resident {
                buffers::write(&self.device, &buffers.proposals, 0, &self.roots)?;
            }
            self.starts_fresh = true;
        }
        Ok(stats)
    }

    fn compute_sums(&mut self, out: &mut CellSums, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        let n = self.seeds.len();
        let mut stats = self.begin_pass(cancel)?;
        let begin = Instant::now();
        self.run_pass(0..self.facets.len() as u32, Wants::Sums, cancel, &mut stats)?;
        stats.clip_ms = elapsed_ms(begin);
        let begin = Instant::now();
        let device = Arc::clone(&self.device);
        let buffers = &self.resident()?.buffers;
        let mut words: Vec<u32> = buffers.read(&device, &buffers.sums, 0..n * SUM_WORDS)?;
        for (seed, units) in &self.pass.finished {
            fixed::add(&mut words[*seed as usize * SUM_WORDS..][..SUM_WORDS], units);
        }
        out.reset(n);
        fixed::decode(&words, self.surface.is_uniform(), &self.scales, out);
        stats.update_ms += elapsed_ms(begin);
        if !self.covers(out.area.iter().sum(), 0..self.facets.len() as u32) {
            return self.sums_in_f64(out, stats, cancel);
        }
        Ok(stats)
    }
}

impl Session for GpuSession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        take_seeds(seeds, self.max_seeds, &mut self.seeds)?;
        self.stale = true;
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.compute_sums(out, cancel))
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.compute_pieces(facets, out, cancel))
    }

    fn device_bytes(&self) -> u64 {
        self.resident.as_ref().map_or(0, |r| r.buffers.plan().total_bytes())
    }
}
