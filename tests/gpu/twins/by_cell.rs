//! Promise: a seed enters the facets that its cell reaches, as far as its row proves it, and no piece that propagation might not
//! have found passes for proved.

use std::collections::{BTreeMap, BTreeSet};

use ::gpu::diagram::layout::{BY_CELL, COMPLETE, Facet, NONE, Params, ROOT, Seed, State, code, failure};
use glam::{DVec3, Vec3};
use needs::needs;
use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_chacha::ChaCha8Rng;
use tessera::mesh::TriMesh;
use tessera::rvd::Surface;

use super::{enter_cell, facet_of, others, record, rng};
use crate::stage::{Stage, records, words};

/// In a pair's first word: it is a piece, of a facet that cells look for.
const PIECE: u32 = 1 << 31;
/// In a slot: a cell nearer to the facet's centroid has named this one.
const NAMED: u32 = 1 << 31;
/// Lists are longer than they are said to be: what is behind stays.
const UNTOUCHED: u32 = 0xabcd_abcd;

/// The cells in a facet's slots.
fn cells(slots: &[u32]) -> BTreeSet<u32> {
    let taken: Vec<u32> = slots.iter().filter(|s| **s != 0).map(|s| (s & !NAMED) - 1).collect();
    let cells: BTreeSet<u32> = taken.iter().copied().collect();
    assert_eq!(cells.len(), taken.len(), "each cell once");
    cells
}

/// A list with room for `capacity` entries of two words, and what is behind it.
fn list(entries: &[[u32; 2]], capacity: usize) -> Vec<u32> {
    let mut all = words(entries);
    all.resize(2 * capacity.max(entries.len()) + 8, UNTOUCHED);
    all
}

/// What a stage has put into such a list, which counted up to `length`.
fn appended(words: &[u32], before: usize, length: u32, capacity: usize) -> Vec<[u32; 2]> {
    let end = (length as usize).min(capacity);
    assert!(words[2 * capacity.max(before)..].iter().all(|w| *w == UNTOUCHED), "nothing is written behind the list");
    records::<[u32; 2]>(&words[2 * before..2 * end.max(before)])
}

/// `clip/verify`: the pieces but the first of a facet that no cell nearer to its centroid has named.
fn unproved(pairs: &[[u32; 2]], named: &BTreeSet<[u32; 2]>) -> BTreeSet<(u32, u32, u32)> {
    let is_piece = |pair: &&[u32; 2]| pair[0] & PIECE != 0 && pair[1] & ROOT == 0;
    let pieces = pairs.iter().filter(is_piece).map(|&[facet, seed]| [facet & !PIECE, seed]);
    pieces.filter(|pair| !named.contains(pair)).map(|[facet, seed]| (facet, seed, code::FINISH)).collect()
}

/// Slots of so many facets with `cells(f)` cells each, of which half are named. Returns the facets, the slots, all cells and
/// those that are named.
type Sets = (Vec<Facet>, Vec<u32>, Vec<[u32; 2]>, BTreeSet<[u32; 2]>);

fn random_sets(rng: &mut ChaCha8Rng, first: u32, count: u32) -> Sets {
    let (mut facets, mut all_slots, mut pairs, mut named) = (Vec::new(), Vec::new(), Vec::new(), BTreeSet::new());
    for f in 0..count {
        let room = 1u32 << [0, 1, 3, 7][f as usize % 4];
        // Empty, full, or in between.
        let cells = match f % 5 {
            0 => 0,
            1 => room,
            _ => rng.random_range(0..=room),
        };
        let mut slots = vec![0; room as usize];
        // The index 0 and the largest are cells as any other.
        let mut seeds = BTreeSet::from([0, (1 << 30) - 1].map(|seed| seed * (f % 3 / 2)));
        while seeds.len() < 3 * room as usize + 2 {
            seeds.insert(rng.random_range(0..1 << 30));
        }
        let mut seeds: Vec<u32> = seeds.into_iter().collect();
        seeds.shuffle(rng);
        for (k, &seed) in seeds.iter().enumerate() {
            // Those behind are in no slot.
            pairs.push([first + f, seed]);
            if k < cells as usize {
                let flag = if rng.random() { NAMED } else { 0 };
                enter_cell(&mut slots, seed, flag);
                if flag != 0 {
                    named.insert([first + f, seed]);
                }
            }
        }
        let by_cell = if rng.random() { BY_CELL } else { 0 };
        facets.push(Facet { slot_begin: all_slots.len() as u32, slot_mask: (room - 1) | by_cell, ..Facet::default() });
        all_slots.extend(slots);
    }
    (facets, all_slots, pairs, named)
}

#[needs(gpu)]
#[test]
fn pieces_that_no_nearer_cell_has_named_are_not_proved() {
    let device = require_device!();
    let stage = Stage::new(&device, "clip/verify", "main", &[]);
    for round in 0..6u64 {
        let mut rng = rng(round);
        // A window of facets may begin anywhere, and a dispatch may be a part of the pairs.
        let (first, part_first) = ([0, 7000][round as usize % 2], [0, 64, 128][round as usize % 3]);
        let (facets, slots, mut pairs, named) = random_sets(&mut rng, first, 40);
        pairs.shuffle(&mut rng);
        for (k, pair) in pairs.iter_mut().enumerate() {
            pair[0] |= if k % 3 == 0 { 0 } else { PIECE };
            pair[1] |= if k % 7 == 0 { ROOT } else { 0 };
        }
        // Pairs behind those that are to be looked at have no facet here.
        let count = pairs.len() - 9;
        pairs[count..].fill([PIECE | (first + 4000), 5]);
        let want = unproved(&pairs[part_first..count], &named);
        assert!(want.len() > 50, "{}", want.len());
        for capacity in [count, 20] {
            let params = Params {
                list_capacity: capacity as u32,
                emit_count: count as u32,
                facet_first: first,
                part_first: part_first as u32,
                ..Params::default()
            };
            let given = [
                words(&[params]),
                words(&facets),
                slots.clone(),
                words(&pairs),
                list(&[], capacity),
                words(&[State::default()]),
            ];
            let got = stage.run((count - part_first).div_ceil(64) as u32, &given);
            assert!(got[2] == slots && got[3] == given[3], "sets and pairs stay as they are");
            let state = records::<State>(&got[5])[0];
            // Failures that the list has no room for are counted all the same.
            assert_eq!(state, State { failures: want.len() as u32, ..State::default() }, "round {round}");
            let told = appended(&got[4], 0, state.failures, capacity);
            let told: BTreeSet<_> = told.into_iter().map(|entry| failure(entry).unwrap()).collect();
            assert_eq!(told.len(), want.len().min(capacity), "each once");
            assert!(told.is_subset(&want), "round {round}: {told:?}");
        }
    }
}

#[needs(gpu)]
#[test]
fn without_pairs_nothing_is_unproved() {
    let device = require_device!();
    let stage = Stage::new(&device, "clip/verify", "main", &[]);
    let params = Params { list_capacity: 4, ..Params::default() };
    let nothing = [words(&[params]), words(&[Facet::default()]), vec![0], list(&[], 4), list(&[], 4)];
    let given = [&nothing[..], &[words(&[State::default()])]].concat();
    assert_eq!(stage.run(1, &given), given);
}

/// The point of a triangle that is nearest to `p`.
fn nearest_on([a, b, c]: [DVec3; 3], p: DVec3) -> DVec3 {
    let n = (b - a).cross(c - a);
    let foot = p - n * (p - a).dot(n) / n.length_squared();
    let edges = [(a, b), (b, c), (c, a)];
    if edges.iter().all(|&(tail, tip)| (tip - tail).cross(foot - tail).dot(n) >= 0.0) {
        return foot;
    }
    let on_edge = |(tail, tip): (DVec3, DVec3)| {
        let along = tip - tail;
        tail + along * ((p - tail).dot(along) / along.length_squared()).clamp(0.0, 1.0)
    };
    edges.map(on_edge).into_iter().min_by(|x, y| x.distance(p).total_cmp(&y.distance(p))).unwrap()
}

/// `clip/reach`: whether no seed is nearer than `i` to the point of the facet nearest to it, and its row is long enough to prove
/// that. `None` where single precision may say either.
fn reaches(places: &[DVec3], i: usize, row: &[u32], complete: bool, corners: [DVec3; 3]) -> Option<bool> {
    let p = places[i];
    let q = nearest_on(corners, p);
    let distance = q.distance(p);
    // Squares of distances up to 2 are right to some roundings of 2⁻²⁴ of what they are made of.
    let rounding = |other: DVec3| 4e-6 * (1.0 + distance) * p.distance(other);
    let others = || places.iter().filter(|&&other| other != p);
    let squared = |other: &DVec3| q.distance_squared(*other) - q.distance_squared(p);
    let nearer = others().any(|other| squared(other) < -rounding(*other));
    let nearest = others().all(|other| squared(other) > rounding(*other));
    let beyond = row.last().map_or(-1.0, |&last| p.distance(places[last as usize]) - 2.0 * distance);
    let (proved, unproved) = (complete || beyond > 1e-5, !complete && beyond < -1e-5);
    match (nearest && proved, nearer || unproved) {
        (true, _) => Some(true),
        (_, true) => Some(false),
        _ => None,
    }
}

/// What a run of `reach` begins with.
struct Reach {
    surface: Surface,
    places: Vec<DVec3>,
    seeds: Vec<Seed>,
    table: Vec<u32>,
    /// Of each box of the grid, its facets.
    near: Vec<Vec<u32>>,
    grid: u32,
    facets: Vec<Facet>,
    /// Of each facet, and behind them which facets are divided, where that is said.
    slots: Vec<u32>,
    divided: Option<usize>,
}

fn reach_input(round: u64, facet_count: u32, seed_count: usize, grid: u32) -> Reach {
    let mut rng = rng(100 + round);
    let mut point = |wide: f64| DVec3::from_array([0; 3].map(|_| (rng.random::<f64>() - 0.5) * wide));
    let mut corners = Vec::new();
    for _ in 0..facet_count {
        let at = point(0.7);
        corners.extend([0; 3].map(|_| at + point(0.4)));
    }
    // The box of all is the unit box, or the seeds would be elsewhere than the facets.
    corners.extend([DVec3::splat(-0.5), DVec3::splat(0.5), DVec3::new(-0.5, 0.5, 0.5)]);
    let triangles = (0..=facet_count).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let surface = Surface::new(&TriMesh::new(corners, triangles).unwrap(), None).unwrap();
    // Most near facets; some outside of the box, where the outermost boxes of the grid go on; some in one place.
    let mut given: Vec<DVec3> = (0..seed_count)
        .map(|i| if i % 4 == 3 { point(1.3) } else { surface.centroid(i as u32 % facet_count) + point(0.2) })
        .collect();
    (0..seed_count / 20).for_each(|k| given[seed_count - 1 - k] = given[k]);
    let mut seeds: Vec<Seed> = given.iter().map(|p| record(p.to_array())).collect();
    let places: Vec<DVec3> = seeds.iter().map(|s| DVec3::from_array(s.position())).collect();
    let mut table = vec![NONE];
    for i in 0..seed_count {
        let mut row = others(&seeds, i);
        // All, none or some. Only the first may be said to be complete.
        let length = match i % 4 {
            0 => row.len(),
            1 if i % 3 == 0 => 0,
            _ => rng.random_range(0..=row.len().min(24)),
        };
        row.truncate(length);
        let complete = if i % 4 == 0 { COMPLETE } else { 0 };
        (seeds[i].row_begin, seeds[i].row_length) = (table.len() as u32, length as u32 | complete);
        table.extend(row);
    }
    let all: Vec<u32> = (0..facet_count).collect();
    let boxes = grid.pow(3);
    let near = (0..boxes)
        .map(|at| match at % 9 {
            0 => Vec::new(),
            1 => all.clone(),
            _ => all.sample(&mut rng, facet_count as usize / 2).copied().collect(),
        })
        .collect();
    let (mut facets, mut slots) = (Vec::new(), Vec::new());
    for f in 0..facet_count {
        let room = 1usize << [0, 2, 5, 9][f as usize % 4];
        let mut own = vec![0; room];
        // What other stages have entered: nothing, some cells, or as many as there are slots.
        let entered = if f % 11 == 0 { room } else { (f as usize % 3).min(room) };
        let mut some: Vec<u32> = (0..seed_count as u32).collect();
        some.shuffle(&mut rng);
        some[..entered.min(seed_count)].iter().for_each(|&seed| enter_cell(&mut own, seed, 0));
        let record = facet_of(&surface, f as usize, room as u32);
        let by_cell = if f % 6 == 5 { 0 } else { BY_CELL };
        facets.push(Facet { slot_begin: slots.len() as u32, slot_mask: record.slot_mask | by_cell, ..record });
        slots.extend(own);
    }
    let divided = round.is_multiple_of(2).then_some(slots.len());
    if divided.is_some() {
        slots.extend((0..facet_count).map(|f| u32::from(f % 7 == 3)));
    }
    Reach { surface, places, seeds, table, near, grid, facets, slots, divided }
}

impl Reach {
    /// The grid as the stage reads it: where each box begins, then the facets, which are numbered from `first` on.
    fn near_words(&self, first: u32) -> Vec<u32> {
        let mut begin = self.near.len() as u32 + 1;
        let mut all = vec![begin];
        for facets in &self.near {
            begin += facets.len() as u32;
            all.push(begin);
        }
        all.extend(self.near.iter().flatten().map(|f| f + first));
        all
    }

    fn box_of(&self, i: usize) -> usize {
        let side = self.grid as f32;
        let at = ((Vec3::from(self.seeds[i].hi) + 0.5) * side).clamp(Vec3::ZERO, Vec3::splat(side - 1.0));
        let [x, y, z] = at.to_array().map(|c| c as usize);
        (z * self.grid as usize + y) * self.grid as usize + x
    }

    fn slots_of<'a>(&self, slots: &'a [u32], f: usize) -> &'a [u32] {
        let begin = self.facets[f].slot_begin as usize;
        &slots[begin..=begin + (self.facets[f].slot_mask & !BY_CELL) as usize]
    }

    /// Of each facet, the seeds among `some` that reach it, and those for which rounding decides.
    fn want(&self, some: std::ops::Range<usize>) -> BTreeMap<usize, [BTreeSet<u32>; 2]> {
        let mut want: BTreeMap<usize, [BTreeSet<u32>; 2]> = BTreeMap::new();
        for i in some {
            let seed = &self.seeds[i];
            let length = (seed.row_length & !COMPLETE) as usize;
            let row = &self.table[seed.row_begin as usize..][..length];
            for &f in &self.near[self.box_of(i)] {
                let f = f as usize;
                let is_divided = self.divided.is_some_and(|at| self.slots[at + f] != 0);
                if is_divided || self.facets[f].slot_mask & BY_CELL == 0 {
                    continue;
                }
                let corners = self.surface.facets()[f].map(|v| self.surface.positions()[v as usize]);
                match reaches(&self.places, i, row, seed.row_length & COMPLETE != 0, corners) {
                    Some(true) => want.entry(f).or_default()[0].insert(i as u32),
                    None => want.entry(f).or_default()[1].insert(i as u32),
                    Some(false) => continue,
                };
            }
        }
        want
    }
}

#[needs(gpu)]
#[test]
fn seeds_enter_the_facets_that_they_reach() {
    let device = require_device!();
    let stage = Stage::new(&device, "clip/reach", "main", &[]);
    let (mut certain, mut unsure, mut full) = (0, 0, 0);
    let cases = [
        (60, 400, 3, 0, usize::MAX),
        (60, 400, 3, 64, 30),
        (1, 1, 1, 0, 9),
        (30, 2, 2, 0, 99),
        (200, 900, 4, 128, 8000),
    ];
    for (round, (facet_count, seed_count, grid, part_first, room)) in cases.into_iter().enumerate() {
        let input = reach_input(round as u64, facet_count, seed_count, grid);
        // A window that begins elsewhere does not say which facets are divided.
        let first = if input.divided.is_some() { 0 } else { 5000 };
        let count = if seed_count > 100 { seed_count - 10 } else { seed_count };
        let want = input.want(part_first..count);
        let before = [[77, 78]; 3];
        let capacity = room.min(before.len() + 4 * seed_count * facet_count as usize);
        let params = Params {
            list_capacity: capacity as u32,
            emit_count: count as u32,
            grid,
            divided: input.divided.map_or(NONE, |at| at as u32),
            facet_first: first,
            part_first: part_first as u32,
            ..Params::default()
        };
        let state = State { length: before.len() as u32, ..State::default() };
        let given = [
            words(&[params]),
            words(&input.seeds),
            words(&input.facets),
            input.table.clone(),
            input.near_words(first),
            input.slots.clone(),
            list(&before, capacity),
            list(&[], capacity),
            words(&[state]),
        ];
        let got = stage.run((count - part_first).div_ceil(64) as u32, &given);
        let after = records::<State>(&got[8])[0];
        let (mut entered, mut missing) = (BTreeSet::new(), [BTreeSet::new(), BTreeSet::new()]);
        for f in 0..facet_count as usize {
            let slots = input.slots_of(&got[5], f);
            let (had, has) = (cells(input.slots_of(&input.slots, f)), cells(slots));
            assert!(had.is_subset(&has), "round {round}, facet {f}: what was there stays");
            let [reached, perhaps] = want.get(&f).cloned().unwrap_or_default();
            let new: BTreeSet<u32> = has.difference(&had).copied().collect();
            assert!(
                new.iter().all(|i| reached.contains(i) || perhaps.contains(i)),
                "round {round}, facet {f}: {new:?} are more than {reached:?}"
            );
            let left: Vec<u32> = reached.difference(&has).copied().collect();
            assert!(left.is_empty() || has.len() == slots.len(), "round {round}, facet {f}: {left:?} are not there");
            full += u32::from(!left.is_empty());
            (certain, unsure) = (certain + reached.len(), unsure + perhaps.len());
            entered.extend(new.iter().map(|&i| [first + f as u32, i]));
            missing[0].extend(left.into_iter().map(|i| (first + f as u32, i, code::CELLS)));
            missing[1].extend(perhaps.difference(&has).map(|&i| (first + f as u32, i, code::CELLS)));
        }
        // Each new cell is a pair at the end of the list, or is counted where the list ends.
        assert_eq!(after.length as usize, before.len() + entered.len(), "round {round}");
        assert_eq!(after.list_overflow as usize, (after.length as usize).saturating_sub(capacity), "round {round}");
        assert_eq!(records::<[u32; 2]>(&got[6][..2 * before.len()]), before, "round {round}: pairs that were there");
        let pairs: BTreeSet<_> = appended(&got[6], before.len(), after.length, capacity).into_iter().collect();
        assert_eq!(pairs.len(), entered.len().min(capacity - before.len()), "round {round}: each once");
        assert!(pairs.is_subset(&entered), "round {round}");
        // A cell that finds the slots taken is a failure.
        let failures = after.failures as usize;
        assert_eq!(after.cells_overflow, after.failures, "round {round}");
        assert!(
            (missing[0].len()..=missing[0].len() + missing[1].len()).contains(&failures),
            "round {round}: {failures}"
        );
        let told = appended(&got[7], 0, after.failures, capacity);
        let told: BTreeSet<_> = told.into_iter().map(|entry| failure(entry).unwrap()).collect();
        assert_eq!(told.len(), failures.min(capacity), "round {round}: each once");
        assert!(told.iter().all(|it| missing.iter().any(|m| m.contains(it))), "round {round}: {told:?}");
    }
    eprintln!("{certain} pairs, rounding decides {unsure}, {full} facets were full");
    assert!(certain > 300 && unsure < certain / 50 && full > 10, "{certain} {unsure} {full}");
}
