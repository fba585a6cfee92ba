//! Promise: gradients, products, directions and moved seeds are those of double precision, totals and decisions those of integers.

use ::gpu::diagram::layout::{DOTS, OptimizerParams, PAIRS, PLAIN_DOTS, Seed, State, Totals, halt, split};
use needs::needs;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{SCALE, bits, floats, near, rng, stage};
use crate::stage::{records, words};

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
