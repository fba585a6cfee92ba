//! Promise: what a surface carries is carried to its remesh, into files and out of them, and no texture spans a seam.

use std::f64::consts::TAU;

use crate::carried::{centroid, everything, texture, uvs, wedges};
use geometry::remesh::attributes::{carry, provenance};
use glam::{DVec2, DVec3, dvec2, dvec3};
use tessera::mesh::TriMesh;
use tessera::mesh::attributes::{AttributeError, Attributes, ColourDepth, Colours, Normals, PerCorner, Scalar};
use tessera::mesh::closest_point::ClosestPoint;
use tessera::mesh::io::{Format, decode_with_attributes};
use tessera::mesh::numbers::NumberType;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::Serial;
use tessera::token::Token;

fn run(mesh: &TriMesh, attributes: Attributes, points: usize) -> Remesh {
    let options = RemeshOptions::plain(Seeds::Sample { points, seed: 4 }, 3).with_attributes(attributes);
    remesh(mesh, &options, &Serial, &mut (), &Token::default()).unwrap()
}

/// Angle in turns, from 0 to 1.
fn turns(y: f64, x: f64) -> f64 {
    (y.atan2(x) / TAU).rem_euclid(1.0)
}

/// `t`, a turn more or less, so that it is on `near`'s side of the seam at 0.
fn beside(t: f64, near: f64) -> f64 {
    t + (near - t).round()
}

fn uv_area([a, b, c]: [DVec2; 3]) -> f64 {
    0.5 * (b - a).perp_dot(c - a)
}

/// An open cylinder of radius 1 and height 2, `n` around.
fn tube(n: u32) -> TriMesh {
    let rows = n / 3;
    let points = (0..=rows).flat_map(|j| {
        (0..n).map(move |i| {
            let (s, c) = (TAU * f64::from(i) / f64::from(n)).sin_cos();
            dvec3(c, s, 2.0 * f64::from(j) / f64::from(rows))
        })
    });
    let mut facets = Vec::new();
    for j in 0..rows {
        for i in 0..n {
            let (a, b) = (j * n + i, j * n + (i + 1) % n);
            facets.extend([[a, b, b + n], [a, b + n, a + n]]);
        }
    }
    TriMesh::new(points.collect(), facets).unwrap()
}

#[test]
fn linear_fields_are_reproduced() {
    for shape in [Shape::Torus, Shape::Hills, Shape::Block] {
        let mesh = shape.build(2000);
        let mut attributes = Attributes::new(&mesh);
        for (axis, name) in ["px", "py", "pz"].into_iter().enumerate() {
            attributes.add_scalar(Scalar::new(name, mesh.positions().iter().map(|p| p[axis]).collect())).unwrap();
        }
        let colour = |p: &DVec3| [0.5 + p.x / 8.0, 0.5 + p.y / 8.0, 0.5 + p.z / 8.0, 0.25];
        let values = mesh.positions().iter().map(colour).collect();
        attributes.set_colours(Colours { values, depth: ColourDepth::Float }).unwrap();
        let done = run(&mesh, attributes, 300);
        let out = done.attributes.unwrap();
        assert_eq!(done.provenance.len(), done.mesh.positions().len());
        for (v, p) in done.mesh.positions().iter().enumerate() {
            // Vertices lie on the surface up to a few roundings of a coordinate of about 1.
            for axis in 0..3 {
                assert!((out.scalars()[axis].values[v] - p[axis]).abs() < 1e-12, "{shape} {v}");
            }
            let got = out.colours().unwrap().values[v];
            assert!(colour(p).iter().zip(got).all(|(want, got)| (want - got).abs() < 1e-12), "{shape} {v}");
        }
    }
}

fn label_of(p: &DVec3) -> f64 {
    if p.x > 0.0 {
        40.0
    } else if p.y > 0.0 {
        7.0
    } else {
        -2.0
    }
}

/// Whole numbers have no values between: those of the nearest corner are taken. Vectors are interpolated as numbers are.
#[test]
fn labels_stay_labels_and_vectors_vectors() {
    let mesh = Shape::Torus.build(2000);
    let mut attributes = Attributes::new(&mesh);
    let pair = mesh.positions().iter().flat_map(|p| [label_of(p), 1.0]).collect();
    let labels =
        Scalar { number: NumberType::I16, ..Scalar::new("label", mesh.positions().iter().map(label_of).collect()) };
    attributes.add_scalar(labels).unwrap();
    attributes.add_scalar(Scalar { number: NumberType::U64, components: 2, ..Scalar::new("pair", pair) }).unwrap();
    let positions = mesh.positions().iter().flat_map(|p| p.to_array()).collect();
    attributes.add_scalar(Scalar { components: 3, ..Scalar::new("position", positions) }).unwrap();
    let done = run(&mesh, attributes, 300);
    let out = done.attributes.unwrap();
    let [label, pair, position] = out.scalars() else { panic!("{:?}", out.scalars().len()) };
    // A negative number is none of U64.
    assert_eq!((label.number, pair.number, position.number), (NumberType::I16, NumberType::F64, NumberType::F64));
    for (v, (p, place)) in done.mesh.positions().iter().zip(&done.provenance).enumerate() {
        let corners = mesh.facets()[place.facet as usize].map(|c| mesh.positions()[c as usize]);
        let distance = |corner: &DVec3| corner.distance(*p);
        let nearest = corners.iter().map(distance).fold(f64::INFINITY, f64::min);
        let is_near = |corner: &&DVec3| distance(corner) < nearest + 1e-9;
        let possible: Vec<f64> = corners.iter().filter(is_near).map(label_of).collect();
        assert!(possible.contains(&label.values[v]), "{v}");
        assert!((DVec3::from_slice(&position.values[3 * v..]) - *p).length() < 1e-12, "{v}");
        assert!((pair.values[2 * v + 1] - 1.0).abs() < 1e-12, "{v}");
    }
}

/// Two charts on a plane, each linear: exact on either side, and beyond the seam as if the chart went on.
#[test]
fn a_seam_between_two_linear_charts() {
    let mesh = Shape::Plane.build(1800);
    let side = |x: f64| if x < 0.5 { 0.0 } else { 10.0 };
    let uv = |p: DVec3, side: f64| dvec2(3.0 * p.x + p.y + side, 0.5 * p.y - side);
    let mut attributes = Attributes::new(&mesh);
    attributes.set_texture(wedges(&mesh, |f, p| uv(p, side(centroid(&mesh, f).x)))).unwrap();
    for points in [40, 500, 4000] {
        let done = run(&mesh, attributes.clone(), points);
        let texture = done.attributes.as_ref().unwrap().texture().unwrap();
        let mut across = 0;
        for facet in 0..done.mesh.facets().len() {
            let side = side(centroid(&done.mesh, facet).x);
            for (got, p) in uvs(texture, facet).into_iter().zip(done.mesh.corners(facet)) {
                // Rounding of numbers up to 14, divided by facets of a thirtieth.
                assert!((got - uv(p, side)).length() < 1e-11, "{points} points, facet {facet}: {got} at {p}");
            }
            let xs = done.mesh.corners(facet).map(|p| p.x < 0.5);
            across += usize::from(xs.contains(&true) && xs.contains(&false));
        }
        assert!(across > 3, "{across} facets lie across the seam");
        // Two values at vertices of facets that lie across, one elsewhere.
        let doubled = texture.values.len() - done.mesh.positions().len();
        assert!((across / 2..=2 * across).contains(&doubled), "{doubled} for {across}");
    }
}

/// Vertices split at the seam, as files without corners have it, are the same seam.
#[test]
fn split_vertices_are_a_seam() {
    let whole = Shape::Plane.build(800);
    let corners = whole.facets().as_flattened();
    let mut seen = std::collections::HashMap::new();
    let (mut points, mut values, mut facets) = (Vec::new(), Vec::new(), Vec::new());
    for (i, &v) in corners.iter().enumerate() {
        let right = centroid(&whole, i / 3).x > 0.5;
        facets.push(*seen.entry((v, right)).or_insert_with(|| {
            let p = whole.positions()[v as usize];
            points.push(p);
            values.push(dvec2(p.x + if right { 5.0 } else { 0.0 }, p.y));
            points.len() as u32 - 1
        }));
    }
    let facets = facets.as_chunks::<3>().0.to_vec();
    let mesh = TriMesh::new(points, facets.clone()).unwrap();
    let mut attributes = Attributes::new(&mesh);
    attributes.set_texture(texture(values, facets)).unwrap();
    let done = run(&mesh, attributes, 200);
    let texture = done.attributes.as_ref().unwrap().texture().unwrap();
    for facet in 0..done.mesh.facets().len() {
        let offset = if centroid(&done.mesh, facet).x > 0.5 { 5.0 } else { 0.0 };
        for (got, p) in uvs(texture, facet).into_iter().zip(done.mesh.corners(facet)) {
            assert!((got - dvec2(p.x + offset, p.y)).length() < 1e-11, "facet {facet}: {got} at {p}");
        }
    }
}

/// One chart that meets itself: u runs once around, and v too on the torus.
#[test]
fn charts_that_meet_themselves() {
    let torus = |p: DVec3| dvec2(turns(p.y, p.x), turns(p.z, p.x.hypot(p.y) - 1.0));
    let upright = |p: DVec3| dvec2(turns(p.y, p.x), 0.5 * p.z);
    let sphere = |p: DVec3| dvec2(turns(p.y, p.x), 0.5 + 0.5 * p.z);
    // Name, mesh, uv, length of a turn in u, uv area, whether v turns too.
    type Case = (&'static str, TriMesh, fn(DVec3) -> DVec2, Option<f64>, bool);
    let cases: [Case; 3] = [
        ("torus", Shape::Torus.build(6000), torus, Some(1.0), true),
        ("tube", tube(48), upright, Some(1.0), false),
        ("sphere", Shape::Sphere.build(4000), sphere, None, false),
    ];
    for (name, mesh, uv, area, v_turns) in cases {
        let mut attributes = Attributes::new(&mesh);
        let given = wedges(&mesh, |f, p| {
            let (home, here) = (uv(centroid(&mesh, f)), uv(p));
            // At a pole, u is what it is in the facet's middle.
            let u = if p.x.hypot(p.y) < 1e-9 { home.x } else { beside(here.x, home.x) };
            dvec2(u, if v_turns { beside(here.y, home.y) } else { here.y })
        });
        attributes.set_texture(given).unwrap();
        for points in [60, 400, 3000] {
            let done = run(&mesh, attributes.clone(), points);
            let texture = done.attributes.as_ref().unwrap().texture().unwrap();
            let edge = (2.0 * mesh.area() / points as f64).sqrt();
            let mut total = 0.0;
            for facet in 0..done.mesh.facets().len() {
                let corners = done.mesh.corners(facet);
                let got = uvs(texture, facet);
                total += uv_area(got);
                // Around the poles a step is any part of a turn.
                let radius = corners.iter().map(|p| p.x.hypot(p.y)).fold(f64::MAX, f64::min);
                if name == "sphere" && radius < 2.0 * edge {
                    continue;
                }
                let width = [0, 1, 2].map(|i| (got[i] - got[(i + 1) % 3]).abs());
                // A facet's edge is at most three times the mean one; v's circle has radius 0.4.
                let most = dvec2(3.0 * edge / radius / TAU, if v_turns { 3.0 * edge / 0.4 / TAU } else { 3.0 * edge });
                // 60 points leave a facet a quarter of the small circle, and less would not be a torus.
                let most = most.min(DVec2::splat(0.62));
                assert!(width.iter().all(|w| w.cmple(most).all()), "{name} {points}: {got:?}, {corners:?}");
                for (got, p) in got.into_iter().zip(corners) {
                    let off = got - uv(p);
                    let off = (off - off.round()) * dvec2(1.0, if v_turns || off.y.abs() < 0.5 { 1.0 } else { 2.0 });
                    // Sagitta of the input's facets, and for those beyond the seam of the way there.
                    let tolerance = if points == 60 { 0.08 } else { 0.015 };
                    assert!(off.length() < tolerance, "{name} {points}: {got} for {} at {p}", uv(p));
                }
            }
            if let Some(area) = area {
                // The remesh of an open surface ends half a cell before its border.
                let area = if v_turns { area } else { area * done.mesh.area() / mesh.area() };
                // The chords of a coarse remesh: 60 points leave a small circle of the torus three edges.
                let tolerance = if points == 60 { 0.2 } else { 0.05 };
                assert!((total.abs() / area - 1.0).abs() < tolerance, "{name} {points}: {total}");
            }
            // Only at seams there are two values at a vertex.
            let seams = if v_turns { 2.0 } else { 1.0 };
            let doubled = texture.values.len() - done.mesh.positions().len();
            let along = seams * TAU * 1.4 / edge;
            assert!((doubled as f64) < 4.0 * along + 20.0, "{name} {points}: {doubled}, about {along} along seams");
        }
    }
}

/// Colours are from 0 to 1 or from 0 to 255, of a file and of arrays alike. Others stay as they are, with a warning.
#[test]
fn colours_of_another_range_are_kept_and_told() {
    let mesh = Shape::Square.build(200);
    let all = |light: [f64; 3], first: [f64; 3]| {
        let mut all = vec![[light[0], light[1], light[2], 1.0]; mesh.positions().len()];
        all[0][..3].copy_from_slice(&first);
        all
    };
    let (bytes, dim) = ([255.0, 51.0, 0.0], [0.5, 0.25, 1.0]);
    for (light, first, scale, outside) in [
        (bytes, bytes, 255.0, 0),
        ([255.0, 0.5, 0.0], bytes, 255.0, 0),
        (dim, dim, 1.0, 0),
        (dim, [2.0, 0.5, 0.0], 1.0, 1),
        (dim, [255.0, 2.0, 0.0], 1.0, 2),
        (bytes, [300.0, 0.0, -1.0], 1.0, 2 + 2 * (mesh.positions().len() - 1)),
    ] {
        let given = all(light, first);
        let mut text = String::new();
        for (p, c) in mesh.positions().iter().zip(&given) {
            text += &format!("v {:?} {:?} {:?} {:?} {:?} {:?}\n", p.x, p.y, p.z, c[0], c[1], c[2]);
        }
        mesh.facets().iter().for_each(|f| text += &format!("f {} {} {}\n", f[0] + 1, f[1] + 1, f[2] + 1));
        let read = decode_with_attributes(Format::Obj, text.as_bytes()).unwrap();
        assert!(read.left_aside.is_empty(), "{:?}", read.left_aside);
        let mut arrays = Attributes::new(&mesh);
        arrays.set_colours(Colours { values: given.clone(), depth: ColourDepth::Float }).unwrap();
        for attributes in [read.attributes, arrays] {
            let kept = &attributes.colours().unwrap().values;
            assert!(
                kept.iter().zip(&given).all(|(kept, given)| (0..3).all(|k| kept[k] == given[k] / scale)),
                "{first:?}"
            );
            let warnings = run(&mesh, attributes, 60).report.warnings;
            let told = warnings.iter().find(|warning| warning.code == "colours_out_of_range");
            assert_eq!(told.and_then(|told| told.count).unwrap_or(0), outside, "{light:?}, {first:?}: {warnings:?}");
        }
    }
}

#[test]
fn normals_stay_unit_and_creases_sharp() {
    let sphere = Shape::Sphere.build(2000);
    let mut attributes = Attributes::new(&sphere);
    attributes.set_normals(Normals::PerVertex(sphere.positions().to_vec())).unwrap();
    let done = run(&sphere, attributes, 300);
    let Some(Normals::PerVertex(normals)) = done.attributes.as_ref().unwrap().normals() else { panic!("per vertex") };
    for (n, p) in normals.iter().zip(done.mesh.positions()) {
        assert!((n.length() - 1.0).abs() < 1e-14, "{n}");
        // Within a facet, whose edges take up a fifteenth, both turn alike up to a square of that.
        assert!(n.dot(p.normalize()) > 1.0 - 1e-4, "{n} at {p}");
    }
    // Flat: each facet has its own normal.
    let block = Shape::Block.build(1200);
    let normal = |mesh: &TriMesh, f: usize| {
        let [a, b, c] = mesh.corners(f);
        (b - a).cross(c - a).normalize()
    };
    let facets = 0..block.facets().len();
    let flat = PerCorner {
        values: facets.clone().map(|f| normal(&block, f)).collect(),
        corners: facets.map(|f| [f as u32; 3]).collect(),
    };
    let mut attributes = Attributes::new(&block);
    attributes.set_normals(Normals::PerCorner(flat)).unwrap();
    let done = run(&block, attributes, 400);
    let Some(Normals::PerCorner(normals)) = done.attributes.as_ref().unwrap().normals() else { panic!("per corner") };
    let mut right = 0;
    for (facet, corners) in normals.corners.iter().enumerate() {
        let [a, b, c] = corners.map(|i| normals.values[i as usize]);
        assert!(a.abs().max_element() > 1.0 - 1e-12, "{a} is no side of the block");
        assert!(a.distance(b) < 1e-12 && a.distance(c) < 1e-12, "facet {facet} is not flat: {a} {b} {c}");
        right += usize::from(a.dot(normal(&done.mesh, facet)) > 0.9);
    }
    // Facets over the creases lean.
    assert!(right * 2 > normals.corners.len(), "{right} of {}", normals.corners.len());
}

/// Sides with vertices and normals of their own, as most exporters write hard edges.
#[test]
fn split_normals_stay_on_their_sides() {
    let block = Shape::Block.build(600);
    let corners = |f: usize| block.corners(f);
    let positions: Vec<DVec3> = (0..block.facets().len()).flat_map(corners).collect();
    let facets: Vec<[u32; 3]> = (0..block.facets().len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let mesh = TriMesh::new(positions, facets).unwrap();
    let straight = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).normalize();
    let normals = (0..mesh.facets().len()).flat_map(|f| [straight(mesh.corners(f)); 3]).collect();
    let mut attributes = Attributes::new(&mesh);
    attributes.set_normals(Normals::PerVertex(normals)).unwrap();
    let options = RemeshOptions::new(Seeds::Sample { points: 500, seed: 4 });
    let options = options.with_attributes(attributes);
    let done = remesh(&mesh, &options, &Serial, &mut (), &Token::default()).unwrap();
    let carried = done.attributes.unwrap();
    let Some(Normals::PerCorner(normals)) = carried.normals() else { panic!("not by corners") };
    for (f, corners) in normals.corners.iter().enumerate() {
        let wanted = straight(done.mesh.corners(f));
        // Creases are kept, so that no facet lies across one.
        assert!(corners.iter().all(|&c| normals.values[c as usize].dot(wanted) > 0.999), "{f}");
    }
}

/// Whatever is wrong with an attribute, the surface is read, and what is wrong is named.
/// Shells that are nearer to each other than edges are long are remeshed each as if alone, and keep what is theirs.
#[test]
fn shells_beside_each_other_keep_their_own() {
    let one = Shape::Sphere.build(2000);
    let (mut positions, mut facets) = one.clone().into_parts();
    let n = positions.len();
    positions.extend(one.positions().iter().map(|p| 1.03 * *p));
    facets.extend(one.facets().iter().map(|f| f.map(|v| v + n as u32)));
    let mesh = TriMesh::new(positions, facets).unwrap();
    let mut attributes = Attributes::new(&mesh);
    let shell: Vec<f64> = (0..2 * n).map(|v| if v < n { 0.0 } else { 1.0 }).collect();
    attributes.add_scalar(Scalar::new("shell", shell)).unwrap();
    let wish = RemeshOptions::new(Seeds::Sample { points: 600, seed: 4 }).with_attributes(attributes);
    let out = remesh(&mesh, &wish, &Serial, &mut (), &Token::default()).unwrap();
    let result = &out.report.result;
    assert_eq!((result.vertices, result.repair.split_cells, result.topology.components), (600, 0, 2));
    assert!(out.report.topology_changes.is_empty());
    // An edge is 0.22 long, and a chord of it 0.006 below the shell.
    let quality = result.quality.unwrap();
    assert!(quality.theta_min_deg > 28.0 && quality.hausdorff_percent < 0.4, "{quality:?}");
    let values = &out.attributes.as_ref().unwrap().scalars()[0].values;
    let per_shell = [0.0, 1.0].map(|shell| values.iter().filter(|v| **v == shell).count());
    assert_eq!(per_shell.iter().sum::<usize>(), 600, "no vertex is on both");
    for (p, value) in out.mesh.positions().iter().zip(values) {
        // Fitted vertices are above the shell by h²/8 = 0.006 in the mean, as flat triangles are below their corners by as much;
        // half of what is between the two is 0.015.
        assert!((p.length() - (1.0 + 0.03 * value)).abs() < 0.012, "{p} of shell {value}");
    }
    for p in &out.seeds {
        // The shells' facets are 0.085 long, and below the sphere by 0.0012 in their middles.
        assert!((p.length() - 1.0).abs() < 0.005 || (p.length() - 1.03).abs() < 0.005, "{p}");
    }
}

#[test]
fn wrong_attributes_are_refused_and_bits_do_not_depend_on_threads() {
    let (mesh, all) = everything();
    let other = Shape::Square.build(2);
    let options =
        RemeshOptions::plain(Seeds::Sample { points: 50, seed: 1 }, 0).with_attributes(Attributes::new(&other));
    let refused = remesh(&mesh, &options, &Serial, &mut (), &Token::default()).unwrap_err();
    assert!(matches!(refused, RemeshError::Attributes(AttributeError::OtherMesh { .. })), "{refused}");

    let done = run(&mesh, all.clone(), 120);
    let on_threads = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let closest = ClosestPoint::new(&mesh);
            let places = provenance(&closest, done.mesh.positions(), &Token::default()).unwrap();
            carry(&mesh, &all, &closest, &done.mesh, &places).unwrap()
        })
    };
    let one = on_threads(1);
    assert_eq!(Some(&one), done.attributes.as_ref());
    assert_eq!(one, on_threads(3));
    assert!(one.check_mesh(&done.mesh).is_ok());
}
