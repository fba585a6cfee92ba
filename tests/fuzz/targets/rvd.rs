//! Any bytes as a small surface with seeds, through every CPU backend and the whole pipeline.
#![no_main]

#[path = "../../common/properties.rs"]
mod properties;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Err(text) = properties::diagram(data) {
        panic!("{text}");
    }
});
