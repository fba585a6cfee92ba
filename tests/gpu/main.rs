//! The GPU backend: shaders, stages and helpers one by one, how pairs are found, resident steps.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

use std::sync::OnceLock;

use ::gpu::diagram::Gpu;

#[path = "../common/gpu.rs"]
mod gpu;
#[path = "../common/hang.rs"]
mod hang;
#[path = "../common/lifts.rs"]
mod lifts;
#[path = "../common/long.rs"]
mod long;
#[path = "../common/points.rs"]
mod points;
#[path = "../common/sessions.rs"]
mod sessions;

/// The backend of these tests, or `None` where there is no adapter and none is required.
fn backend() -> Option<&'static Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    GPU.get_or_init(|| crate::gpu::device().map(|device| Gpu::new(device, None).unwrap())).as_ref()
}

macro_rules! require_gpu {
    () => {
        match crate::backend() {
            Some(gpu) => gpu,
            None => return,
        }
    };
}

mod hangs;
mod helpers;
mod lifted;
mod resident;
mod shaders;
mod shares;
mod stage;
mod strategies;
mod twins;
mod windows;
