//! A session's buffers.
//!
//! Purpose: what a [`Plan`] says, allocated once, under the names of the shaders' bindings.
//! Invariant: fields have the names that the plan has. Must not know: what is in them.

use wgpu::BufferUsages as Usage;

use crate::buffers::{Allocation, Staging, write};
use crate::diagram::layout::Params;
use crate::diagram::plan::{self, OptimizerPlan, Plan};
use crate::dispatch::{self, Origins};
use crate::{Device, GpuError};

/// All buffers of a session. Field names are those of [`Plan`] and of the shaders' bindings.
#[derive(Debug)]
pub(crate) struct Buffers {
    /// Seed records.
    pub seeds: wgpu::Buffer,
    /// Neighbour table.
    pub table: wgpu::Buffer,
    /// Sets of cells.
    pub slots: wgpu::Buffer,
    /// List of pairs.
    pub list: wgpu::Buffer,
    /// Fixed-point sums.
    pub sums: wgpu::Buffer,
    /// List of failures.
    pub failures: wgpu::Buffer,
    /// Summary block.
    pub state: wgpu::Buffer,
    /// Indirect arguments.
    pub arguments: wgpu::Buffer,
    /// Parameters.
    pub params: wgpu::Buffer,
    /// Heads of emitted pieces.
    pub heads: wgpu::Buffer,
    /// Their vertices.
    pub vertices: wgpu::Buffer,
    /// Their labels.
    pub labels: wgpu::Buffer,
    /// Grid of facets.
    pub near: wgpu::Buffer,
    /// Grid of seeds.
    pub cells: wgpu::Buffer,
    /// How far the seeds of each of its cells have moved.
    pub drifts: wgpu::Buffer,
    /// Seeds in its order.
    pub sorted: wgpu::Buffer,
    /// Where the parts of a dispatch begin.
    pub origins: wgpu::Buffer,
    /// Where seeds were when lists were made, and how far these reach.
    pub list_origins: wgpu::Buffer,
    /// Lists.
    pub lists: wgpu::Buffer,
    /// What is done with them.
    pub list_state: wgpu::Buffer,
    /// What there is of each window of facets.
    pub windows: Vec<WindowBuffers>,
    /// Readback.
    pub staging: Staging,
    plan: Plan,
    _allocation: Allocation,
}

/// Buffers of the facets of a window.
#[derive(Debug)]
pub(crate) struct WindowBuffers {
    /// Facet records.
    pub facets: wgpu::Buffer,
    /// Candidates.
    pub candidates: wgpu::Buffer,
}

impl Buffers {
    /// Allocates everything, for windows of so many facets each.
    ///
    /// # Errors
    /// `OutOfMemory` with the bytes of the whole plan; what was allocated is freed again.
    pub(crate) fn new(device: &Device, plan: Plan, windows: &[u64]) -> Result<Self, GpuError> {
        let storage = Usage::STORAGE | Usage::COPY_DST | Usage::COPY_SRC;
        let mut allocation = Allocation::new(device, plan.total_bytes());
        let mut make = |label: &str, bytes: u64, usage: Usage| allocation.make(device, label, bytes, usage);
        let mut windows_of = Vec::with_capacity(windows.len());
        for &facets in windows {
            let (records, candidates) = plan::window_bytes(facets);
            windows_of.push(WindowBuffers {
                facets: make("facets", records, storage)?,
                candidates: make("candidates", candidates, storage)?,
            });
        }
        let made = Self {
            windows: windows_of,
            seeds: make("seeds", plan.seeds_bytes, storage)?,
            table: make("table", plan.table_bytes, storage)?,
            slots: make("slots", plan.slots_bytes, storage)?,
            list: make("list", plan.list_bytes, storage)?,
            sums: make("sums", plan.sums_bytes, storage)?,
            failures: make("failures", plan.failures_bytes, storage)?,
            state: make("state", plan.state_bytes, storage)?,
            arguments: make("arguments", plan.arguments_bytes, storage | Usage::INDIRECT)?,
            params: make("params", plan.params_bytes, Usage::UNIFORM | Usage::COPY_DST)?,
            heads: make("heads", plan.heads_bytes, storage)?,
            vertices: make("vertices", plan.vertices_bytes, storage)?,
            labels: make("labels", plan.labels_bytes, storage)?,
            near: make("near", plan.near_bytes, storage)?,
            cells: make("cells", plan.cells_bytes, storage)?,
            drifts: make("drifts", plan.drifts_bytes, storage)?,
            sorted: make("sorted", plan.sorted_bytes, storage)?,
            origins: make("origins", plan.origins_bytes, Usage::COPY_SRC | Usage::COPY_DST)?,
            list_origins: make("list origins", plan.list_origins_bytes, storage)?,
            lists: make("lists", plan.lists_bytes, storage)?,
            list_state: make("list state", plan.list_state_bytes, storage | Usage::INDIRECT)?,
            staging: Staging::new(device, &mut allocation, plan.staging_bytes)?,
            plan,
            _allocation: allocation,
        };
        write(device, &made.origins, 0, &dispatch::origins(plan.origins_bytes / 4))?;
        Ok(made)
    }

    /// What they were made for.
    pub(crate) fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Where the parts of a dispatch begin, and where the stages read it.
    pub(crate) fn origins(&self) -> Origins<'_> {
        Origins { of_parts: &self.origins, to: &self.params, offset: std::mem::offset_of!(Params, part_first) as u64 }
    }
}

/// The buffers with which seeds are moved. Fields as in [`OptimizerPlan`] and in the shaders.
#[derive(Debug)]
pub(crate) struct OptimizerBuffers {
    /// The present point.
    pub points: wgpu::Buffer,
    /// Which seeds are held.
    pub held: wgpu::Buffer,
    /// The gradient there.
    pub gradient: wgpu::Buffer,
    /// The gradient at the trial point.
    pub ahead: wgpu::Buffer,
    /// The direction.
    pub direction: wgpu::Buffer,
    /// Steps of the history.
    pub steps: wgpu::Buffer,
    /// Changes of the gradient.
    pub changes: wgpu::Buffer,
    /// Partial sums over cells.
    pub partial_totals: wgpu::Buffer,
    /// Their sum.
    pub totals: wgpu::Buffer,
    /// Partial dot products.
    pub partials: wgpu::Buffer,
    /// Dot products.
    pub dots: wgpu::Buffer,
    /// Parameters.
    pub params: wgpu::Buffer,
    /// State and totals of each pass of a submission.
    pub journal: wgpu::Buffer,
    plan: OptimizerPlan,
    _allocation: Allocation,
}

impl OptimizerBuffers {
    /// Allocates everything, zeroed.
    ///
    /// # Errors
    /// `OutOfMemory` with the bytes of the whole plan.
    pub(crate) fn new(device: &Device, plan: OptimizerPlan) -> Result<Self, GpuError> {
        let storage = Usage::STORAGE | Usage::COPY_DST | Usage::COPY_SRC;
        let mut allocation = Allocation::new(device, plan.total_bytes());
        let mut make = |label: &str, bytes: u64, usage: Usage| allocation.make(device, label, bytes, usage);
        Ok(Self {
            points: make("points", plan.points_bytes, storage)?,
            held: make("held", plan.held_bytes, storage)?,
            gradient: make("gradient", plan.vector_bytes, storage)?,
            ahead: make("ahead", plan.vector_bytes, storage)?,
            direction: make("direction", plan.vector_bytes, storage)?,
            steps: make("steps", plan.history_bytes, storage)?,
            changes: make("changes", plan.history_bytes, storage)?,
            partial_totals: make("partial_totals", plan.partial_totals_bytes, storage)?,
            totals: make("totals", plan.totals_bytes, storage)?,
            partials: make("partials", plan.partials_bytes, storage)?,
            dots: make("dots", plan.dots_bytes, storage)?,
            params: make("optimizer params", plan.params_bytes, Usage::UNIFORM | Usage::COPY_DST)?,
            journal: make("journal", plan.journal_bytes, Usage::COPY_SRC | Usage::COPY_DST)?,
            plan,
            _allocation: allocation,
        })
    }

    /// What they were made for.
    pub(crate) fn plan(&self) -> &OptimizerPlan {
        &self.plan
    }
}
