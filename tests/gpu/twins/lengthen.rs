//! Promise: the seeds of pairs that ran out of neighbours get a row that begins as the old one did and is longer, and these pairs
//! come once more. What cannot have one stays with the host.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use ::gpu::Device;
use ::gpu::diagram::layout::{
    COMPLETE, INDEX, LENGTHENERS, LONGER, MOST_REQUEUED, NONE, Params, RINGS, ROOT, ROW, STRIDE, Seed, Sorted, State,
    code, failure, halt,
};
use glam::Vec3;
use needs::needs;
use rand::RngExt;

use super::neighbours::cell_of;
use super::{failure_entry, others, record, rng};
use crate::stage::{Stage, records, words};

/// In an entry's first word: the pair was put to the end of the list again; below it, in which round.
const REQUEUED: u32 = 1 << 30;
const MOST: usize = LONGER as usize;
/// Entries that will do.
const ENOUGH: usize = MOST * 3 / 4;

/// Seeds in a grid, each with the first `known` entries of its row.
struct Searched {
    seeds: Vec<Seed>,
    side: u32,
    table: Vec<u32>,
    cells: Vec<u32>,
    sorted: Vec<Sorted>,
}

fn searched(places: &[[f64; 3]], side: u32, known: impl Fn(usize) -> usize) -> Searched {
    let mut seeds: Vec<Seed> = places.iter().map(|&p| record(p)).collect();
    let mut table = vec![NONE; seeds.len() * STRIDE as usize];
    for i in 0..seeds.len() {
        let mut row = others(&seeds, i);
        row.truncate(known(i).min(ROW as usize));
        let at = i * STRIDE as usize;
        table[at] = row.len() as u32;
        table[at + 1..][..row.len()].copy_from_slice(&row);
        (seeds[i].row_begin, seeds[i].row_length) = (at as u32 + 1, row.len() as u32);
    }
    let mut of_cell: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    let mut firsts: HashMap<[u64; 3], u32> = HashMap::new();
    for (i, seed) in seeds.iter().enumerate() {
        of_cell.entry(cell_of(Vec3::from(seed.hi) + Vec3::from(seed.lo), side)).or_default().push(i as u32);
        firsts.entry(seed.position().map(f64::to_bits)).or_insert(i as u32);
    }
    // Cells of a line of the grid follow each other; the entry behind the last says where the line ends.
    let (mut cells, mut sorted) = (Vec::new(), Vec::new());
    for cell in 0..side * side * (side + 1) {
        cells.push(sorted.len() as u32);
        for &i in of_cell.get(&cell).into_iter().flatten() {
            let seed = &seeds[i as usize];
            let first = firsts[&seed.position().map(f64::to_bits)];
            sorted.push(Sorted { hi: seed.hi, lo: seed.lo, seed: i, first });
        }
    }
    Searched { seeds, side, table, cells, sorted }
}

impl Searched {
    /// How far from seed `i` all is within the rings of cells that are looked at; beyond the outermost cells is nothing.
    fn looked_at(&self, i: usize) -> f64 {
        let (side, rings) = (i64::from(self.side), i64::from(RINGS));
        let reach = self.seeds[i].position().map(|x| {
            let place = (((x + 0.5) * side as f64) as i64).clamp(0, side - 1);
            let wall = |at: i64| at as f64 / side as f64 - 0.5;
            let below = if place - rings <= 0 { f64::INFINITY } else { x - wall(place - rings) };
            let above = if place + rings >= side - 1 { f64::INFINITY } else { wall(place + rings + 1) - x };
            below.min(above)
        });
        reach.into_iter().fold(f64::INFINITY, f64::min)
    }

    /// The lengths that the longer row of seed `i` may have: no row ends between two seeds at one distance, all that were
    /// looked at are in it if there is room for them, and otherwise it has [`ENOUGH`] if it can end there.
    fn lengths(&self, i: usize) -> BTreeSet<usize> {
        let seed = &self.seeds[i];
        let keys: Vec<f32> = others(&self.seeds, i).iter().map(|&j| seed.key(&self.seeds[j as usize])).collect();
        let ends = |k: &usize| *k == keys.len() || *k == 0 || keys[k - 1] < keys[*k];
        // The stage allows for the rounding of seeds and walls.
        let reach = self.looked_at(i);
        let within = |reach: f64| keys.iter().filter(|&&key| f64::from(key) < reach * reach).count();
        let (least, most) = (within((reach - 2e-6) * 0.9999), within(reach));
        if most <= MOST {
            return (least..=most).filter(ends).collect();
        }
        let ends: BTreeSet<usize> = (0..=MOST).filter(ends).collect();
        let enough = ends.range(ENOUGH..).copied().collect::<BTreeSet<_>>();
        if enough.is_empty() { ends.last().copied().into_iter().collect() } else { enough }
    }
}

/// Which failures come once more: those of pairs that lack neighbours, if their seed's row is made longer now; all but the first of a
/// seed do not wait to see whether it is. None if the row was made longer in an earlier round, which did not help.
fn requeued(entries: &[[u32; 2]], round: u32, is_longer: impl Fn(u32) -> bool) -> Vec<bool> {
    let seed = |entry: &[u32; 2]| entry[1] & (REQUEUED - 1);
    let lacks = |entry: &&[u32; 2]| failure([entry[0] & !REQUEUED, entry[1]]).is_some_and(|f| f.2 == code::NEIGHBOURS);
    let before = |k: usize| entries[..k].iter().filter(lacks).filter(move |e| seed(e) == seed(&entries[k]));
    let of = |(k, entry): (usize, &[u32; 2])| {
        let earlier = before(k).any(|e| e[0] & REQUEUED != 0 && e[0] & (REQUEUED - 1) < round);
        let is_open = entry[0] & REQUEUED == 0 && lacks(&entry);
        is_open && !earlier && (before(k).next().is_some() || is_longer(seed(entry)))
    };
    entries.iter().enumerate().map(of).collect()
}

/// What a dispatch begins with beside the seeds.
struct Dispatch {
    entries: Vec<[u32; 2]>,
    groups: u32,
    /// Entries behind the rows as the search wrote them.
    room: usize,
    state: State,
    capacity: usize,
}

impl Dispatch {
    fn new(entries: Vec<[u32; 2]>) -> Self {
        let state = State { failures: entries.len() as u32, length: 5, rounds: 9, ..State::default() };
        Self { entries, groups: LENGTHENERS, room: 300 * MOST, state, capacity: 1000 }
    }
}

struct Lengthen(Stage);

impl Lengthen {
    fn new(device: &Arc<Device>) -> Self {
        let constants = [("ROW", i64::from(ROW)), ("LONGER", i64::from(LONGER)), ("MOST", i64::from(MOST_REQUEUED))];
        Self(Stage::new(device, "neighbours/lengthen", "main", &constants))
    }

    fn run(&self, input: &Searched, with: &Dispatch) -> (Vec<Vec<u32>>, Vec<Vec<u32>>) {
        let params = Params {
            seeds: input.seeds.len() as u32,
            row: ROW,
            side: input.side,
            list_capacity: with.capacity as u32,
            ..Params::default()
        };
        let mut failures = words(&with.entries);
        failures.resize(2 * with.capacity.max(with.entries.len()), NONE);
        let given = vec![
            words(&[params]),
            words(&input.seeds),
            input.cells.clone(),
            words(&input.sorted),
            [&input.table[..], &vec![NONE; with.room]].concat(),
            vec![NONE; 2 * with.capacity],
            failures,
            words(&[with.state]),
        ];
        (self.0.run(with.groups, &given), given)
    }

    /// Runs, and compares all that is written with the twin. How long the longer rows are, by seed.
    fn check(&self, name: &str, input: &Searched, with: &Dispatch) -> BTreeMap<u32, usize> {
        let (got, given) = self.run(input, with);
        let seeds: Vec<Seed> = records(&got[1]);
        let table = &got[4];
        let after = records::<State>(&got[7])[0];
        let moved: BTreeMap<u32, usize> = (0..seeds.len())
            .filter(|&i| seeds[i] != input.seeds[i])
            .map(|i| (i as u32, (seeds[i].row_length & INDEX) as usize))
            .collect();

        // Rows: the nearest seeds in order, one behind the other, where nothing was.
        let (end, mut begins) = (input.table.len(), BTreeSet::new());
        assert_eq!(table[..end], input.table, "{name}: rows of the search stay");
        for (&i, &length) in &moved {
            let (seed, old) = (&seeds[i as usize], &input.seeds[i as usize]);
            assert_eq!((seed.hi, seed.lo), (old.hi, old.lo), "{name}: seed {i} stays where it is");
            let all = others(&input.seeds, i as usize);
            let row = &table[seed.row_begin as usize..][..length];
            assert_eq!(row, &all[..length], "{name}: row of {i}");
            assert!(length > (old.row_length & INDEX) as usize, "{name}: row of {i} is longer");
            let behind = end + with.state.longer as usize;
            assert!(seed.row_begin as usize >= behind, "{name}: row of {i} is behind the others");
            begins.insert((seed.row_begin as usize, length));
            let is_complete = seed.row_length & COMPLETE != 0;
            assert!(!is_complete || length == all.len(), "{name}: row of {i} is not complete");
            let has_all = all.len() < MOST && input.looked_at(i as usize) == f64::INFINITY;
            assert!(!has_all || is_complete, "{name}: row of {i} is complete");
        }
        let ranges: Vec<(usize, usize)> = begins.into_iter().collect();
        assert_eq!(ranges.len(), moved.len(), "{name}: each row in its own place");
        assert!(ranges.windows(2).all(|w| w[0].0 + w[0].1 <= w[1].0), "{name}: rows do not overlap");
        let written = table[end..].iter().filter(|w| **w != NONE).count();
        assert_eq!(written, moved.values().sum::<usize>(), "{name}: nothing else is written");

        // Whose row may be longer, and has room.
        let come_again = requeued(&with.entries, with.state.rounds, |_| true);
        let asked: BTreeSet<u32> =
            with.entries.iter().zip(&come_again).filter(|e| *e.1).map(|e| e.0[1] & !(3 << 30)).collect();
        let mut could = 0;
        for &i in &asked {
            let lengths = input.lengths(i as usize);
            let known = (input.seeds[i as usize].row_length & INDEX) as usize;
            match moved.get(&i) {
                Some(length) => assert!(lengths.contains(length), "{name}: row of {i} is {length}, not {lengths:?}"),
                None if lengths.iter().all(|&length| length <= known) => {}
                None => could += 1,
            }
        }
        assert!(moved.keys().all(|i| asked.contains(i)), "{name}: {:?} are not {asked:?}", moved.keys());
        let asked_for = (after.longer - with.state.longer) as usize;
        assert!(could > 0 || asked_for == written, "{name}: {asked_for} entries for {written}");
        assert!(could == 0 || after.longer as usize > with.room, "{name}: {could} rows are not made, and have room");

        // Pairs.
        let again = requeued(&with.entries, with.state.rounds, |i| moved.contains_key(&i));
        let mut pairs = Vec::new();
        for (k, (&entry, &again)) in with.entries.iter().zip(&again).enumerate() {
            let now = [got[6][2 * k], got[6][2 * k + 1]];
            if !again {
                assert_eq!(now, entry, "{name}: entry {k} stays open, or done");
                continue;
            }
            assert_eq!(now, [entry[0] & COMPLETE | REQUEUED | with.state.rounds, entry[1]], "{name}: entry {k}");
            let root = if entry[1] & REQUEUED != 0 { ROOT } else { 0 };
            pairs.push([entry[0] & (REQUEUED - 1), entry[1] & (REQUEUED - 1) | root]);
        }
        let length = with.state.length as usize + pairs.len();
        let overflow = length.saturating_sub(with.capacity.max(with.state.length as usize));
        let want = State {
            length: length as u32,
            requeued: with.state.requeued + pairs.len() as u32,
            list_overflow: overflow as u32,
            longer: after.longer,
            ..with.state
        };
        assert_eq!(after, want, "{name}");
        let stored = &got[5][2 * with.state.length as usize..2 * length.min(with.capacity)];
        let mut stored: Vec<[u32; 2]> = records(stored);
        stored.sort_unstable();
        pairs.sort_unstable();
        if overflow == 0 {
            assert_eq!(stored, pairs, "{name}: pairs");
        } else {
            assert_eq!(stored.len(), pairs.len() - overflow, "{name}: pairs that there is room for");
            assert!(stored.iter().all(|pair| pairs.contains(pair)), "{name}: pairs");
        }
        assert_eq!(got[5][..2 * with.state.length as usize], given[5][..2 * with.state.length as usize], "{name}");
        moved
    }
}

/// One pair for each seed.
fn one_each(seeds: impl IntoIterator<Item = u32>) -> Vec<[u32; 2]> {
    let entry = |(k, seed)| failure_entry(100 + k as u32, seed, k % 3 == 0, code::NEIGHBOURS);
    seeds.into_iter().enumerate().map(entry).collect()
}

fn cloud(n: usize, wide: f64, seed: u64) -> Vec<[f64; 3]> {
    let mut rng = rng(seed);
    (0..n).map(|_| [0; 3].map(|_| (rng.random::<f64>() - 0.5) * wide)).collect()
}

#[needs(gpu)]
#[test]
fn rows_go_on_in_the_order_of_distance() {
    let device = require_device!();
    let lengthen = Lengthen::new(&device);
    let known = |i: usize| [0, 1, 7, 20][i % 4];
    // More seeds than a row holds; some outside of the box, where the outermost cells go on.
    for (n, side, wide) in [(600, 3, 1.0), (600, 9, 1.0), (2000, 12, 1.2), (129, 2, 1.0), (130, 1, 1.0)] {
        let input = searched(&cloud(n, wide, n as u64), side, known);
        let lengths = lengthen.check(&format!("{n} in {side}"), &input, &Dispatch::new(one_each(0..60)));
        assert_eq!(lengths.len(), 60);
        assert!(lengths.values().all(|l| (ENOUGH..=MOST).contains(l)), "{n} in {side}: {lengths:?}");
    }
    // As many as a row may have, fewer, and none.
    for n in [128, 100, 22, 2, 1] {
        let input = searched(&cloud(n, 1.0, n as u64), 4, known);
        let lengths = lengthen.check(&format!("{n}"), &input, &Dispatch::new(one_each(0..n as u32)));
        let longer = (0..n).filter(|&i| known(i) < n - 1).count();
        assert_eq!(lengths.len(), longer, "{n}");
        assert!(lengths.values().all(|&l| l == n - 1), "{n}: {lengths:?}");
    }
    // So far apart that the rings do not have enough of them.
    let input = searched(&cloud(300, 1.0, 5), 60, known);
    let lengths = lengthen.check("sparse", &input, &Dispatch::new(one_each(0..300).split_off(60)));
    assert!(!lengths.is_empty() && lengths.values().all(|&l| l < ENOUGH), "{lengths:?}");
    // One at work instead of many.
    let input = searched(&cloud(600, 1.0, 6), 5, known);
    lengthen.check("one group", &input, &Dispatch { groups: 1, ..Dispatch::new(one_each(0..70)) });
}

#[needs(gpu)]
#[test]
fn no_row_ends_among_seeds_at_one_distance() {
    let device = require_device!();
    let lengthen = Lengthen::new(&device);
    // Of a lattice, where distances are exact: around an inner point 6, 18, 26, 32, 56, 80, 92, 122, 146, ...
    let lattice = |k: i32| [k % 11, k / 11 % 11, k / 121].map(|x| f64::from(x - 5) / 16.0);
    let places: Vec<[f64; 3]> = (0..1331).map(lattice).collect();
    let input = searched(&places, 6, |i| [6, 18, 0, 13][i % 4]);
    let lengths = lengthen.check("lattice", &input, &Dispatch::new(one_each(600..740)));
    assert_eq!(lengths.get(&665), Some(&122), "{lengths:?}");
    // More at one distance than a row holds: all points with whole coordinates on a sphere, around its centre.
    let sphere = |k: i32| [k % 21, k / 21 % 21, k / 441].map(|x| x - 10);
    let on_sphere = (0..9261).map(sphere).filter(|p| p.iter().map(|x| x * x).sum::<i32>() == 101);
    let mut places = vec![[0.0; 3]];
    places.extend(on_sphere.map(|p| p.map(|x| f64::from(x) / 64.0)));
    assert!(places.len() > MOST + 20, "{}", places.len());
    let input = searched(&places, 4, |_| 0);
    assert_eq!(lengthen.check("sphere", &input, &Dispatch::new(one_each([0]))).len(), 0);
    // Some within it: the row ends before the sphere, and is no longer if it has these.
    places.extend([1, 2, 3].map(|k| [f64::from(k) / 128.0, 0.0, 0.0]));
    let input = searched(&places, 4, |_| 0);
    assert_eq!(lengthen.check("within", &input, &Dispatch::new(one_each([0]))), BTreeMap::from([(0, 3)]));
    let input = searched(&places, 4, |_| 3);
    assert_eq!(lengthen.check("known", &input, &Dispatch::new(one_each([0]))).len(), 0);
    // Later duplicates are nobody's neighbours.
    let mut places = cloud(300, 1.0, 7);
    places.extend_from_within(..200);
    let input = searched(&places, 3, |i| i % 21);
    lengthen.check("duplicates", &input, &Dispatch::new(one_each(0..100)));
}

#[needs(gpu)]
#[test]
fn each_seed_gets_one_row_and_all_its_pairs_come_again() {
    let device = require_device!();
    let lengthen = Lengthen::new(&device);
    let input = searched(&cloud(500, 1.0, 8), 5, |i| i % 21);
    for round in 0..4u64 {
        let mut rng = rng(200 + round);
        let count = [256, 200, 30, 3][round as usize];
        // Some seeds often; what lacks something else is for others; some have come again, in this round or an earlier one.
        let entries: Vec<[u32; 2]> = (0..count)
            .map(|k| {
                let seed = rng.random_range(0..[40, 500, 4, 1][round as usize]);
                let why = [code::NEIGHBOURS, code::NEIGHBOURS, code::CELLS, code::POLYGON, code::FINISH]
                    [rng.random_range(0..5)];
                let mut entry = failure_entry(7 * k, seed, rng.random(), why);
                if round < 2 && rng.random_range(0..8) == 0 {
                    entry[0] = entry[0] & ROOT | REQUEUED | rng.random_range(0..=8);
                }
                entry
            })
            .collect();
        lengthen.check(&format!("round {round}"), &input, &Dispatch::new(entries));
    }
}

#[needs(gpu)]
#[test]
fn what_has_no_room_is_left_and_counted() {
    let device = require_device!();
    let lengthen = Lengthen::new(&device);
    let input = searched(&cloud(400, 1.0, 9), 4, |_| 20);
    let all = || Dispatch::new(one_each(0..50));
    // Rows: of all, of some, of none.
    for room in [50 * MOST, 3 * MOST, MOST - 1, 0] {
        let lengths = lengthen.check(&format!("room for {room}"), &input, &Dispatch { room, ..all() });
        assert!(lengths.len() >= room.min(50 * MOST) / MOST, "{room}: {lengths:?}");
    }
    // Pairs, of which the list holds some.
    let state = State { length: 70, ..all().state };
    lengthen.check("list", &input, &Dispatch { capacity: 90, state, ..all() });
    // Rows that earlier rounds made stay.
    let state = State { longer: 2 * LONGER, requeued: 4, ..all().state };
    lengthen.check("behind others", &input, &Dispatch { state, ..all() });
}

#[needs(gpu)]
#[test]
fn where_pairs_are_many_or_none_or_the_pass_has_halted_nothing_is_done() {
    let device = require_device!();
    let lengthen = Lengthen::new(&device);
    let input = searched(&cloud(400, 1.0, 9), 4, |_| 20);
    let with = |count: u32| Dispatch::new(one_each(0..count));
    let halted = State { halt: halt::INCOMPLETE, ..with(50).state };
    for (name, with) in [
        ("many", with(MOST_REQUEUED + 1)),
        ("none", with(0)),
        ("halted", Dispatch { state: halted, ..with(50) }),
        ("more than the list holds", Dispatch { capacity: 49, ..with(50) }),
    ] {
        let (got, given) = lengthen.run(&input, &with);
        assert!(got == given, "{name}: nothing changes");
    }
    assert_eq!(lengthen.check("as many as may be", &input, &with(MOST_REQUEUED)).len(), MOST_REQUEUED as usize);
}
