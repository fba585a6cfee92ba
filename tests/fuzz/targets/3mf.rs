//! Any bytes as a .3mf file.
#![no_main]

#[path = "../../common/properties.rs"]
mod properties;

use tessera::mesh::io::Format;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Err(text) = properties::file(Format::ThreeMf, data) {
        panic!("{text}");
    }
});
