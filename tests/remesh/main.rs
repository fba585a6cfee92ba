//! From steps to a remesh: energies, densities, features, fidelity, attributes.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/gpu.rs"]
mod gpu;
#[path = "../common/readers.rs"]
mod readers;
#[path = "../common/rough.rs"]
mod rough;
#[path = "../common/surfaces.rs"]
mod surfaces;

mod attributes;
mod curves;
mod cvt;
mod density;
mod features;
mod fidelity;
mod lbfgs;
mod near_corners;
mod parts;
mod pipeline;
mod reported;
mod stray;
mod thin;
