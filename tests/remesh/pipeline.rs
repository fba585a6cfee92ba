//! The whole pipeline on generated surfaces: topology kept, orientation kept, the same bits.

use crate::{hostile, surfaces};
use glam::DVec3;
use tessera::cvt::{DensityOptions, DensitySource};
use tessera::mesh::TriMesh;
use tessera::mesh::attributes::Attributes;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Observer, Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::{Backend, RvdError};
use tessera::rvd::{Parallel, Serial};
use tessera::token::Token;

fn options(points: usize, lloyd: usize) -> RemeshOptions {
    RemeshOptions::plain(Seeds::Sample { points, seed: 3 }, lloyd)
}

fn run(mesh: &TriMesh, options: &RemeshOptions, backend: &dyn Backend) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, backend, &mut (), &Token::default())
}

/// Six times the volume inside a closed surface: positive if it is oriented outward.
fn volume(mesh: &TriMesh) -> f64 {
    (0..mesh.facets().len()).map(|f| mesh.corners(f)).map(|[a, b, c]| a.dot(b.cross(c))).sum()
}

#[test]
fn closed_surfaces_keep_their_topology_and_orientation() {
    let backend = Parallel::new(None).unwrap();
    for (shape, mesh) in surfaces::closed(4000) {
        for (points, lloyd) in [(1500, 0), (1500, 10), (400, 10)] {
            let out = run(&mesh, &options(points, lloyd), &backend).unwrap();
            let after = topology(&out.mesh);
            assert_eq!(after.euler, shape.euler(), "{shape}, {points} points, {lloyd} steps: {after:?}");
            assert_eq!(
                after,
                tessera::mesh::measure::Topology { euler: shape.euler(), components: 1, ..Default::default() }
            );
            let triangles = 2 * out.mesh.positions().len() as i64 - 2 * shape.euler();
            assert_eq!(out.mesh.facets().len() as i64, triangles, "{shape}");
            let kept = volume(&out.mesh) / volume(&mesh);
            assert!(kept > 0.7 && kept < 1.1, "{shape}, {points} points: volume {kept}");
            assert_eq!(out.vertex_seed.len(), out.mesh.positions().len());
        }
    }
}

/// Facets that are much larger than cells are divided for the steps, and what is said of the surface is of those that came in.
#[test]
fn a_block_of_few_facets_is_divided_for_the_steps_alone() {
    let corner = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let facets = sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let mesh = TriMesh::new((0..8).map(corner).collect(), facets).unwrap();
    let given = mesh.facets().len();
    let weights = mesh.positions().iter().map(|p| 1.0 + p.x.abs()).collect();
    for source in [DensitySource::Uniform, DensitySource::Weights(weights)] {
        let density = DensityOptions::new().with_source(source);
        let sample = RemeshOptions::new(Seeds::Sample { points: 900, seed: 3 });
        let options = sample.with_density(density).with_attributes(Attributes::new(&mesh));
        let out = run(&mesh, &options, &Parallel::new(Some(2)).unwrap()).unwrap();
        let report = &out.report;
        assert_eq!(report.input.facets, given);
        assert!(report.density.facets > 10 * given, "{:?}", report.density);
        assert!(report.features.seeds > 0 && report.features.missing_segments == 0, "{:?}", report.features);
        assert!(report.result.quality.as_ref().unwrap().hausdorff_percent < 1e-9, "{:?}", report.result);
        assert!((out.mesh.area() / mesh.area() - 1.0).abs() < 1e-9);
        assert_eq!(out.provenance.len(), out.mesh.positions().len());
        for (place, p) in out.provenance.iter().zip(out.mesh.positions()) {
            let [a, b, c] = mesh.corners(place.facet as usize);
            let [u, v, w] = place.barycentric;
            assert!((u * a + v * b + w * c).distance(*p) < 1e-9);
        }
    }
}

/// Weights are checked before anything is made of them.
#[test]
fn weights_that_are_none_are_refused() {
    let mesh = Shape::Block.build(12);
    let vertices = mesh.positions().len();
    let of = |weights: Vec<f64>| {
        let density = DensityOptions::new().with_source(DensitySource::Weights(weights));
        let options = RemeshOptions::new(Seeds::Sample { points: 500, seed: 3 }).with_density(density);
        run(&mesh, &options, &Serial).map(|_| ())
    };
    for count in [0, vertices - 1, vertices + 1] {
        let refused = of(vec![1.0; count]);
        assert!(matches!(refused, Err(RemeshError::Rvd(RvdError::WeightCount { .. }))), "{count}: {refused:?}");
    }
    for bad in [f64::NAN, f64::INFINITY, -1.0] {
        let mut weights = vec![1.0; vertices];
        weights[2] = bad;
        let refused = of(weights);
        assert!(matches!(refused, Err(RemeshError::Rvd(RvdError::BadWeight { .. }))), "{bad}: {refused:?}");
    }
    assert!(of(vec![0.0; vertices]).is_err());
}

#[test]
fn no_facet_joins_two_sheets() {
    let mesh = Shape::Sheets.build(2000);
    let out = run(&mesh, &options(300, 10), &Serial).unwrap();
    let after = topology(&out.mesh);
    assert_eq!((after.components, after.euler, after.boundary_loops), (2, 2, 2));
    let (low, high) = mesh.bounds();
    let middle = 0.5 * (low + high).z;
    for f in 0..out.mesh.facets().len() {
        let above = out.mesh.corners(f).map(|p| p.z > middle);
        assert!(above == [true; 3] || above == [false; 3], "facet {f} joins the sheets");
    }
}

/// A plate a hundredth as thick as wide with 200 vertices, spaced a tenth of its width: cells reach
/// through it, and their two parts are two vertices.
#[test]
fn a_thin_plate_keeps_its_two_sides() {
    let block = Shape::Genus(0).build(6000);
    let (low, high) = block.bounds();
    let thin = (high - low).min_element();
    let flat = if (high - low).z == thin {
        DVec3::Z
    } else if (high - low).y == thin {
        DVec3::Y
    } else {
        DVec3::X
    };
    let squeeze = DVec3::ONE + flat * (0.01 / thin - 1.0);
    let positions = block.positions().iter().map(|&p| (p - low) / (high - low).max_element() * squeeze).collect();
    let mesh = TriMesh::new(positions, block.facets().to_vec()).unwrap();
    for lloyd in [0, 20] {
        let out = run(&mesh, &options(200, lloyd), &Serial).unwrap();
        let after = topology(&out.mesh);
        assert_eq!((after.euler, after.components), (2, 1), "{lloyd} steps: {:?}", out.report.result.repair);
        assert_eq!((after.boundary_edges, after.non_manifold_edges, after.non_manifold_vertices), (0, 0, 0));
        assert!(out.report.result.repair.split_cells > 20, "{lloyd} steps: the plate is not thin");
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    for mesh in [Shape::Torus.build(3000), Shape::Slivers.build(3000)] {
        let want = run(&mesh, &options(500, 5), &Parallel::new(Some(2)).unwrap()).unwrap();
        for threads in [1, 2, 3] {
            let backend = Parallel::new(Some(threads)).unwrap();
            let got = run(&mesh, &options(500, 5), &backend).unwrap();
            assert_eq!(got.mesh, want.mesh);
            assert_eq!(got.vertex_seed, want.vertex_seed);
        }
    }
}

/// Wants to see the seeds after every step, or every third.
struct Onlooker {
    every: usize,
    asked: usize,
    seen: Vec<(usize, Vec<DVec3>)>,
}

impl Observer for Onlooker {
    fn wants_seeds(&mut self) -> bool {
        self.asked += 1;
        self.asked.is_multiple_of(self.every)
    }

    fn seeds(&mut self, steps: usize, seeds: &[DVec3]) {
        self.seen.push((steps, seeds.to_vec()));
    }
}

#[test]
fn who_looks_on_sees_the_seeds_move_and_changes_nothing() {
    let (mesh, backend) = (Shape::Block.build(3000), Parallel::new(None).unwrap());
    for options in [options(200, 12), RemeshOptions::new(Seeds::Sample { points: 200, seed: 5 })] {
        let alone = run(&mesh, &options, &backend).unwrap();
        for every in [1, 3] {
            let mut onlooker = Onlooker { every, asked: 0, seen: Vec::new() };
            let seen = remesh(&mesh, &options, &backend, &mut onlooker, &Token::default()).unwrap();
            assert_eq!(seen.mesh.positions(), alone.mesh.positions());
            assert_eq!(seen.mesh.facets(), alone.mesh.facets());
            let Onlooker { seen, .. } = onlooker;
            assert!(seen.len() > 2 && seen.is_sorted_by_key(|(steps, _)| *steps), "{}", seen.len());
            let (low, high) = mesh.bounds();
            for (steps, seeds) in &seen {
                assert_eq!(seeds.len(), 200, "after {steps} steps");
                let margin = (high - low) * 0.01;
                assert!(seeds.iter().all(|s| s.cmpge(low - margin).all() && s.cmple(high + margin).all()));
            }
            assert_ne!(seen.first().unwrap().1, seen.last().unwrap().1);
        }
    }
}

#[test]
fn units_and_offset_do_not_matter() {
    let mesh = Shape::Torus.build(2000);
    let moved = |scale: f64, offset: DVec3| {
        let positions = mesh.positions().iter().map(|&p| p * scale + offset).collect();
        TriMesh::new(positions, mesh.facets().to_vec()).unwrap()
    };
    for (scale, offset) in [(1e-30, DVec3::ZERO), (1e30, DVec3::ZERO), (1.0, DVec3::splat(1e6))] {
        let out = run(&moved(scale, offset), &options(300, 5), &Serial).unwrap();
        let after = topology(&out.mesh);
        assert_eq!((after.euler, after.non_manifold_edges), (0, 0), "scale {scale}, offset {offset}");
        assert_eq!(out.mesh.positions().len(), 300);
    }
}

#[test]
fn given_seeds_are_the_vertices() {
    let mesh = Shape::Sphere.build(3000);
    let seeds: Vec<DVec3> = tessera::mesh::sample::sample(&mesh, None, 200, 9).iter().map(|p| p.position).collect();
    let out = run(&mesh, &options(0, 0).with_seeds(Seeds::Given(seeds.clone())), &Serial).unwrap();
    assert_eq!(out.mesh.positions().len(), 200);
    for (p, &seed) in out.mesh.positions().iter().zip(&out.vertex_seed) {
        assert!(p.distance(seeds[seed as usize]) < 1e-12);
    }
    assert!(matches!(
        run(&mesh, &options(0, 0).with_seeds(Seeds::Given(vec![])), &Serial),
        Err(RemeshError::Rvd(RvdError::NoSeeds))
    ));
    assert!(matches!(
        run(&mesh, &options(0, 0).with_seeds(Seeds::Given(seeds[..2].to_vec())), &Serial),
        Err(RemeshError::TooFewSeeds { seeds: 2, .. })
    ));
}

#[test]
fn weights_gather_seeds() {
    let mesh = Shape::Plane.build(4000);
    let weights: Vec<f64> = mesh.positions().iter().map(|p| if p.x > 0.5 { 1.0 } else { 1.0 / 256.0 }).collect();
    let out = run(&mesh, &options(1000, 20).with_density(Some(weights).into()), &Serial).unwrap();
    let right = out.mesh.positions().iter().filter(|p| p.x > 0.5).count() as f64;
    // Edge length ∝ w^(-1/4): four times as fine on the right, sixteen times as many seeds.
    let ratio = right / (1000.0 - right);
    assert!(ratio > 11.0 && ratio < 20.0, "{ratio}");
}

fn seeded(mesh: &TriMesh, seeds: Vec<DVec3>) -> Remesh {
    run(mesh, &options(0, 0).with_seeds(Seeds::Given(seeds)), &Serial).unwrap()
}

/// A square lattice: every RVD vertex is where four cells meet.
#[test]
fn a_lattice_has_a_valid_dual() {
    let mesh = Shape::Plane.build(800);
    for side in [2u32, 5, 10, 21] {
        let seeds: Vec<DVec3> = (0..side * side)
            .map(|k| DVec3::new(f64::from(k % side) + 0.5, f64::from(k / side) + 0.5, 0.0) / f64::from(side))
            .collect();
        let out = seeded(&mesh, seeds);
        assert_eq!(out.mesh.positions().len(), (side * side) as usize);
        assert_eq!(out.mesh.facets().len(), 2 * (side as usize - 1).pow(2), "side {side}");
        let after = topology(&out.mesh);
        assert_eq!((after.euler, after.boundary_loops, after.non_manifold_edges), (1, 1, 0), "side {side}");
        let report = &out.report.result.repair;
        assert_eq!((report.not_disks, report.multiple_edges, report.inconsistent_vertices), (0, 0, 0));
    }
}

/// Seeds on a circle: all their cells meet in its centre.
#[test]
fn cocircular_seeds_have_a_valid_dual() {
    let mesh = Shape::Plane.build(500);
    for n in [3, 4, 6, 8, 12] {
        let seeds: Vec<DVec3> = (0..n)
            .map(|k| f64::from(k) / f64::from(n) * std::f64::consts::TAU)
            .map(|a| DVec3::new(0.5 + 0.25 * a.cos(), 0.5 + 0.25 * a.sin(), 0.0))
            .collect();
        let out = seeded(&mesh, seeds);
        assert_eq!((out.mesh.positions().len(), out.mesh.facets().len()), (n as usize, n as usize - 2));
        assert_eq!(topology(&out.mesh).euler, 1);
    }
}

/// A cube with seeds on its corners, edges and faces, in a grid.
#[test]
fn a_cube_with_seeds_on_edges_and_corners() {
    let corner = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let facets = quads.iter().flat_map(|q: &[u32; 4]| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    let mesh = TriMesh::new((0..8).map(corner).collect(), facets).unwrap();
    assert!(volume(&mesh) > 0.0);
    for n in [2u32, 3, 5] {
        let mut seeds = Vec::new();
        for k in 0..(n + 1).pow(3) {
            let at = [k % (n + 1), k / (n + 1) % (n + 1), k / (n + 1).pow(2)];
            if at.iter().any(|&c| c == 0 || c == n) {
                seeds.push(DVec3::from_array(at.map(f64::from)) / f64::from(n));
            }
        }
        let count = seeds.len();
        let out = seeded(&mesh, seeds);
        let after = topology(&out.mesh);
        assert_eq!(out.mesh.positions().len(), count, "n {n}");
        assert_eq!((after.euler, after.components, after.non_manifold_edges), (2, 1, 0), "n {n}");
        assert_eq!(out.mesh.facets().len(), 2 * count - 4);
        assert!(out.report.topology_changes.is_empty());
    }
}

/// Facets without area between others: no integral has them, but the surface goes on across them.
#[test]
fn flat_facets_do_not_cut_the_surface() {
    // A grid whose middle line is doubled: below it the edges are twice as long as above, and flat
    // triangles lie between.
    let n = 8u32;
    let mut positions = Vec::new();
    let mut facets = Vec::new();
    let mut row = |y: f64, count: u32| -> Vec<u32> {
        let first = positions.len() as u32;
        positions.extend((0..=count).map(|x| DVec3::new(f64::from(x) / f64::from(count), y, 0.0)));
        (first..=first + count).collect()
    };
    let (low, coarse, fine, high) = (row(0.0, n), row(0.5, n), row(0.5, 2 * n), row(1.0, 2 * n));
    let mut strip = |a: &[u32], b: &[u32]| {
        for k in 0..a.len() - 1 {
            facets.extend([[a[k], a[k + 1], b[k + 1]], [a[k], b[k + 1], b[k]]]);
        }
    };
    strip(&low, &coarse);
    strip(&fine, &high);
    for k in 0..n as usize {
        facets.push([coarse[k], coarse[k + 1], fine[2 * k + 1]]);
    }
    let mesh = TriMesh::new(positions, facets).unwrap();
    assert_eq!(mesh.degenerate_count(), n as usize);
    let out = run(&mesh, &options(150, 10), &Parallel::new(Some(2)).unwrap()).unwrap();
    let after = topology(&out.mesh);
    assert_eq!((after.euler, after.components, after.boundary_loops), (1, 1, 1), "{:?}", out.report.result.repair);
    assert_eq!(out.mesh.positions().len(), 150);
}

/// Both sides of a surface without thickness: the sides stay two where they are two sheets, and a
/// surface that is the same facets twice over is refused by name.
#[test]
fn surfaces_without_thickness() {
    let sheet = Shape::Plane.build(200);
    let flip = |f: &[u32; 3], by: u32| [f[0] + by, f[2] + by, f[1] + by];
    let count = sheet.positions().len() as u32;
    let two = |by: u32| {
        let mut positions = sheet.positions().to_vec();
        positions.extend_from_slice(sheet.positions());
        let facets = sheet.facets().iter().copied().chain(sheet.facets().iter().map(|f| flip(f, by))).collect();
        TriMesh::new(positions, facets).unwrap()
    };
    // Welded or not, both sides lie in the same places, so they are the same edges.
    for mesh in [two(0), two(count)] {
        assert!(matches!(run(&mesh, &options(100, 2), &Serial), Err(RemeshError::NoThickness)));
    }
    // Two triangles with the same corners are a closed surface.
    let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    let mesh = TriMesh::new(corners, vec![[0, 1, 2], [0, 2, 1]]).unwrap();
    for points in [20, 30, 100] {
        let out = run(&mesh, &options(points, 2), &Serial).unwrap();
        let after = topology(&out.mesh);
        assert_eq!((after.euler, after.non_manifold_edges, after.non_manifold_vertices), (2, 0, 0), "{points} points");
    }
}

#[test]
fn too_few_seeds_for_the_topology_are_said_to_be() {
    let mesh = Shape::Genus(3).build(3000);
    assert!(matches!(run(&mesh, &options(12, 5), &Serial), Err(RemeshError::TooFewSeeds { seeds: 12, .. })));
    for (points, euler) in [(16, None), (24, None), (40, Some(-4))] {
        let out = run(&mesh, &options(points, 5), &Serial).unwrap();
        let (repair, after) = (&out.report.result.repair, topology(&out.mesh));
        assert!(repair.not_disks + repair.multiple_edges > 0, "{points} points");
        assert_eq!(out.report.topology_changes.is_empty(), after.euler == -4, "{points} points");
        // Cells that meet twice, on two sides of the plate: the edge is made two, and the handles stay.
        assert!(euler.is_none_or(|euler| after.euler == euler), "{points} points: {after:?}");
    }
    let enough = run(&mesh, &options(1500, 5), &Serial).unwrap();
    assert_eq!((enough.report.result.repair.not_disks, enough.report.result.repair.multiple_edges), (0, 0));
    assert!(enough.report.topology_changes.is_empty());
}

/// Quasi-Newton steps end when they have converged, however many were asked for.
#[test]
fn steps_end_when_they_have_converged() {
    let mesh = Shape::Torus.build(1000);
    let options = RemeshOptions::plain(Seeds::Sample { points: 20, seed: 1 }, 2).with_newton(300);
    for (backend, _) in hostile::backends() {
        let out = hostile::run(&mesh, &options, backend).unwrap();
        assert!(out.report.converged);
        let taken = out.report.iterations.len();
        assert!((3..302).contains(&taken), "{taken}");
        let kinds = out.report.iterations.iter().map(|i| i.kind).collect::<Vec<_>>();
        assert_eq!(kinds[..2], ["lloyd"; 2]);
        assert_eq!(kinds[2], "lbfgs");
    }
}
