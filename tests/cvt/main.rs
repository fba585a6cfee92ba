//! Seeds that move: Lloyd and quasi-Newton steps on every backend, and the densities that they follow.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/gpu.rs"]
mod gpu;
#[path = "../common/surfaces.rs"]
mod surfaces;

mod density;
mod lbfgs;
mod lloyd;
