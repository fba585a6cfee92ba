//! Promise: on a lifted surface the device searches as the host does, by the distances of R^6, and windows and capacities change no bit.

use std::sync::Arc;

use ::gpu::diagram::layout::{LiftedSeed, ROW, split};
use geometry::knn::{NeighbourRow, SeedIndex};
use glam::DVec3;
use needs::needs;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{
    Accumulate, Backend, Capacities, CellSums, Lifted, Parallel, PieceBatch, Point, SessionOptions, Together, Tuning,
};
use tessera::token::Token;

use crate::lifts::{lifted, seeds_on};
use crate::long::some;
use crate::sessions::{minimise, read};
use crate::windows;

fn record(p: Lifted) -> LiftedSeed {
    let ((hi, lo), (lift_hi, lift_lo)) = (split(p.place.to_array()), split(p.lift.to_array()));
    LiftedSeed { hi, lo, lift_hi, lift_lo, ..LiftedSeed::default() }
}

#[needs(gpu)]
#[test]
fn rows_and_first_cells_are_the_hosts() {
    let gpu = require_gpu!();
    for (shape, share) in [(Shape::Torus, 0.05), (Shape::Hills, 0.3), (Shape::Block, 1.0)] {
        let surface = lifted(&shape.build(800), None, share);
        let even = seeds_on(&surface, 1000, 3);
        let mut twins = even.clone();
        // Twins, and seeds in one place whose lifts differ.
        for k in 0..300 {
            twins[999 - k] = if k % 2 == 0 { even[k] } else { Lifted { lift: -even[k].lift, ..even[k] } };
        }
        let far = even.iter().map(|p| Lifted { lift: p.lift + DVec3::splat(9.0), ..*p }).collect();
        for (name, seeds) in [("even", even), ("twins", twins), ("far", far)] {
            let search = |neighbours| {
                let capacities = Capacities::new().with_neighbours(neighbours);
                let options = SessionOptions::new(seeds.len()).with_capacities(capacities);
                gpu.search_lifted(Arc::clone(&surface), &[&seeds], options, &Token::default()).unwrap().remove(0)
            };
            let (found, short) = (search(24), search(5));
            let index = SeedIndex::new(&seeds);
            assert_eq!(found.by_host, name == "far", "{shape}, {name}");
            assert_eq!(found.duplicates, index.duplicates() as u64, "{shape}, {name}");
            let records: Vec<LiftedSeed> = seeds.iter().map(|&p| record(p)).collect();
            let mut full = 0;
            for (i, row) in found.rows.iter().enumerate() {
                let mut want = NeighbourRow::default();
                index.row(i as u32, seeds.len(), &mut want);
                for (&got, &want) in row.seeds.iter().zip(&want.seeds) {
                    let of = |j: u32| seeds[j as usize].distance(seeds[i]);
                    // A float's rounding, of the distance and of either end.
                    assert!((of(got) - of(want)).abs() <= 3e-7 * of(want) + 4e-11, "{shape}, {name}: row of {i}");
                }
                if !found.by_host {
                    let keys: Vec<f32> = row.seeds.iter().map(|&j| records[i].key(&records[j as usize])).collect();
                    assert!(keys.is_sorted(), "{shape}, {name}: row of {i} is in the order of the host's keys");
                }
                full += usize::from(row.seeds.len() == ROW as usize || row.complete);
                assert!(short.rows[i].seeds.len() <= 5 && row.seeds.starts_with(&short.rows[i].seeds), "{name}");
            }
            println!("{shape}, {name}: {full} of {} rows are full", seeds.len());
            assert!(found.by_host || full * 10 >= seeds.len() * 9, "{shape}, {name}: {full}");
            for &(f, first) in &found.first {
                let q = surface.centroid(f);
                let (d, w) = (q.distance(seeds[first as usize]), q.distance(seeds[index.nearest(q) as usize]));
                assert!(d <= w + 3e-7 * (w + 1.0), "{shape}, {name}: first cell of {f} is {d:e} away, not {w:e}");
                assert!(!index.is_duplicate(first), "{shape}, {name}: {first} is a later duplicate");
            }
        }
    }
}

#[needs(gpu)]
#[test]
fn windows_and_capacities_change_no_bit() {
    let Some([small, whole]) = windows::backends() else { return };
    let tiny = Capacities::new().with_neighbours(5).with_polygon(5).with_cells(2).with_pairs_percent(10);
    // Records of 1.15 MB: two windows.
    let mesh = Shape::Torus.build(8000);
    let uneven: Vec<f64> = (0..mesh.positions().len()).map(|v| 0.2 + (v % 5) as f64).collect();
    for (weights, share) in some(1, [(Some(&uneven[..]), 0.5), (None, 0.1)]) {
        let surface = lifted(&mesh, weights, share);
        let seeds = seeds_on(&surface, 500, 7);
        let mut first: Option<(CellSums<Lifted>, PieceBatch)> = None;
        let usual = Capacities::default();
        let cases = [
            (whole, usual, Accumulate::Auto),
            (small, usual, Accumulate::Auto),
            (small, tiny, Accumulate::Auto),
            (whole, usual, Accumulate::TwoPhase),
        ];
        for (gpu, capacities, accumulate) in cases {
            let tuning = Tuning::new().with_accumulate(accumulate);
            let options = SessionOptions::new(seeds.len()).with_capacities(capacities).with_tuning(tuning);
            let mut session = gpu.lifted_session(Arc::clone(&surface), options).unwrap();
            let (mut sums, mut pieces, token) = (CellSums::default(), PieceBatch::default(), Token::default());
            // Fewer seeds first: there is more room later.
            session.set_seeds(&seeds[..100]).unwrap();
            session.sums(&mut sums, &token).unwrap();
            session.set_seeds(&seeds).unwrap();
            let stats = session.sums(&mut sums, &token).unwrap();
            session.pieces(0..surface.facets().len() as u32, &mut pieces, &token).unwrap();
            println!("lift {share}: {stats:?}");
            let (want, want_pieces) = first.get_or_insert_with(|| (sums.clone(), pieces.clone()));
            assert!(sums == *want, "lift {share}: sums");
            assert!(pieces == *want_pieces, "lift {share}: pieces");
        }
    }
}

/// Lloyd steps together and one by one, and then quasi-Newton steps, on the device and on the host.
#[needs(gpu)]
#[test]
fn seeds_move_as_on_the_host() {
    let gpu = require_gpu!();
    let parallel = Parallel::new(Some(2)).unwrap();
    let mesh = Shape::Torus.build(3000);
    let uneven: Vec<f64> = (0..mesh.positions().len()).map(|v| 0.2 + (v % 5) as f64).collect();
    for (weights, share) in [(None, 0.1), (Some(&uneven[..]), 0.3)] {
        let surface = lifted(&mesh, weights, share);
        // No step is taken where a cell is empty.
        let (mut seeds, mut sums) = (seeds_on(&surface, 600, 9), CellSums::default());
        let mut session = parallel.lifted_session(Arc::clone(&surface), SessionOptions::new(600)).unwrap();
        session.set_seeds(&seeds).unwrap();
        session.sums(&mut sums, &Token::default()).unwrap();
        let mut areas = sums.area.iter();
        seeds.retain(|_| areas.next().is_some_and(|&area| area > 0.0));
        let held: Vec<bool> = (0..seeds.len()).map(|i| i % 50 == 0).collect();
        let run = |backend: &dyn Backend, together| {
            let tuning = Tuning::new().with_together(Together::AtMost(together));
            let options = SessionOptions::new(seeds.len()).with_tuning(tuning);
            let mut session = backend.lifted_session(Arc::clone(&surface), options).unwrap();
            session.set_seeds(&seeds).unwrap();
            let moving = session.resident().unwrap();
            moving.hold(&held).unwrap();
            let mut evaluations = Vec::new();
            while evaluations.len() < 8 {
                moving.relax(8 - evaluations.len(), &mut evaluations, &Token::default()).unwrap();
            }
            let relaxed = read(moving);
            let mut energies: Vec<f64> = evaluations.iter().map(|e| e.energy).collect();
            energies.extend(minimise(moving, 0, 3).0);
            (relaxed, energies, read(moving))
        };
        let (host, device, one_by_one) = (run(&parallel, 1), run(gpu, 8), run(gpu, 1));
        assert!(device == run(gpu, 8), "lift {share}: a second run");
        assert!(device == one_by_one, "lift {share}: steps one by one");
        let spacing = (surface.area() / seeds.len() as f64).sqrt();
        let apart = host.0.iter().zip(&device.0).map(|(a, b)| a.distance(*b) / spacing).fold(0.0, f64::max);
        println!("lift {share}: {apart:.1e} of the spacing apart; energies {:?} and {:?}", host.1, device.1);
        // Each step repeats the rounding of single precision, 1e-6 of the spacing, and may amplify it a little.
        assert!(apart < 1e-4, "lift {share}: {apart:e}");
        assert!(device.1[8] < 0.8 * device.1[0], "lift {share}: {:?}", device.1);
        assert!(held.iter().enumerate().all(|(i, &held)| !held || device.2[i].distance(seeds[i]) < 1e-11));
        for (a, b) in host.1.iter().zip(&device.1) {
            assert!((a / b - 1.0).abs() < 1e-4, "lift {share}: energies {a:e} and {b:e}");
        }
        assert!(device.1.windows(2).all(|w| w[1] <= w[0] * (1.0 + 1e-6)), "lift {share}: {:?}", device.1);
    }
}
