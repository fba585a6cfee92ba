//! Promise: of a facet all pieces are added up, as the reference has them, or none, and then the facet begins in the list of pairs.
//! Which of these depends on the facet and the seeds alone.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use ::gpu::diagram::layout::{
    BY_CELL, COMPLETE, Facet, NONE, Params, ROOT, ROW, STRIDE, SUM_WORDS, Seed, State, accumulate, halt,
};
use glam::{DVec3, dvec3};
use needs::needs;
use rand::RngExt;
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{Backend, PieceBatch, Serial, SessionOptions, Surface};
use tessera::token::Token;

use super::{clip_params, facet_of, others, record, rng, sums_of};
use crate::points::noise;
use crate::stage::{Stage, records, words};

/// Slots of each facet's set of cells.
const SLOTS: u32 = 8;
/// Entries of the list that are there before.
const BEFORE: usize = 2;

/// Mass, moment, energy, area.
type Sums = [f64; 6];

/// `clip/divide`: of each facet its cells and the sums over their pieces.
fn pieces(surface: &Arc<Surface>, seeds: &[DVec3]) -> Vec<BTreeMap<u32, Sums>> {
    let mut session = Serial.session(Arc::clone(surface), SessionOptions::new(seeds.len())).unwrap();
    session.set_seeds(seeds).unwrap();
    let mut batch = PieceBatch::default();
    session.pieces(0..surface.facets().len() as u32, &mut batch, &Token::default()).unwrap();
    let mut all = vec![BTreeMap::new(); surface.facets().len()];
    for k in 0..batch.len() {
        let (p, w) = (&batch.position[batch.vertices(k)], &batch.weight[batch.vertices(k)]);
        let mut sums = [0.0; 6];
        for j in 2..p.len() {
            let corners = [(p[0], w[0]), (p[j - 1], w[j - 1]), (p[j], w[j])];
            add_triangle(&mut sums, corners, seeds[batch.seed[k] as usize]);
        }
        all[batch.facet[k] as usize].insert(batch.seed[k], sums);
    }
    all
}

/// By corners, middles of edges and the centroid. That is exact for cubics, and the integrands are products of at most three
/// linear functions.
fn add_triangle(sums: &mut Sums, corners: [(DVec3, f64); 3], seed: DVec3) {
    let [a, b, c] = corners;
    let area = 0.5 * (b.0 - a.0).cross(c.0 - a.0).length();
    let mean = |of: &[(DVec3, f64)]| {
        let share = 1.0 / of.len() as f64;
        (of.iter().map(|v| v.0).sum::<DVec3>() * share, of.iter().map(|v| v.1).sum::<f64>() * share)
    };
    let points = [
        (a, 1.0 / 20.0),
        (b, 1.0 / 20.0),
        (c, 1.0 / 20.0),
        (mean(&[a, b]), 2.0 / 15.0),
        (mean(&[b, c]), 2.0 / 15.0),
        (mean(&[c, a]), 2.0 / 15.0),
        (mean(&corners), 9.0 / 20.0),
    ];
    for ((p, weight), share) in points {
        let (x, mass) = (p - seed, area * share * weight);
        let each = [mass, mass * x.x, mass * x.y, mass * x.z, mass * x.length_squared(), area * share];
        sums.iter_mut().zip(each).for_each(|(sum, each)| *sum += each);
    }
}

/// What a run of the stage begins with.
struct Input {
    surface: Arc<Surface>,
    seeds: Vec<Seed>,
    table: Vec<u32>,
    /// Facet and the seed nearest to its centroid.
    candidates: Vec<[u32; 2]>,
    want: Vec<BTreeMap<u32, Sums>>,
}

fn input(surface: Surface, given: &[DVec3], entries: impl Fn(usize) -> usize) -> Input {
    let surface = Arc::new(surface);
    let mut seeds: Vec<Seed> = given.iter().map(|p| record(p.to_array())).collect();
    let places: Vec<DVec3> = seeds.iter().map(|s| DVec3::from_array(s.position())).collect();
    let mut table = vec![0; seeds.len() * STRIDE as usize];
    for i in 0..seeds.len() {
        let row = others(&seeds, i);
        let length = row.len().min(entries(i)).min(ROW as usize);
        let complete = if length == row.len() { COMPLETE } else { 0 };
        let at = i * STRIDE as usize;
        table[at] = length as u32 | complete;
        table[at + 1..][..length].copy_from_slice(&row[..length]);
        (seeds[i].row_begin, seeds[i].row_length) = (at as u32 + 1, table[at]);
    }
    let nearest = |f: u32| {
        let q = surface.centroid(f);
        let by = |a: &usize, b: &usize| places[*a].distance(q).total_cmp(&places[*b].distance(q));
        (0..places.len()).min_by(by).unwrap() as u32
    };
    let candidates = (0..surface.facets().len() as u32).map(|f| [f, nearest(f)]).collect();
    let want = pieces(&surface, &places);
    Input { surface, seeds, table, candidates, want }
}

/// How the stage is called.
#[derive(Clone, Default)]
struct Call {
    /// The records begin with this facet.
    first: usize,
    /// Candidates, and from where on among these.
    range: Range<usize>,
    part_first: usize,
    /// Facets that cells look for.
    by_cell: bool,
    /// Whether it is noted which of them are done.
    noted: bool,
    halt: u32,
    accumulate: u32,
    /// Entries that the list holds.
    capacity: usize,
}

impl Input {
    fn all(&self) -> Call {
        Call { range: 0..self.candidates.len(), capacity: self.candidates.len() + BEFORE, ..Call::default() }
    }

    fn is_uniform(&self) -> bool {
        self.surface.is_uniform()
    }

    /// Runs the stage, and returns what it wrote and was given.
    fn run(&self, stage: &Stage, call: &Call) -> (Vec<Vec<u32>>, Vec<Vec<u32>>) {
        let facets = self.surface.facets().len();
        let record = |f: usize| {
            let facet = facet_of(&self.surface, f, SLOTS);
            let by_cell = if call.by_cell && f.is_multiple_of(2) { BY_CELL } else { 0 };
            Facet { slot_begin: f as u32 * SLOTS, slot_mask: facet.slot_mask | by_cell, ..facet }
        };
        let flags = facets * SLOTS as usize;
        let params = Params {
            enqueue_begin: call.range.start as u32,
            enqueue_count: call.range.len() as u32,
            enqueue_root: ROOT,
            list_capacity: call.capacity as u32,
            accumulate: call.accumulate,
            divided: if call.noted { flags as u32 } else { NONE },
            facet_first: call.first as u32,
            part_first: call.part_first as u32,
            ..clip_params(self.seeds.len(), call.capacity, self.is_uniform())
        };
        let state = State { length: BEFORE as u32, halt: call.halt, ..State::default() };
        let given = vec![
            words(&[params]),
            words(&self.seeds),
            words(&(call.first..facets).map(record).collect::<Vec<_>>()),
            self.table.clone(),
            words(&self.candidates),
            vec![0; flags + facets],
            vec![NONE; 2 * call.capacity.max(BEFORE) + 2],
            vec![0; SUM_WORDS * self.seeds.len()],
            words(&[state]),
        ];
        let count = (call.range.len() - call.part_first).div_ceil(64) as u32;
        (stage.run(count, &given), given)
    }

    /// Runs the stage and compares with the twin. The facets that were divided, and that were not.
    fn check(&self, name: &str, stage: &Stage, call: &Call) -> [BTreeSet<u32>; 2] {
        let (got, given) = self.run(stage, call);
        let after = records::<State>(&got[8])[0];
        let asked: Vec<[u32; 2]> = self.candidates[call.range.start + call.part_first..call.range.end]
            .iter()
            .copied()
            .filter(|pair| pair[1] != NONE)
            .collect();

        // A facet that is not divided has its first cell in its set; nothing else is there.
        let flags = self.surface.facets().len() * SLOTS as usize;
        let mut facets = [BTreeSet::new(), BTreeSet::new()];
        let mut want_slots = given[5].clone();
        for &[f, first] in &asked {
            let slots = &got[5][(f * SLOTS) as usize..][..SLOTS as usize];
            let is_paired = slots.iter().any(|s| *s != 0);
            facets[usize::from(is_paired)].insert(f);
            if is_paired {
                super::enter_cell(&mut want_slots[(f * SLOTS) as usize..][..SLOTS as usize], first, 0);
            } else if call.noted && f % 2 == 0 {
                want_slots[flags + f as usize] = 1;
            }
        }
        assert_eq!(got[5], want_slots, "{name}: sets, and which are divided");

        // And it begins in the list.
        let [divided, paired] = &facets;
        let roots: BTreeSet<[u32; 2]> =
            asked.iter().filter(|pair| paired.contains(&pair[0])).map(|&[f, first]| [f, first | ROOT]).collect();
        let end = (BEFORE + roots.len()).min(call.capacity);
        let pairs: BTreeSet<[u32; 2]> = records(&got[6][2 * BEFORE..2 * end]).into_iter().collect();
        assert!(pairs.len() == end - BEFORE && pairs.is_subset(&roots), "{name}: {pairs:?} of {roots:?}");
        assert!(
            got[6][..2 * BEFORE].iter().chain(&got[6][2 * end..]).all(|w| *w == NONE),
            "{name}: the rest of the list"
        );

        // The sums are those of all pieces of the divided facets.
        let mut want: BTreeMap<u32, Sums> = BTreeMap::new();
        let mut count = 0;
        for &f in divided {
            let pieces = &self.want[f as usize];
            // Where bisectors run along edges the reference has pieces without area.
            count += pieces.values().filter(|sums| sums[5] > 1e-9 * self.surface.facet_area(f)).count();
            for (&seed, sums) in pieces {
                let all = want.entry(seed).or_default();
                all.iter_mut().zip(sums).for_each(|(all, each)| *all += each);
            }
        }
        let state = State {
            length: (BEFORE + roots.len()) as u32,
            list_overflow: (BEFORE + roots.len()).saturating_sub(call.capacity) as u32,
            paired: roots.len() as u32,
            pieces: after.pieces,
            halt: call.halt,
            ..State::default()
        };
        assert_eq!(after, state, "{name}");
        // Pieces that are next to nothing may be there for one and not for the other.
        assert!(
            u64::from(after.pieces).abs_diff(count as u64) <= count as u64 / 100,
            "{name}: {} of {count}",
            after.pieces
        );
        let mut worst = 0f64;
        for i in 0..self.seeds.len() {
            let mut want = want.get(&(i as u32)).copied().unwrap_or_default();
            if self.is_uniform() {
                // The host takes the area.
                want[0] = 0.0;
            }
            if call.accumulate == accumulate::NOWHERE {
                want = [0.0; 6];
            }
            let got = sums_of(&got[7], i);
            worst = got.iter().zip(&want).fold(worst, |worst, (got, want)| worst.max((got - want).abs()));
        }
        eprintln!("{name}: {} divided, {} by pairs, off by {worst:.1e}", divided.len(), paired.len());
        // 9e-9 was measured: sides are placed to some 2⁻²⁴ of the box, and cells are a few tenths of it wide.
        assert!(worst < 1e-7, "{name}: off by {worst:e}");
        facets
    }

    /// Cells that a facet meets.
    fn cells(&self, f: u32) -> usize {
        self.want[f as usize].len()
    }
}

fn variant(members: i64, weighted: bool) -> Stage {
    let device = crate::gpu::device().unwrap();
    let constants =
        [("ROW", i64::from(ROW)), ("MEMBERS", members), ("WEIGHTED", i64::from(weighted)), ("SHARED", 0), ("WIDE", 0)];
    Stage::new(&device, "clip/divide", "main", &constants)
}

fn torus(facets: usize, weighted: bool) -> Surface {
    let mesh = Shape::Torus.build(facets);
    let weights: Vec<f64> = mesh.positions().iter().map(|p| 1.5 + (3.0 * p.x).sin() * (2.0 * p.y).cos()).collect();
    Surface::new(&mesh, weighted.then_some(&weights[..])).unwrap()
}

#[needs(gpu)]
#[test]
fn facets_are_divided_as_the_reference_does_or_begin_in_the_list() {
    require_device!();
    for (members, weighted) in [(4, false), (8, true)] {
        let stage = variant(members, weighted);
        for (facets, n) in [(500, 20), (500, 150), (200, 400), (3000, 100)] {
            let surface = torus(facets, weighted);
            let seeds = noise(&surface, n, 0.02, n as u64);
            let input = input(surface, &seeds, |_| ROW as usize);
            let name = format!("{facets} facets, {n} seeds, {members} at once");
            let [divided, paired] = input.check(&name, &stage, &input.all());
            assert!(divided.iter().all(|&f| input.cells(f) <= members as usize), "{name}: more than it has room for");
            // Facets that are short beside the spacing of the seeds are what the stage is for.
            let simple = paired.iter().filter(|&&f| input.cells(f) == 1).count();
            let all = (0..input.want.len() as u32).filter(|&f| input.cells(f) == 1).count();
            assert!(simple * 4 <= all, "{name}: {simple} of {all} facets of one cell are not divided");
            if facets == 3000 {
                assert!(divided.len() > 2500, "{name}: {}", divided.len());
            }
            if n == 400 {
                assert!(!paired.is_empty(), "{name}");
            }
            // The same again, whatever room there is: which facets, and each bit of the sums.
            let (once, _) = input.run(&stage, &input.all());
            let (again, _) = input.run(&stage, &Call { capacity: BEFORE, ..input.all() });
            assert!(once[5] == again[5] && once[7] == again[7], "{name}: bits");
        }
    }
}

#[needs(gpu)]
#[test]
fn a_facet_is_not_divided_by_a_row_that_may_lack_its_cells() {
    require_device!();
    let stage = variant(4, false);
    let surface = || torus(600, false);
    let seeds = noise(&surface(), 60, 0.0, 3);
    let whole = input(surface(), &seeds, |_| ROW as usize);
    let [all, _] = whole.check("whole rows", &stage, &whole.all());
    for length in [0, 1, 3, 6] {
        let short = input(surface(), &seeds, |_| length);
        // The sums are right all the same.
        let [divided, _] = short.check(&format!("rows of {length}"), &stage, &short.all());
        // Facets that are small beside the distance of their two nearest seeds need no more than these.
        assert!(divided.is_subset(&all) && (length > 0 || divided.is_empty()), "{length}: {}", divided.len());
    }
    // A seed alone has nobody beside it.
    for seeds in [vec![dvec3(0.1, 0.2, 0.0)], vec![dvec3(0.3, 0.0, 0.1); 3]] {
        let one = input(surface(), &seeds, |_| ROW as usize);
        let [divided, paired] = one.check(&format!("{} in one place", seeds.len()), &stage, &one.all());
        assert!(paired.is_empty() && divided.len() == one.want.len(), "{paired:?}");
    }
}

#[needs(gpu)]
#[test]
fn ties_far_seeds_and_pieces_of_nothing_lose_no_area() {
    require_device!();
    let stage = variant(4, false);
    let plane = || Surface::new(&Shape::Plane.build(200), None).unwrap();
    // Bisectors run along edges and through corners; four cells meet in one point.
    let lattice: Vec<DVec3> =
        (0..36).map(|k| dvec3(f64::from(k % 6), f64::from(k / 6), 0.0) / 5.0 - dvec3(0.5, 0.5, 0.0)).collect();
    let vertices = plane().positions().to_vec();
    let mut twins = noise(&plane(), 40, 0.0, 4);
    twins.extend_from_within(..20);
    let near: Vec<DVec3> = noise(&plane(), 20, 0.0, 5).iter().flat_map(|&p| [p, p + dvec3(0.0, 1e-6, 0.0)]).collect();
    let above: Vec<DVec3> = noise(&plane(), 40, 0.0, 6).iter().map(|&p| p + dvec3(0.0, 0.0, 3.0)).collect();
    let far: Vec<DVec3> = above.iter().map(|&p| p + dvec3(0.0, 0.0, 7.0)).collect();
    for (name, seeds) in
        [("lattice", lattice), ("vertices", vertices), ("twins", twins), ("near", near), ("above", above), ("far", far)]
    {
        let input = input(plane(), &seeds, |_| ROW as usize);
        let [divided, _] = input.check(name, &stage, &input.all());
        // Beyond the range of single precision nothing is.
        assert!(name != "far" || divided.is_empty());
    }
    // Slivers.
    let mut rng = rng(7);
    let mut corners = vec![DVec3::splat(-0.5), dvec3(0.5, -0.5, -0.5), dvec3(-0.5, 0.5, 0.5)];
    for k in 0..60 {
        let mut some = || DVec3::from_array([0; 3].map(|_| 0.8 * (rng.random::<f64>() - 0.5)));
        let (a, b) = (some(), some());
        corners.extend([a, b, a.lerp(b, 0.4) + some() * 10f64.powi(-(k % 8))]);
    }
    let facets = (0..corners.len() as u32 / 3).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let surface = Surface::new(&TriMesh::new(corners, facets).unwrap(), None).unwrap();
    let seeds = noise(&surface, 50, 0.1, 8);
    let input = input(surface, &seeds, |_| ROW as usize);
    input.check("slivers", &stage, &input.all());
}

#[needs(gpu)]
#[test]
fn windows_parts_and_notes_change_nothing_else() {
    require_device!();
    let stage = variant(4, false);
    let surface = torus(500, false);
    let seeds = noise(&surface, 150, 0.0, 9);
    let mut input = input(surface, &seeds, |_| ROW as usize);
    let [all, _] = input.check("all", &stage, &input.all());
    let of = |facets: Range<usize>| -> BTreeSet<u32> {
        all.range(facets.start as u32..facets.end as u32).copied().collect()
    };
    // Records from a facet on, candidates from one on, and the second part of a dispatch.
    let window = Call { first: 90, range: 100..400, part_first: 128, ..input.all() };
    assert_eq!(input.check("window", &stage, &window)[0], of(228..400));
    // Of facets that cells look for it is noted whether they are done.
    let noted = Call { by_cell: true, noted: true, ..input.all() };
    assert_eq!(input.check("noted", &stage, &noted)[0], all);
    // Measured without sums.
    let unsummed = Call { accumulate: accumulate::NOWHERE, ..input.all() };
    assert_eq!(input.check("without sums", &stage, &unsummed)[0], all);
    // A facet whose first cell is not known waits for the host.
    let count = input.candidates.len();
    input.candidates[..count / 2].iter_mut().for_each(|pair| pair[1] = NONE);
    assert_eq!(input.check("not known", &stage, &input.all())[0], of(count / 2..count));
    let (got, given) = input.run(&stage, &Call { halt: halt::INCOMPLETE, ..input.all() });
    assert!(got == given, "halted: nothing changes");
}
