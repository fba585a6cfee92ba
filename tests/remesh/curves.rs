//! Promise: a remesh keeps creases, corners and boundaries.

use std::collections::BTreeSet;

use ::gpu::diagram::Gpu;
use geometry::mesh::adjacency::{Adjacency, EdgeKind};
use geometry::mesh::features::FeatureError;
use glam::{DQuat, DVec3};
use needs::needs;
use tessera::cvt::{DensityOptions, DensitySource};
use tessera::mesh::TriMesh;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::report::CountReason;
use tessera::remesh::{Placement, Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::Backend;
use tessera::rvd::Parallel;

use crate::parts::{counts, creases_above, disk, find, l_shape, length, prism, slit, tube};
use tessera::token::Token;

pub(crate) fn options(points: usize) -> RemeshOptions {
    RemeshOptions::new(Seeds::Sample { points, seed: 5 })
        .with_newton(15)
        .with_placement(Placement::Surface)
        .with_measure(false)
}

fn run_on(backend: &dyn Backend, mesh: &TriMesh, options: &RemeshOptions) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, backend, &mut (), &Token::default())
}

pub(crate) fn run(mesh: &TriMesh, options: &RemeshOptions) -> Result<Remesh, RemeshError> {
    run_on(&Parallel::new(Some(2)).unwrap(), mesh, options)
}

fn edges(mesh: &TriMesh) -> BTreeSet<[u32; 2]> {
    let of = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
    mesh.facets().iter().flat_map(of).map(|[a, b]| [a.min(b), a.max(b)]).collect()
}

/// Every straight crease of the input is a chain of edges of the result, its corners are vertices, and the result has
/// the input's topology. Vertices of curves are at most `off` from them.
fn keeps_creases(name: &str, mesh: &TriMesh, out: &Remesh, off: f64) {
    let figures = &out.report.features;
    assert_eq!(
        (figures.missing_segments, figures.broken_curves, figures.dropped_curves),
        (0, 0, 0),
        "{name}: {figures:?}"
    );
    assert_eq!(out.report.topology_changes, Vec::<String>::new(), "{name}");
    let wanted = find(mesh, &creases_above(30.0)).unwrap();
    assert_eq!(figures.boundaries + figures.creases, wanted.curves.len(), "{name}");
    assert_eq!(figures.corners, wanted.corners.len(), "{name}");
    for &v in &wanted.corners {
        let corner = mesh.positions()[v as usize];
        assert!(out.mesh.positions().contains(&corner), "{name}: {corner} is no vertex");
    }
    let there = edges(&out.mesh);
    let lines: Vec<[DVec3; 2]> = wanted
        .curves
        .iter()
        .map(|c| [c.vertices[0], c.vertices[c.vertices.len() - 1]].map(|v| mesh.positions()[v as usize]))
        .collect();
    let mut covered = vec![0.0; lines.len()];
    for &[a, b] in &out.curve_edges {
        assert!(there.contains(&[a.min(b), a.max(b)]), "{name}: a curve edge is none of the mesh");
        let ends = [a, b].map(|v| out.mesh.positions()[v as usize]);
        let on = |[p, q]: &[DVec3; 2]| {
            let way = (*q - *p).normalize();
            ends.iter().all(|&e| {
                (e - *p).reject_from_normalized(way).length() < off && {
                    let s = (e - *p).dot(way);
                    s > -off && s < p.distance(*q) + off
                }
            })
        };
        let k = lines.iter().position(on).unwrap_or_else(|| panic!("{name}: {ends:?} is on no crease"));
        covered[k] += ends[0].distance(ends[1]);
    }
    for (covered, [p, q]) in covered.iter().zip(&lines) {
        // A zigzag of slope s is longer by s²/2.
        let longer = 1e-9 + 5.0 * off * off;
        assert!((covered - p.distance(*q)).abs() < longer, "{name}: {covered} of the crease from {p} to {q}");
    }
}

/// Coordinates are a few units large and go to the unit frame and back.
fn keeps_straight_creases(name: &str, mesh: &TriMesh, out: &Remesh) {
    keeps_creases(name, mesh, out, 1e-9);
}

/// What is noise beside the edges of a remesh stays that where other edges of it are much shorter.
#[test]
fn an_adaptive_remesh_takes_no_noise_for_creases() {
    let ball = Shape::Sphere.build(8000);
    // Bumps of one vertex each on one side, and edges that are to be a tenth as long as there on the other.
    let bumps = |(v, &p): (usize, &DVec3)| if v % 11 == 0 && p.x < 0.5 { 1.03 * p } else { p };
    let positions = ball.positions().iter().enumerate().map(bumps).collect();
    let mesh = TriMesh::new(positions, ball.facets().to_vec()).unwrap();
    assert!(counts(&find(&mesh, &creases_above(30.0)).unwrap()).1 > 100);
    let size = |p: DVec3| if p.x > 0.9 { 0.1 } else { 1.0 };
    let sizes = DensitySource::Sizes(mesh.positions().iter().map(|&p| size(p)).collect());
    for source in [DensitySource::Uniform, sizes, DensitySource::Curvature, DensitySource::FeatureSize] {
        let name = source.name();
        let density = DensityOptions::from_source(source);
        let options = options(2000).with_density(density).with_lloyd(1).with_newton(0);
        let features = run(&mesh, &options).unwrap().report.features;
        println!("{name}: {features:?}");
        assert_eq!(features.creases, 0, "{name}");
    }
}

/// The faces of a part may be a few large facets. Seeds of a side that is one edge of the mesh once gathered in four places.
#[test]
fn a_few_large_facets_are_remeshed_as_well_as_many() {
    // What is flat is met, and a fitted vertex leaves a straight crease by no more than a thousandth of an edge: 0.003 % of the
    // diagonal.
    for (shape, facets, most) in [(Shape::Square, 2, 1e-9), (Shape::Plane, 8, 1e-9), (Shape::Genus(0), 12, 0.003)] {
        let mesh = shape.build(facets);
        let out = run(&mesh, &RemeshOptions::new(Seeds::Sample { points: 2000, seed: 5 })).unwrap();
        let quality = out.report.result.quality.unwrap();
        println!("{shape} of {} facets: {quality:?}", mesh.facets().len());
        assert!(quality.q_min > 0.5 && quality.q_avg > 0.91 && quality.theta_min_deg > 30.0, "{shape}: {quality:?}");
        assert!(quality.hausdorff_percent < most, "{shape}: {quality:?}");
        assert_eq!(out.report.features.missing_segments, 0, "{shape}");
    }
}

#[test]
fn creases_are_edges_and_corners_are_vertices() {
    for (name, mesh) in [("block", Shape::Block.build(3000)), ("slab", Shape::Genus(0).build(2000)), ("L", l_shape())] {
        for points in [300, 800] {
            let out = run(&mesh, &options(points)).unwrap();
            keeps_straight_creases(&format!("{name}, {points}"), &mesh, &out);
        }
        // The fit weighs creases against faces: a vertex may leave a straight one by a thousandth of an edge; corners stay.
        let fitted = run(&mesh, &options(500).with_placement(Placement::Fitted)).unwrap();
        let longest = edges(&fitted.mesh).iter().map(|e| length(&fitted.mesh, e)).fold(0.0, f64::max);
        keeps_creases(&format!("{name}, fitted"), &mesh, &fitted, 1e-3 * longest);
        let plain = run(&mesh, &options(300).with_crease_angle_deg(0.0)).unwrap();
        assert!(plain.curve_edges.is_empty());
        assert_eq!(plain.report.features.seeds, 0);
    }
}

#[needs(gpu)]
#[test]
fn the_gpu_keeps_creases_too() {
    let Some(device) = crate::gpu::device() else { return };
    let gpu = Gpu::new(device, None).unwrap();
    let mesh = l_shape();
    let out = run_on(&gpu, &mesh, &options(300)).unwrap();
    keeps_straight_creases("L on the GPU", &mesh, &out);
    let mesh = Shape::Plane.build(800);
    keeps_straight_creases("plane on the GPU", &mesh, &run_on(&gpu, &mesh, &options(150)).unwrap());
}

/// Given creases of a smooth surface: the equator of a tube's middle.
#[test]
fn given_creases_are_kept() {
    let mesh = tube(48, 12);
    let ring: Vec<[u32; 2]> = (0..48).map(|i| [6 * 48 + i, 6 * 48 + (i + 1) % 48]).collect();
    let out = run(&mesh, &options(500).with_creases(ring)).unwrap();
    let figures = &out.report.features;
    assert_eq!((figures.boundaries, figures.creases, figures.missing_segments), (2, 1, 0));
    let middle = |v: u32| (out.mesh.positions()[v as usize].z - 1.0).abs() < 1e-9;
    let on: Vec<&[u32; 2]> = out.curve_edges.iter().filter(|e| e.iter().all(|&v| middle(v))).collect();
    let around: f64 = on.iter().map(|e| length(&out.mesh, &e[..])).sum();
    // A polygon of about thirty corners in the circle.
    assert!(around > 0.99 * std::f64::consts::TAU && around < std::f64::consts::TAU, "{around}");
}

/// Length of the boundary.
fn rim(mesh: &TriMesh) -> f64 {
    let adjacency = Adjacency::new(mesh);
    let half = |h: usize| mesh.positions()[mesh.facets()[h / 3][h % 3] as usize];
    (0..3 * mesh.facets().len())
        .filter(|&h| adjacency.kind(h) == EdgeKind::Boundary)
        .map(|h| half(h).distance(half(3 * (h / 3) + (h + 1) % 3)))
        .sum()
}

#[test]
fn an_open_plane_does_not_shrink() {
    let mesh = Shape::Plane.build(800);
    for points in [60, 400] {
        let out = run(&mesh, &options(points)).unwrap();
        keeps_straight_creases("plane", &mesh, &out);
        let after = topology(&out.mesh);
        assert_eq!((after.boundary_loops, after.euler, after.components), (1, 1, 1));
        // Straight sides and exact corners.
        assert!((out.mesh.area() - mesh.area()).abs() < 1e-9, "{}", out.mesh.area());
        assert!((rim(&out.mesh) - 4.0).abs() < 1e-9);
    }
    // Where boundaries are free the rim is about half an edge inside.
    let free = run(&mesh, &options(400).with_keep_boundaries(false)).unwrap();
    assert_eq!((topology(&free.mesh).boundary_loops, topology(&free.mesh).euler), (1, 1));
    assert!(free.curve_edges.is_empty());
    assert!(free.mesh.area() < 0.97 && free.mesh.area() > 0.85, "{}", free.mesh.area());
    assert!(free.mesh.positions().iter().all(|p| (0.0..1.0).contains(&p.x) && p.x > 0.0 && p.y > 0.0 && p.y < 1.0));
}

/// Along a sharp edge one row of seeds serves both sides, from between them; put on the surface they are nearer to the edge
/// than before, and came between its seeds: of 310 segments 26 were missing.
#[test]
fn sharp_creases_are_kept() {
    for degrees in [90.0, 70.0, 54.0, 45.0, 30.0, 20.0] {
        let (sin, cos) = f64::to_radians(0.5 * degrees).sin_cos();
        let mesh = prism(&[(0.0, 0.0), (cos, -sin), (cos, sin)], &[[0, 1, 2]], 9.0, 2.0);
        for (points, seed) in [(800, 0), (800, 1), (3000, 2)] {
            let out = run(&mesh, &RemeshOptions::new(Seeds::Sample { points, seed })).unwrap();
            let (figures, quality) = (&out.report.features, out.report.result.quality.unwrap());
            assert_eq!(figures.missing_segments, 0, "{degrees}°, {points}, {seed}: {figures:?}");
            assert_eq!(out.report.topology_changes, Vec::<String>::new(), "{degrees}°, {points}, {seed}");
            // Nor does what lies on one side draw facets of the other one away from it.
            assert!(quality.hausdorff_percent < 1e-9, "{degrees}°, {points}, {seed}: {quality:?}");
            // Not below what the ends of the wedge have.
            assert!(quality.theta_min_deg > 30.0_f64.min(degrees) - 4.0, "{degrees}°, {points}, {seed}: {quality:?}");
        }
    }
}

/// Whatever shape triangles would have with a dent in a side, straight sides stay straight.
#[test]
fn a_plate_has_no_dents() {
    let mesh = Shape::Square.build(2);
    for seed in 0..12 {
        let options = RemeshOptions::new(Seeds::Sample { points: 700, seed });
        let out = run(&mesh, &options).unwrap();
        let quality = out.report.result.quality.unwrap();
        assert!(
            (out.mesh.area() - 1.0).abs() < 1e-9 && (rim(&out.mesh) - 4.0).abs() < 1e-9,
            "{seed}: {} {} {quality:?}",
            out.mesh.area() - 1.0,
            rim(&out.mesh) - 4.0
        );
        assert!(quality.hausdorff_percent < 1e-6 && quality.theta_min_deg > 30.0, "{seed}: {quality:?}");
    }
}

/// Nearly all points, or all, are on the boundary where a strip is narrower than an edge; it keeps its width.
#[test]
fn a_narrow_strip_keeps_its_boundary() {
    let plane = Shape::Plane.build(800);
    let narrow = |p: &DVec3| DVec3::new(p.x * 6.0, p.y * 0.2, p.z);
    let mesh = TriMesh::new(plane.positions().iter().map(narrow).collect(), plane.facets().to_vec()).unwrap();
    for points in [100, 150, 200] {
        let out = run(&mesh, &options(points)).unwrap();
        assert!((out.mesh.area() / mesh.area() - 1.0).abs() < 1e-9, "{points}: {}", out.mesh.area());
        assert!((rim(&out.mesh) - 12.4).abs() < 1e-9, "{points}: {}", rim(&out.mesh));
        assert_eq!(topology(&out.mesh), topology_of_open(1), "{points}");
    }
}

#[test]
fn closed_boundaries_stay() {
    for (name, mesh, loops) in [("disk", disk(96, 16), 1), ("tube", tube(96, 24), 2)] {
        for placement in [Placement::Surface, Placement::Fitted] {
            let out = run(&mesh, &options(600).with_placement(placement)).unwrap();
            let figures = &out.report.features;
            assert_eq!((figures.boundaries, figures.creases, figures.missing_segments), (loops, 0, 0), "{name}");
            assert_eq!(topology(&out.mesh), topology_of_open(loops), "{name}");
            let kept = rim(&out.mesh) / rim(&mesh);
            // Of a polygon of n corners in a circle π²/6n² is missing: 0.5 % of twenty.
            assert!((kept - 1.0).abs() < 0.01, "{name}: {kept}");
        }
        let free = run(&mesh, &options(600).with_keep_boundaries(false)).unwrap();
        assert!(free.mesh.area() < 0.97 * mesh.area(), "{name}");
    }
}

/// Its rims are a third of an edge apart, and both stay.
#[test]
fn a_slit_keeps_both_its_rims() {
    let mesh = slit(40);
    let out = run(&mesh, &options(500)).unwrap();
    let figures = &out.report.features;
    assert_eq!((figures.missing_segments, topology(&out.mesh).boundary_loops), (0, 2), "{figures:?}");
}

fn topology_of_open(loops: usize) -> TopologyWithoutEdges {
    TopologyWithoutEdges { euler: 2 - loops as i64, components: 1, boundary_loops: loops }
}

#[derive(Debug)]
struct TopologyWithoutEdges {
    euler: i64,
    components: usize,
    boundary_loops: usize,
}

impl PartialEq<TopologyWithoutEdges> for tessera::mesh::measure::Topology {
    fn eq(&self, other: &TopologyWithoutEdges) -> bool {
        (self.euler, self.components, self.boundary_loops) == (other.euler, other.components, other.boundary_loops)
            && (self.non_manifold_edges, self.non_manifold_vertices) == (0, 0)
    }
}

/// A tube whose eleven inner rings are to be creases.
fn ringed_tube() -> (TriMesh, Vec<[u32; 2]>) {
    let ring = |j: u32| (0..48).map(move |i| [j * 48 + i, j * 48 + (i + 1) % 48]);
    (tube(48, 12), (1..12).flat_map(ring).collect())
}

/// With few points, creases get longer edges. If they need more points than there are, they go before boundaries, and the remesh is still
/// one. A tube whose rings are turned has no flat edges, as a designed part has, which gets more points.
#[test]
fn too_few_points_give_curves_up() {
    let (mesh, creases) = ringed_tube();
    let turned =
        |(k, p): (usize, &DVec3)| DQuat::from_rotation_z(-((k / 48) as f64) * std::f64::consts::PI / 48.0) * *p;
    let turned =
        TriMesh::new(mesh.positions().iter().enumerate().map(turned).collect(), mesh.facets().to_vec()).unwrap();
    for (mesh, points, dropped_curves, creases_kept) in [(&mesh, 120, 0, 11), (&turned, 20, 11, 0)] {
        let out = run(mesh, &options(points).with_creases(creases.clone())).unwrap();
        let figures = &out.report.features;
        assert_eq!(
            (figures.dropped_curves, figures.creases, figures.boundaries),
            (dropped_curves, creases_kept, 2),
            "{figures:?}"
        );
        assert_eq!(topology(&out.mesh), topology_of_open(2), "{points} points");
        assert!(out.mesh.positions().len() <= points);
        let ring = std::f64::consts::TAU;
        assert!(
            (figures.dropped_length - dropped_curves as f64 * ring).abs() < 0.01 * ring * dropped_curves as f64 + 1e-9
        );
        assert_eq!(figures.dropped.len(), dropped_curves.min(8));
        for curve in &figures.dropped {
            let [x, y, _] = curve.place;
            assert!((x.hypot(y) - 1.0).abs() < 1e-9 && (curve.length - ring).abs() < 0.01 * ring, "{curve:?}");
        }
        let warned = out.report.warnings.iter().find(|warning| warning.code == "dropped_curves");
        assert_eq!(warned.map_or(0, |warning| warning.places.len()), figures.dropped.len());
    }
    for points in [20, 1200] {
        let out = run(&mesh, &options(points).with_creases(creases.clone())).unwrap();
        let figures = &out.report.features;
        assert_eq!((figures.dropped_curves, figures.creases, figures.missing_segments), (0, 11, 0), "{figures:?}");
        assert_eq!(out.report.vertex_count.reason == Some(CountReason::FewPoints), points == 20);
        assert!(out.mesh.positions().len() <= points.max(80));
    }
}

/// Where creases are strict, there is a result with all curves or none at all.
#[test]
fn strict_creases_are_kept_or_refused() {
    let (mesh, creases) = ringed_tube();
    let run =
        |points, is_strict| run(&mesh, &options(points).with_creases(creases.clone()).with_strict_creases(is_strict));
    let error = run(20, true).unwrap_err();
    let RemeshError::CreasesDropped { curves, length, place } = error else { panic!("{error}") };
    let ring = std::f64::consts::TAU;
    assert_eq!(curves, 11);
    assert!(length > 10.0 * ring && length < 11.0 * ring, "{length}");
    assert!((place.x.hypot(place.y) - 1.0).abs() < 1e-9, "{place}");
    assert!(error.to_string().starts_with("11 of the creases and boundaries could not be kept"), "{error}");
    for points in [120, 1200] {
        let (strict, other) = (run(points, true).unwrap(), run(points, false).unwrap());
        assert_eq!(strict.report.features.dropped_curves, 0, "{points} points");
        assert_eq!(strict.mesh.positions(), other.mesh.positions(), "{points} points");
    }
}

/// Seeds of a closed curve move to its kinks; two of them never to the same one, where it begins either.
#[test]
fn closed_curves_have_no_seed_twice() {
    let mesh = tube(24, 12);
    for points in [200, 500] {
        let out = run(&mesh, &options(points).with_newton(4)).unwrap();
        let figures = &out.report.features;
        assert_eq!((figures.boundaries, figures.missing_segments), (2, 0), "{points} points");
    }
}

/// Curves that are short beside the edges of the remesh leave a valid result.
#[test]
fn holes_smaller_than_an_edge_leave_a_valid_surface() {
    let mesh = Shape::Genus(6).build(8000);
    let out = run(&mesh, &options(120)).unwrap();
    let after = topology(&out.mesh);
    assert_eq!((after.non_manifold_edges, after.non_manifold_vertices, after.boundary_edges), (0, 0, 0));
    let many = run(&mesh, &options(2000)).unwrap();
    keeps_straight_creases("six holes", &mesh, &many);
}

#[test]
fn wrong_creases_are_refused() {
    let mesh = Shape::Sphere.build(500);
    let [a, b, c] = mesh.facets()[0];
    for wrong in [[a, a], [b, u32::MAX]] {
        let options = RemeshOptions::new(Seeds::Sample { points: 50, seed: 1 });
        let error = run(&mesh, &options.with_creases(vec![[a, b], [c, b], wrong, [a, c]])).unwrap_err();
        assert!(matches!(error, RemeshError::Feature(FeatureError::NoSuchEdge { crease: 2, .. })), "{error}");
    }
    let options = options(50).with_crease_angle_deg(200.0);
    assert!(matches!(run(&mesh, &options), Err(RemeshError::Feature(FeatureError::BadAngle(_)))));
}
