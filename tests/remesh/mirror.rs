//! Promise: with a mirror plane, the result is symmetric to the bit, a manifold of the input's topology, and each half has
//! its own attributes.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use geometry::mesh::adjacency::Adjacency;
use glam::{DMat3, DQuat, DVec3, EulerRot, dvec3};
use tessera::mesh::attributes::{Attributes, Scalar};
use tessera::mesh::measure::{topology, topology_unless};
use tessera::mesh::plane::Plane;
use tessera::mesh::regions::Regions;
use tessera::mesh::shapes::Shape;
use tessera::mesh::tensor::Tensor;
use tessera::remesh::{Anisotropy, Placement, Refine, Remesh, RemeshError, RemeshOptions, Seeds, Tolerance, remesh};
use tessera::rvd::Parallel;
use tessera::{DensityOptions, DensitySource, Token, TriMesh};

use crate::long::some;
use crate::parts;
use crate::rough::Random;

fn sample(points: usize) -> RemeshOptions {
    RemeshOptions::new(Seeds::Sample { points, seed: 0 })
}

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default())
}

fn bits(p: DVec3) -> [u64; 3] {
    (p + DVec3::ZERO).to_array().map(f64::to_bits)
}

fn diagonal(mesh: &TriMesh) -> f64 {
    let (low, high) = mesh.bounds();
    (high - low).length()
}

fn moved(mesh: &TriMesh, to: impl Fn(DVec3) -> DVec3) -> TriMesh {
    TriMesh::new(mesh.positions().iter().map(|&p| to(p)).collect(), mesh.facets().to_vec()).unwrap()
}

/// The same with the middle of its bounding box at the origin, and `axis` along x.
fn centred(mesh: &TriMesh, axis: usize) -> TriMesh {
    let (low, high) = mesh.bounds();
    moved(mesh, |p| {
        let p = p - 0.5 * (low + high);
        dvec3(p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3])
    })
}

/// The part of a surface where x is not below 0. Vertices that are nearly there are there.
fn cut(mesh: &TriMesh) -> TriMesh {
    let small = 1e-3 * diagonal(mesh);
    let snap = |p: &DVec3| if p.x.abs() < small { dvec3(0.0, p.y, p.z) } else { *p };
    let places: Vec<DVec3> = mesh.positions().iter().map(snap).collect();
    let (mut positions, mut facets) = (Vec::new(), Vec::new());
    let mut known: HashMap<[u32; 2], u32> = HashMap::new();
    let mut vertex = |a: u32, b: u32| {
        let ends = [a.min(b), a.max(b)];
        *known.entry(ends).or_insert_with(|| {
            let [p, q] = ends.map(|v| places[v as usize]);
            let between = || p.lerp(q, p.x / (p.x - q.x)).with_x(0.0);
            positions.push(if a == b { p } else { between() });
            positions.len() as u32 - 1
        })
    };
    for t in mesh.facets().iter().filter(|t| t.iter().any(|&v| places[v as usize].x > 0.0)) {
        let mut left = Vec::new();
        for (a, b) in (0..3).map(|k| (t[k], t[(k + 1) % 3])) {
            let [p, q] = [a, b].map(|v| places[v as usize].x);
            if p >= 0.0 {
                left.push(vertex(a, a));
            }
            if p * q < 0.0 {
                left.push(vertex(a, b));
            }
        }
        facets.extend((1..left.len() - 1).map(|k| [left[0], left[k], left[k + 1]]));
    }
    TriMesh::new(positions, facets).unwrap()
}

/// A half with its mirror image at x = 0.
fn doubled(half: &TriMesh) -> TriMesh {
    let (mut positions, mut facets) = half.clone().into_parts();
    let mut image: Vec<u32> = (0..positions.len() as u32).collect();
    for v in 0..image.len() {
        let p = positions[v];
        if p.x != 0.0 {
            image[v] = positions.len() as u32;
            positions.push(dvec3(-p.x, p.y, p.z));
        }
    }
    facets.extend(half.facets().iter().map(|&[a, b, c]| [a, c, b].map(|v| image[v as usize])));
    TriMesh::new(positions, facets).unwrap()
}

/// Smooth bumps around the origin.
fn bumped(mesh: &TriMesh, random: &mut Random) -> TriMesh {
    let mut signed = || dvec3(random.signed(), random.signed(), random.signed());
    let bumps: Vec<(DVec3, f64)> = (0..5).map(|_| (1.5 * signed(), 0.12 * signed().x)).collect();
    let height = |p: DVec3| bumps.iter().map(|&(at, by)| by * (-2.0 * p.distance_squared(at)).exp()).sum::<f64>();
    moved(mesh, |p| p * (1.0 + height(p)))
}

/// A plane, and what takes x = 0 to it.
struct Frame {
    turn: DMat3,
    shift: DVec3,
    plane: Plane,
}

impl Frame {
    fn new(turn: DMat3, shift: DVec3, sign: f64) -> Self {
        let normal = sign * (turn * DVec3::X);
        Self { turn, shift, plane: Plane::new(normal, normal.dot(shift)).unwrap() }
    }

    /// Across an axis.
    fn across(axis: usize, shift: DVec3, sign: f64) -> Self {
        let [x, y, z] = [0, 1, 2].map(|k| DVec3::AXES[(axis + k) % 3]);
        Self::new(DMat3::from_cols(x, y, z), shift, sign)
    }

    fn slanted(random: &mut Random) -> Self {
        let [a, b, c] = [0; 3].map(|_| std::f64::consts::PI * random.signed());
        let turn = DMat3::from_quat(DQuat::from_euler(EulerRot::XYZ, a, b, c));
        let shift = 3.0 * dvec3(random.signed(), random.signed(), random.signed());
        Self::new(turn, shift, if random.unit() < 0.5 { 1.0 } else { -1.0 })
    }

    /// Two across axes, at and off the origin, and two slanted ones.
    fn several(random: &mut Random) -> [Self; 4] {
        [
            Self::across(0, DVec3::ZERO, 1.0),
            Self::across(1, 2.0 * random.point(), -1.0),
            Self::slanted(random),
            Self::slanted(random),
        ]
    }

    fn place(&self, mesh: &TriMesh) -> TriMesh {
        moved(mesh, |p| self.turn * p + self.shift)
    }
}

/// Vertices and facets on one side of the plane are the mirror images of those on the other, to the bit.
fn assert_symmetric(name: &str, plane: Plane, done: &Remesh) {
    let mesh = &done.mesh;
    let near = 1e-9 * diagonal(mesh);
    let side: Vec<i32> = mesh.positions().iter().map(|&p| plane.height(p)).map(|h| sign(h, near)).collect();
    let image = |v: u32| {
        let p = mesh.positions()[v as usize];
        bits(if side[v as usize] > 0 { plane.reflect(p) } else { p })
    };
    let mut alone: BTreeMap<[u64; 3], i32> = BTreeMap::new();
    (0..).zip(&side).for_each(|(v, &side)| *alone.entry(image(v)).or_default() += side);
    let count = alone.values().filter(|count| **count != 0).count();
    assert_eq!(count, 0, "{name}: vertices without their mirror image");
    let mut alone: BTreeMap<[[u64; 3]; 3], i32> = BTreeMap::new();
    for (f, &t) in mesh.facets().iter().enumerate() {
        let sides = t.map(|v| side[v as usize]);
        let (least, most) = (sides.into_iter().min().unwrap(), sides.into_iter().max().unwrap());
        assert!(least < 0 || most > 0, "{name}: facet {f} is in the plane");
        assert!(least >= 0 || most <= 0, "{name}: facet {f} crosses the plane");
        let mut corners = t.map(image);
        if most > 0 {
            corners.swap(1, 2);
        }
        let first = (0..3).min_by_key(|&k| corners[k]).unwrap();
        corners.rotate_left(first);
        *alone.entry(corners).or_default() += least + most;
    }
    let count = alone.values().filter(|count| **count != 0).count();
    assert_eq!(count, 0, "{name}: facets without their mirror image");
    let edges: BTreeSet<[u32; 2]> = edges(mesh);
    let in_plane = edges.iter().filter(|edge| edge.iter().all(|&v| side[v as usize] == 0)).count();
    assert!(in_plane > 0, "{name}");
    assert_eq!(done.report.result.mirror.unwrap().seam_edges, in_plane, "{name}: edges in the plane");
    let curves: BTreeSet<[u32; 2]> = done.curve_edges.iter().map(|&[a, b]| [a.min(b), a.max(b)]).collect();
    assert_eq!(curves.len(), done.curve_edges.len(), "{name}: each edge once");
    assert!(curves.is_subset(&edges), "{name}: curves are edges");
    assert_eq!(done.vertex_seed.len(), mesh.positions().len(), "{name}");
    assert!(done.vertex_seed.iter().all(|&seed| (seed as usize) < done.seeds.len()), "{name}");
}

fn sign(height: f64, near: f64) -> i32 {
    i32::from(height > near) - i32::from(height < -near)
}

fn edges(mesh: &TriMesh) -> BTreeSet<[u32; 2]> {
    let sides = mesh.facets().iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    sides.map(|[a, b]| [a.min(b), a.max(b)]).collect()
}

/// The topology and the area of `mesh`, as many vertices as asked for, nothing that crosses.
fn assert_like(name: &str, mesh: &TriMesh, done: &Remesh) {
    let key = |mesh: &TriMesh| {
        let of = topology(mesh);
        (of.euler, of.components, of.boundary_loops, of.non_manifold_edges, of.non_manifold_vertices)
    };
    assert_eq!(key(&done.mesh), key(mesh), "{name}");
    assert_counts(name, mesh, done);
}

fn assert_counts(name: &str, mesh: &TriMesh, done: &Remesh) {
    let report = &done.report;
    assert_eq!(report.result.crossings.as_ref().unwrap().count, 0, "{name}");
    let area = done.mesh.area() / mesh.area();
    assert!((area - 1.0).abs() < 0.01, "{name}: {area} of the area");
    let (vertices, asked) = (done.mesh.positions().len(), report.vertex_count.asked);
    let off = vertices.abs_diff(asked);
    assert!(off * 50 <= asked || off <= 3, "{name}: {vertices} vertices, {asked} asked for");
    assert_eq!((report.result.vertices, report.result.facets), (vertices, done.mesh.facets().len()), "{name}");
}

/// What holds for symmetric input.
fn assert_mirrored(name: &str, mesh: &TriMesh, plane: Plane, done: &Remesh) {
    assert_symmetric(name, plane, done);
    assert_like(name, mesh, done);
    assert!(!warns(done, "asymmetric"), "{name}: {:?}", done.report.result.mirror);
    assert!(done.report.topology_changes.is_empty(), "{name}: {:?}", done.report.topology_changes);
}

fn warns(done: &Remesh, code: &str) -> bool {
    done.report.warnings.iter().any(|warning| warning.code == code)
}

/// A torus, not cut through its middle: two loops with a kink.
fn torus(facets: usize) -> TriMesh {
    doubled(&cut(&moved(&Shape::Torus.build(facets), |p| p + 0.15 * DVec3::X)))
}

fn hills(facets: usize) -> TriMesh {
    doubled(&cut(&centred(&Shape::Hills.build(facets), 0)))
}

/// Surfaces that are symmetric at x = 0 with their vertices, some of them open, some with creases and kinks.
#[test]
fn doubled_surfaces_come_out_symmetric() {
    let mut random = Random::new(11);
    let tilt = DMat3::from_quat(DQuat::from_euler(EulerRot::XYZ, 0.3, 0.2, 0.15));
    let ball = bumped(&Shape::Sphere.build(2000), &mut random);
    let block = centred(&Shape::Block.build(900), 0);
    let surfaces = [
        ("ball", doubled(&cut(&moved(&ball, |p| tilt * p + 0.2 * DVec3::X))), [400, 1500]),
        ("torus", torus(2000), [400, 1500]),
        ("flat torus", doubled(&cut(&centred(&Shape::Torus.build(1500), 2))), [400, 1000]),
        ("hills", hills(1800), [1500, 4000]),
        ("block", doubled(&cut(&moved(&block, |p| tilt * p + 0.1 * DVec3::X))), [800, 1500]),
    ];
    for (k, (name, mesh, counts)) in surfaces.iter().enumerate() {
        let frames = Frame::several(&mut random);
        for (l, points) in counts.iter().enumerate() {
            let frame = &frames[(k + 2 * l) % 4];
            let name = format!("{name} at {}, {points}", frame.plane);
            let mesh = frame.place(mesh);
            let done = run(&mesh, &sample(*points).with_mirror(frame.plane)).unwrap();
            assert_mirrored(&name, &mesh, frame.plane, &done);
            assert_eq!(done.report.vertex_count.asked, *points, "{name}");
        }
    }
}

/// Surfaces that are symmetric, and have no vertices in the plane, or others on either side.
#[test]
fn facets_are_cut_where_they_cross_the_plane() {
    let mut random = Random::new(12);
    let mut surfaces = vec![("sphere".to_owned(), Shape::Sphere.build(1280), 400)];
    for (holes, axis, points) in [(0, 0, 400), (0, 1, 400), (0, 2, 400), (2, 0, 1500), (2, 1, 1500), (2, 2, 1500)] {
        let shape = Shape::Genus(holes);
        let facets = 600 + 150 * axis + 500 * holes as usize;
        surfaces.push((format!("{shape} across {axis}"), centred(&shape.build(facets), axis), points));
    }
    for (k, (name, mesh, points)) in surfaces.into_iter().enumerate() {
        let frame = Frame::several(&mut random).into_iter().nth(k % 4).unwrap();
        let name = format!("{name} at {}", frame.plane);
        let mesh = frame.place(&mesh);
        let done = run(&mesh, &sample(points).with_mirror(frame.plane)).unwrap();
        assert_mirrored(&name, &mesh, frame.plane, &done);
        let quality = done.report.result.quality.unwrap();
        let bound = if k == 0 { 1.0 } else { 0.05 };
        assert!(quality.hausdorff_percent < bound, "{name}: {}", quality.hausdorff_percent);
    }
}

/// Densities, edge lengths, tolerances, creases: all end in a symmetric result.
#[test]
fn other_options_are_met_on_both_sides() {
    let mut random = Random::new(13);
    let frame = Frame::slanted(&mut random);
    let ball = bumped(&Shape::Sphere.build(2000), &mut random);
    let canonical = doubled(&cut(&moved(&ball, |p| p + 0.1 * DVec3::X)));
    let mesh = frame.place(&canonical);
    let density = DensityOptions::from_source;
    let sizes: Vec<f64> = canonical.positions().iter().map(|p| 0.1 + 0.04 * p.y).collect();
    let implied = || RemeshOptions::new(Seeds::Implied { seed: 3 });
    let tolerance = Refine::new(Tolerance::DiagonalPercent(0.4)).with_max_points(1200);
    let all = [
        ("curvature", sample(800).with_density(density(DensitySource::Curvature))),
        ("sizes", sample(800).with_density(density(DensitySource::Sizes(sizes)))),
        ("edge length", implied().with_density(DensityOptions::default().with_edge_length(0.15))),
        ("anisotropy", sample(800).with_anisotropy(Anisotropy::Share(0.3))),
        ("vertices on the surface", sample(500).with_placement(Placement::Surface)),
        ("tolerance", sample(300).with_refine(tolerance)),
        ("keep", sample(500).with_keep_non_manifold(true)),
    ];
    for (name, options) in all {
        let done = run(&mesh, &options.with_mirror(frame.plane)).unwrap();
        assert_symmetric(name, frame.plane, &done);
        assert!(!warns(&done, "asymmetric"), "{name}");
        assert_eq!(topology(&done.mesh).euler, 2, "{name}");
        assert_eq!(topology(&done.mesh).boundary_edges, 0, "{name}");
        if name == "tolerance" {
            let distance = done.report.result.quality.unwrap().hausdorff_percent;
            assert!(distance < 0.45 || warns(&done, "deviation_missed"), "{name}: {distance}");
        } else if name != "vertices on the surface" {
            assert_like(name, &mesh, &done);
        }
    }

    // A crease that is given, across the plane and along it.
    let flat = centred(&Shape::Plane.build(800), 0);
    let (n, at) = (flat.positions().len() as u32, |v: u32| flat.positions()[v as usize]);
    let height = at(n / 4).y;
    let mut creases: Vec<[u32; 2]> = edges(&flat).into_iter().collect();
    creases.retain(|edge| edge.iter().all(|&v| (at(v).y - height).abs() < 1e-9));
    assert!(creases.len() > 10);
    let frame = Frame::across(2, dvec3(0.3, 0.2, 0.7), -1.0);
    let mesh = frame.place(&flat);
    let done = run(&mesh, &sample(400).with_creases(creases).with_mirror(frame.plane)).unwrap();
    assert_mirrored("crease", &mesh, frame.plane, &done);
    let along = (frame.turn * DVec3::Y, (frame.turn * DVec3::Y).dot(frame.shift) + height);
    let on = |p: &&DVec3| (along.0.dot(**p) - along.1).abs() < 1e-6;
    let (front, behind): (Vec<DVec3>, Vec<DVec3>) =
        done.mesh.positions().iter().filter(on).partition(|&&p| frame.plane.height(p) > 0.0);
    // Edges are about 0.055 long.
    assert!(front.len() >= 7 && behind.len() >= 7, "{} {}", front.len(), behind.len());
}

/// Boxes that touch: with `corners`, two more at corners of the first; else one at an edge that the plane crosses.
fn touching(corners: bool) -> (TriMesh, usize) {
    let first = centred(&Shape::Genus(0).build(500), 0);
    let (low, high) = first.bounds();
    let size = high - low;
    let others = if corners { vec![size, size * dvec3(-1.0, 1.0, 1.0)] } else { vec![size * dvec3(0.0, 1.0, 1.0)] };
    let (mut positions, mut facets) = first.clone().into_parts();
    for by in &others {
        let before = positions.len() as u32;
        positions.extend(first.positions().iter().map(|&p| p + *by));
        facets.extend(first.facets().iter().map(|t| t.map(|v| v + before)));
    }
    // The places of both are the same, up to rounding.
    let key = |p: DVec3| (p * 1e9).round().to_array().map(|x| x as i64);
    let known: HashMap<[i64; 3], DVec3> = positions.iter().map(|&p| (key(p), p)).collect();
    positions.iter_mut().for_each(|p| *p = known[&key(*p)]);
    (TriMesh::new(positions, facets).unwrap(), 1 + others.len())
}

#[test]
fn solids_that_touch_stay_solids() {
    let mut random = Random::new(14);
    for (corners, axis) in [(false, true), (false, false), (true, true), (true, false)] {
        let (mesh, solids) = touching(corners);
        let shift = random.point();
        let frame = if axis { Frame::across(1, shift, -1.0) } else { Frame::slanted(&mut random) };
        let mesh = frame.place(&mesh);
        for keep in [false, true] {
            let name = format!("{solids} solids at {}, keep {keep}", frame.plane);
            let options = sample(400 * solids).with_mirror(frame.plane).with_keep_non_manifold(keep);
            let done = run(&mesh, &options).unwrap();
            assert_symmetric(&name, frame.plane, &done);
            assert_counts(&name, &mesh, &done);
            assert!(!warns(&done, "asymmetric"), "{name}: {:?}", done.report.result.mirror);
            let quality = done.report.result.quality.unwrap();
            assert!(quality.hausdorff_percent < 0.05, "{name}: {}", quality.hausdorff_percent);
            let (before, after) = (topology(&mesh), topology(&done.mesh));
            assert_eq!(after.boundary_edges, 0, "{name}");
            if keep && !corners {
                assert_eq!((after.euler, after.components), (before.euler, before.components), "{name}");
                assert!(after.non_manifold_edges > 0, "{name}");
            } else if !keep {
                let own = (0..done.mesh.positions().len() as u32).collect();
                let apart = Adjacency::with(&done.mesh, own, &Token::default()).unwrap();
                let of = topology_unless(&done.mesh, &apart, &Token::default()).unwrap();
                assert_eq!((of.euler, of.non_manifold_edges, of.boundary_edges), (2 * solids as i64, 0, 0), "{name}");
            }
        }
    }
}

/// Regions that are others behind the plane, and a scalar that is.
#[test]
fn each_half_has_its_own_attributes() {
    let mut random = Random::new(15);
    for (kind, canonical) in [("torus", torus(2000)), ("hills", hills(1800))] {
        let frame = Frame::slanted(&mut random);
        let mesh = frame.place(&canonical);
        let sign = (frame.turn * DVec3::X).dot(frame.plane.normal()).signum();
        let middle = |f: usize| canonical.corners(f).into_iter().sum::<DVec3>() / 3.0;
        let is_front = |f: usize| sign * middle(f).x > 0.0;
        let values: Vec<f64> = mesh.positions().iter().map(|&p| frame.plane.height(p)).collect();
        let halves = |f: usize| -> i64 { if is_front(f) { 1 } else { 2 } };
        let quarters = |f: usize| -> i64 { halves(f) + if middle(f).y > 0.0 { 10 } else { 0 } };
        // Those behind have a border that those before have not.
        let thirds = |f: usize| -> i64 { if is_front(f) { 1 } else { quarters(f) } };
        let all: [(&str, &dyn Fn(usize) -> i64); 3] =
            [("halves", &halves), ("quarters", &quarters), ("thirds", &thirds)];
        for (what, label) in all {
            let name = format!("{kind}, {what}");
            let labels: Vec<i64> = (0..mesh.facets().len()).map(label).collect();
            let mut attributes = Attributes::new(&mesh);
            attributes.set_regions(Regions::of_numbers(&labels).unwrap()).unwrap();
            attributes.add_scalar(Scalar::new("height", values.clone())).unwrap();
            let done = run(&mesh, &sample(1200).with_mirror(frame.plane).with_attributes(attributes)).unwrap();
            assert_mirrored(&name, &mesh, frame.plane, &done);
            let carried = done.attributes.as_ref().unwrap();
            for (f, number) in carried.regions().unwrap().numbers().enumerate() {
                let middle = done.mesh.corners(f).into_iter().sum::<DVec3>() / 3.0;
                assert_eq!(number % 10 == 1, frame.plane.height(middle) > 0.0, "{name}: facet {f} is of {number}");
            }
            for region in &done.report.result.regions {
                let share = region.area / region.input_area;
                assert!((share - 1.0).abs() < 0.03, "{name}: {share} of region {}", region.number);
            }
            let distinct: BTreeSet<i64> = labels.iter().copied().collect();
            assert_eq!(done.report.result.regions.len(), distinct.len(), "{name}");
            let most = 0.01 * diagonal(&mesh);
            assert_eq!(done.provenance.len(), done.mesh.positions().len(), "{name}");
            for (&p, value) in done.mesh.positions().iter().zip(&carried.scalars()[0].values) {
                let height = frame.plane.height(p);
                assert!((value - height).abs() < most, "{name}: {value} at {height}");
            }
            let [low, high] = [f64::min, f64::max].map(|of| carried.scalars()[0].values.iter().copied().fold(0.0, of));
            assert!(low < -10.0 * most && high > 10.0 * most, "{name}: {low} to {high}");
        }
    }
}

#[test]
fn an_asymmetric_input_is_told_of() {
    let mut random = Random::new(16);
    for k in 0..3 {
        let frame = Frame::several(&mut random).into_iter().nth(k + 1).unwrap();
        let mesh = frame.place(&torus(2000));
        let height = |v: &u32| frame.plane.height(mesh.positions()[*v as usize]);
        let vertex = (0..mesh.positions().len() as u32).min_by(|a, b| height(a).total_cmp(&height(b))).unwrap();
        let (mut positions, facets) = mesh.clone().into_parts();
        positions[vertex as usize] -= 0.03 * diagonal(&mesh) * frame.plane.normal();
        let bent = TriMesh::new(positions, facets).unwrap();
        let options = sample(500).with_mirror(frame.plane);
        let done = run(&bent, &options).unwrap();
        let name = frame.plane.to_string();
        assert!(warns(&done, "asymmetric"), "{name}");
        let percent = done.report.result.mirror.unwrap().asymmetry_percent;
        assert!((2.0..3.1).contains(&percent), "{name}: {percent}");
        assert_symmetric(&name, frame.plane, &done);
        assert_like(&name, &mesh, &done);
        // Of the bent vertex, nothing is in the result.
        let lowest = done.mesh.positions().iter().map(|&p| frame.plane.height(p)).fold(0.0, f64::min);
        assert!(lowest > height(&vertex) - 0.005 * diagonal(&mesh), "{name}: {lowest}");
        let straight = run(&mesh, &options).unwrap();
        assert!(straight.report.result.mirror.unwrap().asymmetry_percent < 1e-3, "{name}");
    }
}

/// Planes through solids with flat sides: the seam has corners, and creases end at all angles.
#[test]
fn solids_with_flat_sides_stay_closed() {
    let mut random = Random::new(18);
    let tetrahedron = TriMesh::new(
        vec![DVec3::ZERO, 2.0 * DVec3::X, 2.0 * DVec3::Y, DVec3::Z],
        vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    )
    .unwrap();
    for (kind, mesh) in [("box", Shape::Genus(0).build(12)), ("tetrahedron", tetrahedron), ("l", parts::l_shape())] {
        let mut lost = 0;
        let planes = some(4, 0..12);
        for &k in &planes {
            let [a, b] = [k, k + 5].map(|f| mesh.corners(f % mesh.facets().len()).into_iter().sum::<DVec3>() / 3.0);
            let inside = a.lerp(b, random.unit());
            let normal = random.point().normalize();
            let plane = Plane::new(normal, normal.dot(inside)).unwrap();
            let name = format!("{kind} {k} at {plane}");
            let done = match run(&mesh, &sample(150 + 80 * k).with_mirror(plane)) {
                Ok(done) => done,
                Err(RemeshError::SeamLost { .. }) => {
                    lost += 1;
                    continue;
                }
                Err(error) => panic!("{name}: {error}"),
            };
            assert_symmetric(&name, plane, &done);
            let of = topology(&done.mesh);
            assert_eq!((of.boundary_edges, of.non_manifold_edges, of.components), (0, 0, 1), "{name}");
            assert!(done.report.topology_changes.is_empty(), "{name}: {:?}", done.report.topology_changes);
            // Tips and slabs thinner than an edge are lost.
            let far = done.report.result.quality.unwrap().hausdorff_percent;
            assert!(far < 8.0 || warns(&done, "lost_parts"), "{name}: {far}");
        }
        assert!(4 * lost < planes.len(), "{kind}: {lost} of {}", planes.len());
    }
}

#[test]
fn a_half_alone_becomes_the_whole() {
    let mut random = Random::new(17);
    let ball = bumped(&Shape::Sphere.build(2000), &mut random);
    let slab = centred(&Shape::Genus(1).build(1200), 1);
    let halves = [
        ("ball", cut(&moved(&ball, |p| p + 0.1 * DVec3::X))),
        ("torus", cut(&moved(&Shape::Torus.build(2000), |p| p + 0.15 * DVec3::X))),
        ("hills", cut(&centred(&Shape::Hills.build(1800), 0))),
        ("slab", cut(&slab)),
    ];
    for (k, (name, half)) in halves.iter().enumerate() {
        // The half is where x is above 0.
        let turn = Frame::slanted(&mut random).turn;
        let turn = if k % 2 == 0 { turn } else { DMat3::IDENTITY };
        let frame = Frame::new(turn, random.point(), 1.0);
        let (mesh, whole) = (frame.place(half), frame.place(&doubled(half)));
        let done = run(&mesh, &sample(1200).with_mirror(frame.plane)).unwrap();
        assert_symmetric(name, frame.plane, &done);
        assert_like(name, &whole, &done);
        assert!(!warns(&done, "asymmetric"), "{name}");
        assert_eq!(done.report.vertex_count.asked, 1200, "{name}");
    }
}

#[test]
fn the_same_bits_on_all_threads() {
    let mut random = Random::new(18);
    for (mesh, frame) in [
        (torus(2000), Frame::slanted(&mut random)),
        (centred(&Shape::Genus(2).build(1500), 1), Frame::across(2, random.point(), -1.0)),
    ] {
        let mesh = frame.place(&mesh);
        let options = sample(1000).with_mirror(frame.plane);
        let of = |threads| {
            let backend = Parallel::new(Some(threads)).unwrap();
            remesh(&mesh, &options, &backend, &mut (), &Token::default()).unwrap()
        };
        let (one, two) = (of(1), of(2));
        assert!(one.mesh == two.mesh, "{}", frame.plane);
        assert_eq!(one.curve_edges, two.curve_edges, "{}", frame.plane);
        assert_eq!(one.seeds, two.seeds, "{}", frame.plane);
    }
}

#[test]
fn what_cannot_be_mirrored_is_refused() {
    let mesh = Shape::Sphere.build(500);
    let plane: Plane = "x".parse().unwrap();
    let error = |options: RemeshOptions| run(&mesh, &options.with_mirror(plane)).map(|done| done.report).unwrap_err();
    let beside = |options| match error(options) {
        RemeshError::Beside { one: "a mirror plane", other } => other,
        error => panic!("{error}"),
    };
    let tensors = vec![Tensor::of_length(0.1); mesh.positions().len()];
    let metric = DensityOptions::from_source(DensitySource::Metric(tensors));
    assert_eq!(beside(RemeshOptions::new(Seeds::Given(mesh.positions().to_vec()))), "seeds");
    assert_eq!(beside(sample(200).with_density(metric)), "a metric");
    let ball = || vec!["sphere:1,0,0,0.3".parse().unwrap()];
    assert_eq!(beside(sample(200).with_keep(ball())), "kept parts");
    assert_eq!(beside(sample(200).with_only(ball())), "kept parts");
    assert_eq!(beside(sample(200).with_keep_rims(true)), "kept parts");
    assert_eq!(beside(sample(200).with_keep_boundaries(false)), "free boundaries");
    assert_eq!(beside(sample(200).with_periodic(vec!["translate:1,0,0".parse().unwrap()])), "periodic boundaries");

    let at = |mesh: &TriMesh, text: &str| run(mesh, &sample(200).with_mirror(text.parse().unwrap()));
    for text in ["x=1.5", "-y=-2", "1,1,1,1.9"] {
        let Err(RemeshError::NothingOnSide { plane }) = at(&mesh, text) else { panic!("{text}") };
        assert_eq!(plane, text.parse::<Plane>().unwrap(), "{text}");
    }
    // Nothing is cut by these: the whole and its image are beside each other.
    for text in ["x=-1.5", "-y=2"] {
        let done = run(&mesh, &sample(400).with_mirror(text.parse().unwrap())).unwrap();
        assert_eq!((done.report.result.topology.components, done.report.result.topology.euler), (2, 4), "{text}");
        assert_eq!(done.report.result.mirror.unwrap().seam_edges, 0, "{text}");
    }
    let slab = Shape::Genus(1).build(800);
    let (low, high) = slab.bounds();
    for (text, z) in [(format!("z={}", low.z), low.z), (format!("-z={}", high.z), high.z)] {
        let cap = (0..slab.facets().len()).filter(|&f| slab.corners(f).iter().all(|p| p.z == z)).count();
        let Err(RemeshError::FacetsInPlane { facets, .. }) = at(&slab, &text) else { panic!("{text}") };
        assert_eq!(facets, cap, "{text}");
    }
}
