//! Surfaces of several sheets that meet along curves, and regions of them.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use geometry::mesh::crossings::crossings;
use glam::DVec3;
use tessera::mesh::attributes::Attributes;
use tessera::mesh::regions::Regions;
use tessera::remesh::{Remesh, RemeshOptions, Seeds, remesh};
use tessera::rvd::Parallel;
use tessera::{Token, TriMesh};

use crate::rough::Random;

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Remesh {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default()).unwrap()
}

/// A box of `cells` chambers with all outer walls and some of the inner ones, each of `s` x `s` squares, bent by `bend`. The regions are
/// the planes.
fn chambers(random: &mut Random, cells: [u32; 3], s: u32, bend: f64) -> (TriMesh, Regions) {
    let mut number: HashMap<[u32; 3], u32> = HashMap::new();
    let (mut positions, mut facets, mut labels) = (Vec::new(), Vec::new(), Vec::new());
    let mut vertex = |at: [u32; 3]| {
        *number.entry(at).or_insert_with(|| {
            let p = DVec3::from(at.map(|k| f64::from(k) / f64::from(s)));
            positions.push(p + bend * DVec3::new((2.1 * p.y).sin(), (1.7 * p.z).sin(), (1.9 * p.x).sin()));
            positions.len() as u32 - 1
        })
    };
    for axis in 0..3 {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        for plane in 0..=cells[axis] {
            for i in 0..cells[u] {
                for j in 0..cells[v] {
                    let is_outer = plane == 0 || plane == cells[axis];
                    if !is_outer && random.unit() < 0.3 {
                        continue;
                    }
                    for (k, l) in (0..s).flat_map(|k| (0..s).map(move |l| (k, l))) {
                        let mut corner = |du: u32, dv: u32| {
                            let mut at = [0; 3];
                            (at[axis], at[u], at[v]) = (plane * s, i * s + k + du, j * s + l + dv);
                            vertex(at)
                        };
                        let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                        facets.extend([[a, b, c], [a, c, d]]);
                        labels.extend([(10 * axis as u32 + plane) as i64; 2]);
                    }
                }
            }
        }
    }
    (TriMesh::new(positions, facets).unwrap(), Regions::of_numbers(&labels).unwrap())
}

fn edges(mesh: &TriMesh) -> BTreeMap<[u32; 2], usize> {
    let mut edges = BTreeMap::new();
    for &[a, b, c] in mesh.facets() {
        for [p, q] in [[a, b], [b, c], [c, a]] {
            *edges.entry([p.min(q), p.max(q)]).or_default() += 1;
        }
    }
    edges
}

/// Vertices less edges plus facets, with vertices as the facets name them.
fn euler(mesh: &TriMesh) -> i64 {
    let used: BTreeSet<u32> = mesh.facets().iter().flatten().copied().collect();
    used.len() as i64 - edges(mesh).len() as i64 + mesh.facets().len() as i64
}

fn area_by_label(mesh: &TriMesh, regions: &Regions) -> BTreeMap<i64, f64> {
    let mut areas = BTreeMap::new();
    for (f, label) in regions.numbers().enumerate() {
        let [a, b, c] = mesh.corners(f);
        *areas.entry(label).or_default() += 0.5 * (b - a).cross(c - a).length();
    }
    areas
}

/// Length of the edges that have this many facets.
fn length_of(mesh: &TriMesh, facets: impl Fn(usize) -> bool) -> f64 {
    let at = |v: u32| mesh.positions()[v as usize];
    edges(mesh).into_iter().filter(|e| facets(e.1)).map(|([a, b], _)| at(a).distance(at(b))).sum()
}

fn assert_is_the_same_complex(name: &str, mesh: &TriMesh, regions: &Regions, bend: f64) {
    let edge = 1.0 / 5.0;
    let points = (mesh.area() / (3f64.sqrt() / 2.0 * edge * edge)) as usize;
    let mut attributes = Attributes::new(mesh);
    attributes.set_regions(regions.clone()).unwrap();
    let options =
        RemeshOptions::new(Seeds::Sample { points, seed: 0 }).with_attributes(attributes).with_keep_non_manifold(true);
    let done = run(mesh, &options);
    let report = &done.report;
    let name = format!("{name}: {:?} {:?}", report.features, report.result.topology);
    assert_eq!(euler(&done.mesh), euler(mesh), "{name}");
    // A chord of length h is shorter than its arc of curvature k by (h k)² / 24 of it; here h = 1/5, and k is up to 4.4 times `bend`.
    let chords = (edge * 4.4 * bend).powi(2) / 24.0;
    for (what, count) in [("rims", 1), ("joints of three", 3), ("of four", 4)] {
        let [before, after] = [mesh, &done.mesh].map(|mesh| length_of(mesh, |k| k == count));
        assert!((after - before).abs() <= (1e-6 + chords) * before, "{name}: {what} {before} {after}");
    }
    assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0, "{name}");
    let after = area_by_label(&done.mesh, done.attributes.as_ref().unwrap().regions().unwrap());
    let before = area_by_label(mesh, regions);
    for (label, area) in &before {
        let now = after.get(label).copied().unwrap_or(0.0);
        assert!((now / area - 1.0).abs() <= 1e-3, "{name}: region {label} has {now} of {area}");
    }
    assert_eq!(after.len(), before.len(), "{name}");
    let vertices = done.mesh.positions().len();
    assert!(vertices.abs_diff(points) * 50 <= points, "{name}: {vertices} for {points}");
}

#[test]
fn chambers_are_the_same_complex() {
    let mut random = Random::new(7);
    for (cells, bend) in [([1, 1, 2], 0.0), ([2, 2, 1], 0.0), ([2, 2, 2], 0.0), ([3, 2, 1], 0.15), ([2, 2, 2], 0.15)] {
        for _ in 0..2 {
            let (mesh, regions) = chambers(&mut random, cells, 12, bend);
            assert_is_the_same_complex(&format!("{cells:?}, bent by {bend}"), &mesh, &regions, bend);
        }
    }
}
