//! Any bytes as a small surface with seeds, on the GPU against the f64 reference.
//!
//! `TESSERA_TEST_GPU` says whether a machine without an adapter is a failure (`tests/common/gpu.rs`).
#![no_main]

#[path = "../../common/cases.rs"]
mod cases;
#[path = "../../common/gpu.rs"]
mod gpu;
#[path = "../../common/gpu_cases.rs"]
mod gpu_cases;

use std::sync::OnceLock;

use tessera::internals::rvd::Gpu;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    let gpu = GPU.get_or_init(|| gpu::device().map(|device| Gpu::new(device, Some(1)).unwrap()));
    if let Some(gpu) = gpu
        && let Some(case) = cases::Case::from_bytes(data)
        && let Err(text) = gpu_cases::check(&case, gpu)
    {
        panic!("{text}");
    }
});
