//! Any bytes as the upload of a stream: protobuf messages, or a client that errs now and then.
#![no_main]

#[path = "../../common/properties.rs"]
mod properties;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Err(text) = properties::upload(data) {
        panic!("{text}");
    }
});
