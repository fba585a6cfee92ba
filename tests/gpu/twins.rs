//! Promise: each stage below, alone, does on the device what its twin here does in double precision or integers.
//!
//! | stage of `shaders/` | twin |
//! | --- | --- |
//! | `neighbours/count`, `offsets`, `scatter`, `duplicates` | [`cell_of`], a histogram and its sums, a map of places |
//! | `neighbours/search`, `first_cells` | `knn::SeedIndex` (`resident.rs`) |
//! | `clip/clip` with all it imports | the reference's clip of one facet, `rvd::clip` through `Serial` |
//! | `clip/checks`: fixed-point sums, sets of cells | 64-bit integers, a set (`helpers.rs`) |
//! | `optimizer/gradient`, `totals` | [`gradient`], [`totals`] |
//! | `optimizer/partial_dots`, `dots` | [`dots`] |
//! | the two-loop recursion on those products | the recursion on vectors (`rvd/gpu/optimizer/history.rs`, which is of the host) |
//! | `optimizer/direction` | [`direction`] |
//! | `optimizer/trial`, `accept`, `centroids` | [`moved`] and differences |
//! | `optimizer/may_step` | [`may_step`] |
//!
//! The other stages (`divide`, `reach`, `verify`, `lengthen`, `from_lists`, and what makes arguments) only choose which pairs are
//! clipped and when. Their twin is the whole pass: `common/conformance`, and `strategies.rs`, with the same bits whichever ran.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use glam::{DVec3, Vec3, dvec3};
use needs::needs;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::internals::gpu::Device;
use tessera::internals::rvd::layout::{
    COMPLETE, DOTS, Facet, ListState, NONE, OptimizerParams, PAIRS, PLAIN_DOTS, Params, ROOT, SUM_WORDS, Seed, Sorted,
    State, Totals, halt, split,
};
use tessera::internals::rvd::plan;
use tessera::mesh::TriMesh;
use tessera::rvd::{Backend, CellSums, Serial, SessionOptions, Surface};
use tessera::token::Token;

use crate::gpu;
use crate::stage::{Stage, records, words};

macro_rules! require_device {
    () => {
        match gpu::device() {
            Some(device) => device,
            None => return,
        }
    };
}

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn stage(device: &Arc<Device>, name: &str) -> Stage {
    let constants = [("PAIRS", PAIRS as i64), ("DOTS", DOTS as i64), ("PART", plan::SEARCH_PART as i64)];
    Stage::new(device, name, "main", &constants)
}

fn floats(rng: &mut ChaCha8Rng, count: usize) -> Vec<f32> {
    (0..count).map(|_| rng.random::<f32>() - 0.5).collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|x| x.to_bits()).collect()
}

/// Within so much of the sum of what was added up.
fn near(name: &str, got: f32, want: f64, added: f64) {
    assert!((f64::from(got) - want).abs() <= 1e-5 * added + 1e-12, "{name}: {got:e} for {want:e}");
}

// ---------------------------------------------------------------------------------------------------------------- neighbours

/// `cell_at(place_of(p))` of `shaders/shared/place.wgsl`.
fn cell_of(p: Vec3, side: u32) -> u32 {
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
        let seeds: Vec<Seed> = places
            .iter()
            .map(|&p| {
                let (hi, lo) = split(p);
                Seed { hi, lo, ..Seed::default() }
            })
            .collect();
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

// ---------------------------------------------------------------------------------------------------------------------- clip

/// The record of the one facet of a surface, with uniform weights or those of the surface.
fn facet_of(surface: &Surface, slots: u32) -> Facet {
    let [a, b, c] = surface.facets()[0].map(|v| surface.positions()[v as usize]);
    let e1 = (b - a).normalize();
    let n = (b - a).cross(c - a).normalize();
    let e2 = n.cross(e1);
    let (hi, lo) = split(a.to_array());
    let [wa, wb, wc] = surface.facets()[0].map(|v| surface.weights()[v as usize]);
    let (corner1_u, corner2_u, corner2_v) = ((b - a).length(), (c - a).dot(e1), (c - a).dot(e2));
    let weight_u = (wb - wa) / corner1_u;
    let weight_v = (wc - wa - weight_u * corner2_u) / corner2_v;
    let of = |v: DVec3| v.as_vec3().to_array();
    Facet {
        hi,
        lo,
        slot_begin: 0,
        slot_mask: slots - 1,
        e1: of(e1),
        e2: of(e2),
        n: of(n),
        corner1_u: corner1_u as f32,
        corner2_u: corner2_u as f32,
        corner2_v: corner2_v as f32,
        weight: wa as f32,
        weight_u: weight_u as f32,
        weight_v: weight_v as f32,
        weight_top: wa.max(wb).max(wc) as f32,
    }
}

/// Units of the sums.
const SCALE: f32 = (1u64 << 40) as f32;

fn clip_params(seeds: usize, list: usize, uniform: bool) -> Params {
    Params {
        mass_scale: SCALE,
        moment_scale: SCALE,
        energy_scale: SCALE,
        area_scale: SCALE,
        uniform_weights: u32::from(uniform),
        list_capacity: list as u32,
        batch: list as u32,
        polygon: 10,
        seeds: seeds as u32,
        divided: NONE,
        ..Params::default()
    }
}

/// Fixed-point sums as doubles: mass, moment, energy, area.
fn sums_of(words: &[u32], seed: usize) -> [f64; 6] {
    [0, 1, 2, 3, 4, 5].map(|which| {
        let at = seed * SUM_WORDS + 2 * which;
        ((u64::from(words[at]) | u64::from(words[at + 1]) << 32) as i64) as f64 / f64::from(SCALE)
    })
}

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
        let mut seeds: Vec<Seed> = given
            .iter()
            .map(|p| {
                let (hi, lo) = split(p.to_array());
                Seed { hi, lo, ..Seed::default() }
            })
            .collect();
        for i in 0..n {
            let mut row: Vec<u32> = (0..n as u32).filter(|&j| j as usize != i).collect();
            row.sort_by(|&a, &b| {
                let of = |j: u32| seeds[i].key(&seeds[j as usize]);
                of(a).total_cmp(&of(b)).then(a.cmp(&b))
            });
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
            words(&[facet_of(&surface, 128)]),
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

// ----------------------------------------------------------------------------------------------------------------- optimizer

/// Sums of cells in units: some without area, some held, some with moments of either sign.
struct Cells {
    words: Vec<u32>,
    mass: Vec<i64>,
    moment: Vec<[i64; 3]>,
    energy: Vec<i64>,
    area: Vec<i64>,
}

fn cells(rng: &mut ChaCha8Rng, n: usize) -> Cells {
    let mut all = Cells { words: Vec::new(), mass: vec![], moment: vec![], energy: vec![], area: vec![] };
    for i in 0..n {
        let area = if i % 17 == 3 { i64::from(rng.random_range(-2..=0)) } else { rng.random_range(1..1 << 40) };
        let mass = if area > 0 { rng.random_range(1..1 << 44) } else { 0 };
        let moment = [0; 3].map(|_| rng.random_range(-(1i64 << 45)..1 << 45));
        let energy = rng.random_range(0..1 << 46);
        for sum in [mass, moment[0], moment[1], moment[2], energy, area] {
            all.words.extend([sum as u32, (sum >> 32) as u32]);
        }
        all.mass.push(mass);
        all.moment.push(moment);
        all.energy.push(energy);
        all.area.push(area);
    }
    all
}

/// `optimizer/gradient`: ∇E of each seed.
fn gradient(cells: &Cells, held: &[u32], unit: f64) -> Vec<f64> {
    let of = |i: usize| cells.moment[i].map(|m| if held[i] != 0 { 0.0 } else { unit * m as f64 });
    (0..held.len()).flat_map(of).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Σ |a b|, which rounding is measured by.
fn size(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a * b).abs()).sum()
}

fn doubles(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&x| f64::from(x)).collect()
}

/// `optimizer/totals`: energy, area and empty cells.
fn totals(cells: &Cells) -> (i64, i64, u32) {
    (cells.energy.iter().sum(), cells.area.iter().sum(), cells.area.iter().filter(|&&a| a <= 0).count() as u32)
}

#[needs(gpu)]
#[test]
fn gradients_and_totals_are_those_of_the_sums() {
    let device = require_device!();
    let [gradients, reduction] = ["optimizer/gradient", "optimizer/totals"].map(|name| stage(&device, name));
    for (n, groups) in [(1, 1), (63, 1), (64, 1), (1000, 3), (4097, 70)] {
        let mut rng = rng(n as u64);
        let cells = cells(&mut rng, n);
        let held: Vec<u32> = (0..n as u32).map(|i| u32::from(i % 5 == 2)).collect();
        let direction = floats(&mut rng, 3 * n);
        let unit = -2.0 / f64::from(SCALE);
        for directed in [0, 1] {
            let params = OptimizerParams {
                seeds: n as u32,
                groups,
                directed,
                gradient_unit: unit as f32,
                ..OptimizerParams::default()
            };
            let partial = vec![0; size_of::<Totals>() / 4 * groups as usize];
            let got = gradients.run(
                groups,
                &[words(&[params]), cells.words.clone(), held.clone(), bits(&direction), vec![0; 3 * n], partial],
            );
            let want = gradient(&cells, &held, unit);
            for (e, (got, want)) in records::<f32>(&got[4]).into_iter().zip(&want).enumerate() {
                near(&format!("{n} seeds, component {e}"), got, *want, want.abs());
            }
            let told = reduction.run(1, &[words(&[params]), got[5].clone(), vec![0; size_of::<Totals>() / 4]]);
            let told = records::<Totals>(&told[2])[0];
            let (energy, area, empty) = totals(&cells);
            let whole = |low: u32, high: u32| (u64::from(low) | u64::from(high) << 32) as i64;
            assert_eq!(whole(told.energy_low, told.energy_high), energy, "{n} seeds: energy");
            assert_eq!(whole(told.area_low, told.area_high), area, "{n} seeds: area");
            assert_eq!(told.empty, empty, "{n} seeds: empty cells");
            near("|g|²", told.gradient_squared, dot(&want, &want), dot(&want, &want));
            let direction = doubles(&direction);
            let slope = if directed == 1 { dot(&want, &direction) } else { 0.0 };
            near("slope", told.slope, slope, size(&want, &direction));
        }
    }
}

/// `shaders/shared/precondition.wgsl`, a component at a time.
fn preconditioner(cells: &Cells, uniform: bool, mean: f64) -> Vec<f64> {
    let of = |i: usize| if uniform { cells.area[i] } else { cells.mass[i] };
    (0..cells.area.len()).flat_map(|i| [if of(i) > 0 { mean / of(i) as f64 } else { 0.0 }; 3]).collect()
}

fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a * b).collect()
}

/// `optimizer/partial_dots` and `dots`: every product and the size of what was added up; `None` for a slot out of use.
fn dots(steps: &[Vec<f64>], changes: &[Vec<f64>], g: &[f64], slot: usize, used: u32, light: &[f64]) -> Vec<(f64, f64)> {
    let zero = vec![0.0; g.len()];
    let kept = |all: &[Vec<f64>], k: usize| if used >> k & 1 == 1 { all[k].clone() } else { zero.clone() };
    let newest = [steps[slot].clone(), changes[slot].clone(), g.to_vec()];
    let vectors: Vec<Vec<f64>> =
        (0..PAIRS).map(|k| kept(steps, k)).chain((0..PAIRS).map(|k| kept(changes, k))).chain([g.to_vec()]).collect();
    let both = |a: &[f64], b: &[f64]| (dot(a, b), size(a, b));
    let mut all: Vec<(f64, f64)> = vectors.iter().flat_map(|v| newest.iter().map(|last| both(v, last))).collect();
    assert_eq!(all.len(), PLAIN_DOTS);
    for k in 0..PAIRS {
        let light = product(light, &kept(changes, k));
        all.extend((k..PAIRS).map(|j| both(&light, &kept(changes, j))));
        all.push(both(&light, g));
    }
    assert_eq!(all.len(), DOTS);
    all
}

/// `optimizer/direction`: steps, and changes and the gradient divided by masses, by their coefficients.
fn direction(steps: &[Vec<f64>], changes: &[Vec<f64>], g: &[f64], c: &[f64], light: &[f64]) -> Vec<f64> {
    let of = |e: usize| {
        let sum = |all: &[Vec<f64>], c: &[f64]| -> f64 {
            all.iter().zip(c).filter(|(_, c)| **c != 0.0).map(|(v, c)| c * v[e]).sum()
        };
        light[e] * (sum(changes, &c[PAIRS..2 * PAIRS]) + c[2 * PAIRS] * g[e]) + sum(steps, &c[..PAIRS])
    };
    (0..g.len()).map(of).collect()
}

#[needs(gpu)]
#[test]
fn products_and_direction_of_the_two_loops_are_those_of_the_vectors() {
    let device = require_device!();
    let [partial, adding, combining] =
        ["partial_dots", "dots", "direction"].map(|name| stage(&device, &format!("optimizer/{name}")));
    for (n, groups, uniform, used) in [(1, 1, true, 1u32), (100, 2, false, 0b1011), (3000, 47, true, 0xff)] {
        let mut rng = rng(n as u64);
        let cells = cells(&mut rng, n);
        let mean = (1u64 << 39) as f32;
        // A slot out of use holds no numbers.
        let mut history = || -> Vec<Vec<f32>> {
            let slots = 0..PAIRS;
            slots.map(|k| if used >> k & 1 == 1 { floats(&mut rng, 3 * n) } else { vec![f32::NAN; 3 * n] }).collect()
        };
        let (steps, changes) = (history(), history());
        let g = floats(&mut rng, 3 * n);
        let slot = used.trailing_zeros();
        // Those of vectors in use alone, and of the gradient.
        let mut c = vec![0.0f32; 20];
        for k in (0..PAIRS).filter(|k| used >> k & 1 == 1) {
            c[k] = rng.random::<f32>() - 0.5;
            c[PAIRS + k] = rng.random::<f32>() - 0.5;
        }
        c[2 * PAIRS] = -1.0;
        let mut coefficients = [[0.0; 4]; 5];
        coefficients.iter_mut().flatten().zip(&c).for_each(|(to, from)| *to = *from);
        let params = OptimizerParams {
            seeds: n as u32,
            groups,
            slot,
            used,
            uniform_weights: u32::from(uniform),
            mean_mass: mean,
            coefficients,
            ..OptimizerParams::default()
        };
        let flat = |all: &[Vec<f32>]| bits(&all.concat());
        let parts = partial.run(
            groups,
            &[
                words(&[params]),
                cells.words.clone(),
                flat(&steps),
                flat(&changes),
                bits(&g),
                vec![0; DOTS * groups as usize],
            ],
        );
        let got = adding.run(1, &[words(&[params]), parts[5].clone(), vec![0; DOTS]]);
        let light = preconditioner(&cells, uniform, f64::from(mean));
        let [s, y] = [&steps, &changes].map(|all| all.iter().map(|v| doubles(v)).collect::<Vec<_>>());
        let want = dots(&s, &y, &doubles(&g), slot as usize, used, &light);
        for (d, (got, (want, size))) in records::<f32>(&got[2]).into_iter().zip(want).enumerate() {
            near(&format!("{n} seeds, product {d}"), got, want, size);
        }

        let got = combining.run(
            groups,
            &[
                words(&[params]),
                flat(&steps),
                flat(&changes),
                bits(&g),
                vec![0; 3 * n],
                vec![0; groups as usize],
                cells.words.clone(),
            ],
        );
        let want = direction(&s, &y, &doubles(&g), &doubles(&c), &light);
        let d = records::<f32>(&got[4]);
        for (e, (&got, &want)) in d.iter().zip(&want).enumerate() {
            near(&format!("{n} seeds, component {e}"), got, want, 16.0 * (1.0 + light[e]));
        }
        let slope: f64 = records::<f32>(&got[5]).iter().map(|&x| f64::from(x)).sum();
        near("slope", slope as f32, dot(&doubles(&g), &doubles(&d)), size(&doubles(&g), &doubles(&d)));
    }
}

/// `shaders/shared/moved.wgsl`: where a seed is after a move.
fn moved(seed: &Seed, by: [f64; 3]) -> [f64; 3] {
    let at = seed.position();
    [0, 1, 2].map(|k| at[k] + by[k])
}

fn some_seeds(rng: &mut ChaCha8Rng, n: usize) -> Vec<Seed> {
    let of = |_| {
        let (hi, lo) = split([0; 3].map(|_| rng.random::<f64>() - 0.5));
        Seed { hi, lo, ..Seed::default() }
    };
    (0..n).map(of).collect()
}

#[needs(gpu)]
#[test]
fn points_move_along_the_direction_and_to_centroids() {
    let device = require_device!();
    let [trial, accept, centroids] =
        ["trial", "accept", "centroids"].map(|name| stage(&device, &format!("optimizer/{name}")));
    let n = 300;
    let groups = 5;
    let mut rng = rng(4);
    let points = some_seeds(&mut rng, n);
    let d = floats(&mut rng, 3 * n);
    let params = OptimizerParams { seeds: n as u32, groups, step: 0.37, slot: 2, ..OptimizerParams::default() };
    let tried = trial.run(groups, &[words(&[params]), words(&points), bits(&d), vec![0; 8 * n]]);
    let seeds: Vec<Seed> = records(&tried[3]);
    // Of a step, and of where a seed is at all: 2⁻⁵².
    let close = |name: &str, got: [f64; 3], want: [f64; 3], by: f64| {
        let off = (0..3).map(|k| (got[k] - want[k]).abs()).fold(0.0, f64::max);
        assert!(off <= 2e-7 * by + 1e-12, "{name}: off by {off:e}");
    };
    for i in 0..n {
        let by = [0, 1, 2].map(|k| 0.37 * f64::from(d[3 * i + k]));
        close(&format!("trial {i}"), seeds[i].position(), moved(&points[i], by), 0.37);
        // As the host splits them, so that differences of upper parts are exact.
        assert!(seeds[i].hi.iter().all(|x| (x * 4096.0).fract() == 0.0), "{:?}", seeds[i]);
    }

    let (ahead, here) = (floats(&mut rng, 3 * n), floats(&mut rng, 3 * n));
    let room = vec![0; 3 * n * PAIRS];
    let accepted = accept.run(
        groups,
        &[words(&[params]), tried[3].clone(), words(&points), bits(&ahead), bits(&here), room.clone(), room],
    );
    assert_eq!(accepted[4], bits(&ahead), "the gradient is the one ahead");
    let [steps, changes] = [5, 6].map(|k| records::<f32>(&accepted[k]));
    for e in 0..3 * n {
        let at = 3 * n * 2 + e;
        let step = seeds[e / 3].position()[e % 3] - points[e / 3].position()[e % 3];
        near("step", steps[at], step, step.abs());
        assert_eq!(changes[at], ahead[e] - here[e]);
    }
    assert!(steps[..3 * n * 2].iter().chain(&steps[3 * n * 3..]).all(|x| *x == 0.0), "other slots stay");

    let cells = cells(&mut rng, n);
    let held: Vec<u32> = (0..n as u32).map(|i| u32::from(i % 7 == 1)).collect();
    let per_mass = 1024.0f32;
    let params = OptimizerParams { moment_per_mass: per_mass, ..params };
    for halted in [0, halt::INCOMPLETE] {
        let state = State { halt: halted, ..State::default() };
        let got = centroids
            .run(groups, &[words(&[params]), cells.words.clone(), held.clone(), words(&points), words(&[state])]);
        for (i, seed) in records::<Seed>(&got[3]).iter().enumerate() {
            if halted != 0 || held[i] != 0 || cells.mass[i] <= 0 {
                assert_eq!(*seed, points[i], "seed {i} stays");
                continue;
            }
            let by = cells.moment[i].map(|m| m as f64 / (cells.mass[i] as f64 * f64::from(per_mass)));
            let most = by.iter().fold(0.0f64, |most, x| most.max(x.abs()));
            // A long way is split as the host does it only below 2048.
            if most < 1.0 {
                close(&format!("centroid {i}"), seed.position(), moved(&points[i], by), 2.0 * most);
            }
        }
    }
}

/// `optimizer/may_step`: whether nothing is left to the host.
fn may_step(state: &State, totals: &Totals, [least, most]: [u64; 2]) -> bool {
    let area = u64::from(totals.area_low) | u64::from(totals.area_high) << 32;
    let full = state.list_overflow + state.cells_overflow != 0;
    let open = state.head < state.length || state.failures != state.requeued;
    let searched = state.near != 0 && state.unproved == 0;
    !full && !open && searched && (least..=most).contains(&area) && totals.empty == 0
}

#[needs(gpu)]
#[test]
fn a_step_follows_a_pass_that_is_complete() {
    let device = require_device!();
    let stage = stage(&device, "optimizer/may_step");
    let good = State { head: 9, length: 9, near: 1, failures: 2, requeued: 2, ..State::default() };
    let (least, most) = (0x1_0000_0005u64, 0x2_0000_0003u64);
    let limbs = |x: u64| [x as u32, (x >> 32) as u32];
    let params = OptimizerParams { least_area: limbs(least), most_area: limbs(most), ..OptimizerParams::default() };
    let states = [
        good,
        State { list_overflow: 1, ..good },
        State { cells_overflow: 1, ..good },
        State { length: 10, ..good },
        State { failures: 3, ..good },
        State { near: 0, ..good },
        State { unproved: 1, ..good },
    ];
    let areas = [0, least - 1, least, least + 1, 0x1_ffff_ffff, 0x2_0000_0000, most, most + 1, u64::MAX, 1 << 63];
    let mut taken = 0;
    for state in states {
        for (area, empty) in areas.into_iter().flat_map(|area| [(area, 0), (area, 1)]) {
            let [area_low, area_high] = limbs(area);
            let totals = Totals { area_low, area_high, empty, ..Totals::default() };
            let got = stage.run(1, &[words(&[params]), words(&[totals]), words(&[state])]);
            let halted = records::<State>(&got[2])[0].halt;
            let may = may_step(&state, &totals, [least, most]);
            assert_eq!(halted, if may { 0 } else { halt::INCOMPLETE }, "{state:?}, {totals:?}");
            taken += u32::from(may);
        }
    }
    assert_eq!(taken, 5);
}
