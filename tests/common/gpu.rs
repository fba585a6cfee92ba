//! Which adapter the GPU tests run on.
//!
//! `TESSERA_TEST_GPU` is `required` (no adapter is a failure), `auto` (any adapter, software too) or `off`. Tests that
//! `#[needs(gpu)]` are ignored if it is `off`, and with `auto` where there is no driver. A driver that opens no adapter is
//! seen too late for that: with `auto` the test says so and ends. What was decided is printed.

#![allow(clippy::panic)]

use std::sync::{Arc, OnceLock};

use ::gpu::{Device, DeviceOptions};

/// The device of this test binary, or `None` where there is none and none is required.
pub fn device() -> Option<Arc<Device>> {
    static DEVICE: OnceLock<Option<Arc<Device>>> = OnceLock::new();
    DEVICE.get_or_init(open).clone()
}

fn open() -> Option<Arc<Device>> {
    let mode = std::env::var("TESSERA_TEST_GPU").unwrap_or_else(|_| "auto".to_owned());
    if mode == "off" {
        eprintln!("TESSERA_TEST_GPU=off: GPU TESTS ARE SKIPPED");
        return None;
    }
    assert!(mode == "auto" || mode == "required", "TESSERA_TEST_GPU={mode}: say required, auto or off");
    match Device::open(&DeviceOptions { software: true, ..DeviceOptions::default() }) {
        Ok(device) => {
            let adapter = device.adapter();
            eprintln!("TESSERA_TEST_GPU={mode}: {} ({}, {})", adapter.name, adapter.backend, adapter.kind);
            Some(device)
        }
        Err(error) if mode == "auto" => {
            eprintln!("TESSERA_TEST_GPU=auto: NO ADAPTER, GPU TESTS ARE SKIPPED: {error}");
            None
        }
        Err(error) => panic!("TESSERA_TEST_GPU=required: {error}"),
    }
}
