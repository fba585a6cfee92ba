//! f32 on a wgpu device, exact as the others.
//!
//! Purpose: the GPU backend. Most facets are done as a whole by `divide`, which makes no polygon. The
//! others, and all of them where the pieces themselves are wanted, go to a list of (facet, cell) pairs
//! (\[HYWZ17\], Algorithms 1 and 2): the nearest seed of each facet begins it, each clipped piece appends
//! the cells across its bisectors, a hash set per facet keeps them apart. The sums are added in
//! fixed point. The neighbours and the nearest seeds are found there too (`search`), and seeds can
//! be moved where they are (`moving`). Indirect dispatches follow the list; the host reads one small
//! block between submissions and does again, with more of what they lacked, the pairs that did not end.
//! Invariant: every pair ends `Done` here or in f64; a full set or list means growing and
//! repeating the pass from zero. Integer sums have no order, so every run has the same bits. Which facets
//! `divide` does, and its variant, depend on the surface and the seeds alone, never on capacities.
//!
//! Measured on a software adapter, where a branch that no lane takes is walked through all the same, a loop
//! that is left at its head runs its body once more for nobody, and each word that lanes load from
//! places of their own costs about 20 cycles for eight of them: the pairs' clip took 30 ms for 69,000
//! facets of 2.3 cells, each facet at once 20 with room for 8 cells, 17 for 6 and 10 for 4 (the last with 64-bit
//! atomics, a fifth of it). The same text as loops that were to be jumped over took 29.
//! Must not know: iterations, jobs, files.

mod buffers;
mod fallback;
mod fixed;
#[cfg(feature = "service")]
pub(crate) mod forecast;
mod grid;
mod history;
pub mod layout;
mod measure;
mod moving;
mod pack;
mod pass;
mod pieces;
mod pipelines;
pub mod plan;
mod reach;
mod relaunch;
mod relax;
mod search;
pub mod shaders;
mod windows;

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use glam::{DVec3, dvec3};

use super::incident::{Diagram, FacetWalker};
use super::parallel::Parallel;
use super::{
    Accumulate, Backend, BackendKind, Capacities, CellSums, DeviceFacts, DeviceWork, PassStats, PhasesMs, PieceBatch,
    Resident, RvdError, Session, SessionOptions, Surface, Together, elapsed_ms, take_seeds,
};
use crate::gpu::limits::Limits;
use crate::gpu::{Device, GpuError, Traffic, dispatch};
use crate::mesh::TriMesh;
use crate::token::Token;
use buffers::Buffers;
use layout::{LONGER, MOST_REQUEUED, NONE, Params, ROW, STRIDE, SUM_WORDS, State};
#[cfg(feature = "cli")]
pub(crate) use measure::AccumulationMs;
use moving::Moving;
use pipelines::{Bindings, Pipelines};
use plan::{BATCH, Counts};
pub use search::Found;
use search::{HostCopy, Place, Rows};
use windows::Layout;

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

    /// From now on the device's own clock times the stages ([`Session::device_phases`]). Returns whether it can.
    ///
    /// # Errors
    /// `Device`, `DeviceLost`.
    pub fn keep_time(&self) -> Result<bool, RvdError> {
        Ok(self.device.keep_time()?)
    }

    /// What the longest of the device's compute passes took since [`Self::keep_time`], by phase; each is one dispatch or
    /// more.
    pub fn longest_passes(&self) -> Option<PhasesMs> {
        self.device.longest_ms().map(phases)
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
        let (mut sums, token) = (CellSums::default(), Token::default());
        session.sums(&mut sums, &token)?;
        let mut batch = PieceBatch::default();
        session.pieces(0..2, &mut batch, &token)?;
        if let Some(seeds) = session.resident() {
            seeds.evaluate(&token)?;
            seeds.direct()?;
            seeds.probe(1e-3, &token)?;
            seeds.accept()?;
            seeds.to_centroids()?;
            // The first one of them alone, then two at once.
            let mut looks = Vec::new();
            while looks.len() < 3 {
                seeds.relax(3, &mut looks, &token)?;
            }
        }
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

/// What a device's time is added up by, in the order of [`PhasesMs`].
mod lane {
    pub(super) const NEIGHBOURS: usize = 0;
    pub(super) const START: usize = 1;
    pub(super) const CLIP: usize = 2;
    pub(super) const UPDATE: usize = 3;
}

fn phases([neighbours, start, clip, update]: [f64; 4]) -> PhasesMs {
    PhasesMs { neighbours, start, clip, update }
}

impl Backend for Gpu {
    fn kind(&self) -> BackendKind {
        BackendKind::Gpu
    }

    fn adapter(&self) -> Option<String> {
        Some(self.device.adapter().name.clone())
    }

    fn device_facts(&self) -> Option<DeviceFacts> {
        let adapter = self.device.adapter();
        Some(DeviceFacts {
            adapter: adapter.name.clone(),
            api: adapter.backend.clone(),
            driver: adapter.driver.clone(),
            is_software: adapter.software,
            max_buffer_bytes: adapter.max_buffer_bytes,
            max_binding_bytes: adapter.max_binding_bytes,
            max_workgroups: adapter.max_workgroups,
            allocated_bytes: self.device.allocated_bytes(),
        })
    }

    fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    fn pool(&self) -> Option<Arc<rayon::ThreadPool>> {
        Some(Arc::clone(&self.pool))
    }

    fn exact_session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        Parallel::on(Arc::clone(&self.pool)).session(surface, options)
    }

    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        let pool = Arc::clone(&self.pool);
        let mut session = pool.install(|| GpuSession::new(self, surface, options));
        session.on_device()?;
        Ok(Box::new(session))
    }
}

/// What lies on the device.
struct OnDevice {
    buffers: Buffers,
    bindings: Bindings,
}

impl OnDevice {
    /// Encodes `stages` in their order; see [`dispatch::encode`].
    fn encode(
        &self,
        device: &Device,
        encoder: &mut wgpu::CommandEncoder,
        lane: usize,
        stages: &[dispatch::Stage<'_>],
        token: &Token,
    ) -> Result<(), RvdError> {
        dispatch::encode(device, encoder, lane, stages, self.buffers.origins(), token)
    }
}

struct GpuSession {
    device: Arc<Device>,
    pool: Arc<rayon::ThreadPool>,
    pipelines: Arc<Pipelines>,
    slots: usize,
    first_polygon: u32,
    /// Mean area and perimeter of a facet.
    lengths: (f64, f64),
    surface: Arc<Surface>,
    mass: f64,
    max_seeds: usize,
    /// Cells along a side of the grid in which seeds are searched: of these, and at most.
    side: u32,
    finest: u32,
    capacities: Capacities,

    /// Capacities on the device, which grow, and the sets of cells they are made of.
    counts: Counts,
    layout: Layout,
    slots_log2: Vec<u8>,
    facets: Vec<layout::Facet>,
    /// Where cells look for facets, and the facets that are left to propagation for these seeds.
    grid: reach::Grid,
    demoted: Vec<u32>,
    /// Whether facets are done as a whole where that is possible.
    divides: bool,
    /// How many steps a submission may have.
    together: Together,
    /// Code in [`layout::accumulate`].
    accumulate: u32,
    /// `None` before the first use and while capacities grow.
    on_device: Option<OnDevice>,

    /// The seeds as they were set, and how many there are.
    seeds: Vec<DVec3>,
    count: usize,
    /// Which seeds the next pass is of.
    place: Place,
    /// Who made the rows that the device has for them.
    rows: Rows,
    /// The device has their facets' first cells.
    started: bool,
    /// The first cells that the device has are those of other seeds at least.
    guessed: bool,
    /// So many seeds were noted for lists when rows were last made.
    listed_for: usize,
    /// Later duplicates among them, and whether some of those are none in f64.
    duplicates: u64,
    merged: bool,
    scales: fixed::Scales,
    /// (facet, first cell) of every facet that is not degenerate, by facet; cells as far as the host knows them.
    roots: Vec<[u32; 2]>,
    /// What the host knows of the seeds on the device.
    host: HostCopy,
    /// Times that the host searched.
    host_searches: u64,
    /// What the device had done before the session was opened.
    opened: Traffic,
    /// What moves seeds, once somebody does.
    moving: Option<Moving>,
    walker: FacetWalker,
    pass: pass::PassResult,
    /// What pairs have lacked so far.
    lacked: pass::Lacked,
    /// Clip dispatches of a pass's first submission: some more than the last pass needed.
    steps: u32,
    /// Facets that were divided at once, and that went pair by pair.
    divided: u64,
    paired: u64,
}

impl GpuSession {
    fn new(gpu: &Gpu, surface: Arc<Surface>, options: SessionOptions) -> Self {
        let SessionOptions { max_seeds, capacities, tuning, flat_pieces: _ } = options;
        let expected = pack::expected_cells(&surface, max_seeds);
        let slots_log2 = pack::first_slots(&expected, capacities.cells, Capacities::default().cells);
        let mut facets = pack::facets(&surface, &slots_log2);
        let by_cell = reach::by_cell(&expected, tuning.strategy);
        reach::mark(&mut facets, &by_cell);
        let grid = reach::Grid::new(&surface, &by_cell, max_seeds);
        let k = capacities.neighbours.clamp(1, max_seeds.max(1)) as u64;
        // Rows by the device or by the host, and a quarter for longer ones where there is room for it; of these as many
        // as the device makes in a pass.
        let rows = max_seeds as u64 * k.max(u64::from(STRIDE));
        let most = Limits::of(&gpu.device.limits()).seen_bytes() / 4;
        let side = grid::grid_side_for(&surface, max_seeds);
        let counts = Counts {
            facets: facets.len() as u64,
            seeds: max_seeds as u64,
            table: (rows + max_seeds as u64 * k / 4 + u64::from(MOST_REQUEUED * LONGER)).min(most.max(rows)),
            polygon: SLOTS as u64,
            near: grid.near.len() as u64,
            cells: plan::grid_cells(side),
            listed: plan::listed(max_seeds as u64, Limits::of(&gpu.device.limits())),
            ..Counts::default()
        };
        // Half as many again for pairs that turn out empty and for pairs done again.
        let layout = Layout::new(&expected, 1.5 * capacities.pairs_percent as f64 / 100.0);
        let live = (0..facets.len()).filter(|&f| !surface.skips(f));
        let roots = live.map(|f| [f as u32, NONE]).collect();
        Self {
            device: Arc::clone(&gpu.device),
            pool: Arc::clone(&gpu.pool),
            pipelines: Arc::clone(&gpu.pipelines),
            slots: SLOTS,
            first_polygon: capacities.polygon.clamp(4, SLOTS) as u32,
            lengths: pack::mean_facet(&surface),
            mass: fixed::total_mass(&surface),
            surface,
            max_seeds,
            side,
            finest: side,
            capacities,
            counts,
            layout,
            slots_log2,
            facets,
            grid,
            demoted: Vec::new(),
            divides: true,
            together: tuning.together,
            accumulate: match tuning.accumulate {
                Accumulate::Direct | Accumulate::Auto => layout::accumulate::DIRECT,
                Accumulate::TwoPhase => layout::accumulate::TWO_PHASE,
            },
            on_device: None,
            seeds: Vec::new(),
            count: 0,
            place: Place::Set,
            rows: Rows::Missing,
            started: false,
            guessed: false,
            listed_for: 0,
            duplicates: 0,
            merged: false,
            scales: fixed::Scales::default(),
            roots,
            host: HostCopy::default(),
            host_searches: 0,
            opened: gpu.device.traffic(),
            moving: None,
            walker: FacetWalker::default(),
            pass: pass::PassResult::default(),
            lacked: pass::Lacked::default(),
            steps: pass::STEPS.0,
            divided: 0,
            paired: 0,
        }
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
            seeds: self.count as u32,
            row: self.capacities.neighbours.clamp(1, ROW as usize) as u32,
            side: self.side,
            roots: self.roots_of(&self.layout.facets()).len() as u32,
            divided: NONE,
            facet_first: self.layout.facets().start,
            has_lists: u32::from(self.counts.listed > 0),
            ..Params::default()
        }
    }

    /// For the pairs that the host does; [`Self::view`] comes before.
    fn diagram(&self) -> Diagram<'_> {
        let HostCopy { seen, index, table, .. } = &self.host;
        Diagram { surface: &self.surface, seeds: seen, index, table }
    }

    /// Statistics of a pass that begins: rows and first cells, in submissions of their own, so that
    /// they can be timed.
    fn begin_pass(&mut self, token: &Token) -> Result<PassStats, RvdError> {
        let mut stats = PassStats::default();
        if self.count == 0 {
            return Err(RvdError::NoSeeds);
        }
        if let Place::Trial(_) = self.place {
            self.place = Place::Point;
            self.moved();
        }
        if let Some(moving) = &mut self.moving {
            moving.sums_lost();
        }
        token.check()?;
        let begin = Instant::now();
        self.search_now(token)?;
        stats.neighbours_ms = elapsed_ms(begin);
        let begin = Instant::now();
        self.start_now(token)?;
        stats.start_ms = elapsed_ms(begin);
        stats.duplicate_seeds = self.duplicates;
        Ok(stats)
    }

    /// What was done since the session was opened.
    fn work(&self) -> DeviceWork {
        let now = self.device.traffic();
        DeviceWork {
            host_searches: self.host_searches,
            divided_facets: self.divided,
            paired_facets: self.paired,
            device_submissions: now.submissions - self.opened.submissions,
            device_allocations: now.allocations - self.opened.allocations,
            uploaded_bytes: now.uploaded_bytes - self.opened.uploaded_bytes,
            read_back_bytes: now.read_bytes - self.opened.read_bytes,
        }
    }

    /// Counts how the facets of a pass went that entered `roots` of them. Returns that alone.
    fn count_facets(&mut self, state: &State, roots: u32) -> DeviceWork {
        let paired_facets = if self.pass.divided { state.paired.min(roots) } else { roots }.into();
        let divided_facets = u64::from(roots) - paired_facets;
        self.divided += divided_facets;
        self.paired += paired_facets;
        DeviceWork { divided_facets, paired_facets, ..DeviceWork::default() }
    }

    /// Adds what was done since `before`.
    fn meter(&self, before: &DeviceWork, stats: &mut PassStats) {
        let done = self.work().since(before);
        stats.set_device_work(stats.device_work().with(&done, |a, b| a + b));
    }

    fn compute_sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        let before = self.work();
        let mut stats = self.begin_pass(token)?;
        let begin = Instant::now();
        self.run_sums(token, &mut stats)?;
        stats.clip_ms = elapsed_ms(begin);
        let begin = Instant::now();
        self.download_sums(out)?;
        stats.update_ms += elapsed_ms(begin);
        if self.merged || !self.covers(out.area.iter().sum(), 0..self.facets.len() as u32) {
            stats = self.sums_in_f64(out, stats, token)?;
        }
        self.meter(&before, &mut stats);
        Ok(stats)
    }

    /// The sums of the last pass, with what the host finished.
    fn download_sums(&mut self, out: &mut CellSums) -> Result<(), RvdError> {
        let words = self.sum_words()?;
        out.reset(self.count);
        fixed::decode(&words, self.surface.is_uniform(), &self.scales, out);
        Ok(())
    }

    /// The same in units.
    fn sum_words(&mut self) -> Result<Vec<u32>, RvdError> {
        let (device, n) = (Arc::clone(&self.device), self.count);
        let buffers = &self.on_device()?.buffers;
        let mut words: Vec<u32> = buffers.staging.read(&device, &buffers.sums, 0..n * SUM_WORDS)?;
        for (seed, units) in &self.pass.finished {
            fixed::add(&mut words[*seed as usize * SUM_WORDS..][..SUM_WORDS], units);
        }
        Ok(words)
    }
}

impl Session for GpuSession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        take_seeds(seeds, self.max_seeds, &mut self.seeds)?;
        if self.count != self.seeds.len() {
            self.guessed = false;
            self.count = self.seeds.len();
            // There are buffers for the grid of the most seeds.
            self.side = match self.count == self.max_seeds {
                true => self.finest,
                false => grid::grid_side_for(&self.surface, self.count).min(self.finest),
            };
        }
        self.place = Place::Set;
        self.moved();
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.compute_sums(out, token))
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.compute_pieces(facets, out, token))
    }

    fn device_bytes(&self) -> u64 {
        let moving = self.moving.as_ref().map_or(0, Moving::device_bytes);
        self.on_device.as_ref().map_or(0, |r| r.buffers.plan().total_bytes()) + moving
    }

    fn device_work(&self) -> DeviceWork {
        self.work()
    }

    fn device_phases(&self) -> Option<PhasesMs> {
        self.device.stage_ms().map(phases)
    }

    fn resident(&mut self) -> Option<&mut dyn Resident> {
        (self.count > 0).then_some(self)
    }
}
