//! The GPU backend: shaders, helpers, diagram, resident steps.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/gpu.rs"]
mod gpu;

mod helpers;
mod resident;
mod rvd;
mod shaders;
mod windows;
