//! The restricted Voronoi diagram, on every backend, of generated, real and hostile input.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/cases.rs"]
mod cases;
#[path = "../common/gpu.rs"]
mod gpu;
#[path = "../common/hostile.rs"]
mod hostile;
#[path = "../common/points.rs"]
mod points;
#[path = "../common/surfaces.rs"]
mod surfaces;

mod hostile_meshes;
mod hostile_seeds;
mod invariants;
mod real_meshes;
