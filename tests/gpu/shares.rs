//! Promise: facets that several devices share, and records that the host sends in turn, change no bit.

use std::sync::{Arc, OnceLock};

use ::gpu::diagram::{Gpu, SharedGpu};
use ::gpu::{Device, DeviceOptions};
use glam::DVec3;
use needs::needs;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{Backend, Capacities, RvdError, SessionOptions, Strategy, Surface, Tuning};
use tessera::token::Token;
use tessera::{RemeshOptions, Seeds, remesh};

use super::windows::{Outcome, run, same, seeds, surface};
use crate::long::some;

fn device(memory_bytes: Option<u64>) -> Arc<Gpu> {
    let options = DeviceOptions { software: true, memory_bytes, ..DeviceOptions::default() };
    Arc::new(Gpu::new(Device::open(&options).unwrap(), Some(2)).unwrap())
}

/// Three devices on one adapter.
fn three() -> Option<&'static [Arc<Gpu>; 3]> {
    static ALL: OnceLock<Option<[Arc<Gpu>; 3]>> = OnceLock::new();
    ALL.get_or_init(|| crate::gpu::device().map(|_| [(); 3].map(|()| device(None)))).as_ref()
}

fn shared(devices: &[Arc<Gpu>]) -> SharedGpu {
    SharedGpu::new(devices.to_vec()).unwrap()
}

fn on(backend: &dyn Backend, surface: &Arc<Surface>, seeds: &[DVec3], options: SessionOptions) -> Outcome {
    run(backend, surface, seeds, options)
}

#[needs(gpu)]
#[test]
fn the_number_of_devices_changes_no_bit() {
    let Some(all) = three() else { return };
    let tiny = Capacities::new().with_neighbours(5).with_polygon(5).with_cells(2).with_pairs_percent(10);
    let usual = Capacities::default();
    for (name, facets, n, weighted, capacities) in
        [("even", 2500, 400, false, usual), ("graded", 2500, 400, true, tiny), ("coarse", 60, 400, false, usual)]
    {
        let surface = surface(facets, weighted);
        let seeds = seeds(&surface, n, 1);
        for strategy in [Strategy::Facet, Strategy::Cell] {
            let tuning = Tuning::new().with_strategy(strategy);
            let options = SessionOptions::new(n).with_capacities(capacities).with_tuning(tuning);
            let alone = on(&*all[0], &surface, &seeds, options);
            for k in 1..=3 {
                same(&format!("{name} on {k}"), &on(&shared(&all[..k]), &surface, &seeds, options), &alone);
            }
        }
    }
}

/// Seeds that single precision cannot tell apart, and seeds far away: the pass is done in double, wherever facets are.
#[needs(gpu)]
#[test]
fn what_the_host_does_is_shared_too() {
    let Some(all) = three() else { return };
    let surface = surface(500, false);
    let mut twins = seeds(&surface, 100, 3);
    twins.extend_from_within(..);
    let heap: Vec<DVec3> = seeds(&surface, 200, 4).iter().map(|&p| p * 1e-6).collect();
    let far: Vec<DVec3> = seeds(&surface, 50, 5).iter().map(|&p| p + DVec3::new(0.0, 100.0, 0.0)).collect();
    for (name, seeds) in [("twins", twins), ("heap", heap), ("far", far)] {
        let options = SessionOptions::new(seeds.len());
        same(name, &on(&shared(&all[..2]), &surface, &seeds, options), &on(&*all[0], &surface, &seeds, options));
    }
}

#[needs(gpu)]
#[test]
fn a_remesh_is_the_same_on_two_devices() {
    let Some(all) = three() else { return };
    let mesh = Shape::Torus.build(3000);
    let options = RemeshOptions::new(Seeds::Sample { points: 300, seed: 2 }).with_newton(4);
    let result = |backend: &dyn Backend| remesh(&mesh, &options, backend, &mut (), &Token::default()).unwrap().mesh;
    assert!(result(&*all[0]) == result(&shared(&all[..2])));
}

#[needs(gpu)]
#[test]
fn records_that_are_sent_in_turn_change_no_bit() {
    let Some([whole, ..]) = three() else { return };
    for weighted in some(1, [true, false]) {
        let surface = surface(16_000, weighted);
        let n = 200;
        let seeds = seeds(&surface, n, 1);
        let options = SessionOptions::new(n);
        let all = on(&**whole, &surface, &seeds, options);
        let bytes = whole.session(Arc::clone(&surface), options).unwrap().device_bytes();
        let records = (size_of::<::gpu::diagram::layout::Facet>() * surface.facets().len()) as u64;
        let least = match device(Some(bytes / 20)).session(Arc::clone(&surface), options) {
            Err(RvdError::OutOfMemory { needed_bytes, .. }) => needed_bytes,
            Err(other) => panic!("{other}"),
            Ok(_) => panic!("it fits a twentieth"),
        };
        assert!(least < bytes);
        for limit in [bytes * 9 / 10, least] {
            let small = device(Some(limit));
            let session = small.session(Arc::clone(&surface), options).unwrap();
            assert!(session.device_bytes() <= limit, "{} for {limit}", session.device_bytes());
            drop(session);
            let part = on(&*small, &surface, &seeds, options);
            same(&format!("{limit} of {bytes}"), &part, &all);
            if limit == least {
                // One buffer for all windows: all records are sent for first cells, and again for pieces.
                assert!(part.stats.uploaded_bytes >= 2 * records, "{:?}", part.stats);
            }
        }
        assert!(device(Some(least - 1)).session(Arc::clone(&surface), options).is_err());
        assert!(all.stats.uploaded_bytes < records, "{:?}", all.stats);
    }
}
