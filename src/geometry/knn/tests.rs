//! Rows and nearest seeds against a search through all seeds.

use glam::DVec3;
use rand::{RngExt, SeedableRng};

use super::grid::Grid;
use super::{Lifted, NeighbourRow, NeighbourTable, Point, SeedIndex, Threads};

fn random(n: usize) -> Vec<DVec3> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(n as u64);
    (0..n).map(|_| DVec3::new(rng.random(), rng.random(), rng.random())).collect()
}

/// On a sphere, as seeds on a surface are.
fn sphere(n: usize) -> Vec<DVec3> {
    random(n).iter().map(|p| (*p - DVec3::splat(0.5)).normalize() * 0.5).collect()
}

fn lattice() -> Vec<DVec3> {
    (0..512).map(|i| DVec3::new((i % 8) as f64, (i / 8 % 8) as f64, (i / 64) as f64)).collect()
}

/// Seed sets of all kinds, and whether a grid takes them.
fn sets() -> Vec<(&'static str, Vec<DVec3>, bool)> {
    let sheet = |n: usize| -> Vec<DVec3> { random(n).iter().map(|p| DVec3::new(p.x, p.y, 0.0)).collect() };
    let mut clustered = sphere(200);
    clustered.extend(sphere(1000).iter().map(|&p| DVec3::splat(0.25) + 1e-3 * p));
    let mut duplicates = sphere(300);
    duplicates.extend_from_within(50..200);
    duplicates.extend_from_within(350..400);
    duplicates.push(DVec3::ZERO);
    duplicates.push(-DVec3::ZERO);
    let mut outliers = sphere(400);
    outliers.extend([DVec3::new(40.0, 0.0, 0.0), DVec3::new(0.0, -90.0, 7.0), DVec3::new(0.0, -90.0, 7.5)]);
    let mut farther = sphere(400);
    farther.push(DVec3::splat(1e30));
    let graded = sphere(900).iter().map(|p| *p * (0.05 + (p.z + 0.5).powi(2))).collect();
    let mut two_far = sphere(300);
    two_far.extend(sphere(300).iter().map(|&p| p + DVec3::X * 1e4));
    vec![
        ("volume", random(500), true),
        ("sphere", sphere(2000), true),
        ("sheet", sheet(900), true),
        ("lattice", lattice(), true),
        (
            "flat lattice",
            lattice()
                .iter()
                .map(|p| DVec3::new(p.x + 8.0 * (p.z % 4.0), p.y + 8.0 * (p.z / 4.0).floor(), 0.0))
                .collect(),
            true,
        ),
        ("graded", graded, true),
        ("clustered", clustered, false),
        ("line", random(300).iter().map(|p| DVec3::splat(p.x)).collect(), true),
        ("even line", (0..300).map(|i| DVec3::new(0.0, f64::from(i), 0.0)).collect(), true),
        ("outliers", outliers, false),
        ("farther", farther, false),
        ("two far", two_far, false),
        ("duplicates", duplicates, true),
        ("all coincident", vec![DVec3::ONE; 200], false),
        ("tiny", sphere(300).iter().map(|&p| 1e-120 * p).collect(), false),
        ("none", vec![], false),
        ("one", random(1), false),
        ("two", random(2), true),
        ("three", random(3), true),
        ("two and duplicates", [random(2), random(2), random(2)].concat(), true),
    ]
}

/// The whole row of seed `i`: later duplicates are in no row, and own a row of one.
fn brute<P: Point>(seeds: &[P], i: usize) -> Vec<u32> {
    let first = |j: usize| seeds.iter().position(|s| *s == seeds[j]).unwrap_or(j);
    if first(i) != i {
        return vec![first(i) as u32];
    }
    let mut all: Vec<(f64, u32)> = (0..seeds.len()).map(|j| (seeds[j].distance_squared(seeds[i]), j as u32)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    all.into_iter().map(|x| x.1).filter(|&j| j as usize != i && first(j as usize) == j as usize).collect()
}

#[test]
fn rows_are_prefixes_of_the_whole_order() {
    for (name, seeds, _) in sets() {
        rows_are_prefixes(name, &seeds);
        // With as many ties in six dimensions, and two seeds in each third place.
        let lifted = seeds.iter().map(|&place| Lifted { place, lift: 0.5 * DVec3::new(place.y, place.z, place.x) });
        let others = lifted.clone().step_by(3).map(|seed| Lifted { lift: -seed.lift, ..seed });
        rows_are_prefixes(name, &lifted.clone().chain(others).collect::<Vec<_>>());
    }
}

fn rows_are_prefixes<P: Point>(name: &str, seeds: &[P]) {
    let index = SeedIndex::new(seeds);
    let unique = seeds.len() - index.duplicates();
    let mut row = NeighbourRow::default();
    let squared = |i: usize, j: u32| seeds[i].distance_squared(seeds[j as usize]);
    for i in (0..seeds.len()).step_by(7) {
        let all = brute(seeds, i);
        for k in [1, 4, 5, 16, 24, 100, 400, 10_000] {
            index.row(i as u32, k, &mut row);
            assert_eq!(row.seeds[..], all[..row.seeds.len()], "{name}: seed {i}, k {k}");
            assert_eq!(row.complete, row.seeds.len() == all.len(), "{name}: seed {i}, k {k}");
            if !index.is_duplicate(i as u32) {
                // All that are nearer than the k-th, and no others.
                let whole = k + 1 >= unique;
                let len =
                    if whole { all.len() } else { all.partition_point(|&j| squared(i, j) < squared(i, all[k - 1])) };
                assert_eq!(row.seeds.len(), len, "{name}: seed {i}, k {k}");
            }
        }
    }
}

#[test]
fn a_grid_takes_what_is_spread_evenly() {
    for (name, seeds, takes) in sets() {
        let points: Vec<[f64; 3]> = seeds.iter().map(|p| p.to_array()).collect();
        for threads in [Threads::One, Threads::Pool] {
            assert_eq!(Grid::new(&points, threads).is_some(), takes, "{name}");
        }
    }
}

#[test]
fn a_grid_proves_nearly_all_rows_on_a_surface() {
    let seeds = sphere(20_000);
    let points: Vec<[f64; 3]> = seeds.iter().map(|p| p.to_array()).collect();
    let grid = Grid::new(&points, Threads::One).unwrap();
    let mut row = NeighbourRow::default();
    for k in [16, 24, 100, 400] {
        let proved = (0..20_000).filter(|&i| grid.row(i, (k - k / 3, k), &mut Default::default(), &mut row)).count();
        assert_eq!(proved, 20_000, "k {k}");
    }
    let found = seeds.iter().filter(|p| grid.nearest(&(**p * 1.0005).to_array()).is_some()).count();
    assert_eq!(found, 20_000);
}

#[test]
fn the_nearest_seed_is_nearest_and_no_later_duplicate() {
    for (name, seeds, _) in sets().into_iter().filter(|s| !s.1.is_empty()) {
        let (index, again) = (SeedIndex::new(&seeds), SeedIndex::with_threads(&seeds, Threads::One));
        let mut points = random(300);
        points.extend(sphere(300).iter().map(|&p| 1.1 * p));
        points.extend(seeds.iter().step_by(3));
        points.extend(lattice().iter().step_by(5).map(|&p| p + DVec3::splat(0.5)));
        points.extend([DVec3::splat(-1e6), DVec3::new(0.0, 1e200, 0.0), DVec3::new(3e4, 0.0, 0.0)]);
        for p in points {
            let squared = |s: &DVec3| (s.x - p.x) * (s.x - p.x) + (s.y - p.y) * (s.y - p.y) + (s.z - p.z) * (s.z - p.z);
            let found = index.nearest(p);
            let least = seeds.iter().map(squared).fold(f64::INFINITY, f64::min);
            assert_eq!(squared(&seeds[found as usize]), least, "{name}: {p}");
            assert!(!index.is_duplicate(found), "{name}: {p}");
            assert_eq!(found, again.nearest(p), "{name}: {p}");
        }
    }
}

#[test]
fn duplicates_are_hidden_and_own_a_row_of_one() {
    let mut seeds = random(100);
    for i in 50..100 {
        seeds[i] = seeds[i % 10];
    }
    let index = SeedIndex::new(&seeds);
    assert_eq!(index.duplicates(), 50);
    let mut row = NeighbourRow::default();
    index.row(57, 20, &mut row);
    assert_eq!((row.seeds.as_slice(), row.complete), (&[7][..], true));
    index.row(7, 1000, &mut row);
    assert_eq!((row.seeds.len(), row.complete), (49, true));
    assert!(row.seeds.iter().all(|&j| j < 50));
    assert_eq!(index.nearest(seeds[99]), 9);
}

#[test]
fn one_and_many_identical_seeds() {
    let one = SeedIndex::new(&[DVec3::ONE]);
    let mut row = NeighbourRow::default();
    one.row(0, 20, &mut row);
    assert!(row.seeds.is_empty() && row.complete);
    let same = SeedIndex::new(&vec![DVec3::ONE; 100_000]);
    same.row(0, 20, &mut row);
    assert!(row.seeds.is_empty() && row.complete);
}

#[test]
fn threads_do_not_change_the_rows() {
    for seeds in [random(20_000), sphere(20_000)] {
        let (a, b) = (SeedIndex::with_threads(&seeds, Threads::One), SeedIndex::new(&seeds));
        let (mut x, mut y) = (NeighbourRow::default(), NeighbourRow::default());
        for i in (0..seeds.len() as u32).step_by(97) {
            a.row(i, 24, &mut x);
            b.row(i, 24, &mut y);
            assert_eq!(x, y);
        }
    }
}

#[test]
fn a_table_holds_the_rows() {
    // One table for all, so that each set finds the memory of another one.
    let mut table = NeighbourTable::default();
    for (name, seeds, _) in sets() {
        for threads in [Threads::One, Threads::Pool] {
            let index = SeedIndex::with_threads(&seeds, threads);
            assert!(table.fill(&index, 24, threads, &|| false));
            let mut row = NeighbourRow::default();
            for i in 0..seeds.len() as u32 {
                index.row(i, 24.min(seeds.len()), &mut row);
                // A beginning of the row, with all that are nearer than the one at two thirds of it.
                let (got, complete) = table.row(i);
                assert_eq!(*got, row.seeds[..got.len()], "{name}: seed {i}");
                if let Some(&last) = row.seeds.get(15) {
                    let squared = |j: u32| (seeds[j as usize] - seeds[i as usize]).length_squared();
                    let nearer = row.seeds.partition_point(|&j| squared(j) < squared(last) * (1.0 - 1e-12));
                    assert!(got.len() >= nearer, "{name}: seed {i} has {} of {nearer}", got.len());
                }
                assert_eq!(complete, row.complete, "{name}: seed {i}");
            }
        }
    }
    {
        table.clear();
        assert_eq!(table.row(0), (&[][..], false));
    }
}
