//! What a device allows, and dispatches, long ones in parts.
//!
//! Purpose: [`Limits`] are the numbers that plans of buffers and dispatches are made for. From them comes how many workgroups and
//! parts a number of items takes. A driver may take a dispatch of a tenth of a second for a hung device, so a stage of many items
//! is dispatched part by part, and after some parts the host may stop.
//! Invariant: numbers come from counts and limits alone. A stage that fits one part takes no pass, copy or submission more.
//! Must not know: what a stage does, what bytes are for.

use std::ops::Range;

use wgpu::{BindGroup, Buffer, CommandEncoder, ComputePass, ComputePipeline};

use crate::device::WORKGROUP;
use crate::{Device, GpuError};
use geometry::token::{Stopped, Token};

/// Items that one dispatch of a heavy stage has at most. Each stage takes some such parts at once; none comes near
/// 100 ms on a software adapter (`tessera bench cvt` says how long the longest took).
pub(crate) const PART: u64 = 1 << 15;
/// Parts that one submission has at most, so that a job can be cancelled between them.
pub(crate) const PARTS: u64 = 16;
/// Bytes of the arguments of an indirect dispatch.
pub(crate) const ARGUMENTS_BYTES: u64 = 12;
/// Workgroups of a reduction at most; each leaves one partial sum.
pub(crate) const REDUCTION_GROUPS: u32 = 256;
/// Items that a lane of a reduction adds up before lanes are added: a workgroup's barriers cost as much as many items.
const LANE_ITEMS: u64 = 4;

/// Parts that a dispatch over `items` may be in.
pub(crate) fn part_count(items: u64) -> u64 {
    items.min(u64::from(u32::MAX)).div_ceil(PART).max(1)
}

pub(crate) fn origins(parts: u64) -> Vec<u32> {
    (0..parts).map(|k| (k * PART) as u32).collect()
}

/// The items of each dispatch over `items`, `parts` times [`PART`] in each but the last; one dispatch if there are none.
pub(crate) fn parts(items: u64, parts: u64) -> impl Iterator<Item = Range<u64>> {
    let most = parts * PART;
    (0..items.div_ceil(most).max(1)).map(move |k| k * most..((k + 1) * most).min(items))
}

pub(crate) fn reduction(items: u64) -> u32 {
    items.div_ceil(LANE_ITEMS * u64::from(WORKGROUP)).clamp(1, u64::from(REDUCTION_GROUPS)) as u32
}

/// Workgroups in x and y for `items` invocations. The shaders number them row by row.
pub(crate) fn workgroups(items: u64, limits: Limits) -> [u32; 2] {
    let groups = items.div_ceil(u64::from(WORKGROUP)).max(1);
    let x = groups.min(u64::from(limits.workgroups));
    let y = groups.div_ceil(x);
    [x as u32, y as u32]
}

pub(crate) fn run(pass: &mut ComputePass<'_>, stage: &ComputePipeline, bound: &BindGroup, items: u64, limits: Limits) {
    run_groups(pass, stage, bound, workgroups(items, limits));
}

pub(crate) fn run_groups(pass: &mut ComputePass<'_>, stage: &ComputePipeline, bound: &BindGroup, [x, y]: [u32; 2]) {
    pass.set_pipeline(stage);
    pass.set_bind_group(0, bound, &[]);
    pass.dispatch_workgroups(x, y, 1);
}

/// Dispatches a stage in as many workgroups as the device has written to `arguments`.
pub(crate) fn run_indirect(pass: &mut ComputePass<'_>, stage: &ComputePipeline, bound: &BindGroup, at: (&Buffer, u64)) {
    pass.set_pipeline(stage);
    pass.set_bind_group(0, bound, &[]);
    pass.dispatch_workgroups_indirect(at.0, at.1);
}

/// Where a stage reads the first item of its part.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Origins<'a> {
    pub of_parts: &'a Buffer,
    pub to: &'a Buffer,
    pub offset: u64,
}

#[derive(Debug)]
pub(crate) struct Stage<'a> {
    pub pipeline: &'a ComputePipeline,
    pub bindings: &'a BindGroup,
    pub items: u64,
    /// [`PART`]s that one dispatch may have.
    pub size: u64,
    /// Where the device says how many workgroups each part has, one part's arguments after another's, if it does.
    pub arguments: Option<(&'a Buffer, u64)>,
}

impl Stage<'_> {
    pub(crate) fn is_long(&self) -> bool {
        self.items > self.size * PART
    }

    /// Dispatches all of it; it is not long.
    pub(crate) fn run(&self, compute: &mut ComputePass<'_>, limits: Limits) {
        self.run_part(compute, 0, self.items, limits);
    }

    fn run_part(&self, compute: &mut ComputePass<'_>, part: u64, items: u64, limits: Limits) {
        let Some((arguments, first)) = self.arguments else {
            return run(compute, self.pipeline, self.bindings, items, limits);
        };
        run_indirect(compute, self.pipeline, self.bindings, (arguments, first + part * ARGUMENTS_BYTES));
    }
}

/// Encodes `stages` in their order. Those that take many parts are submitted on the way.
pub(crate) fn encode<E: From<GpuError> + From<Stopped>>(
    device: &Device,
    encoder: &mut CommandEncoder,
    lane: usize,
    stages: &[Stage<'_>],
    origins: Origins<'_>,
    token: &Token,
) -> Result<(), E> {
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
            in_parts::<E>(device, encoder, lane, long, origins, token)?;
        }
    }
    Ok(())
}

fn in_parts<E: From<GpuError> + From<Stopped>>(
    device: &Device,
    encoder: &mut CommandEncoder,
    lane: usize,
    stage: &Stage<'_>,
    origins: Origins<'_>,
    token: &Token,
) -> Result<(), E> {
    let limits = Limits::of(&device.limits());
    let begin_at = |encoder: &mut CommandEncoder, item: u64| {
        encoder.copy_buffer_to_buffer(origins.of_parts, item / PART * 4, origins.to, origins.offset, 4);
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

/// The part of a buffer that one readback copies at most.
pub(crate) const STAGING_BYTES: u64 = 32 << 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Limits {
    pub buffer_bytes: u64,
    pub binding_bytes: u64,
    /// Workgroups in one dimension.
    pub workgroups: u32,
}

impl Limits {
    pub(crate) fn of(limits: &wgpu::Limits) -> Self {
        Self {
            buffer_bytes: limits.max_buffer_size,
            binding_bytes: limits.max_storage_buffer_binding_size,
            workgroups: limits.max_compute_workgroups_per_dimension,
        }
    }

    /// Largest buffer that a shader can see all of, bytes.
    pub(crate) fn seen_bytes(self) -> u64 {
        // Offsets within a buffer are 32-bit words on the device.
        self.buffer_bytes.min(self.binding_bytes).min(16 << 30)
    }
}

/// Whether a shader can see each of these buffers (name, bytes) as a whole.
pub(crate) fn fits(buffers: &[(&str, u64)], limits: Limits) -> Result<(), GpuError> {
    let limit_bytes = limits.seen_bytes();
    for &(what, needed_bytes) in buffers {
        if needed_bytes > limit_bytes {
            return Err(GpuError::NeverFits { what: what.to_owned(), needed_bytes, limit_bytes });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_cover_all_items_and_none_is_too_large() {
        for items in [0, 1, PART, PART + 1, 10 * PART + 7] {
            for most in [1, 4] {
                let parts: Vec<_> = parts(items, most).collect();
                assert_eq!((parts[0].start, parts[parts.len() - 1].end), (0, items));
                assert!(parts.windows(2).all(|p| p[0].end == p[1].start));
                assert!(parts.iter().all(|p| p.end - p.start <= most * PART && p.start % PART == 0));
                assert!(parts.last().unwrap().start / PART < part_count(items));
            }
        }
    }

    #[test]
    fn workgroups_cover_their_items() {
        let limits = Limits { buffer_bytes: 256 << 20, binding_bytes: 128 << 20, workgroups: 65_535 };
        for items in [0, 1, 64, 65, 65_535 * 64, 65_535 * 64 + 1, 100_000_000] {
            let [x, y] = workgroups(items, limits);
            assert!(x <= 65_535 && y <= 65_535);
            assert!(u64::from(x) * u64::from(y) * 64 >= items);
        }
    }
}
