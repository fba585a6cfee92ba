//! The stages' sources.
//!
//! Purpose: [`compose`] turns a stage of `shaders/` into WGSL. A stage has the name of its file everywhere: `clip/emit` is
//! `shaders/clip/emit.wgsl`, and the pipeline `emit`. Files in `shared/` are imported by stages.
//! Invariant: every file of `shaders/` is listed. Must not know: what is dispatched when.

use crate::shader::{self, ComposeError, Constant, Sources};

macro_rules! sources {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../../shaders/", $name, ".wgsl")))),*]
    };
}

/// All files of `shaders/`: name and text.
pub const SOURCES: Sources = sources![
    "clip/checks",
    "clip/clip",
    "clip/divide",
    "clip/emit",
    "clip/enqueue",
    "clip/indirect_arguments",
    "clip/overflow",
    "clip/reach",
    "clip/verify",
    "neighbours/count",
    "neighbours/duplicates",
    "neighbours/first_cells",
    "neighbours/from_lists",
    "neighbours/lengthen",
    "neighbours/offsets",
    "neighbours/scatter",
    "neighbours/search",
    "optimizer/accept",
    "optimizer/centroids",
    "optimizer/direction",
    "optimizer/dots",
    "optimizer/gradient",
    "optimizer/may_step",
    "optimizer/partial_dots",
    "optimizer/totals",
    "optimizer/trial",
    "shared/accumulate",
    "shared/add_lanes",
    "shared/append",
    "shared/append_pair",
    "shared/cell_set",
    "shared/clip_pair",
    "shared/distance",
    "shared/failure",
    "shared/fixed",
    "shared/from_fixed",
    "shared/grid",
    "shared/list_state",
    "shared/moved",
    "shared/optimizer_params",
    "shared/place",
    "shared/polygon_array",
    "shared/polygon_registers",
    "shared/precondition",
    "shared/reduce",
    "shared/requeue",
    "shared/rings",
    "shared/sorted",
    "shared/state",
    "shared/take_pairs",
    "shared/types",
];

/// Composes stage `name` with `constants`.
///
/// # Errors
/// [`ComposeError`], naming file and line.
pub fn compose(name: &str, constants: &[Constant<'_>]) -> Result<String, ComposeError> {
    shader::compose(SOURCES, name, constants)
}
