//! Promise: what a surface carries goes into files and comes out of them, as far as a format can hold it, and what is wrong with
//! an attribute spoils nothing else.

use crate::carried::{everything, texture, uvs};
use crate::readers;
use glam::{DVec2, DVec3, dvec2};
use tessera::mesh::attributes::{Attributes, ColourDepth, Colours, Normals};
use tessera::mesh::io::{
    Format, decode_with_attributes, encode, encode_with_attributes, read_with_attributes, write_with_attributes,
};

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
    // Two facets without texture coordinates, and a vertex without colour.
    assert_eq!(loaded.left_aside.len(), 2, "{:?}", loaded.left_aside);
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
    assert!(loaded.left_aside.is_empty(), "{:?}", loaded.left_aside);
    let gaps = &all.scalars().iter().find(|scalar| scalar.name == "bad").unwrap().values;
    assert!(gaps[0].is_nan() && gaps[1..] == [1.0; 3]);
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
        // Two facets of the OBJ name no texture coordinates.
        assert_eq!(loaded.left_aside.len(), usize::from(format == Format::Obj), "{format:?} {:?}", loaded.left_aside);
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
        assert!(loaded.attributes.is_empty() && !loaded.left_aside.is_empty(), "{text}");
        readers::check(Format::Obj, text.as_bytes()).unwrap();
    }
    for word in ["COFF", "NOFF", "STOFF", "STCNOFF"] {
        let text = format!("{word} 3 1 0\n0 0 0\n1 0 0 1 2 3 4 5 6 7 8 9 9 9 9 9\n0 1 0 nan x 1\n3 0 1 2\n");
        let loaded = decode_with_attributes(Format::Off, text.as_bytes()).unwrap();
        assert!(loaded.attributes.is_empty() && !loaded.left_aside.is_empty(), "{text}");
    }
}
