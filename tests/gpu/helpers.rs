//! Promise: each shared shader helper does on the device what f64 and integers do on the host,
//! and the device refuses what it cannot do with a typed error.

use std::sync::Arc;

use crate::stage::{STAGING_BYTES, Stage, staging};
use ::gpu::buffers::write;
use ::gpu::device::adapters;
use ::gpu::{Device, DeviceOptions, GpuError};
use needs::needs;
use wgpu::BufferUsages as Usage;

/// Runs one check and reads (sums, slots, outcomes).
fn check(
    device: &Arc<Device>,
    wide: bool,
    entry: &str,
    inputs: &[u32],
    slots: usize,
) -> (Vec<u32>, Vec<u32>, Vec<u32>) {
    let stage = Stage::new(device, "clip/checks", entry, &[("WIDE", i64::from(wide))]);
    let groups = inputs.len().div_ceil(64) as u32;
    let mut all = stage.run(groups, &[inputs.to_vec(), vec![0; 4], vec![0; slots], vec![0; inputs.len()]]);
    let (outcomes, slots) = (all.remove(3), all.remove(2));
    (all.remove(1), slots, outcomes)
}

#[needs(gpu)]
#[test]
fn fixed_point_sums_carry_and_go_negative() {
    let Some(device) = crate::gpu::device() else { return };
    let two32 = 4_294_967_296f32;
    let mut cases: Vec<Vec<f32>> = vec![
        vec![1.0; 1000],
        vec![-1.0; 1000],
        vec![4_294_967_040.0; 300],
        vec![-4_294_967_040.0, 4_294_967_040.0, -3.0],
        vec![two32, -two32, two32, 0.0, -0.0, 0.4, -0.4],
        vec![1.5e18, -1.25e18, 7.0, -1e10],
        vec![-two32 * 3.0, 1.0],
    ];
    // Mixed magnitudes and signs, so that every path of the carry is taken.
    let mut x = 1u32;
    cases.push(
        (0..4096)
            .map(|_| {
                x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let magnitude = f64::from(x >> 8) * f64::from(x % 25).exp2();
                if x & 64 == 0 { magnitude as f32 } else { -(magnitude as f32) }
            })
            .collect(),
    );
    for case in cases {
        let want: i64 = case.iter().map(|&v| f64::from(v).round_ties_even() as i64).sum();
        let inputs: Vec<u32> = case.iter().map(|v| v.to_bits()).collect();
        for wide in [false, true] {
            if wide && !device.has_wide_atomics() {
                eprintln!("no 64-bit atomics here");
                continue;
            }
            let (sums, _, _) = check(&device, wide, "check_fixed", &inputs, 4);
            let got = (u64::from(sums[0]) | u64::from(sums[1]) << 32) as i64;
            assert_eq!(got, want, "{wide}, {:?}...", &case[..case.len().min(8)]);
        }
    }
}

#[needs(gpu)]
#[test]
fn a_cell_set_takes_each_cell_once_and_says_when_it_is_full() {
    let Some(device) = crate::gpu::device() else { return };
    // 4096 insertions of 256 different cells into 256 slots, the key 0 and large ones among them.
    let inputs: Vec<u32> = (0..4096u32).map(|k| (k * 7919 % 256) * 8_000_000).collect();
    let (_, slots, outcomes) = check(&device, false, "check_cell_set", &inputs, 256);
    let mut stored: Vec<u32> = slots.iter().map(|s| s.wrapping_sub(1)).collect();
    stored.sort_unstable();
    assert_eq!(stored, (0..256u32).map(|k| k * 8_000_000).collect::<Vec<_>>());
    assert_eq!(outcomes.iter().filter(|o| **o == 1).count(), 256);
    assert!(outcomes.iter().all(|o| *o < 2));
    // 300 different cells do not fit.
    let inputs: Vec<u32> = (0..300).collect();
    let (_, _, outcomes) = check(&device, false, "check_cell_set", &inputs, 256);
    assert_eq!(outcomes.iter().filter(|o| **o == 1).count(), 256);
    assert_eq!(outcomes.iter().filter(|o| **o == 2).count(), 44);
}

#[needs(gpu)]
#[test]
fn adapters_are_listed_and_software_is_not_taken_by_default() {
    let Some(device) = crate::gpu::device() else { return };
    let all = adapters();
    assert!(all.iter().any(|a| a.name == device.adapter().name));
    if all.iter().all(|a| a.software) {
        let Err(GpuError::NoAdapter { found }) = Device::open(&DeviceOptions::default()) else {
            panic!("a software adapter was taken");
        };
        assert!(!found.is_empty() && found[0].contains("CPU"), "{found:?}");
    }
    let options = DeviceOptions { software: true, name: Some("no such adapter".into()), ..Default::default() };
    assert!(matches!(Device::open(&options), Err(GpuError::NoAdapter { .. })));
}

#[needs(gpu)]
#[test]
fn too_large_a_buffer_is_an_error_and_the_device_goes_on() {
    let Some(device) = crate::gpu::device() else { return };
    let bytes = device.limits().max_buffer_size.saturating_add(4);
    assert!(device.buffer("huge", bytes, Usage::STORAGE).is_err());
    device.check().unwrap();
    device.buffer("small", 64, Usage::STORAGE).unwrap();
}

#[needs(gpu)]
#[test]
fn reads_longer_than_the_staging_buffer_come_in_portions() {
    let Some(device) = crate::gpu::device() else { return };
    let values: Vec<u32> = (0..100_000).collect();
    let buffer = device.buffer("long", 400_000, Usage::STORAGE | Usage::COPY_DST | Usage::COPY_SRC).unwrap();
    write(&device, &buffer, 0, &values).unwrap();
    let (reader, _allocation) = staging(&device);
    const { assert!(STAGING_BYTES < 400_000) };
    assert_eq!(reader.read::<u32>(&device, &buffer, 5..99_999).unwrap(), values[5..99_999]);
}
