//! Promise: what a surface carries is carried to its remesh, into files and out of them, and no texture spans a seam.

use std::f64::consts::TAU;

use crate::readers;
use glam::{DVec2, DVec3, dvec2, dvec3};
use tessera::internals::remesh::{carry, provenance};
use tessera::mesh::TriMesh;
use tessera::mesh::attributes::{AttributeError, Attributes, ColourDepth, Colours, Normals, PerCorner};
use tessera::mesh::closest_point::ClosestPoint;
use tessera::mesh::io::{
    Format, decode_with_attributes, encode, encode_with_attributes, read_with_attributes, write_with_attributes,
};
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::Serial;
use tessera::token::Token;

fn run(mesh: &TriMesh, attributes: Attributes, points: usize) -> Remesh {
    let options = RemeshOptions::plain(Seeds::Sample { points, seed: 4 }, 3).with_attributes(attributes);
    remesh(mesh, &options, &Serial, &mut (), &Token::default()).unwrap()
}

fn texture(values: Vec<DVec2>, corners: Vec<[u32; 3]>) -> PerCorner<DVec2> {
    PerCorner { values, corners }
}

/// Every corner a value of its own, made by `uv(facet, position)`.
fn wedges(mesh: &TriMesh, uv: impl Fn(usize, DVec3) -> DVec2) -> PerCorner<DVec2> {
    let facets = 0..mesh.facets().len();
    let values = facets.clone().flat_map(|f| mesh.corners(f).map(|p| uv(f, p))).collect();
    texture(values, facets.map(|f| [0, 1, 2].map(|k| 3 * f as u32 + k)).collect())
}

fn centroid(mesh: &TriMesh, facet: usize) -> DVec3 {
    mesh.corners(facet).iter().sum::<DVec3>() / 3.0
}

/// Angle in turns, from 0 to 1.
fn turns(y: f64, x: f64) -> f64 {
    (y.atan2(x) / TAU).rem_euclid(1.0)
}

/// `t`, a turn more or less, so that it is on `near`'s side of the seam at 0.
fn beside(t: f64, near: f64) -> f64 {
    t + (near - t).round()
}

/// Uv of each corner of a facet.
fn uvs(texture: &PerCorner<DVec2>, facet: usize) -> [DVec2; 3] {
    texture.corners[facet].map(|i| texture.values[i as usize])
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
            attributes.add_scalar(name, mesh.positions().iter().map(|p| p[axis]).collect()).unwrap();
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

/// A mesh with everything: two charts, normals, 8-bit colours, two scalars.
fn everything() -> (TriMesh, Attributes) {
    let mesh = Shape::Hills.build(300);
    let mut all = Attributes::new(&mesh);
    all.set_texture(wedges(&mesh, |f, p| {
        dvec2(p.x / 3.0 + if centroid(&mesh, f).x < 0.4 { 0.0 } else { 2.0 }, p.y / 7.0)
    }))
    .unwrap();
    all.set_normals(Normals::PerVertex(mesh.positions().iter().map(|p| dvec3(p.x, 0.3, 1.0)).collect())).unwrap();
    let values = (0..mesh.positions().len()).map(|i| [7, 11, 13, 17].map(|k| f64::from((i * k % 256) as u8) / 255.0));
    all.set_colours(Colours { values: values.collect(), depth: ColourDepth::Eight }).unwrap();
    all.add_scalar("density", mesh.positions().iter().map(|p| p.x / 3.0).collect()).unwrap();
    all.add_scalar("t", mesh.positions().iter().map(|p| p.z * 1e-300).collect()).unwrap();
    (mesh, all)
}

#[test]
fn files_keep_what_they_can_hold() {
    let (mesh, all) = everything();
    let folder = tempfile::tempdir().unwrap();
    let round = |extension: &str, attributes: &Attributes| {
        let path = folder.path().join("mesh").with_extension(extension);
        let left_out = write_with_attributes(&path, &mesh, attributes).unwrap();
        let loaded = read_with_attributes(&path).unwrap();
        assert!(loaded.left_aside.is_empty(), "{:?}", loaded.left_aside);
        (loaded, left_out)
    };
    let before = readers::on_corners(&mesh, &all);
    let (ply, left_out) = round("ply", &all);
    assert!(left_out.is_empty(), "{left_out:?}");
    assert_eq!(readers::on_corners(&ply.mesh, &ply.attributes), before);
    assert_eq!((ply.attributes.scalars(), ply.attributes.colours()), (all.scalars(), all.colours()));
    assert_eq!(ply.attributes.normals(), all.normals());

    let (obj, left_out) = round("obj", &all);
    assert_eq!(left_out, ["opacity", "scalar density", "scalar t"]);
    let after = readers::on_corners(&obj.mesh, &obj.attributes);
    assert_eq!((&after[0], &after[1]), (&before[0], &before[1]));
    assert_eq!(obj.attributes.colours().unwrap().depth, ColourDepth::Eight);
    assert!(after[2].iter().zip(&before[2]).all(|(a, b)| a[..3] == b[..3] && a[3] == 1.0));

    let (off, left_out) = round("off", &all);
    assert_eq!(left_out, ["texture coordinates (they have seams)", "scalar density", "scalar t"]);
    assert_eq!((off.attributes.normals(), off.attributes.colours()), (all.normals(), all.colours()));

    let (stl, left_out) = round("stl", &all);
    assert!(stl.attributes.is_empty());
    assert_eq!(left_out, ["normals", "texture coordinates", "colours", "scalar density", "scalar t"]);

    // One value for each vertex fits all but STL.
    let mut plain = Attributes::new(&mesh);
    let values = mesh.positions().iter().map(|p| dvec2(p.x / 3.0, p.y)).collect();
    plain.set_texture(texture(values, mesh.facets().to_vec())).unwrap();
    let values = mesh.positions().iter().map(|p| [p.x / 3.0, 1e-3, 0.5, 1.0]).collect();
    plain.set_colours(Colours { values, depth: ColourDepth::Float }).unwrap();
    for extension in ["ply", "off"] {
        let (loaded, left_out) = round(extension, &plain);
        assert!(left_out.is_empty());
        assert_eq!(loaded.attributes, plain, "{extension}");
    }
    let (loaded, left_out) = round("obj", &plain);
    assert!(left_out.is_empty());
    assert_eq!(readers::on_corners(&loaded.mesh, &loaded.attributes), readers::on_corners(&mesh, &plain));
    // Nothing to carry: the plain writer's bytes.
    for format in Format::ALL {
        let (bytes, left_out) = encode_with_attributes(format, &mesh, &Attributes::new(&mesh)).unwrap();
        assert_eq!((bytes, left_out.len()), (encode(format, &mesh).unwrap(), 0), "{format:?}");
    }
}

#[test]
fn files_of_other_programs() {
    let obj = "v 0 0 0 1 0.5 0\nv 1 0 0 1 0 0\nv 1 1 0\nv 0 1 0 0 0 1\nvt 0 0\nvt 1\nvt 1 1 0\nvn 0 0 2\n\
               f 1/1/1 2/2/1 3/-1/-1 4//1\nf 1 3 4\n";
    let loaded = decode_with_attributes(Format::Obj, obj.as_bytes()).unwrap();
    assert!(loaded.left_aside.is_empty(), "{:?}", loaded.left_aside);
    let (mesh, all) = (&loaded.mesh, &loaded.attributes);
    assert_eq!(mesh.facets().len(), 3);
    let uv = all.texture().unwrap();
    assert_eq!(uvs(uv, 0), [dvec2(0., 0.), dvec2(1., 0.), dvec2(1., 1.)]);
    assert_eq!(uvs(uv, 1), [dvec2(0., 0.), dvec2(1., 1.), DVec2::ZERO]);
    assert_eq!(uvs(uv, 2), [DVec2::ZERO; 3]);
    assert_eq!(all.colours().unwrap().values[2], [1.0; 4]);
    let Some(Normals::PerCorner(n)) = all.normals() else { panic!("the last facet has none") };
    assert_eq!((n.values[n.corners[0][0] as usize], n.values[n.corners[2][0] as usize]), (DVec3::Z, DVec3::ZERO));

    let ply = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
               property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float quality\n\
               property float texture_u\nproperty float texture_v\nproperty float bad\nelement face 1\n\
               property list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n\
               0 0 0 255 0 51 .5 0 0 nan\n1 0 0 255 0 51 1. 1 0 1\n1 1 0 0 0 0 2 1 1 1\n0 1 0 0 0 0 3 0 1 1\n\
               4 0 1 2 3 8 0 0 .5 0 .5 .5 0 .5\n";
    let loaded = decode_with_attributes(Format::Ply, ply.as_bytes()).unwrap();
    let all = &loaded.attributes;
    assert!(
        matches!(&loaded.left_aside[..], [AttributeError::NonFinite { attribute, index: 0 }] if attribute.contains("bad"))
    );
    assert_eq!(all.colours().unwrap().values[1], [1.0, 0.0, 0.2, 1.0]);
    assert_eq!(all.scalars()[0].values, [0.5, 1.0, 2.0, 3.0]);
    assert_eq!(uvs(all.texture().unwrap(), 1), [DVec2::ZERO, dvec2(0.5, 0.5), dvec2(0.0, 0.5)]);

    let off = "CNOFF 3 1 0\n0 0 0 0 0 1 1 0 0 0.5\n1 0 0 0 0 1 1 0 0\n0 1 0 0 0 1 0 0 1 1\n3 0 1 2\n";
    let loaded = decode_with_attributes(Format::Off, off.as_bytes()).unwrap();
    assert!(loaded.left_aside.is_empty(), "{:?}", loaded.left_aside);
    let colours = loaded.attributes.colours().unwrap();
    assert_eq!((colours.values[0], colours.values[1]), ([1., 0., 0., 0.5], [1., 0., 0., 1.]));
    assert_eq!(loaded.attributes.normals(), Some(&Normals::PerVertex(vec![DVec3::Z; 3])));
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
    attributes.add_scalar("shell".to_owned(), shell).unwrap();
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

/// A polygon that is not convex is not cut as a fan; texture coordinates go with their corners in every format that has them.
#[test]
fn corners_of_polygons_that_are_not_convex_keep_their_texture() {
    // An L with a corner in the middle of a side, its first corner far from the notch, and a triangle before and after it.
    let ring = [(2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (0, 1), (0, 0)];
    let obj = |sign: &str| {
        let places: String = ring.iter().map(|(x, y)| format!("v {x} {y} 0\nvt {x} {y}\n")).collect();
        let corners: Vec<String> = (1..=7).map(|k| format!("{k}/{k}")).collect();
        format!("{places}v 9 0 0\n{sign}f 1 2 8\nf {}\nf 2 3 8\n", corners.join(" "))
    };
    let places: String = ring.iter().map(|(x, y)| format!("{x} {y} 0\n")).collect();
    let uv: Vec<String> = ring.iter().map(|(x, y)| format!("{x} {y}")).collect();
    let ply = format!(
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\nelement face 3\n\
         property list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n{places}9 0 0\n\
         3 0 1 7 6 2 0 2 1 9 0\n7 0 1 2 3 4 5 6 14 {}\n3 1 2 7 6 2 1 1 1 9 0\n",
        uv.join(" ")
    );
    let off = format!("OFF\n8 3 0\n{places}9 0 0\n3 0 1 7\n7 0 1 2 3 4 5 6\n3 1 2 7\n");
    // `s off` is a line that does not matter; continued lines go through the crate.
    let texts =
        [(Format::Obj, obj("s off\n")), (Format::Obj, obj("f 1 2 \\\n8\n")), (Format::Ply, ply), (Format::Off, off)];
    for (format, text) in texts {
        let loaded = decode_with_attributes(format, text.as_bytes()).unwrap();
        assert_eq!(loaded.left_aside, [], "{format:?}");
        assert_eq!(loaded.mesh, tessera::mesh::io::decode(format, text.as_bytes()).unwrap());
        let flat = |f: usize| {
            let [a, b, c] = loaded.mesh.corners(f);
            0.5 * (b - a).cross(c - a).z
        };
        let polygon: Vec<f64> = (0..loaded.mesh.facets().len())
            .filter(|&f| loaded.mesh.corners(f).iter().all(|p| p.x < 3.0))
            .map(flat)
            .collect();
        assert_eq!(polygon.len(), 5, "{format:?}");
        assert!(polygon.iter().all(|&area| area > 0.0), "{format:?}: {polygon:?}");
        assert_eq!(polygon.iter().sum::<f64>(), 3.0, "{format:?}");
        let Some(texture) = loaded.attributes.texture() else {
            assert_eq!(format, Format::Off);
            continue;
        };
        for f in (0..loaded.mesh.facets().len()).filter(|&f| loaded.mesh.corners(f).iter().all(|p| p.x < 3.0)) {
            for (uv, p) in uvs(texture, f).into_iter().zip(loaded.mesh.corners(f)) {
                assert_eq!(uv, p.truncate(), "{format:?}, facet {f}");
            }
        }
    }
}

#[test]
fn hostile_attributes_spoil_nothing_else() {
    let obj = |lines: &str, face: &str| format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{lines}\nf {face}\n");
    let cases = [
        obj("vt 0 0", "1/1 2/2 3/3"),
        obj("vt nan 0", "1/1 2/1 3/1"),
        obj("vt x y", "1/1 2/1 3/1"),
        obj("vt", "1/1 2/1 3/1"),
        obj("vt 0 0", "1/0 2/1 3/1"),
        obj("vt 0 0", "1/-2 2/1 3/1"),
        obj("vt 0 0", "1/4294967295 2/1 3/4294967296"),
        obj("vt 0 0", "1/9223372036854775807 2/-9223372036854775808 3/1"),
        obj("vn 0 0", "1//1 2//1 3//1"),
        obj("vn 0 inf 0", "1//1 2//1 3//1"),
        obj("vn 0 0 1", "1//1 2//7 3//1"),
        obj("v 1 1 1 1 nan 1", "1 2 4"),
        obj("v 1 1 1 1 1 1 1", "1 2 4"),
    ];
    for text in cases {
        let loaded = decode_with_attributes(Format::Obj, text.as_bytes()).unwrap();
        assert!(loaded.attributes.is_empty() && loaded.left_aside.len() == 1, "{text}{:?}", loaded.left_aside);
        readers::check(Format::Obj, text.as_bytes()).unwrap();
    }
    for word in ["COFF", "NOFF", "STOFF", "STCNOFF"] {
        let text = format!("{word} 3 1 0\n0 0 0\n1 0 0 1 2 3 4 5 6 7 8 9 9 9 9 9\n0 1 0 nan x 1\n3 0 1 2\n");
        let loaded = decode_with_attributes(Format::Off, text.as_bytes()).unwrap();
        assert!(loaded.attributes.is_empty() && !loaded.left_aside.is_empty(), "{text}");
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
