//! The restricted Voronoi diagram on every backend: one suite for all of them, and what each adds to it.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/broken.rs"]
mod broken;
#[path = "../common/cases.rs"]
mod cases;
#[path = "../common/conformance.rs"]
mod conformance;
#[path = "../common/gpu.rs"]
mod gpu;
#[path = "../common/lifts.rs"]
mod lifts;
#[path = "../common/points.rs"]
mod points;
#[path = "../common/sessions.rs"]
mod sessions;
#[path = "../common/surfaces.rs"]
mod surfaces;

mod backends;
mod lifted;
mod lists;
mod oracle;
