//! From steps to a remesh: energies, densities, features, fidelity, attributes.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/gpu.rs"]
mod gpu;
#[path = "../common/readers.rs"]
mod readers;
#[path = "../common/surfaces.rs"]
mod surfaces;

mod attributes;
mod curves;
mod cvt;
mod density;
mod deviation;
mod features;
mod fidelity;
mod generated;
mod lbfgs;
mod near_corners;
mod parts;
mod pipeline;
mod stray;
mod thin;
mod vertex_count;
