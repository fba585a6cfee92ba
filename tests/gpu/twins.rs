//! Promise: each stage below, alone, does on the device what its twin here does in double precision or integers.
//!
//! | stage of `shaders/` | twin |
//! | --- | --- |
//! | `neighbours/count`, `offsets`, `scatter`, `duplicates` | [`neighbours`]: a histogram of the grid's cells, its sums, a map of places |
//! | `neighbours/search`, `first_cells`, `from_lists` | `knn::SeedIndex` (`resident.rs`) |
//! | `neighbours/lengthen` | [`lengthen`]: the order of all seeds by distance, and where a row may end |
//! | `clip/clip` with all it imports | [`clip`]: the reference's clip of one facet, `rvd::clip` through `Serial` |
//! | `clip/divide` | [`divide`]: all pieces of the reference, added up facet by facet |
//! | `clip/reach`, `verify` | [`by_cell`]: the closest point of a triangle and all seeds; a set of named pairs |
//! | `clip/checks`: fixed-point sums, sets of cells | 64-bit integers, a set (`helpers.rs`) |
//! | `optimizer/*` | [`optimizer`]: functions of the same names |
//! | the two-loop recursion on dot products | the recursion on vectors (`rvd/gpu/optimizer/history.rs`, which is of the host) |
//!
//! What makes arguments (`enqueue`, `indirect_arguments`, `overflow`) has no twin: it decides when pairs are clipped. The whole
//! pass has the same bits whichever ran: `common/conformance`, and `strategies.rs`.

use std::collections::HashSet;
use std::sync::Arc;

use ::gpu::Device;
use ::gpu::diagram::layout::{DOTS, Facet, NONE, PAIRS, Params, SUM_WORDS, Seed, split};
use ::gpu::diagram::plan;
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::rvd::Surface;

use crate::stage::Stage;

macro_rules! require_device {
    () => {
        match crate::gpu::device() {
            Some(device) => device,
            None => return,
        }
    };
}

mod by_cell;
mod clip;
mod divide;
mod lengthen;
mod neighbours;
mod optimizer;

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

/// The record of a seed whose row is not known.
fn record(place: [f64; 3]) -> Seed {
    let (hi, lo) = split(place);
    Seed { hi, lo, ..Seed::default() }
}

/// All other seeds, nearest first; of those in one place the first alone.
fn others(seeds: &[Seed], i: usize) -> Vec<u32> {
    let key = |j: u32| seeds[i].key(&seeds[j as usize]);
    let mut places = HashSet::new();
    // Zeros of both signs are one place.
    let mut is_first = |j: usize| places.insert(seeds[j].position().map(|x| (x + 0.0).to_bits()));
    let firsts = (0..seeds.len()).filter(|&j| is_first(j));
    let mut row: Vec<u32> = firsts.filter(|&j| j != i).map(|j| j as u32).collect();
    // Squares are in the order of their bits.
    row.sort_by_cached_key(|&j| (key(j).to_bits(), j));
    row
}

/// An entry of the list of failures, as `shared/failure` packs it.
fn failure_entry(facet: u32, seed: u32, first: bool, code: u32) -> [u32; 2] {
    [facet | (code & 1) << 31, seed | u32::from(first) << 30 | (code >> 1) << 31]
}

/// Enters a cell that is not there into a facet's slots, which `shared/cell_set` fills from the place of a hash on.
fn enter_cell(slots: &mut [u32], seed: u32, flag: u32) {
    let mask = slots.len() - 1;
    let mut at = (seed.wrapping_mul(2_654_435_769) >> 8) as usize & mask;
    while slots[at] != 0 {
        at = (at + 1) & mask;
    }
    slots[at] = (seed + 1) | flag;
}

/// The record of a facet, with uniform weights or those of the surface. The cells that it meets are in so many slots.
fn facet_of(surface: &Surface, f: usize, slots: u32) -> Facet {
    let [a, b, c] = surface.facets()[f].map(|v| surface.positions()[v as usize]);
    let e1 = (b - a).normalize();
    let n = (b - a).cross(c - a).normalize();
    let e2 = n.cross(e1);
    let (hi, lo) = split(a.to_array());
    let [wa, wb, wc] = surface.facets()[f].map(|v| surface.weights()[v as usize]);
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
