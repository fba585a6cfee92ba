//! A session's buffers bound to the stages.
//!
//! Purpose: the bind groups of all pipelines.
//! Invariant: binding numbers are those in the stage's `.wgsl`. Must not know: what is dispatched when.

use super::buffers::{Buffers, OptimizerBuffers, WindowBuffers};
use crate::diagram::pipelines::Pipelines;
use crate::{Device, GpuError};

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
            $(pub $stage: wgpu::BindGroup,)*
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
    /// One session's buffers bound to each stage.
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
    /// One window's.
    WindowBindings(device, pipelines, b: Buffers, w: WindowBuffers)
    {
        // By the variants of the pipeline.
        divide: Vec<[wgpu::BindGroup; 2]> = {
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

fn bind(
    device: &Device,
    pipeline: &wgpu::ComputePipeline,
    buffers: &[&wgpu::Buffer],
) -> Result<wgpu::BindGroup, GpuError> {
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
