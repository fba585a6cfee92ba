//! Surfaces between labelled cells of a grid, as segmented images have them: three sheets meet in a curve, and four curves in a point.

use std::collections::{BTreeMap, BTreeSet};

use geometry::mesh::crossings::crossings;
use glam::DVec3;
use tessera::TriMesh;
use tessera::mesh::attributes::Attributes;
use tessera::mesh::regions::Regions;
use tessera::remesh::{RemeshOptions, Seeds};

use crate::complexes::{Failures, edges, euler, how_many, run};
use crate::rough::Random;

/// Rounds of smoothing, after which little of the grid is left.
const ROUNDS: usize = 60;

/// The surfaces between what `label` tells apart in the unit cube, on a grid of `n` cells a side, six tetrahedra each. They face the
/// higher label; a region is what lies between two.
fn between_labels(n: usize, label: impl Fn(DVec3) -> i64) -> (TriMesh, Regions) {
    let place = |at: [usize; 3]| DVec3::from(at.map(|k| k as f64 / n as f64));
    // Vertices by the grid's points that they are the middle of.
    let mut number: BTreeMap<Vec<[usize; 3]>, u32> = BTreeMap::new();
    let (mut positions, mut facets, mut labels) = (Vec::new(), Vec::new(), Vec::new());
    let cells = (0..n).flat_map(|i| (0..n).flat_map(move |j| (0..n).map(move |k| [i, j, k])));
    let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    for (cell, order) in cells.flat_map(|cell| orders.map(|order| (cell, order))) {
        let mut corners = [cell; 4];
        for (k, axis) in order.into_iter().enumerate() {
            (k + 1..4).for_each(|later| corners[later][axis] += 1);
        }
        let own = corners.map(|at| label(place(at)));
        for [a, b] in (0..4).flat_map(|a| (0..4).map(move |b| [a, b])).filter(|&[a, b]| own[a] < own[b]) {
            let rest: Vec<usize> = (0..4).filter(|&k| k != a && k != b).collect();
            let around = [vec![a, b], vec![a, b, rest[0]], vec![0, 1, 2, 3], vec![a, b, rest[1]]];
            let mut ring = around.map(|of| {
                let mut of: Vec<[usize; 3]> = of.into_iter().map(|k| corners[k]).collect();
                of.sort_unstable();
                let middle = of.iter().map(|&at| place(at)).sum::<DVec3>() / of.len() as f64;
                *number.entry(of).or_insert_with(|| {
                    positions.push(middle);
                    positions.len() as u32 - 1
                })
            });
            let [p, q, r, s] = ring.map(|v| positions[v as usize]);
            if (r - p).cross(s - q).dot(place(corners[b]) - place(corners[a])) < 0.0 {
                ring.reverse();
            }
            let [p, q, r, s] = ring;
            facets.extend([[p, q, r], [p, r, s]]);
            labels.extend([1000 * own[a] + own[b]; 2]);
        }
    }
    let mut mesh = TriMesh::new(positions, facets).unwrap();
    smooth(&mut mesh);
    (mesh, Regions::of_numbers(&labels).unwrap())
}

/// Moves each vertex half way to the middle of its neighbours: in a curve along it, in a side of the cube within that.
fn smooth(mesh: &mut TriMesh) {
    let mut along: Vec<Vec<u32>> = vec![Vec::new(); mesh.positions().len()];
    let mut around = along.clone();
    for ([a, b], count) in edges(mesh) {
        for (v, other) in [(a, b), (b, a)] {
            around[v as usize].push(other);
            if count != 2 {
                along[v as usize].push(other);
            }
        }
    }
    let mut positions = mesh.positions().to_vec();
    for _ in 0..ROUNDS {
        let before = positions.clone();
        for (v, p) in positions.iter_mut().enumerate() {
            let by = if along[v].is_empty() { &around[v] } else { &along[v] };
            let middle = by.iter().map(|&u| before[u as usize]).sum::<DVec3>() / by.len() as f64;
            let moved = 0.5 * (*p + middle);
            let stays = |axis: usize| [0.0, 1.0].contains(&before[v][axis]);
            *p = DVec3::from([0, 1, 2].map(|axis| if stays(axis) { before[v][axis] } else { moved[axis] }));
        }
    }
    *mesh = TriMesh::new(positions, mesh.facets().to_vec()).unwrap();
}

/// The cells of points far from each other.
fn foam(random: &mut Random, cells: usize, n: usize) -> (TriMesh, Regions) {
    let mut centres = vec![random.point()];
    let nearest = |centres: &[DVec3], p: DVec3| {
        let by = |k: &usize| p.distance_squared(centres[*k]);
        (0..centres.len()).min_by(|a, b| by(a).total_cmp(&by(b))).unwrap()
    };
    while centres.len() < cells {
        let tried: Vec<DVec3> = (0..30).map(|_| random.point()).collect();
        let clear = |p: &DVec3| p.distance(centres[nearest(&centres, *p)]);
        centres.push(tried.into_iter().max_by(|a, b| clear(a).total_cmp(&clear(b))).unwrap());
    }
    between_labels(n, |p| nearest(&centres, p) as i64)
}

/// A bent pipe with walls across it.
fn pipe(random: &mut Random, walls: usize, n: usize) -> (TriMesh, Regions) {
    let (bend, radius, turn) = (0.1 + 0.05 * random.unit(), 0.2 + 0.05 * random.unit(), 3.0 + 2.0 * random.unit());
    between_labels(n, |p| {
        let is_within = (p.x - 0.5 - bend * (turn * p.z).sin()).hypot(p.y - 0.5) < radius;
        if is_within { 1 + (p.z * (walls + 1) as f64).floor().min(walls as f64) as i64 } else { 0 }
    })
}

/// The same with vertices in one place as one.
fn welded(mesh: &TriMesh) -> TriMesh {
    let mut number: BTreeMap<[u64; 3], u32> = BTreeMap::new();
    let mut positions = Vec::new();
    let place = |p: &DVec3| {
        let key = (*p + DVec3::ZERO).to_array().map(f64::to_bits);
        *number.entry(key).or_insert_with(|| {
            positions.push(*p);
            positions.len() as u32 - 1
        })
    };
    let of: Vec<u32> = mesh.positions().iter().map(place).collect();
    let facets: BTreeSet<[u32; 3]> = mesh.facets().iter().map(|t| t.map(|v| of[v as usize])).collect();
    TriMesh::new(positions, facets.into_iter().collect()).unwrap()
}

fn assert_is_the_same(name: &str, mesh: &TriMesh, regions: &Regions, points: usize) {
    for keeps in [true, false] {
        let mut options = RemeshOptions::new(Seeds::Sample { points, seed: 0 }).with_keep_non_manifold(keeps);
        if keeps {
            let mut attributes = Attributes::new(mesh);
            attributes.set_regions(regions.clone()).unwrap();
            options = options.with_attributes(attributes);
        }
        let done = run(mesh, &options);
        let report = &done.report;
        let name =
            format!("{name}, {points} points, keeps {keeps}: {:?} {:?}", report.features, report.result.topology);
        if !keeps {
            let topology = &report.result.topology;
            assert_eq!((topology.non_manifold_edges, topology.non_manifold_vertices), (0, 0), "{name}");
        }
        assert_eq!(euler(&welded(&done.mesh)), euler(mesh), "{name}");
        assert_eq!(crossings(&done.mesh, &tessera::Token::default()).unwrap().count, 0, "{name}");
        let share = done.mesh.area() / mesh.area();
        // Smoothing leaves waves of the grid, which facets cut short.
        assert!((share - 1.0).abs() < 2e-3, "{name}: {share} of the area");
        assert!(done.mesh.positions().len().abs_diff(points) * 50 <= points, "{name}");
    }
}

#[test]
fn pipes_and_foams_of_labels_are_the_same_complex() {
    let (mut random, mut failures) = (Random::new(11), Failures::default());
    for k in 0..how_many(2) {
        let (mesh, regions) = foam(&mut random, 4 + k % 4, 10);
        failures.check(|| assert_is_the_same(&format!("foam {k}"), &mesh, &regions, 1500));
        let (mesh, regions) = pipe(&mut random, 1 + k % 2, 12);
        failures.check(|| assert_is_the_same(&format!("pipe {k}"), &mesh, &regions, 1500));
    }
    failures.finish();
}
