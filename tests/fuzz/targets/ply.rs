//! Any bytes as a .ply file.
#![no_main]

#[path = "../../common/readers.rs"]
mod readers;

use tessera::mesh::io::Format;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Err(text) = readers::check(Format::Ply, data) {
        panic!("{text}");
    }
});
