//! Any bytes as a .vtu file.
#![no_main]

#[path = "../../common/properties.rs"]
mod properties;

use tessera::mesh::io::Format;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Err(text) = properties::file(Format::Vtu, data) {
        panic!("{text}");
    }
});
