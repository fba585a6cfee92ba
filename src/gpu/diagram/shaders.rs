//! The stages' sources.
//!
//! Purpose: [`compose`] turns a stage of `shaders/` into WGSL. A stage has the name of its file everywhere: `clip/emit` is
//! `shaders/clip/emit.wgsl`, and the pipeline `emit`. Files in `shared/` are imported by stages.
//! Invariant: every file of `shaders/` is listed. Must not know: what is dispatched when.

use crate::shader::{self, ComposeError, Constant, Sources};

macro_rules! sources {
    ($($folder:ident: $($name:ident)*;)*) => {
        &[$($((
            concat!(stringify!($folder), "/", stringify!($name)),
            include_str!(concat!("../../../shaders/", stringify!($folder), "/", stringify!($name), ".wgsl")),
        ),)*)*]
    };
}

/// All files of `shaders/`: name and text.
pub const SOURCES: Sources = sources! {
    clip: checks clip divide emit enqueue indirect_arguments overflow reach verify;
    neighbours: count duplicates first_cells from_lists lengthen offsets scatter search;
    optimizer: accept centroids direction dots gradient may_step partial_dots totals trial;
    shared: accumulate add_lanes append append_pair cell_set clip_pair direction_of distance failure fixed from_fixed grid
        list_state moved optimizer_params place plane point polygon_array polygon_registers precondition reduce requeue rings
        sorted state take_pairs types;
};

/// Stages with a variant for lifted surfaces.
pub const LIFTED: &[&str] = &[
    "clip/clip",
    "clip/divide",
    "clip/emit",
    "clip/enqueue",
    "neighbours/count",
    "neighbours/duplicates",
    "neighbours/first_cells",
    "neighbours/lengthen",
    "neighbours/scatter",
    "neighbours/search",
    "optimizer/accept",
    "optimizer/centroids",
    "optimizer/direction",
    "optimizer/gradient",
    "optimizer/partial_dots",
    "optimizer/trial",
];

/// Composes stage `name` with `constants`: in R³, unless `LIFTED` is among them.
pub fn compose(name: &str, constants: &[Constant<'_>]) -> Result<String, ComposeError> {
    shader::compose(SOURCES, name, &[&[("LIFTED", 0)], constants].concat())
}
