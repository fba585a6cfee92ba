//! Promise: the pieces of one facet are the reference's, whichever variant of the stage clips them.

use std::sync::Arc;

use ::gpu::diagram::layout::{COMPLETE, ROOT, SUM_WORDS, Seed, State};
use glam::{DVec3, dvec3};
use needs::needs;
use rand::RngExt;
use tessera::mesh::TriMesh;
use tessera::rvd::{Backend, CellSums, Serial, SessionOptions, Surface};
use tessera::token::Token;

use super::{clip_params, facet_of, others, record, rng, sums_of};
use crate::stage::{Stage, records, words};

#[needs(gpu)]
#[test]
fn the_clip_of_one_facet_is_the_references() {
    let device = require_device!();
    let variants = [0, 1].map(|shared| {
        let constants = [("SLOTS", 10), ("ARRAY", 0), ("SHARED", shared), ("WIDE", 0)];
        Stage::new(&device, "clip/clip", "main", &constants)
    });
    let array = Stage::new(&device, "clip/clip", "main", &[("SLOTS", 64), ("ARRAY", 1), ("SHARED", 0), ("WIDE", 0)]);
    for round in 0..12u64 {
        let mut rng = rng(round);
        let mut point = |size: f64| dvec3(rng.random::<f64>(), rng.random::<f64>(), rng.random::<f64>()) * size;
        let mesh = TriMesh::new(vec![point(1.0), point(1.0), point(1.0)], vec![[0, 1, 2]]).unwrap();
        let weights = [0.3, 1.0, 0.6];
        let uniform = round % 2 == 0;
        let surface = Arc::new(Surface::new(&mesh, (!uniform).then_some(&weights[..])).unwrap());
        let n = [1, 2, 3, 8, 20, 40][round as usize % 6];
        let given: Vec<DVec3> = (0..n).map(|_| point(1.0) - DVec3::splat(0.5)).collect();

        // Every seed's row has all others, nearest first.
        let mut table = Vec::new();
        let mut seeds: Vec<Seed> = given.iter().map(|p| record(p.to_array())).collect();
        for i in 0..n {
            let row = others(&seeds, i);
            (seeds[i].row_begin, seeds[i].row_length) = (table.len() as u32, row.len() as u32 | COMPLETE);
            table.extend(row);
        }
        table.push(0);
        // A facet's first cell is that of the seed nearest to its centroid, which no pair of the others is.
        let middle = surface.centroid(0);
        let nearest = (0..n).min_by(|&a, &b| given[a].distance(middle).total_cmp(&given[b].distance(middle))).unwrap();
        let mut list: Vec<[u32; 2]> = (0..n).map(|i| [0, i as u32 | if i == nearest { ROOT } else { 0 }]).collect();
        list.resize(3 * n, [0, 0]);
        let state = State { end: n as u32, length: n as u32, ..State::default() };
        let buffers = [
            words(&[clip_params(n, 3 * n, uniform)]),
            words(&seeds),
            words(&[facet_of(&surface, 0, 128)]),
            table,
            vec![0; 128],
            words(&list),
            vec![0; SUM_WORDS * n],
            vec![0; 6 * n],
            words(&[state]),
        ];

        let mut want = CellSums::default();
        let mut session = Serial.session(Arc::clone(&surface), SessionOptions::new(n)).unwrap();
        session.set_seeds(&given).unwrap();
        let stats = session.sums(&mut want, &Token::default()).unwrap();
        let mut first: Option<Vec<u32>> = None;
        for (stage, name) in variants.iter().chain([&array]).zip(["direct", "shared", "array"]) {
            let got = stage.run((n as u32).div_ceil(64), &buffers);
            let after = records::<State>(&got[8])[0];
            assert_eq!((after.failures, after.cells_overflow), (0, 0), "round {round}, {name}");
            assert!(u64::from(after.pieces).abs_diff(stats.pairs) <= 1, "round {round}, {name}: {after:?}, {stats:?}");
            for i in 0..n {
                let [mass, x, y, z, energy, area] = sums_of(&got[6], i);
                let mass = if uniform { area } else { mass };
                let near = |what: &str, got: f64, want: f64| {
                    assert!((got - want).abs() < 2e-6, "round {round}, {name}, cell {i}: {what} {got} for {want}");
                };
                near("area", area, want.area[i]);
                near("mass", mass, want.mass[i]);
                near("energy", energy, want.energy[i]);
                assert!((dvec3(x, y, z) - want.moment[i]).length() < 2e-6, "round {round}, {name}, cell {i}: moment");
            }
            // The neighbours across a piece's bisectors were named: each is a cell or was entered for nothing.
            let entered = &records::<[u32; 2]>(&got[5])[n..(after.length as usize).min(3 * n)];
            assert!(entered.iter().all(|&[f, j]| f == 0 && (j as usize) < n), "round {round}, {name}: {entered:?}");
            // Pieces are added by integers: where they meet changes no bit.
            if name != "array" {
                let sums = first.get_or_insert_with(|| got[6].clone());
                assert!(*sums == got[6], "round {round}, {name}: bits");
            }
        }
    }
}
