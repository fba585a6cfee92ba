//! Any bytes as a small surface with seeds, on the GPU against the f64 reference.
//!
//! `TESSERA_TEST_GPU` says whether a machine without an adapter is a failure (`tests/common/gpu.rs`).
#![no_main]

#[path = "../../common/properties.rs"]
mod properties;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Err(text) = properties::diagram_on_the_gpu(data) {
        panic!("{text}");
    }
});
