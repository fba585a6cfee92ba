//! Single precision on a wgpu device, as exact as the other backends.
//!
//! Purpose: the GPU backend. The stage `divide` does most facets as a whole, without a polygon. The other facets, and all of
//! them where the pieces themselves are wanted, go to a list of (facet, cell) pairs (\[HYWZ17\], Algorithms 1 and 2): the
//! nearest seed of each facet begins it, each clipped piece appends the cells across its bisectors, and a hash set per facet
//! keeps pairs apart. Sums are added in fixed point. Neighbours and nearest seeds are found on the device too (`neighbours`),
//! and seeds can be moved there (`optimizer`). Indirect dispatches follow the list. The host reads one small block between
//! submissions, and launches the pairs that did not end again, with more of what they lacked. Invariant: every pair ends `Done`
//! here or in f64. A full set or list grows, and the pass begins from zero. Integer sums have no order, so every run has the
//! same bits. Which facets `divide` does, and its variant, depend on the surface and the seeds alone, never on capacities.
//!
//! What costs time on a software adapter: it executes a branch that no lane takes. A loop that is left at its head executes its
//! body once more. A word that each of eight lanes loads from a place of its own costs about 20 cycles. Measured with 69,000
//! facets of 2.3 cells each: clipping all pairs took 30 ms. Dividing the facets took 20 ms with room for 8 cells, 17 for 6 and
//! 10 for 4, the last with 64-bit atomics (a fifth of it). Must not know: iterations, jobs, files.

mod clip;
pub(crate) mod forecast;
pub mod layout;
mod memory;
mod neighbours;
mod optimizer;
mod pipelines;
pub mod plan;
mod session;
pub mod shaders;
mod shared;
mod space;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use glam::{DVec3, dvec3};

use crate::dispatch::Limits;
use crate::{Device, GpuError};
use geometry::mesh::TriMesh;
use geometry::rvd::parallel::Parallel;
use geometry::rvd::{
    Backend, BackendKind, Capacities, CellSums, DeviceFacts, Lifted, PhasesMs, PieceBatch, RvdError, Session,
    SessionOptions, Surface, elapsed_ms,
};
use geometry::token::Token;
use layout::accumulate::{DIRECT, NOWHERE, TWO_PHASE};
pub use neighbours::Found;
use pipelines::Pipelines;
use session::GpuSession;
pub use shared::SharedGpu;
use space::DeviceSpace;

type Result<T, E = RvdError> = std::result::Result<T, E>;

impl From<GpuError> for RvdError {
    fn from(error: GpuError) -> Self {
        match error {
            GpuError::OutOfMemory { needed_bytes, limit_bytes, .. } => Self::OutOfMemory { needed_bytes, limit_bytes },
            GpuError::NeverFits { needed_bytes, limit_bytes, .. } => Self::NeverFits { needed_bytes, limit_bytes },
            GpuError::Lost(why) => Self::DeviceLost(why),
            GpuError::Timeout { .. } => Self::DeviceLost(error.to_string()),
            GpuError::NoAdapter { .. } | GpuError::Failed(_) | GpuError::Shader(_) => Self::Device(error.to_string()),
        }
    }
}

/// The GPU backend: a device, its compiled stages, and a pool for what the CPU prepares.
#[derive(Debug)]
pub struct Gpu {
    device: Arc<Device>,
    pool: Arc<rayon::ThreadPool>,
    pipelines: Arc<Pipelines>,
    /// Those of lifted surfaces, once there was one.
    lifted: Mutex<Option<Arc<Pipelines>>>,
}

impl Gpu {
    /// Compiles the stages and proves them on a tiny diagram whose sums are known. `threads`
    /// is for neighbour rows and first cells on the CPU; `None` is one a core.
    ///
    /// # Errors
    /// `Device` or `DeviceLost` if the device cannot do it; `Internal` if its sums are wrong.
    pub fn new(device: Arc<Device>, threads: Option<usize>) -> Result<Self> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads.unwrap_or(0))
            .thread_name(|i| format!("tessera-gpu-host-{i}"))
            .build()
            .map_err(|e| RvdError::Internal(format!("no thread pool: {e}")))?;
        let begin = Instant::now();
        let pipelines = Arc::new(pool.install(|| Pipelines::compile(&device))?);
        let compile_ms = elapsed_ms(begin);
        let begin = Instant::now();
        let gpu = Self { device, pool: Arc::new(pool), pipelines, lifted: Mutex::default() };
        gpu.warm_up()?;
        let warm_up_ms = elapsed_ms(begin);
        tracing::debug!(compile_ms, warm_up_ms, "stages compiled");
        Ok(gpu)
    }

    /// The stages of lifted surfaces. Most runs need none, so they are compiled for the first session.
    fn lifted_pipelines(&self) -> Result<Arc<Pipelines>> {
        let kept = || self.lifted.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pipelines) = &*kept() {
            return Ok(Arc::clone(pipelines));
        }
        // Not under the lock: a thread of the pool that waits may take up another session's opening.
        let made = Arc::new(self.pool.install(|| self.pipelines.lifted(&self.device))?);
        Ok(Arc::clone(kept().get_or_insert(made)))
    }

    /// The device, for shaders of a caller's own.
    pub fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// From now on the device's own clock times the stages ([`Session::device_phases`]). Returns whether it can.
    pub fn keep_time(&self) -> Result<bool> {
        Ok(self.device.keep_time()?)
    }

    /// What the longest compute pass of each phase took since [`Self::keep_time`]; each is one dispatch or more.
    pub fn longest_passes(&self) -> Option<PhasesMs> {
        self.device.longest_ms().map(phases)
    }

    /// One seed amid a ring of 24, so that both polygon variants run, on a square of area 1. Some
    /// drivers compile at the first dispatch, which the first caller should not pay for.
    fn warm_up(&self) -> Result<()> {
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
            seeds.search_direction()?;
            seeds.probe(1e-3, &token)?;
            seeds.accept()?;
            seeds.to_centroids()?;
            // The first one of them alone, then two at once.
            let mut evaluations = Vec::new();
            while evaluations.len() < 3 {
                seeds.relax(3, &mut evaluations, &token)?;
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

    fn exact_session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>> {
        Parallel::on(Arc::clone(&self.pool)).session(surface, options)
    }

    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>> {
        let mut session = self.pool.install(|| GpuSession::new(self, surface, options))?;
        session.ensure_memory()?;
        Ok(Box::new(session))
    }

    fn exact_lifted_session(
        &self,
        surface: Arc<Surface<Lifted>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Lifted>>> {
        Parallel::on(Arc::clone(&self.pool)).lifted_session(surface, options)
    }

    fn lifted_session(
        &self,
        surface: Arc<Surface<Lifted>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Lifted>>> {
        let session = self.pool.install(|| GpuSession::new(self, surface, options))?;
        Ok(Box::new(session))
    }
}

struct Context<P: DeviceSpace> {
    device: Arc<Device>,
    pool: Arc<rayon::ThreadPool>,
    pipelines: Arc<Pipelines>,
    surface: Arc<Surface<P>>,
    mass: f64,
    /// The longest lift of the surface.
    longest_lift: f64,
    max_seeds: usize,
    /// First capacities.
    capacities: Capacities,
}

impl<P: DeviceSpace> Context<P> {
    pub(super) fn limits(&self) -> Limits {
        Limits::of(&self.device.limits())
    }
}

/// Milliseconds of each clip pass, by how its pieces were added.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AccumulationMs {
    /// Atomics to global memory.
    pub direct: Vec<f64>,
    /// Partial sums within workgroups first.
    pub two_phase: Vec<f64>,
    /// Clipped and integrated, but not added.
    pub without: Vec<f64>,
}

impl Gpu {
    /// Times `passes` passes of each kind over the same seeds (unit frame), in turn, so that what
    /// else the machine does falls on all alike. One more of each goes before.
    pub fn measure_accumulation(
        &self,
        surface: Arc<Surface>,
        seeds: &[DVec3],
        options: SessionOptions,
        passes: usize,
        token: &Token,
    ) -> Result<AccumulationMs> {
        self.pool.install(|| {
            let mut session = GpuSession::new(self, surface, options)?;
            session.set_seeds(seeds)?;
            // Facets that are done as a whole are added directly only.
            session.clip.divides = false;
            let mut stats = session.begin_pass(token)?;
            let mut out = AccumulationMs::default();
            for pass in 0..=passes {
                let kinds = [(DIRECT, &mut out.direct), (TWO_PHASE, &mut out.two_phase), (NOWHERE, &mut out.without)];
                for (code, times) in kinds {
                    session.clip.accumulate = code;
                    let begin = Instant::now();
                    session.run_sums(token, &mut stats)?;
                    if pass > 0 {
                        times.push(elapsed_ms(begin));
                    }
                }
            }
            Ok(out)
        })
    }
}
