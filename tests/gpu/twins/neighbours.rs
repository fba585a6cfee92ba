//! Promise: the grid of the seeds is a histogram and its sums, and later duplicates name the first seed in their place.

use std::collections::{HashMap, HashSet};

use ::gpu::diagram::layout::{ListState, Params, Seed, Sorted, State, halt};
use ::gpu::diagram::plan;
use glam::Vec3;
use needs::needs;
use rand::RngExt;

use super::{record, rng, stage};
use crate::stage::{records, words};

/// `cell_at(place_of(p))` of `shaders/shared/place.wgsl`.
pub fn cell_of(p: Vec3, side: u32) -> u32 {
    let at = ((p + 0.5) * side as f32).clamp(Vec3::ZERO, Vec3::splat(side as f32 - 1.0));
    let [x, y, z] = at.to_array().map(|c| c as u32);
    (z * side + y) * (side + 1) + x
}

#[needs(gpu)]
#[test]
fn the_grid_holds_every_seed_once_where_it_is() {
    let device = require_device!();
    let [count, offsets, scatter, duplicates] =
        ["count", "offsets", "scatter", "duplicates"].map(|name| stage(&device, &format!("neighbours/{name}")));
    for (n, side, wide) in [(1, 1, 1.0), (64, 3, 1.0), (1000, 7, 1.0), (5000, 12, 0.3), (777, 5, 6.0)] {
        let mut rng = rng(n as u64);
        let mut point = || [0; 3].map(|_| (rng.random::<f64>() - 0.5) * wide);
        let mut places: Vec<[f64; 3]> = (0..n).map(|_| point()).collect();
        // Some in one place, as the first of them.
        (0..n / 10).for_each(|k| places[n - 1 - k] = places[k / 2]);
        let seeds: Vec<Seed> = places.iter().map(|&p| record(p)).collect();
        let params = Params { seeds: n as u32, side, ..Params::default() };
        let cells = (side * side * (side + 1)) as usize;
        let parts = (n as u64).div_ceil(plan::SEARCH_PART) as usize;
        let list_state = vec![0; size_of::<ListState>() / 4 + 6 * parts + n];
        let groups = (n as u32).div_ceil(64);
        let state = words(&[State::default()]);
        let counted = count.run(
            groups,
            &[words(&[params]), words(&seeds), vec![0; cells], state, vec![0; 4 * n], list_state, vec![0; cells]],
        );
        let seeds: Vec<Seed> = records(&counted[1]);
        let mut histogram = vec![0; cells];
        for seed in &seeds {
            let cell = cell_of(Vec3::from(seed.hi) + Vec3::from(seed.lo), side);
            assert_eq!(seed.row_length, cell, "{n} seeds: the cell");
            histogram[cell as usize] += 1;
        }
        assert_eq!(counted[2], histogram, "{n} seeds: counts");
        let found = records::<State>(&counted[3])[0];
        assert_eq!(found.halt & halt::FAR != 0, places.iter().flatten().any(|x| x.abs() > 8.0));

        let placed = offsets.run(
            (side * side).div_ceil(64),
            &[words(&[params]), counted[2].clone(), counted[3].clone(), counted[5].clone(), vec![0; 3 * parts]],
        );
        assert_eq!(records::<State>(&placed[2])[0].cursor, n as u32, "all are given a place");
        // Lines of cells come in any order; within a line cells follow each other.
        let mut begins = Vec::new();
        for line in 0..(side * side) as usize {
            let first = line * (side as usize + 1);
            for x in 0..side as usize {
                let [begin, end] = [placed[1][first + x], placed[1][first + x + 1]];
                assert_eq!(end - begin, histogram[first + x], "{n} seeds: cell {x} of line {line}");
                begins.extend(begin..end);
            }
        }
        begins.sort_unstable();
        assert_eq!(begins, (0..n as u32).collect::<Vec<_>>(), "each place once");

        let scattered = scatter
            .run(groups, &[words(&[params]), counted[1].clone(), placed[1].clone(), vec![0; 8 * n], placed[2].clone()]);
        let sorted: Vec<Sorted> = records(&scattered[3]);
        assert_eq!(sorted.iter().map(|s| s.seed).collect::<HashSet<_>>().len(), n, "{n} seeds: each once");
        for (at, entry) in sorted.iter().enumerate() {
            let seed = &seeds[entry.seed as usize];
            assert_eq!((entry.hi, entry.lo, entry.first), (seed.hi, seed.lo, seed.row_length));
            let cell = seed.row_length as usize;
            assert!((placed[1][cell]..placed[1][cell + 1]).contains(&(at as u32)), "{n} seeds: its cell has it");
        }

        let told =
            duplicates.run(groups, &[words(&[params]), placed[1].clone(), scattered[3].clone(), scattered[4].clone()]);
        let mut first_at: HashMap<[u32; 6], u32> = HashMap::new();
        let place = |seed: &Seed| {
            let [a, b, c] = seed.hi.map(f32::to_bits);
            let [d, e, f] = seed.lo.map(f32::to_bits);
            [a, b, c, d, e, f]
        };
        for i in (0..n).rev() {
            first_at.insert(place(&seeds[i]), i as u32);
        }
        for entry in records::<Sorted>(&told[2]) {
            assert_eq!(entry.first, first_at[&place(&seeds[entry.seed as usize])], "seed {}", entry.seed);
        }
        assert_eq!(records::<State>(&told[3])[0].duplicates as usize, n - first_at.len());
    }
}
