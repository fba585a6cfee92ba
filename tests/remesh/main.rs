//! From a surface to its remesh: features, fidelity, attributes, and input that is hardly a surface.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/broken.rs"]
mod broken;
#[path = "../common/carried.rs"]
mod carried;
#[path = "../common/cases.rs"]
mod cases;
#[path = "../common/gpu.rs"]
mod gpu;
#[path = "../common/hostile.rs"]
mod hostile;
#[path = "../common/long.rs"]
mod long;
#[path = "../common/metrics.rs"]
mod metrics;
#[path = "../common/parts.rs"]
mod parts;
#[path = "../common/points.rs"]
mod points;
#[path = "../common/readers.rs"]
mod readers;
#[path = "../common/rough.rs"]
mod rough;
#[path = "../common/surfaces.rs"]
mod surfaces;

mod anisotropy;
mod attributes;
mod complexes;
mod curves;
mod density;
mod deviation;
mod fidelity;
mod generated;
mod hostile_meshes;
mod hostile_seeds;
mod kept;
mod labelled;
mod mechanical;
mod metric;
mod mirror;
mod near_corners;
mod periodic;
mod pipeline;
mod real_meshes;
mod reported;
mod sheets;
mod stray;
mod thin;
mod vertex_count;
mod zones;
