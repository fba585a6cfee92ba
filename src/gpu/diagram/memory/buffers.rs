//! A session's buffers, and the stages bound to them.
//!
//! Purpose: what a [`Plan`] says, allocated once, under the names of the shaders' bindings; the bind groups of all pipelines.
//! Invariant: fields have the names that the plan has; binding numbers are those in the stage's `.wgsl`.
//! Must not know: what is in the buffers, what is dispatched when.

use wgpu::{BindGroup, BufferUsages as Usage};

use super::resident::Resident;
use crate::buffers::{Allocation, Staging, write};
use crate::diagram::layout::Params;
use crate::diagram::pipelines::Pipelines;
use crate::diagram::plan::{self, OptimizerPlan, Plan, optimizer_buffers, session_buffers};
use crate::dispatch::{self, Origins};
use crate::{Device, GpuError};

const STORAGE: Usage = Usage::STORAGE.union(Usage::COPY_DST).union(Usage::COPY_SRC);
const ARGUMENTS: Usage = STORAGE.union(Usage::INDIRECT);
const UNIFORM: Usage = Usage::UNIFORM.union(Usage::COPY_DST);
const COPIED: Usage = Usage::COPY_SRC.union(Usage::COPY_DST);

/// Makes the buffers of a table in `plan`, and fields for what is made apart.
macro_rules! buffers {
    (
        $plan:ident { $($(#[$apart_doc:meta])* $apart:ident = $apart_bytes:expr,)* }
        $buffers:ident($c:ident: $counts:ty) { $($(#[$doc:meta])* $name:ident: $usage:ident = $bytes:expr,)* }
        [$($own:ident: $type:ty),*]
    ) => {
        #[derive(Debug)]
        pub(crate) struct $buffers {
            $($(#[$doc])* pub $name: wgpu::Buffer,)*
            $(pub $own: $type,)*
            pub plan: $plan,
            _allocation: Allocation,
        }

        impl $buffers {
            fn make(
                device: &Device,
                plan: $plan,
                mut allocation: Allocation,
                ($($own,)*): ($($type,)*),
            ) -> Result<Self, GpuError> {
                Ok(Self {
                    $($name: allocation.make(device, stringify!($name), plan.$name, $usage)?,)*
                    $($own,)*
                    plan,
                    _allocation: allocation,
                })
            }
        }
    };
}
session_buffers!(buffers windows: Vec<WindowBuffers>, staging: Staging);
optimizer_buffers!(buffers);

#[derive(Debug)]
pub(crate) struct WindowBuffers {
    pub facets: wgpu::Buffer,
    pub candidates: wgpu::Buffer,
}

impl Buffers {
    /// Allocates everything, for windows of these numbers of facets, with `held` buffers for their records. On an error what was
    /// allocated is freed again.
    pub(crate) fn new(
        device: &Device,
        lifted: bool,
        plan: Plan,
        windows: &[u64],
        held: usize,
    ) -> Result<Self, GpuError> {
        let mut allocation = Allocation::new(device, plan.total_bytes());
        // The last one is for the longest of those that take turns with it.
        let longest =
            |buffer: usize| if buffer + 1 == held { windows[buffer..].iter().max() } else { windows.get(buffer) };
        let records = |buffer: usize| plan::window_bytes(lifted, longest(buffer).copied().unwrap_or(0)).0;
        let records: Vec<wgpu::Buffer> = (0..held)
            .map(|buffer| allocation.make(device, "facets", records(buffer), STORAGE))
            .collect::<Result<_, GpuError>>()?;
        let mut window = |(k, &facets): (usize, &u64)| {
            let (_, candidates) = plan::window_bytes(lifted, facets);
            Ok(WindowBuffers {
                facets: records[Resident::buffer_of(held, k)].clone(),
                candidates: allocation.make(device, "candidates", candidates, STORAGE)?,
            })
        };
        let windows = windows.iter().enumerate().map(&mut window).collect::<Result<_, GpuError>>()?;
        let staging = Staging::new(device, &mut allocation, plan.staging)?;
        let made = Self::make(device, plan, allocation, (windows, staging))?;
        write(device, &made.origins, 0, &dispatch::origins(plan.origins / 4))?;
        Ok(made)
    }

    pub(crate) fn origins(&self) -> Origins<'_> {
        Origins { of_parts: &self.origins, to: &self.params, offset: std::mem::offset_of!(Params, part_first) as u64 }
    }
}

impl OptimizerBuffers {
    pub(crate) fn new(device: &Device, plan: OptimizerPlan) -> Result<Self, GpuError> {
        Self::make(device, plan, Allocation::new(device, plan.total_bytes()), ())
    }
}

/// A bind group for each stage, of its pipeline and these buffers, and fields of its own that are made first.
macro_rules! bindings {
    (
        $(#[$doc:meta])*
        $name:ident($device:ident, $pipelines:ident $(, $from:ident: $type:ty)*)
        { $($own:ident: $own_type:ty = $made:expr,)* }
        { $($stage:ident: $pipeline:ident[$($buffer:expr),*],)* }
    ) => {
        $(#[$doc])*
        #[derive(Debug)]
        pub(crate) struct $name {
            $(pub $own: $own_type,)*
            $(pub $stage: BindGroup,)*
        }

        impl $name {
            pub(crate) fn new($device: &Device, $pipelines: &Pipelines, $($from: &$type),*) -> Result<Self, GpuError> {
                Ok(Self {
                    $($own: $made,)*
                    $($stage: bind($device, &$pipelines.$pipeline, &[$(&$buffer),*])?,)*
                })
            }
        }
    };
}

bindings! {
    Bindings(device, pipelines, b: Buffers)
    {
        // Stages that see a window of the facets.
        windows: Vec<WindowBindings> = {
            let window = |w| WindowBindings::new(device, pipelines, b, w);
            b.windows.iter().map(window).collect::<Result<_, _>>()?
        },
    }
    {
        indirect_arguments: indirect_arguments[b.params, b.state, b.arguments],
        count: count[b.params, b.seeds, b.cells, b.state, b.list_origins, b.list_state, b.drifts],
        offsets: offsets[b.params, b.cells, b.state, b.list_state, b.arguments],
        scatter: scatter[b.params, b.seeds, b.cells, b.sorted, b.state],
        duplicates: duplicates[b.params, b.cells, b.sorted, b.state],
        from_lists: from_lists[
            b.params, b.seeds, b.sorted, b.table, b.list_origins, b.lists, b.list_state, b.state, b.drifts
        ],
        search: search[b.params, b.seeds, b.cells, b.sorted, b.table, b.state, b.list_origins, b.list_state],
        search_lists: search_lists[
            b.params, b.seeds, b.cells, b.sorted, b.table, b.state, b.list_origins, b.list_state, b.lists
        ],
        lengthen: lengthen[b.params, b.seeds, b.cells, b.sorted, b.table, b.list, b.failures, b.state],
        overflow: overflow[b.params, b.list, b.failures, b.state, b.arguments],
    }
}

bindings! {
    WindowBindings(device, pipelines, b: Buffers, w: WindowBuffers)
    {
        // By the variants of the pipeline.
        divide: Vec<[BindGroup; 2]> = {
            let divide = [
                &b.params, &b.seeds, &w.facets, &b.table, &w.candidates, &b.slots, &b.list, &b.sums, &b.state
            ];
            let both = |[plain, weighted]: &[wgpu::ComputePipeline; 2]| {
                Ok::<_, GpuError>([bind(device, plain, &divide)?, bind(device, weighted, &divide)?])
            };
            pipelines.divide.iter().map(both).collect::<Result<_, _>>()?
        },
    }
    {
        enqueue: enqueue[b.params, w.facets, w.candidates, b.slots, b.list, b.failures, b.state],
        clip: clip[b.params, b.seeds, w.facets, b.table, b.slots, b.list, b.sums, b.failures, b.state],
        clip_shared: clip_shared[b.params, b.seeds, w.facets, b.table, b.slots, b.list, b.sums, b.failures, b.state],
        clip_large: clip_large[b.params, b.seeds, w.facets, b.table, b.slots, b.list, b.sums, b.failures, b.state],
        emit: emit[b.params, b.seeds, w.facets, b.table, b.list, b.heads, b.vertices, b.labels],
        reach: reach[b.params, b.seeds, w.facets, b.table, b.near, b.slots, b.list, b.failures, b.state],
        verify: verify[b.params, w.facets, b.slots, b.list, b.failures, b.state],
        first_cells: first_cells[
            b.params, b.seeds, w.facets, b.table, b.cells, b.sorted, w.candidates, b.state
        ],
    }
}

bindings! {
    /// The stages that move seeds, bound. Made anew whenever one of the two sets of buffers is.
    OptimizerBindings(device, pipelines, b: Buffers, m: OptimizerBuffers)
    {}
    {
        trial: trial[m.params, m.points, m.direction, b.seeds],
        centroids: centroids[m.params, b.sums, m.held, m.points, b.state],
        totals: totals[m.params, m.partial_totals, m.totals],
        may_step: may_step[m.params, m.totals, b.state],
        accept: accept[m.params, b.seeds, m.points, m.ahead, m.gradient, m.steps, m.changes],
        partial_dots: partial_dots[m.params, b.sums, m.steps, m.changes, m.gradient, m.partials],
        dots: dots[m.params, m.partials, m.dots],
        direction: direction[m.params, m.steps, m.changes, m.gradient, m.direction, m.partials, b.sums],
        gradient: gradient[m.params, b.sums, m.held, m.direction, m.gradient, m.partial_totals],
        gradient_ahead: gradient[m.params, b.sums, m.held, m.direction, m.ahead, m.partial_totals],
    }
}

fn bind(device: &Device, pipeline: &wgpu::ComputePipeline, buffers: &[&wgpu::Buffer]) -> Result<BindGroup, GpuError> {
    let entries: Vec<wgpu::BindGroupEntry<'_>> = buffers
        .iter()
        .enumerate()
        .map(|(k, buffer)| wgpu::BindGroupEntry { binding: k as u32, resource: buffer.as_entire_binding() })
        .collect();
    device.scoped(|| {
        device.raw().create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        })
    })
}
