//! Dispatches in parts.
//!
//! Purpose: a driver may take a dispatch of a tenth of a second for a hung device, so a stage of many items is
//! dispatched part by part, and after some parts the host may stop.
//! Invariant: a stage that fits one part costs what it did: no pass, copy or submission more.
//! Must not know: what a stage does.

use std::mem::offset_of;

use super::pass::run;
use crate::gpu::Device;
use crate::gpu::buffers::Buffers;
use crate::gpu::layout::Params;
use crate::gpu::plan::{ARGUMENTS_BYTES, Limits, PART, PARTS, parts};
use crate::rvd::RvdError;
use crate::token::Token;

/// [`PART`]s that one dispatch of a stage may have, by what an item costs: on a software adapter with two cores 20 to
/// 40 ms.
pub(super) mod size {
    /// A facet that looks for its first cell without a guess.
    pub(crate) const LOOK: u64 = 1;
    /// A seed that looks for its neighbours, or for facets; a facet that is divided with room for many cells.
    pub(crate) const SEARCH: u64 = 2;
    /// A facet that is divided, or walks to its first cell.
    pub(crate) const FACET: u64 = 4;
    /// An item that is looked at and put somewhere.
    pub(crate) const ITEM: u64 = 32;
}

/// A stage over so many items.
pub(super) struct Stage<'a> {
    pub pipeline: &'a wgpu::ComputePipeline,
    pub bindings: &'a wgpu::BindGroup,
    pub items: u64,
    /// One of [`size`].
    pub size: u64,
    /// Where the device says how many workgroups each part has, one part's arguments after another's, if it does.
    pub arguments: Option<(&'a wgpu::Buffer, u64)>,
}

impl Stage<'_> {
    /// Whether it takes more than one dispatch.
    pub(super) fn is_long(&self) -> bool {
        self.items > self.size * PART
    }

    /// Dispatches all of it; it is not long.
    pub(super) fn run(&self, compute: &mut wgpu::ComputePass<'_>, limits: Limits) {
        self.run_part(compute, 0, self.items, limits);
    }

    fn run_part(&self, compute: &mut wgpu::ComputePass<'_>, part: u64, items: u64, limits: Limits) {
        let Some((arguments, first)) = self.arguments else {
            return run(compute, self.pipeline, self.bindings, items, limits);
        };
        compute.set_pipeline(self.pipeline);
        compute.set_bind_group(0, self.bindings, &[]);
        compute.dispatch_workgroups_indirect(arguments, first + part * ARGUMENTS_BYTES);
    }
}

/// Encodes `stages` in their order. Those that take many parts are submitted on the way.
pub(super) fn encode(
    device: &Device,
    encoder: &mut wgpu::CommandEncoder,
    lane: usize,
    stages: &[Stage<'_>],
    buffers: &Buffers,
    token: &Token,
) -> Result<(), RvdError> {
    let limits = Limits::of(&device.limits());
    let mut rest = stages;
    while !rest.is_empty() {
        let (short, others) = rest.split_at(rest.iter().take_while(|s| !s.is_long()).count());
        if !short.is_empty() {
            let mut compute = device.pass(encoder, lane);
            short.iter().for_each(|stage| stage.run(&mut compute, limits));
        }
        rest = others;
        if let Some((long, others)) = rest.split_first() {
            rest = others;
            in_parts(device, encoder, lane, long, buffers, token)?;
        }
    }
    Ok(())
}

fn in_parts(
    device: &Device,
    encoder: &mut wgpu::CommandEncoder,
    lane: usize,
    stage: &Stage<'_>,
    buffers: &Buffers,
    token: &Token,
) -> Result<(), RvdError> {
    let limits = Limits::of(&device.limits());
    let part_first = offset_of!(Params, part_first) as u64;
    let begin_at = |encoder: &mut wgpu::CommandEncoder, item: u64| {
        encoder.copy_buffer_to_buffer(&buffers.origins, item / PART * 4, &buffers.params, part_first, 4);
    };
    for (k, part) in parts(stage.items, stage.size).enumerate() {
        if k > 0 && (k as u64).is_multiple_of(PARTS) {
            device.run(std::mem::replace(encoder, device.encoder()))?;
            token.check()?;
        }
        begin_at(encoder, part.start);
        let mut compute = device.pass(encoder, lane);
        stage.run_part(&mut compute, k as u64, part.end - part.start, limits);
    }
    begin_at(encoder, 0);
    Ok(())
}
