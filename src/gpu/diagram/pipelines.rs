//! The stages as pipelines.
//!
//! Purpose: one pipeline per stage and variant, made once per device. A pipeline has the name of its stage. Drivers take about
//! 20 ms for one, so they are made side by side.
//! Invariant: wgpu derives the layouts of bindings from the stage's `.wgsl`, so that a stage is described in one place only.
//! Must not know: what is dispatched when, and on which buffers.

use rayon::prelude::*;

use super::layout::{DOTS, LENGTHENERS, LIST, LONGER, MEMBERS, MOST_REQUEUED, PAIRS, ROW};
use super::plan::SEARCH_PART;
use super::shaders;
use crate::shader::Constant;
use crate::{Device, GpuError};

/// Polygon slots of the register variant. The same for all capacities: other slots would be another program, which a driver
/// may round differently in the last bit. A smaller capacity is a limit below it, a larger one goes to the large variant.
pub(super) const SLOTS: usize = 10;

/// Slots of the variant that pairs with large polygons are clipped by.
pub(super) const LARGE_POLYGON: usize = 64;

/// Constants of the stages that know polygons.
fn polygons(slots: usize, array: i64, shared: i64, wide: i64) -> [Constant<'static>; 4] {
    [("SLOTS", slots as i64), ("ARRAY", array), ("SHARED", shared), ("WIDE", wide)]
}

/// Constants of a stage that finds the nearest `width` seeds.
fn search(width: u32) -> [Constant<'static>; 4] {
    [("ROW", ROW.into()), ("LIST", LIST.into()), ("WIDTH", width.into()), PART]
}

const PART: Constant<'static> = ("PART", SEARCH_PART as i64);
const HISTORY: Constant<'static> = ("PAIRS", PAIRS as i64);
const MOST: Constant<'static> = ("MOST", MOST_REQUEUED as i64);
const LENGTHENING: Constant<'static> = ("LENGTHENERS", LENGTHENERS as i64);

macro_rules! pipelines {
    ($wide:ident; $($(#[$doc:meta])* $name:ident: $stage:literal, $constants:expr;)*) => {
        /// The stages.
        #[derive(Clone, Debug)]
        pub(super) struct Pipelines {
            /// By [`MEMBERS`], then without and with weights.
            pub divide: [[wgpu::ComputePipeline; 2]; MEMBERS.len()],
            $($(#[$doc])* pub $name: wgpu::ComputePipeline,)*
        }

        impl Pipelines {
            /// Composes and compiles all stages, on the threads of the present pool.
            pub(super) fn compile(device: &Device) -> Result<Self, GpuError> {
                Self::make(device, None)
            }

            /// The same for lifted surfaces: variants of the stages that have one. The others are shared, or not used.
            pub(super) fn lifted(&self, device: &Device) -> Result<Self, GpuError> {
                Self::make(device, Some(self))
            }

            fn make(device: &Device, plain: Option<&Self>) -> Result<Self, GpuError> {
                let $wide = i64::from(device.has_wide_atomics());
                let lifted = i64::from(plain.is_some());
                let variants = (0..MEMBERS.len()).flat_map(|members| [(members, 0), (members, 1)]);
                // Each with the pipeline that is shared, if there is one.
                let mut wanted: Vec<(&str, Vec<Constant<'static>>, Option<&wgpu::ComputePipeline>)> =
                    variants.map(|(members, weighted)| ("clip/divide", divide(members, weighted, $wide), None)).collect();
                wanted.extend([$(($stage, $constants.to_vec(), plain.map(|plain| &plain.$name))),*]);
                let make = |(stage, constants, plain): &(&str, Vec<Constant<'static>>, Option<&wgpu::ComputePipeline>)| {
                    match plain.filter(|_| !shaders::LIFTED.contains(stage)) {
                        Some(shared) => Ok(shared.clone()),
                        None => pipeline(device, stage, &[&constants[..], &[("LIFTED", lifted)]].concat()),
                    }
                };
                let made: Result<Vec<_>, GpuError> = wanted.par_iter().map(make).collect();
                // In the order in which they were wanted.
                let mut made = made?.into_iter();
                let mut next = || made.next().ok_or_else(|| GpuError::Failed("a stage is missing".to_owned()));
                let mut both = || Ok::<_, GpuError>([next()?, next()?]);
                let divide = [both()?, both()?, both()?, both()?];
                Ok(Self { divide, $($name: next()?,)* })
            }
        }
    };
}

/// Constants of the stage that divides whole facets, of at most [`MEMBERS`]`[members]` cells.
fn divide(members: usize, weighted: i64, wide: i64) -> Vec<Constant<'static>> {
    let [row, members] = [ROW, MEMBERS[members]].map(i64::from);
    vec![("ROW", row), ("MEMBERS", members), ("WEIGHTED", weighted), ("SHARED", 0), ("WIDE", wide)]
}

pipelines! {
    wide;
    enqueue: "clip/enqueue", polygons(SLOTS, 0, 0, wide);
    indirect_arguments: "clip/indirect_arguments", [LENGTHENING];
    /// With the polygon in registers.
    clip: "clip/clip", polygons(SLOTS, 0, 0, wide);
    /// The same, adding in two phases.
    clip_shared: "clip/clip", polygons(SLOTS, 0, 1, wide);
    /// The first with [`LARGE_POLYGON`] indexed slots.
    clip_large: "clip/clip", polygons(LARGE_POLYGON, 1, 0, wide);
    emit: "clip/emit", polygons(SLOTS, 0, 0, wide);
    reach: "clip/reach", polygons(SLOTS, 0, 0, wide);
    verify: "clip/verify", polygons(SLOTS, 0, 0, wide);
    count: "neighbours/count", [PART];
    offsets: "neighbours/offsets", [PART];
    scatter: "neighbours/scatter", [];
    duplicates: "neighbours/duplicates", [];
    from_lists: "neighbours/from_lists", search(LIST);
    search: "neighbours/search", search(ROW);
    /// That makes lists too.
    search_lists: "neighbours/search", search(LIST);
    lengthen: "neighbours/lengthen", [("ROW", ROW.into()), ("LONGER", LONGER.into()), MOST];
    overflow: "clip/overflow", [MOST, LENGTHENING];
    first_cells: "neighbours/first_cells", [];
    trial: "optimizer/trial", [];
    centroids: "optimizer/centroids", [];
    gradient: "optimizer/gradient", [];
    totals: "optimizer/totals", [];
    may_step: "optimizer/may_step", [];
    accept: "optimizer/accept", [];
    partial_dots: "optimizer/partial_dots", [HISTORY];
    dots: "optimizer/dots", [("DOTS", DOTS as i64)];
    direction: "optimizer/direction", [HISTORY];
}

fn pipeline(device: &Device, stage: &str, constants: &[Constant<'_>]) -> Result<wgpu::ComputePipeline, GpuError> {
    let source = shaders::compose(stage, constants)?;
    device.scoped(|| {
        let module = device.raw().create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(stage),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        device.raw().create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(stage),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            compilation_options: wgpu::PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        })
    })
}
