//! The stages as pipelines.
//!
//! Purpose: one pipeline per stage and variant, made once per device. A pipeline has the name of its stage.
//! Invariant: wgpu derives the layouts of bindings from the stage's `.wgsl`, so that a stage is described in one place only.
//! Must not know: what is dispatched when, and on which buffers.

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
        /// The stages. [`compile`](Self::compile) composes and compiles them all.
        #[derive(Clone, Debug)]
        pub(super) struct Pipelines {
            /// By [`MEMBERS`], then without and with weights.
            pub divide: [[wgpu::ComputePipeline; 2]; MEMBERS.len()],
            $($(#[$doc])* pub $name: wgpu::ComputePipeline,)*
        }

        impl Pipelines {
            pub(super) fn compile(device: &Device) -> Result<Self, GpuError> {
                let $wide = i64::from(device.has_wide_atomics());
                Ok(Self {
                    divide: divide(device, 0, $wide)?,
                    $($name: pipeline(device, $stage, &$constants)?,)*
                })
            }

            /// The same for lifted surfaces: variants of the stages that have one. The others are shared, or not used.
            pub(super) fn lifted(&self, device: &Device) -> Result<Self, GpuError> {
                let $wide = i64::from(device.has_wide_atomics());
                let variant = |plain: &wgpu::ComputePipeline, stage: &str, constants: &[Constant<'_>]| {
                    if !shaders::LIFTED.contains(&stage) {
                        return Ok(plain.clone());
                    }
                    pipeline(device, stage, &[constants, &[("LIFTED", 1)]].concat())
                };
                Ok(Self {
                    divide: divide(device, 1, $wide)?,
                    $($name: variant(&self.$name, $stage, &$constants)?,)*
                })
            }
        }
    };
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

/// The variants of the stage `divide`.
fn divide(device: &Device, lifted: i64, wide: i64) -> Result<[[wgpu::ComputePipeline; 2]; MEMBERS.len()], GpuError> {
    let variant = |members: u32, weighted| {
        let of_facet = [("ROW", ROW.into()), ("MEMBERS", members.into()), ("WEIGHTED", weighted), ("SHARED", 0)];
        pipeline(device, "clip/divide", &[&of_facet[..], &[("WIDE", wide), ("LIFTED", lifted)]].concat())
    };
    let both = |members| Ok::<_, GpuError>([variant(members, 0)?, variant(members, 1)?]);
    let [a, b, c, d] = MEMBERS;
    Ok([both(a)?, both(b)?, both(c)?, both(d)?])
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
