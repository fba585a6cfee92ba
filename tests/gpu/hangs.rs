//! Promise: nobody waits for a driver that does not answer, wherever the driver holds the call up.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ::gpu::{Device, DeviceOptions, GpuError};
use needs::needs;

use crate::hang::Hang;

const TIMEOUT: Duration = Duration::from_secs(1);
/// Of a machine that does other things too.
const SLACK: Duration = Duration::from_secs(3);
/// Much longer than the two limits that are waited for: it is measured beside other tests, and may go faster later.
const HANG: Duration = Duration::from_secs(12);

/// A device of its own, at work for long.
fn hanging() -> Arc<Device> {
    let options = DeviceOptions { software: true, timeout: TIMEOUT, ..DeviceOptions::default() };
    let device = Device::open(&options).unwrap();
    let hang = Hang::new(Arc::clone(&device), HANG);
    hang.submit();
    device
}

#[needs(gpu)]
#[test]
fn a_driver_that_does_not_answer_holds_nobody_up() {
    if crate::gpu::device().is_none() {
        return;
    }
    let device = hanging();
    let begin = Instant::now();
    // A software driver keeps the call that submits, others the one that waits.
    let answer = device.run(device.encoder());
    assert!(matches!(answer, Err(GpuError::Timeout { seconds: 1 })), "{answer:?}");
    assert!(begin.elapsed() < 2 * TIMEOUT + SLACK, "{:?}", begin.elapsed());
    // It counts as lost from here on, at once.
    let begin = Instant::now();
    let usage = wgpu::BufferUsages::STORAGE;
    let buffer = device.buffer("later", 64, usage);
    assert!(matches!(&buffer, Err(GpuError::Lost(why)) if why.contains("no answer within 1 s")), "{buffer:?}");
    assert!(matches!(device.run(device.encoder()), Err(GpuError::Lost(_))));
    // Nor does it hold up who lets go of it.
    drop(device);
    assert!(begin.elapsed() < SLACK, "{:?}", begin.elapsed());
}

#[needs(gpu)]
#[test]
fn who_lets_go_of_a_device_at_work_waits_no_longer_than_for_its_work() {
    if crate::gpu::device().is_none() {
        return;
    }
    let device = hanging();
    let begin = Instant::now();
    drop(device);
    assert!(begin.elapsed() < TIMEOUT + SLACK, "{:?}", begin.elapsed());
}
