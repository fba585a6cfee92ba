//! Promise: strips, skins, grids, packages and files beside a file are read as the surfaces that other programs see in them.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat4, DQuat, DVec3};
use tessera::mesh::TriMesh;
use tessera::mesh::io::{
    DataError, FileError, Format, decode, decode_with_attributes, encode, read, read_bytes, read_with_attributes,
};
use tessera::mesh::shapes::Shape;

use crate::packages::stored;

fn check(format: Format, bytes: &[u8]) {
    crate::readers::check(format, bytes).unwrap();
}

/// A grid of n by n squares in rows of strips, whose ends are marked.
fn strips(n: u32) -> (Vec<DVec3>, Vec<i64>) {
    let points = (0..=n).flat_map(|y| (0..=n).map(move |x| DVec3::new(x.into(), y.into(), 0.0))).collect();
    let row = |y: u32| (0..=n).flat_map(move |x| [i64::from((y + 1) * (n + 1) + x), i64::from(y * (n + 1) + x)]);
    (points, (0..n).flat_map(|y| row(y).chain([-1])).collect())
}

#[test]
fn ply_strips() {
    let n = 20;
    let (points, strip) = strips(n);
    let head = |format: &str, kind: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
             element tristrips 1\nproperty list int {kind} vertex_indices\nend_header\n",
            points.len()
        )
    };
    let mut text = head("ascii", "int");
    points.iter().for_each(|p| writeln!(text, "{} {} {}", p.x, p.y, p.z).unwrap());
    let _ = write!(text, "{}", strip.len());
    strip.iter().for_each(|v| write!(text, " {v}").unwrap());
    text.push('\n');
    let mut files = vec![text.clone().into_bytes()];
    for big in [false, true] {
        let mut file = head(if big { "binary_big_endian" } else { "binary_little_endian" }, "int").into_bytes();
        let mut put = |bytes: &[u8]| if big { file.extend(bytes) } else { file.extend(bytes.iter().rev()) };
        points.iter().flat_map(|p| p.to_array()).for_each(|x| put(&x.to_be_bytes()));
        put(&(strip.len() as i32).to_be_bytes());
        strip.iter().for_each(|&v| put(&(v as i32).to_be_bytes()));
        files.push(file);
    }
    for file in files {
        check(Format::Ply, &file);
        let mesh = decode(Format::Ply, &file).unwrap();
        assert_eq!((mesh.positions().len(), mesh.facets().len()), (441, 800));
        assert!((mesh.area() - f64::from(n * n)).abs() < 1e-9);
        let up = |f: usize| {
            let [a, b, c] = mesh.corners(f);
            (b - a).cross(c - a).z
        };
        let first = up(0).signum();
        assert!((0..mesh.facets().len()).all(|f| up(f) * first > 0.0), "all are oriented alike");
    }
    // A strip that repeats vertices to turn, one that is too short, and a vertex that is not there.
    let turned = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement \
                  tristrips 2\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n\
                  9 0 1 2 2 3 3 -1 1 3\n2 0 1\n";
    assert_eq!(decode(Format::Ply, turned.as_bytes()).unwrap().facets(), [[0, 1, 2]]);
    check(Format::Ply, turned.as_bytes());
    let beyond = turned.replace("9 0 1 2", "9 0 1 7");
    assert!(matches!(decode(Format::Ply, beyond.as_bytes()), Err(DataError::Element { element: "face", .. })));
}

/// A torus that two joints hold: its node's own place does not count, theirs does.
#[test]
fn skins_place_surfaces() {
    let mesh = Shape::Torus.build(200);
    let plain = String::from_utf8(encode(Format::Gltf, &mesh).unwrap()).unwrap();
    let count = decode(Format::Gltf, plain.as_bytes()).unwrap().positions().len();
    let bound = DMat4::from_translation(DVec3::new(0.0, 0.0, -2.0));
    let joint = DMat4::from_scale_rotation_translation(
        DVec3::splat(2.0),
        DQuat::from_rotation_z(0.5),
        DVec3::new(1.0, 2.0, 3.0),
    );
    let parent = DMat4::from_translation(DVec3::new(10.0, 0.0, 0.0));
    let numbers = |m: DMat4| m.to_cols_array().map(|x| x as f32);
    // Each vertex has the first joint with weight 3/4 and the second one with 1/4; the same moves, so that all is rigid.
    let mut data: Vec<u8> = Vec::new();
    (0..count).for_each(|_| data.extend([0u8, 1, 0, 0]));
    (0..count).for_each(|_| [0.75f32, 0.25, 0.0, 0.0].iter().for_each(|w| data.extend(w.to_le_bytes())));
    (0..2).for_each(|_| numbers(bound).iter().for_each(|x| data.extend(x.to_le_bytes())));
    let buffer = format!("{{\"byteLength\":{},\"uri\":\"data:;base64,{}\"}}", data.len(), STANDARD.encode(&data));
    let text = plain
        .replace("\"buffers\":[", &format!("\"buffers\":[{buffer},"))
        .replace("\"buffer\":0", "\"buffer\":1")
        .replace(
            "\"bufferViews\":[",
            &format!(
                "\"bufferViews\":[{{\"buffer\":0,\"byteLength\":{}}},{{\"buffer\":0,\"byteOffset\":{},\"byteLength\":{}}},\
                 {{\"buffer\":0,\"byteOffset\":{},\"byteLength\":128}},",
                4 * count,
                4 * count,
                16 * count,
                20 * count
            ),
        )
        .replace("\"bufferView\":0", "\"bufferView\":3")
        .replace("\"bufferView\":1", "\"bufferView\":4")
        .replace(
            "\"accessors\":[",
            &format!(
                "\"accessors\":[{{\"bufferView\":0,\"componentType\":5121,\"count\":{count},\"type\":\"VEC4\"}},\
                 {{\"bufferView\":1,\"componentType\":5126,\"count\":{count},\"type\":\"VEC4\"}},\
                 {{\"bufferView\":2,\"componentType\":5126,\"count\":2,\"type\":\"MAT4\"}},"
            ),
        )
        .replace("\"POSITION\":0", "\"POSITION\":3,\"JOINTS_0\":0,\"WEIGHTS_0\":1")
        .replace("\"indices\":1", "\"indices\":4");
    let matrix = |m: DMat4| format!("[{}]", m.to_cols_array().map(|x| x.to_string()).join(","));
    let nodes = |skin: &str| {
        format!(
            "\"nodes\":[{{\"mesh\":0,{skin}\"scale\":[100,100,100],\"translation\":[5,0,0]}},{{\"children\":[2,3],\
             \"matrix\":{}}},{{\"matrix\":{}}},{{\"matrix\":{}}}]",
            matrix(parent),
            matrix(joint),
            matrix(joint)
        )
    };
    let file = |skin: &str, inverses: &str| {
        text.replace("\"nodes\":[0]", "\"nodes\":[0,1]")
            .replace("\"nodes\":[{\"mesh\":0}]", &nodes(skin))
            .replace("\"asset\"", &format!("\"skins\":[{{\"joints\":[2,3]{inverses}}}],\"asset\""))
    };
    let before = decode(Format::Gltf, plain.as_bytes()).unwrap();
    let placed = |text: &str, place: DMat4, lines: usize| {
        check(Format::Gltf, text.as_bytes());
        let loaded = decode_with_attributes(Format::Gltf, text.as_bytes()).unwrap();
        assert_eq!(loaded.left_aside.len(), lines, "{:?}", loaded.left_aside);
        assert_eq!(loaded.mesh.facets(), before.facets());
        for (&p, q) in before.positions().iter().zip(loaded.mesh.positions()) {
            assert!(place.transform_point3(p).distance(*q) < 1e-4, "{p} {q}");
        }
    };
    placed(&file("\"skin\":0,", ",\"inverseBindMatrices\":2"), parent * joint * bound, 0);
    placed(&file("\"skin\":0,", ""), parent * joint, 0);
    let node = DMat4::from_scale_rotation_translation(DVec3::splat(100.0), DQuat::IDENTITY, DVec3::new(5.0, 0.0, 0.0));
    placed(&file("", ""), node, 0);
    // A skin without its numbers: the node's place, and a line.
    placed(&file("\"skin\":0,", ",\"inverseBindMatrices\":77"), node, 1);
    placed(&file("\"skin\":0,", "").replace("\"joints\":[2,3]", "\"joints\":[2,300]"), node, 1);
}

#[test]
fn sparse_accessors() {
    // Three vertices of zeros, of which two are given.
    let mut data = Vec::new();
    [1u8, 2, 0, 0].iter().for_each(|&n| data.push(n));
    [1.0f32, 0.0, 0.0, 0.0, 1.0, 0.0].iter().for_each(|x| data.extend(x.to_le_bytes()));
    let text = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"nodes\":[{{\"mesh\":0}}],\"meshes\":[{{\"primitives\":[{{\"attributes\":\
         {{\"POSITION\":0}}}}]}}],\"accessors\":[{{\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\"sparse\":{{\"count\":2,\
         \"indices\":{{\"bufferView\":0,\"componentType\":5121}},\"values\":{{\"bufferView\":1}}}}}}],\"bufferViews\":[\
         {{\"buffer\":0,\"byteLength\":4}},{{\"buffer\":0,\"byteOffset\":4,\"byteLength\":24}}],\"buffers\":[{{\
         \"byteLength\":28,\"uri\":\"data:;base64,{}\"}}]}}",
        STANDARD.encode(&data)
    );
    check(Format::Gltf, text.as_bytes());
    assert_eq!(decode(Format::Gltf, text.as_bytes()).unwrap().area(), 0.5);
    for (from, to) in [
        ("\"componentType\":5121", "\"componentType\":1"),
        ("\"count\":3", "\"count\":2"),
        ("\"count\":3", "\"count\":9000000"),
    ] {
        let wrong = text.replace(from, to);
        assert!(decode(Format::Gltf, wrong.as_bytes()).is_err(), "{to}");
        check(Format::Gltf, wrong.as_bytes());
    }
}

#[test]
fn buffers_beside_a_gltf() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = Shape::Torus.build(200);
    let whole = String::from_utf8(encode(Format::Gltf, &mesh).unwrap()).unwrap();
    let (before, after) = whole.split_once("data:application/octet-stream;base64,").unwrap();
    let (data, after) = after.split_once('"').unwrap();
    let data = STANDARD.decode(data).unwrap();
    let below = folder.path().join("below");
    std::fs::create_dir(&below).unwrap();
    std::fs::write(folder.path().join("outside.bin"), &data).unwrap();
    std::fs::write(below.join("a part.bin"), &data).unwrap();
    std::fs::create_dir(below.join("parts")).unwrap();
    std::fs::write(below.join("parts/b.bin"), &data).unwrap();
    let path = below.join("torus.gltf");
    let named = |uri: &str| {
        std::fs::write(&path, format!("{before}{uri}\"{after}")).unwrap();
        read(&path)
    };
    let expected = decode(Format::Gltf, whole.as_bytes()).unwrap();
    for uri in ["a%20part.bin", "./a part.bin", "parts/b.bin"] {
        assert_eq!(named(uri).unwrap(), expected, "{uri}");
        // As it is sent to a server.
        assert_eq!(decode(Format::Gltf, &read_bytes(&path, Format::Gltf).unwrap()).unwrap(), expected);
    }
    let outside = folder.path().join("outside.bin");
    for uri in [
        "../outside.bin",
        "%2e%2e/outside.bin",
        outside.to_str().unwrap(),
        "https://example.org/a.bin",
        "none.bin",
        "parts",
    ] {
        let error = named(uri).unwrap_err();
        assert!(
            matches!(&error, FileError::Data { cause: DataError::Element { element: "buffer", .. }, .. }),
            "{uri}: {error}"
        );
    }
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(&outside, below.join("link.bin")).unwrap();
        assert!(named("link.bin").is_err());
    }
    // A server has the text alone.
    let sent = std::fs::read(&path).unwrap();
    let error = decode(Format::Gltf, &sent).unwrap_err().to_string();
    assert!(error.contains("in another file"), "{error}");
    let packed = below.join("torus.gltf.gz");
    let text = format!("{before}parts/b.bin\"{after}").into_bytes();
    std::fs::write(&packed, tessera::mesh::io::pack_for(&packed, text).unwrap()).unwrap();
    assert_eq!(read(&packed).unwrap(), expected);
}

/// A cell of every kind, in text; arrays of cells; several pieces.
#[test]
fn grids_of_cells() {
    let file = |types: &str, corners: &str, ends: &str, count: usize| {
        format!(
            "<VTKFile type='UnstructuredGrid' byte_order='LittleEndian'><UnstructuredGrid><Piece NumberOfPoints='8' \
             NumberOfCells='{count}'><PointData><DataArray type='Float32' Name='h' format='ascii'>0 1 2 3 4 5 6 7</DataArray>\
             </PointData><CellData><DataArray type='Int32' Name='part' format='ascii'>1</DataArray></CellData><Points>\
             <DataArray type='Float32' NumberOfComponents='3' format='ascii'>0 0 0 1 0 0 1 1 0 0 1 0 0 0 1 1 0 1 1 1 1 0 1 1\
             </DataArray></Points><Cells><DataArray type='Int64' Name='connectivity' format='ascii'>{corners}</DataArray>\
             <DataArray type='Int64' Name='offsets' format='ascii'>{ends}</DataArray><DataArray type='UInt8' Name='types' \
             format='ascii'>{types}</DataArray></Cells></Piece></UnstructuredGrid></VTKFile>"
        )
        .replace('\'', "\"")
    };
    // A vertex, a line, a triangle, a quad, a pixel, a polygon, a strip.
    let all = file("1 3 5 9 8 7 6", "0 0 1 0 1 2 0 1 2 3 4 5 7 6 0 1 2 3 0 1 3 2", "1 3 6 10 14 18 22", 7);
    check(Format::Vtu, all.as_bytes());
    let loaded = decode_with_attributes(Format::Vtu, all.as_bytes()).unwrap();
    assert_eq!((loaded.mesh.facets().len(), loaded.mesh.area()), (9, 4.5));
    assert_eq!(loaded.attributes.scalars()[0].values[7], 7.0);
    assert_eq!(loaded.left_aside.len(), 2, "{:?}", loaded.left_aside);
    assert!(loaded.left_aside[0].to_string().contains("cell array"), "{:?}", loaded.left_aside);
    // A hexahedron beside a triangle is left aside; alone it is no surface.
    let both = file("12 5", "0 1 2 3 4 5 6 7 0 1 2", "8 11", 2);
    check(Format::Vtu, both.as_bytes());
    assert_eq!(decode_with_attributes(Format::Vtu, both.as_bytes()).unwrap().left_aside.len(), 2);
    let volume = file("12", "0 1 2 3 4 5 6 7", "8", 1);
    check(Format::Vtu, volume.as_bytes());
    let error = decode(Format::Vtu, volume.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("Extract Surface"), "{error}");
    let wrong = all.replace("UnstructuredGrid\"", "PolyData\"");
    assert!(decode(Format::Vtu, wrong.as_bytes()).unwrap_err().to_string().contains("name it .vtp"));
    let beyond = file("5", "0 1 8", "3", 1);
    assert!(matches!(decode(Format::Vtu, beyond.as_bytes()), Err(DataError::Element { element: "cell", .. })));
}

/// A unit tetrahedron, and the parts of a package around it.
const TETRAHEDRON: &str = "<mesh><vertices><vertex x=\"0\" y=\"0\" z=\"0\"/><vertex x=\"1\" y=\"0\" z=\"0\"/><vertex x=\"0\" \
    y=\"1\" z=\"0\"/><vertex x=\"0\" y=\"0\" z=\"1\"/></vertices><triangles><triangle v1=\"0\" v2=\"2\" v3=\"1\"/>\
    <triangle v1=\"0\" v2=\"1\" v3=\"3\"/><triangle v1=\"1\" v2=\"2\" v3=\"3\"/><triangle v1=\"2\" v2=\"0\" v3=\"3\"/>\
    </triangles></mesh>";

fn volume(mesh: &TriMesh) -> f64 {
    let six = |f: usize| {
        let [a, b, c] = mesh.corners(f);
        a.dot(b.cross(c))
    };
    (0..mesh.facets().len()).map(six).sum::<f64>() / 6.0
}

#[test]
fn packages_of_objects() {
    let model = |resources: &str, build: &str| {
        format!(
            "<?xml version=\"1.0\"?>\n<model unit=\"millimeter\"><resources>{resources}</resources><build>{build}</build></model>"
        )
    };
    let object = |id: u32, content: &str| format!("<object id=\"{id}\">{content}</object>");
    let pair = "<components><component objectid=\"1\"/><component objectid=\"1\" transform=\"-1 0 0 0 1 0 0 0 1 5 0 0\"/></components>";
    let resources = object(1, TETRAHEDRON) + &object(2, pair);
    let build = "<item objectid=\"2\" transform=\"2 0 0 0 2 0 0 0 2 0 0 7\"/><item objectid=\"1\"/>";
    let file = stored(&[("3D/3dmodel.model", &model(&resources, build))]);
    check(Format::ThreeMf, &file);
    let loaded = decode_with_attributes(Format::ThreeMf, &file).unwrap();
    assert!(loaded.left_aside.is_empty(), "{:?}", loaded.left_aside);
    let mesh = loaded.mesh;
    assert_eq!((mesh.positions().len(), mesh.facets().len()), (12, 12));
    assert_eq!(mesh.bounds(), (DVec3::ZERO, DVec3::new(10.0, 2.0, 9.0)));
    // A mirrored component is turned inside out again.
    assert!((volume(&mesh) - (2.0 * 8.0 + 1.0) / 6.0).abs() < 1e-12, "{}", volume(&mesh));

    // The build may name objects of other parts, whose unit may be another one.
    let relations = "<Relationships><Relationship Target=\"/3D/first.model\" Id=\"r\" \
        Type=\"http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel\"/></Relationships>";
    let outer = object(1, "<components><component p:path=\"/3D/Objects/a.model\" objectid=\"9\"/></components>");
    let inner = model(&object(9, TETRAHEDRON), "").replace("millimeter", "centimeter");
    let first = model(&outer, "<item objectid=\"1\"/>");
    let parts = [("_rels/.rels", relations), ("3D/first.model", &*first), ("3d/objects/A.model", &*inner)];
    let file = stored(&parts);
    check(Format::ThreeMf, &file);
    assert_eq!(decode(Format::ThreeMf, &file).unwrap().bounds().1, DVec3::splat(10.0));
    let inches = first.replace("millimeter", "inch").replace(&outer, &object(1, TETRAHEDRON));
    let lines = decode_with_attributes(Format::ThreeMf, &stored(&[("3D/3dmodel.model", &inches)])).unwrap().left_aside;
    assert!(lines.len() == 1 && lines[0].to_string().contains("unit"), "{lines:?}");

    // What is no surface.
    let circle = object(1, "<components><component objectid=\"1\"/></components>");
    let many = (2..40).map(|id| {
        let before = format!("<component objectid=\"{}\"/>", id - 1);
        object(id, &format!("<components>{before}{before}</components>"))
    });
    let bomb = object(1, TETRAHEDRON) + &many.collect::<String>();
    for (resources, build) in [
        (circle.as_str(), "<item objectid=\"1\"/>"),
        (&bomb, "<item objectid=\"39\"/>"),
        (&object(1, TETRAHEDRON), "<item objectid=\"2\"/>"),
        (&object(1, TETRAHEDRON), ""),
        (&object(1, &TETRAHEDRON.replace("v3=\"3\"", "v3=\"4\"")), "<item objectid=\"1\"/>"),
        (&object(1, &TETRAHEDRON.replace("z=\"1\"", "z=\"one\"")), "<item objectid=\"1\"/>"),
        (&object(1, TETRAHEDRON), "<item objectid=\"1\" transform=\"1 0 0\"/>"),
        ("<object id=\"1\">", ""),
    ] {
        let file = stored(&[("3D/3dmodel.model", &model(resources, build))]);
        assert!(decode(Format::ThreeMf, &file).is_err(), "{resources} {build}");
        check(Format::ThreeMf, &file);
    }
    assert!(decode(Format::ThreeMf, &stored(&[("readme.txt", "nothing")])).is_err());
    // Much of nothing, which is packed to a thousandth.
    let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    std::io::Write::write_all(&mut packer, &encode(Format::ThreeMf, &Shape::Square.build(2)).unwrap()).unwrap();
    let packed = packer.finish().unwrap();
    assert_eq!(decode(Format::ThreeMf, &packed).unwrap().facets().len(), 2);
}

/// A plate whose middle line is named by the file.
#[test]
fn named_edges_are_kept() {
    let n = 10u32;
    let (mut text, at) = (String::new(), |x: u32, y: u32| y * (n + 1) + x + 1);
    let count = (n + 1) * (n + 1);
    let _ = writeln!(text, "MeshVersionFormatted 2\nDimension 3\nVertices\n{count}");
    for y in 0..=n {
        (0..=n).for_each(|x| writeln!(text, "{} {} 0 0", f64::from(x) / 10.0, f64::from(y) / 10.0).unwrap());
    }
    let _ = writeln!(text, "Edges\n{}", n + 1);
    let _ = writeln!(text, "{} {} 1", at(0, 0), at(3, 3));
    (0..n).for_each(|y| writeln!(text, "{} {} 1", at(5, y), at(5, y + 1)).unwrap());
    let named = |keyword: &str| {
        let numbers: String = (1..=n + 1).map(|edge| format!("{edge}\n")).collect();
        format!("{keyword}\n{}\n{numbers}", n + 1)
    };
    let mut faces = format!("Triangles\n{}\n", 2 * n * n);
    for (x, y) in (0..n).flat_map(|y| (0..n).map(move |x| (x, y))) {
        let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
        let _ = writeln!(faces, "{a} {b} {c} 0\n{a} {c} {d} 0");
    }
    for keyword in ["RequiredEdges", "Ridges"] {
        let file = format!("{text}{}{faces}End\n", named(keyword));
        check(Format::Medit, file.as_bytes());
        let loaded = decode_with_attributes(Format::Medit, file.as_bytes()).unwrap();
        // The first is no edge of the surface.
        assert_eq!((loaded.creases.len(), loaded.left_aside.len()), (10, 1), "{:?}", loaded.left_aside);
    }
    // Without names there are none.
    let file = format!("{text}{faces}End\n");
    assert!(decode_with_attributes(Format::Medit, file.as_bytes()).unwrap().creases.is_empty());
    let path = tempfile::tempdir().unwrap();
    let path = path.path().join("plate.mesh");
    std::fs::write(&path, format!("{text}{}{faces}End\n", named("Ridges"))).unwrap();
    assert_eq!(read_with_attributes(&path).unwrap().creases.len(), 10);
}

/// The same in a binary file: keyword, place of the next one, count, numbers.
#[test]
fn named_edges_of_binary_files() {
    let mesh = Shape::Square.build(2);
    let mut bytes = encode(Format::MeditBinary, &mesh).unwrap();
    // Before the end, which has no count.
    bytes.truncate(bytes.len() - 8);
    let mut keyword = |number: u32, numbers: &[u32]| {
        bytes.extend(number.to_le_bytes());
        let count = if number == 5 { numbers.len() / 3 } else { numbers.len() };
        let next = bytes.len() + 8 + 4 * numbers.len();
        bytes.extend((next as u32).to_le_bytes());
        bytes.extend((count as u32).to_le_bytes());
        numbers.iter().for_each(|n| bytes.extend(n.to_le_bytes()));
    };
    let [a, b, _] = mesh.facets()[0];
    keyword(5, &[a + 1, b + 1, 0]);
    keyword(16, &[1]);
    keyword(15, &[2, 1, 2]);
    bytes.extend([54, 0, 0, 0, 0, 0, 0, 0]);
    check(Format::MeditBinary, &bytes);
    let loaded = decode_with_attributes(Format::MeditBinary, &bytes).unwrap();
    assert_eq!((loaded.mesh, loaded.creases, loaded.vertices), (mesh, vec![[a.min(b), a.max(b)]], vec![0, 1]));
}
