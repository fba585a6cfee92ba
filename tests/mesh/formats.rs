//! Promise: files of VTK, Gmsh, Medit and glTF are read as the surfaces that other programs see in them, with what their points
//! carry; what is packed is read up to a limit.

use std::io::Write as _;
use std::path::PathBuf;

use crate::carried::everything;
use crate::readers;
use glam::{DVec3, dvec2};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::mesh::TriMesh;
use tessera::mesh::attributes::{AttributeError, Attributes, ColourDepth, Colours, Normals, PerCorner, Scalar};
use tessera::mesh::io::{
    DataError, Format, UNPACKED_RATIO, decode, decode_with_attributes, encode, encode_with_attributes, read,
    read_with_attributes, unpack, write, write_with_attributes,
};
use tessera::mesh::numbers::NumberType;
use tessera::mesh::shapes::Shape;

/// How often each file is changed.
const CHANGES: usize = 800;

/// One value of everything for each vertex; numbers that single precision keeps.
fn plain(mesh: &TriMesh) -> Attributes {
    let mut all = Attributes::new(mesh);
    all.set_normals(Normals::PerVertex(mesh.positions().iter().map(|p| p.normalize_or_zero()).collect())).unwrap();
    let values = mesh.positions().iter().map(|p| dvec2(p.x, p.y)).collect();
    all.set_texture(PerCorner { values, corners: mesh.facets().to_vec() }).unwrap();
    let colour = |p: &DVec3| [0.2, if p.z > 0.0 { 1.0 } else { 0.0 }, 0.4, 1.0];
    let values = mesh.positions().iter().map(colour).collect();
    all.set_colours(Colours { values, depth: ColourDepth::Eight }).unwrap();
    all.add_scalar(Scalar::new("height", mesh.positions().iter().map(|p| p.z).collect())).unwrap();
    all.add_scalar(Scalar::new("t", mesh.positions().iter().map(|p| p.y / 3.0).collect())).unwrap();
    all
}

const WHOLE: [NumberType; 8] = [
    NumberType::I8,
    NumberType::U8,
    NumberType::I16,
    NumberType::U16,
    NumberType::I32,
    NumberType::U32,
    NumberType::I64,
    NumberType::U64,
];

/// Whole numbers of each type, and vectors: their types and their numbers of columns come back where a format has them.
#[test]
fn types_and_vectors_come_back() {
    let mesh = Shape::Hills.build(200);
    let count = mesh.positions().len();
    let mut all = Attributes::new(&mesh);
    for (k, number) in WHOLE.into_iter().enumerate() {
        let least = if k % 2 == 0 { -3.0 } else { 0.0 };
        let values = (0..count).map(|v| least + (v % 5) as f64).collect();
        all.add_scalar(Scalar { number, ..Scalar::new(format!("whole{k}"), values) }).unwrap();
    }
    for components in [2, 3, 4, 9] {
        let values = (0..components * count).map(|i| i as f64 / 3.0).collect();
        all.add_scalar(Scalar { components, ..Scalar::new(format!("vector{components}"), values) }).unwrap();
        let values = (0..components * count).map(|i| (i % 200) as f64).collect();
        let pair = Scalar { components, number: NumberType::I32, ..Scalar::new(format!("cell{components}"), values) };
        all.add_scalar(pair).unwrap();
    }
    for format in [Format::Vtk, Format::Vtp, Format::Ply, Format::Gmsh] {
        let (bytes, left_out) = encode_with_attributes(format, &mesh, &all).unwrap();
        let loaded = decode_with_attributes(format, &bytes).unwrap();
        assert!(left_out.is_empty() && loaded.left_aside.is_empty(), "{:?}", loaded.left_aside);
        let found = loaded.attributes.scalars();
        if matches!(format, Format::Vtk | Format::Vtp) {
            assert_eq!(found, all.scalars(), "{format:?}");
        }
        for wanted in all.scalars().iter().filter(|scalar| scalar.components == 1) {
            let got = found.iter().find(|scalar| scalar.name == wanted.name).unwrap();
            assert_eq!(got.values, wanted.values, "{format:?}");
            // PLY has no numbers of 64 bits, and Gmsh doubles alone.
            let number = match (format, wanted.number) {
                (Format::Gmsh, _) => NumberType::F64,
                (Format::Ply, NumberType::I64 | NumberType::U64) => NumberType::I32,
                (_, number) => number,
            };
            assert_eq!(got.number, number, "{format:?}");
        }
        // PLY has a property for each number.
        let numbers = |scalars: &[Scalar]| scalars.iter().map(|scalar| scalar.values.len()).sum::<usize>();
        // Gmsh's vectors have three numbers or nine.
        let wider = if format == Format::Gmsh { 2 * (1 + 5) * count } else { 0 };
        assert_eq!(numbers(found), numbers(all.scalars()) + wider, "{format:?}");
    }
    // The first of these is 2^53 + 1 as well.
    for id in [9_007_199_254_740_992.0, 9_007_199_254_740_994.0] {
        let rounded = all.add_scalar(Scalar { number: NumberType::I64, ..Scalar::new("id", vec![id; count]) });
        assert!(matches!(rounded, Err(AttributeError::Inexact { index: 0, .. })), "{id}");
    }
    let half = Scalar { number: NumberType::U8, ..Scalar::new("half", vec![0.5; count]) };
    all.add_scalar(half).unwrap();
    assert_eq!(all.scalars().last().unwrap().number, NumberType::F64);
}

#[test]
fn what_points_carry_comes_back() {
    let mesh = Shape::Hills.build(200);
    let all = plain(&mesh);
    for format in [Format::Vtk, Format::Vtp, Format::Vtu] {
        let (bytes, left_out) = encode_with_attributes(format, &mesh, &all).unwrap();
        let loaded = decode_with_attributes(format, &bytes).unwrap();
        assert!(left_out.is_empty() && loaded.left_aside.is_empty(), "{:?}", loaded.left_aside);
        assert_eq!((loaded.mesh, loaded.attributes), (mesh.clone(), all.clone()), "{format:?}");
        let mut fractions = Attributes::new(&mesh);
        let values = mesh.positions().iter().map(|p| [p.x / 3.0, 0.1, 2.0, 0.5]).collect();
        fractions.set_colours(Colours { values, depth: ColourDepth::Float }).unwrap();
        let bytes = encode_with_attributes(format, &mesh, &fractions).unwrap().0;
        assert_eq!(decode_with_attributes(format, &bytes).unwrap().attributes, fractions, "{format:?}");
    }
    let (bytes, left_out) = encode_with_attributes(Format::Gmsh, &mesh, &all).unwrap();
    assert_eq!(left_out, ["normals", "texture coordinates", "colours"]);
    assert_eq!(decode_with_attributes(Format::Gmsh, &bytes).unwrap().attributes.scalars(), all.scalars());
}

/// Far from the origin single precision is too coarse for short edges.
#[test]
fn rounding_is_told() {
    let near = Shape::Torus.build(500);
    let moved = near.positions().iter().map(|&p| p + DVec3::new(1e5, -3e5, 0.3)).collect();
    let far = TriMesh::new(moved, near.facets().to_vec()).unwrap();
    for format in Format::ALL {
        let left_out = |mesh: &TriMesh| encode_with_attributes(format, mesh, &Attributes::new(mesh)).unwrap().1;
        assert!(left_out(&near).is_empty(), "{format:?}");
        let is_told = left_out(&far).iter().any(|what| what.contains("precision"));
        assert_eq!(is_told, format == Format::Stl, "{format:?}");
        if ["glb", "gltf"].contains(&format.extension()) {
            // The node has the place.
            let back = decode(format, &encode(format, &far).unwrap()).unwrap();
            let moved = back.positions().iter().zip(far.positions()).map(|(p, q)| p.distance(*q));
            assert!(moved.fold(0.0, f64::max) < 1e-7, "{format:?}");
        }
    }
}

#[test]
fn vtk_dialects() {
    let text = "# vtk DataFile Version 2.0\r\na title\r\nASCII\r\ndataset unstructured_grid\nFIELD FieldData 2\nnames 1 2 string\n\
                one\ntwo words\nTIME 1 1 double\n0.5\nPOINTS 7 float\n0 0 0 1 0 0 0 1 0 1 1 0 2 0 0 2 1 0 5 5 5\n\
                METADATA\nINFORMATION 0\n\nCELLS 4 17\n4 0 1 2 3\n6 1 4 3 4 4 3\n1 6\n2 0 1\n\
                CELL_TYPES 4\n8 22 1 3\nCELL_DATA 4\nSCALARS part int\nLOOKUP_TABLE default\n1 2 3 4\nPOINT_DATA 7\n\
                SCALARS height double 1\nLOOKUP_TABLE mine\n0 1 2 3 4 nan(ind) 6\nLOOKUP_TABLE mine 2\n0 0 0 1 1 1 1 1\n\
                VECTORS speed float\n0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0\nCOLOR_SCALARS c 3\n\
                1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 0 0.5 0\nSCALARS bits bit\nLOOKUP_TABLE default\n1 0 1 0 1 0 1\n";
    let loaded = decode_with_attributes(Format::Vtk, text.as_bytes()).unwrap();
    assert_eq!((loaded.mesh.positions().len(), loaded.mesh.facets().len(), loaded.mesh.area()), (7, 3, 1.5));
    // The array of cells, a point and a line; a scalar may have gaps.
    assert_eq!(loaded.left_aside.len(), 2, "{:?}", loaded.left_aside);
    assert!(loaded.attributes.scalars().iter().any(|scalar| (scalar.name.as_str(), scalar.components) == ("speed", 3)));
    assert!(loaded.attributes.scalars().iter().find(|scalar| scalar.name == "height").unwrap().values[5].is_nan());
    let wrong = text.replace("nan(ind)", "north");
    assert_eq!(decode_with_attributes(Format::Vtk, wrong.as_bytes()).unwrap().left_aside.len(), 3);
    let colours = loaded.attributes.colours().unwrap();
    assert_eq!((colours.values[6], colours.depth), ([0.0, 0.5, 0.0, 1.0], ColourDepth::Float));
    let shorter = text.replace("POINT_DATA 7", "POINT_DATA 4000000000");
    assert!(matches!(decode(Format::Vtk, shorter.as_bytes()), Err(DataError::Truncated(_))));
    for other in ["STRUCTURED_POINTS", "RECTILINEAR_GRID"] {
        let error = decode(Format::Vtk, text.replace("unstructured_grid", other).as_bytes()).unwrap_err();
        assert!(matches!(error, DataError::Syntax { line: 4, .. }), "{error:?}");
    }
}

#[test]
fn vtp_pieces_are_one_surface() {
    let piece = |x: f64, rest: &str| {
        format!(
            "<Piece NumberOfPoints=\"3\" NumberOfPolys=\"1\"><PointData Scalars=\"h\"><DataArray type=\"Float32\" Name=\"h\" \
             format=\"ascii\">{x} 1 2</DataArray>{rest}</PointData>\n<!-- a comment --><Points><DataArray type=\"Float64\" \
             NumberOfComponents=\"3\" format=\"ascii\">{x} 0 0 1 0 0 0 1 0<InformationKey name=\"a\"><Value>7</Value>\
             </InformationKey></DataArray></Points><Polys><DataArray type=\"Int32\" Name=\"connectivity\">0 1 2</DataArray>\
             <DataArray type=\"UInt8\" Name=\"offsets\">3</DataArray></Polys></Piece>"
        )
    };
    let other = "<DataArray type=\"Int8\" Name=\"only\" format=\"ascii\">1 2 3</DataArray>";
    let file = |pieces: &str| {
        format!("<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\"><PolyData>{pieces}</PolyData></VTKFile>\n")
    };
    let text = file(&(piece(0.0, other) + &piece(-1.0, "")));
    let loaded = decode_with_attributes(Format::Vtp, text.as_bytes()).unwrap();
    assert_eq!((loaded.mesh.positions().len(), loaded.mesh.facets().len(), loaded.mesh.area()), (6, 2, 1.5));
    assert_eq!(loaded.attributes.scalars()[0].values, [0.0, 1.0, 2.0, -1.0, 1.0, 2.0]);
    assert_eq!(loaded.left_aside.len(), 1, "{:?}", loaded.left_aside);
    let far = text.replace("0 1 2</DataArray>", "0 1 3</DataArray>");
    assert!(matches!(decode(Format::Vtp, far.as_bytes()), Err(DataError::Element { element: "cell", .. })));
    let grid = text.replace("PolyData\"", "UnstructuredGrid\"");
    assert!(matches!(decode(Format::Vtp, grid.as_bytes()), Err(DataError::Header(_))));
    // Many arrays that name the same appended bytes: nothing is made of more than there are.
    let array = "<DataArray type=\"Float64\" Name=\"x\" format=\"appended\" offset=\"0\"/>";
    let many = text.replace("<PointData Scalars=\"h\">", &format!("<PointData>{}", array.repeat(1000)));
    let many = many.replace(
        "</VTKFile>",
        &format!("<AppendedData encoding=\"raw\">_{}</AppendedData></VTKFile>", "x".repeat(9000)),
    );
    assert!(decode_with_attributes(Format::Vtp, many.as_bytes()).unwrap().left_aside.len() >= 1000);
}

/// Seams and opacity too; numbers to single precision, colours of eight bits exactly.
#[test]
fn gltf_carries_corners() {
    let (mesh, all) = everything();
    for format in [Format::Glb, Format::Gltf] {
        let (bytes, left_out) = encode_with_attributes(format, &mesh, &all).unwrap();
        assert!(left_out.iter().all(|what| what.starts_with("scalar")), "{left_out:?}");
        let loaded = decode_with_attributes(format, &bytes).unwrap();
        assert!(loaded.left_aside.is_empty(), "{:?}", loaded.left_aside);
        assert_eq!(loaded.mesh.positions().len(), mesh.positions().len());
        let before = readers::on_corners(&mesh, &all);
        let after = readers::on_corners(&loaded.mesh, &loaded.attributes);
        for (before, after) in before.iter().zip(&after) {
            assert_eq!(before.len(), after.len());
            let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-6 * (1.0 + a.abs()));
            assert!(before.iter().zip(after).all(|(a, b)| near(a, b)), "{format:?}");
        }
        assert_eq!(before[2], after[2]);
    }
}

fn gltf(scene: &str, more: &str) -> String {
    // Four vertices of a unit square, and the numbers 0 1 2 3 as bytes.
    let data = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAACAPwAAgD8AAAAAAAECAw==";
    format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},{scene},\"accessors\":[{{\"bufferView\":0,\"componentType\":5126,\"count\":4,\
         \"type\":\"VEC3\"}},{{\"bufferView\":1,\"componentType\":5121,\"count\":4,\"type\":\"SCALAR\"}}],\"bufferViews\":[\
         {{\"buffer\":0,\"byteLength\":48}},{{\"buffer\":0,\"byteOffset\":48,\"byteLength\":4}}],\"buffers\":[{{\
         \"byteLength\":52,\"uri\":\"data:application/octet-stream;base64,{data}\"}}]{more}}}"
    )
}

#[test]
fn nodes_of_a_scene_are_placed() {
    let strip = "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,\"mode\":5}]}]";
    let scene = format!(
        "\"scene\":0,\"scenes\":[{{\"nodes\":[0]}}],\"nodes\":[{{\"scale\":[2,2,2],\"children\":[1,2]}},{{\"mesh\":0,\
         \"translation\":[1,0,0]}},{{\"mesh\":0,\"matrix\":[-1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}},{{\"mesh\":0}}],{strip}"
    );
    let mesh = decode(Format::Gltf, gltf(&scene, "").as_bytes()).unwrap();
    assert_eq!((mesh.positions().len(), mesh.facets().len(), mesh.area()), (8, 4, 8.0));
    assert_eq!(mesh.bounds(), (DVec3::new(-2.0, 0.0, 0.0), DVec3::new(4.0, 2.0, 0.0)));
    let up = |f: usize| {
        let [a, b, c] = mesh.corners(f);
        (b - a).cross(c - a).z > 0.0
    };
    assert!((0..4).all(up), "a mirrored node turns its facets");
    let circle = scene.replace("\"translation\":[1,0,0]", "\"children\":[0]");
    assert!(matches!(
        decode(Format::Gltf, gltf(&circle, "").as_bytes()),
        Err(DataError::Element { element: "node", .. })
    ));
    // A mesh named more often than a file of this size may.
    let text = String::from_utf8(encode(Format::Gltf, &Shape::Torus.build(2000)).unwrap()).unwrap();
    let nodes = vec!["{\"mesh\":0}"; 2000].join(",");
    let many = text.replace("{\"mesh\":0}", &nodes).replace("\"scene\":0,\"scenes\":[{\"nodes\":[0]}],", "");
    let error = decode(Format::Gltf, many.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("repeat"), "{error}");
    let packed = gltf(&scene, ",\"extensionsRequired\":[\"KHR_draco_mesh_compression\"]");
    let error = decode(Format::Gltf, packed.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("KHR_draco_mesh_compression"), "{error}");
}

#[test]
fn volumes_are_left_aside_or_refused() {
    let msh = |elements: &str| {
        let count = elements.lines().count();
        format!(
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 1 \"all\"\n$EndPhysicalNames\n$Nodes\n4\n\
             11 0 0 0\n7 1 0 0\n9 0 1 0\n1000 0 0 1\n$EndNodes\n$Elements\n{count}\n{elements}$EndElements\n"
        )
    };
    let tetrahedron = "1 4 2 1 1 11 7 9 1000\n";
    let error = decode(Format::Gmsh, msh(tetrahedron).as_bytes()).unwrap_err().to_string();
    assert!(error.contains("fill space"), "{error}");
    let both = msh(&format!("{tetrahedron}2 2 2 1 1 11 7 9\n3 1 2 1 1 7 9\n"));
    let loaded = decode_with_attributes(Format::Gmsh, both.as_bytes()).unwrap();
    // The tetrahedron and a line.
    assert_eq!((loaded.mesh.area(), loaded.left_aside.len()), (0.5, 2));
    let unknown = msh("2 2 2 1 1 11 7 8\n");
    assert!(matches!(
        decode(Format::Gmsh, unknown.as_bytes()),
        Err(DataError::Element { element: "element", index: 0, .. })
    ));
}

#[test]
fn packed_files() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = Shape::Torus.build(400);
    for format in Format::ALL {
        let path = folder.path().join(format!("a.{}.gz", format.extension()));
        write(&path, &mesh).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(bytes.starts_with(&[0x1f, 0x8b]));
        let whole = encode(format, &mesh).unwrap();
        assert_eq!(*unpack(&bytes, whole.len()).unwrap(), *whole);
        assert_eq!(unpack(&bytes, whole.len() - 1), Err(DataError::TooLong { limit: whole.len() - 1 }));
        assert_eq!(read(&path).unwrap(), decode(format, &whole).unwrap(), "{format:?}");
        assert!(matches!(decode(format, &bytes[..bytes.len() - 9]), Err(DataError::Truncated(_))), "{format:?}");
    }
    // What packs to a thousandth.
    let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    for _ in 0..64 {
        packer.write_all(&[b'\n'; 1 << 20]).unwrap();
    }
    let bomb = packer.finish().unwrap();
    assert!(bomb.len() * UNPACKED_RATIO + (1 << 20) < 64 << 20);
    assert!(matches!(decode(Format::Obj, &bomb), Err(DataError::TooLong { .. })));
}

/// Counts that no file of this size can hold.
#[test]
fn absurd_counts_of_other_formats() {
    for count in ["4000000000", "9223372036854775807", "18446744073709551615"] {
        let files = [
            (
                Format::Vtk,
                format!("# vtk DataFile Version 3.0\n\nBINARY\nDATASET POLYDATA\nPOINTS {count} float\n0000"),
            ),
            (
                Format::Vtk,
                format!(
                    "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nPOLYGONS {count} {count}\n3 0 0 0\n"
                ),
            ),
            (
                Format::Vtk,
                format!(
                    "# vtk DataFile Version 5.1\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nPOLYGONS {count} {count}\nOFFSETS vtktypeint64\n0 3\nCONNECTIVITY vtktypeint64\n0 0 0\n"
                ),
            ),
            (
                Format::Vtp,
                format!(
                    "<VTKFile type=\"PolyData\"><Piece NumberOfPoints=\"{count}\" NumberOfPolys=\"{count}\"><Points><DataArray type=\"Float64\" format=\"binary\">AAAA</DataArray></Points></Piece></VTKFile>"
                ),
            ),
            (Format::Gmsh, format!("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{count}\n1 0 0 0\n$EndNodes\n")),
            (
                Format::Gmsh,
                format!(
                    "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n{count} {count} 1 1\n2 1 0 {count}\n1\n0 0 0\n$EndNodes\n"
                ),
            ),
            (
                Format::Gmsh,
                format!("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Elements\n{count}\n1 2 {count} 1 1 1\n$EndElements\n"),
            ),
            (Format::Medit, format!("MeshVersionFormatted 2\nDimension 3\nVertices {count}\n0 0 0 0\n")),
            (Format::Medit, format!("MeshVersionFormatted 2\nDimension 3\nTriangles {count}\n1 1 1 0\n")),
        ];
        for (format, text) in files {
            assert!(decode(format, text.as_bytes()).is_err(), "{text}");
        }
    }
}

/// Changed files of formats that `fuzz_short` takes too, where that does not run.
#[test]
fn changed_files() {
    let mesh = Shape::Torus.build(24);
    let all = plain(&mesh);
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let corpus = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus");
    for format in Format::ALL.into_iter().skip(4) {
        let mut originals =
            vec![encode(format, &mesh).unwrap(), encode_with_attributes(format, &mesh, &all).unwrap().0];
        for file in std::fs::read_dir(corpus.join(format.extension())).unwrap() {
            originals.push(std::fs::read(file.unwrap().path()).unwrap());
            readers::check(format, &originals[originals.len() - 1]).unwrap();
            assert!(decode(format, &originals[originals.len() - 1]).is_ok());
        }
        originals.sort();
        for original in originals {
            for _ in 0..CHANGES {
                let mut bytes = original.clone();
                for _ in 0..rng.random_range(1..4) {
                    let at = rng.random_range(0..bytes.len());
                    let end = (at + rng.random_range(1..40)).min(bytes.len());
                    match rng.random_range(0..5) {
                        0 => bytes[at] = rng.random(),
                        1 => bytes[at] = b"0123456789 \n-./e#\"{}<>=$"[rng.random_range(0..24)],
                        2 => drop(bytes.drain(at..end)),
                        3 => bytes.extend_from_within(at..end),
                        _ => bytes.truncate(at.max(1)),
                    }
                    if bytes.is_empty() {
                        break;
                    }
                }
                let text = |text: String| format!("{text}\n{}", String::from_utf8_lossy(&bytes));
                readers::check(format, &bytes).map_err(text).unwrap_or_else(|text| panic!("{text}"));
            }
        }
    }
}

/// See `tests/python/formats.py`.
#[test]
#[ignore = "needs the folder TESSERA_FORMATS, which tests/python/formats.py writes"]
fn files_of_other_libraries() {
    let folder = PathBuf::from(std::env::var_os("TESSERA_FORMATS").expect("TESSERA_FORMATS names a folder"));
    let mut wrong = Vec::new();
    let list = std::fs::read_to_string(folder.join("list.txt")).unwrap();
    assert!(list.lines().count() >= 30, "{list}");
    for line in list.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        let (vertices, facets): (usize, usize) = (words[1].parse().unwrap(), words[2].parse().unwrap());
        let area: f64 = words[3].parse().unwrap();
        match read_with_attributes(&folder.join(words[0])) {
            Ok(loaded) => {
                let (mesh, all) = (&loaded.mesh, &loaded.attributes);
                let right = (mesh.positions().len(), mesh.facets().len()) == (vertices, facets)
                    && (mesh.area() / area - 1.0).abs() < 1e-6;
                if !right {
                    let found = (mesh.positions().len(), mesh.facets().len(), mesh.area());
                    wrong.push(format!("{line}: {found:?} is read"));
                }
                let scalars = all.scalars();
                let height = scalars.iter().find(|scalar| scalar.name == "height");
                let right =
                    height.is_none_or(|s| s.values.iter().zip(mesh.positions()).all(|(h, p)| (h - p.z).abs() < 1e-6));
                let has = [
                    ("normals", all.normals().is_some()),
                    ("texture", all.texture().is_some()),
                    ("colours", all.colours().is_some()),
                    ("scalars", height.is_some()),
                ];
                let has: Vec<&str> = has.iter().filter(|(_, has)| *has).map(|(name, _)| *name).collect();
                // An array of cells is left aside, and so are points and lines. Strips have none.
                let has_cells = words[4].contains("normals,texture,colours") && !words[0].starts_with("strips");
                let aside = usize::from(has_cells || words[0].starts_with("mixed-"));
                if !right || has.join(",") != words[4].trim_matches('-') || loaded.left_aside.len() != aside {
                    wrong.push(format!("{line}: {has:?}, {right}, {:?}", loaded.left_aside));
                }
            }
            Err(error) => wrong.push(format!("{line}: {error}")),
        }
    }
    let ours = folder.join("ours");
    std::fs::create_dir_all(&ours).unwrap();
    let mesh = Shape::Torus.build(300);
    for format in Format::ALL {
        write_with_attributes(&ours.join("a").with_extension(format.extension()), &mesh, &plain(&mesh)).unwrap();
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
