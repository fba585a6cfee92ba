//! Promise: a file of any content is read as the surface it holds or refused by naming what is wrong; nothing is
//! reserved for counts that only a header declares.

use std::fmt::Write as _;
use std::time::Instant;

use crate::readers;
use rand::{Rng, SeedableRng};
use tessera::mesh::attributes::{Attributes, ColourDepth, Colours, Normals, PerCorner, Scalar};
use tessera::mesh::io::{
    DataError, FileError, Format, counts, decode, decode_with_attributes, encode, encode_with_attributes, read,
};
use tessera::mesh::shapes::Shape;
use tessera::mesh::{MeshError, TriMesh};

fn obj(text: &str) -> Result<TriMesh, DataError> {
    decode(Format::Obj, text.as_bytes())
}

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

/// The bytes of `format` for the unit square.
fn square(format: Format) -> Vec<u8> {
    encode(format, &Shape::Square.build(2)).unwrap()
}

#[test]
fn obj_groups_empty_and_huge() {
    let mut text = String::from("o nothing\ng\ng a b c\ns off\nusemtl none\n");
    for k in 0..3000 {
        // A group for each facet, with an empty one after it.
        let _ = write!(text, "o part{k}\ng g{k}\ns {k}\nusemtl m{k}\n");
        let _ = write!(text, "v {k} 0 0\nv {k} 1 0\nv {k} 0 1\nf -3 -2 -1\ng empty{k}\n");
    }
    let mesh = obj(&text).unwrap();
    assert_eq!((mesh.facets().len(), mesh.positions().len()), (3000, 9000));
    // Vertices shared across groups stay shared.
    let shared = obj("g a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\ng b\nf 2 4 3\ng c\ng d\n").unwrap();
    assert_eq!((shared.facets().len(), shared.positions().len()), (2, 4));
    // Faces before their vertices, and vertices that no face uses.
    assert_eq!(obj("f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 9 9 9\n").unwrap().area(), 0.5);
    assert_eq!(obj("g only\no groups\n"), Err(DataError::Mesh(MeshError::NoFacets)));
    let name = "n".repeat(1 << 20);
    assert_eq!(obj(&format!("o {name}\n{TRIANGLE}g {name}\n")).unwrap().facets().len(), 1);
}

#[test]
fn obj_polygons_indices_and_line_ends() {
    for ends in ["\n", "\r\n", "\n\n", " \t\r\n"] {
        let text = TRIANGLE.replace('\n', ends);
        assert_eq!(obj(&text).unwrap().area(), 0.5, "{ends:?}");
        assert_eq!(obj(text.trim_end()).unwrap().area(), 0.5, "{ends:?}, no line end at the end");
    }
    // A polygon with a thousand corners, named from the end.
    let count = 1000;
    let mut text = String::new();
    for k in 0..count {
        let (sin, cos) = (f64::from(k) / f64::from(count) * std::f64::consts::TAU).sin_cos();
        let _ = writeln!(text, "v {cos} {sin} 0");
    }
    text.push('f');
    for k in 0..count {
        let _ = write!(text, " {}", k - count);
    }
    let disc = obj(&text).unwrap();
    assert_eq!(disc.facets().len(), 998);
    assert!((disc.area() / std::f64::consts::PI - 1.0).abs() < 1e-4);
    for bad in
        ["f 1 2", "f 1 2 0", "f 1 2 4", "f 1 2 -4", "f 1 2 99999999999999999999", "f 1 2 3.0", "f 1 2 //3", "f a b c"]
    {
        let error = obj(&TRIANGLE.replace("f 1 2 3", bad)).unwrap_err();
        assert!(matches!(error, DataError::Syntax { line: 4, .. }), "{bad}: {error:?}");
    }
}

#[test]
fn numbers_that_are_none() {
    let nothing = ["nan", "NaN", "-nan", "inf", "-Inf", "infinity", "1e999"];
    let text_of = |format: Format, number: &str| match format {
        Format::Obj => format!("v 0 0 0\nv 1 {number} 0\nv 0 1 0\nf 1 2 3\n"),
        Format::Off => format!("OFF\n3 1 0\n0 0 0\n1 {number} 0\n0 1 0\n3 0 1 2\n"),
        Format::Ply => format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 {number} 0\n0 1 0\n3 0 1 2\n"
        ),
        Format::Stl => format!(
            "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 {number} 0\nvertex 0 1 0\nendloop\n\
             endfacet\nendsolid a\n"
        ),
        Format::Vtk => format!(
            "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET POLYDATA\nPOINTS 3 double\n0 0 0\n1 {number} 0\n0 1 0\n\
             POLYGONS 1 4\n3 0 1 2\n"
        ),
        Format::Vtp => format!(
            "<VTKFile type=\"PolyData\">\n<PolyData>\n<Piece NumberOfPoints=\"3\" NumberOfPolys=\"1\">\n<Points>\n\
             <DataArray type=\"Float64\" NumberOfComponents=\"3\">\n0 0 0\n1 {number} 0\n0 1 0\n</DataArray></Points>\n\
             <Polys><DataArray type=\"Int32\" Name=\"connectivity\">0 1 2</DataArray><DataArray type=\"Int32\" \
             Name=\"offsets\">3</DataArray></Polys></Piece></PolyData></VTKFile>\n"
        ),
        Format::Vtu => format!(
            "<VTKFile type=\"UnstructuredGrid\">\n<UnstructuredGrid>\n<Piece NumberOfPoints=\"3\" NumberOfCells=\"1\">\n\
             <Points>\n<DataArray type=\"Float64\" NumberOfComponents=\"3\">\n0 0 0\n1 {number} 0\n0 1 0\n</DataArray>\
             </Points>\n<Cells><DataArray type=\"Int32\" Name=\"connectivity\">0 1 2</DataArray><DataArray type=\"Int32\" \
             Name=\"offsets\">3</DataArray><DataArray type=\"UInt8\" Name=\"types\">5</DataArray></Cells></Piece>\
             </UnstructuredGrid></VTKFile>\n"
        ),
        Format::Gmsh => format!(
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n1 0 0 0\n2 1 {number} 0\n3 0 1 0\n$EndNodes\n$Elements\n\
             1\n1 2 2 0 0 1 2 3\n$EndElements\n"
        ),
        Format::Medit => format!(
            "MeshVersionFormatted 2\nDimension 3\nVertices\n3\n0 0 0 0\n1 {number} 0 0\n0 1 0 0\nTriangles\n1\n1 2 3 0\n\
             End\n"
        ),
        other => panic!("{other:?} is no text"),
    };
    for format in Format::ALL {
        if matches!(format, Format::MeditBinary | Format::Glb | Format::Gltf | Format::ThreeMf) {
            continue;
        }
        assert!(decode(format, text_of(format, "0").as_bytes()).is_ok(), "{format:?}");
        for number in nothing {
            let error = decode(format, text_of(format, number).as_bytes()).unwrap_err();
            let named = match &error {
                DataError::Mesh(MeshError::NonFinitePosition { vertex, .. }) => *vertex == 1,
                DataError::Syntax { line, .. } => *line > 1,
                DataError::Element { index, .. } => *index == 0,
                _ => false,
            };
            assert!(named, "{format:?}, {number}: {error:?}");
        }
        for number in ["1,5", "0x10", "--1", "1e", "1e+", "one"] {
            let error = decode(format, text_of(format, number).as_bytes()).unwrap_err();
            let named = matches!(error, DataError::Syntax { .. } | DataError::Element { .. });
            assert!(named, "{format:?}, {number}: {error:?}");
        }
        // Subnormal and longer than any double.
        for number in ["1e-320", "0.00000000000000000000000000000000000000000000000000001", "+0", "-0.0"] {
            assert!(decode(format, text_of(format, number).as_bytes()).is_ok(), "{format:?}, {number}");
        }
    }
}

#[test]
fn cut_off_at_every_byte() {
    for format in Format::ALL {
        let whole = square(format);
        for end in 0..whole.len() {
            match decode(format, &whole[..end]) {
                // Text may end after a shorter number.
                Ok(mesh) => {
                    let is_text = matches!(format, Format::Obj | Format::Off | Format::Medit);
                    assert!(is_text, "{format:?} {end}: {mesh:?}");
                }
                Err(DataError::Empty) => assert_eq!(end, 0),
                Err(_) => {}
            }
        }
    }
}

/// With attributes too: the same surface or the same error as without, wherever the file ends.
#[test]
fn cut_off_with_attributes() {
    let mesh = Shape::Square.build(2);
    let mut attributes = Attributes::new(&mesh);
    let values = vec![glam::dvec2(0.25, 1.0), glam::dvec2(1e-3, 0.5)];
    attributes.set_texture(PerCorner { values, corners: vec![[0, 1, 1], [1, 0, 0]] }).unwrap();
    attributes.set_normals(Normals::PerVertex(vec![glam::DVec3::Z; 4])).unwrap();
    attributes.set_colours(Colours { values: vec![[0.2, 0.4, 0.6, 1.0]; 4], depth: ColourDepth::Eight }).unwrap();
    attributes.add_scalar(Scalar::new("density", vec![0.1; 4])).unwrap();
    for format in Format::ALL {
        let whole = encode_with_attributes(format, &mesh, &attributes).unwrap().0;
        for end in 0..=whole.len() {
            readers::check(format, &whole[..end]).unwrap_or_else(|text| panic!("{end}: {text}"));
        }
    }
}

/// Counts that no file of this size can hold: an error, at once, and no memory. The process would die of an attempt to
/// reserve them, so that the test need not measure.
#[test]
fn absurd_counts() {
    let begin = Instant::now();
    let counts = ["4", "4000000000", "4294967296", "9223372036854775807", "18446744073709551615"];
    for count in counts {
        let ply = |encoding: &str, vertices: &str, faces: &str, other: &str| {
            format!(
                "ply\nformat {encoding} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
                 property float z\n{other}element face {faces}\nproperty list uint int vertex_indices\nend_header\n"
            )
        };
        for encoding in ["ascii", "binary_little_endian", "binary_big_endian"] {
            let other = format!("element other {count}\nproperty list uint double a\n");
            for header in
                [ply(encoding, count, "1", ""), ply(encoding, "3", count, ""), ply(encoding, "1", "1", &other)]
            {
                let mut bytes = header.into_bytes();
                bytes.extend_from_slice(b"0 0 0 1 ");
                assert!(decode(Format::Ply, &bytes).is_err());
            }
        }
        // A list as long as its four bytes can say.
        let mut bytes = ply("binary_little_endian", "3", "1", "").into_bytes();
        bytes.extend_from_slice(&[0; 36]);
        bytes.extend_from_slice(&[0xff; 8]);
        let list = decode(Format::Ply, &bytes).unwrap_err();
        assert!(matches!(list, DataError::Truncated(_)), "{list:?}");
        for text in [
            format!("OFF\n{count} 1 0\n0 0 0\n"),
            format!("OFF\n3 {count} 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
            format!("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n{count} 0 1 2\n"),
        ] {
            let error = decode(Format::Off, text.as_bytes()).unwrap_err();
            assert!(matches!(error, DataError::Truncated(_) | DataError::Syntax { .. }), "{error:?}");
        }
    }
    for count in [3u32, 1 << 24, u32::MAX] {
        let mut bytes = square(Format::Stl);
        bytes[80..84].copy_from_slice(&count.to_le_bytes());
        let error = decode(Format::Stl, &bytes).unwrap_err();
        assert!(matches!(error, DataError::Truncated(_)), "{error:?}");
    }
    assert!(begin.elapsed().as_secs() < 60);
}

#[test]
fn empty_files_garbage_and_the_wrong_extension() {
    let folder = tempfile::tempdir().unwrap();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let mut noise = vec![0; 5000];
    rng.fill_bytes(&mut noise);
    for format in Format::ALL {
        let write = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name).with_extension(format.extension());
            std::fs::write(&path, bytes).unwrap();
            read(&path)
        };
        for blank in [&b""[..], b"\n", b" \r\n\t "] {
            let error = write("empty", blank).unwrap_err();
            assert!(matches!(&error, FileError::Data { cause: DataError::Empty, .. }), "{error}");
            assert!(error.to_string().contains("empty"), "{error}");
        }
        for (name, bytes) in [("noise", &noise[..]), ("zeros", &[0; 5000]), ("ones", &[0xff; 5000]), ("one", b"x")] {
            let error = write(name, bytes).unwrap_err();
            assert!(matches!(error, FileError::Data { .. }), "{format:?}, {name}: {error}");
            assert!(error.to_string().len() < 600, "{format:?}, {name}: {error}");
        }
        for other in Format::ALL.into_iter().filter(|&other| other != format) {
            let error = write("other", &square(other)).unwrap_err();
            assert!(matches!(error, FileError::Data { .. }), "{other:?} as {format:?}: {error}");
        }
        assert!(write("square", &square(format)).is_ok());
    }
    let unreadable = read(&folder.path().join("folder.obj/none.obj")).unwrap_err();
    assert!(matches!(unreadable, FileError::Io { .. }));
    std::fs::create_dir(folder.path().join("folder.ply")).unwrap();
    assert!(matches!(read(&folder.path().join("folder.ply")), Err(FileError::Io { .. })));
}

/// Vertices that no facet uses, twice the same vertex, facets without area: kept or left out, never an error.
#[test]
fn dirty_but_right() {
    for format in [Format::Obj, Format::Off, Format::Ply] {
        let dirty = TriMesh::new(
            [[0., 0., 0.], [9., 9., 9.], [1., 0., 0.], [0., 1., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1., 0.]]
                .map(glam::DVec3::from_array)
                .to_vec(),
            vec![[0, 2, 3], [4, 6, 5], [2, 4, 2], [0, 0, 0]],
        )
        .unwrap();
        let bytes = encode(format, &dirty).unwrap();
        readers::check(format, &bytes).unwrap();
        let again = decode(format, &bytes).unwrap();
        assert_eq!((again.area(), again.facets().len(), again.degenerate_count()), (1.0, 4, 2));
    }
}

/// Text that begins with a byte order mark, as some editors save it, is what it is without.
#[test]
fn a_byte_order_mark_hides_nothing() {
    for format in [Format::Obj, Format::Off] {
        let first = TriMesh::new(
            [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]].map(glam::DVec3::from_array).to_vec(),
            vec![[0, 1, 2]],
        );
        let mut bytes = encode(format, &first.unwrap()).unwrap();
        let without = decode(format, &bytes).unwrap();
        bytes.splice(0..0, *b"\xef\xbb\xbf");
        assert_eq!(decode(format, &bytes).unwrap(), without);
        assert_eq!(decode_with_attributes(format, &bytes).unwrap().mesh, without);
    }
    // With a vertex to spare no index is out of range if the first one is lost.
    let spare = obj("\u{feff}v 0 0 0\nv 1 0 0\nv 0 1 0\nv 9 9 9\nf 1 2 3\n").unwrap();
    assert_eq!(spare.area(), 0.5);
    assert_eq!(decode(Format::Ply, b"\xef\xbb\xbf"), Err(DataError::Empty));
}

/// Normals of ascii STL are left aside, whatever they are.
#[test]
fn stl_normals_that_are_no_numbers() {
    for normal in ["facet normal nan nan nan", "facet normal -nan(ind) 0 0", "facet", "FACET normal 1e999 0 0"] {
        let text = format!(
            "solid s\n{normal}\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n"
        );
        assert_eq!(decode(Format::Stl, text.as_bytes()).unwrap().area(), 0.5, "{normal}");
    }
}

/// What single precision would make one point of is not written as if it were a surface.
#[test]
fn stl_holds_no_facets_that_vanish() {
    let mesh = |low: f64, size: f64| {
        let corner = |x: f64, y: f64| glam::DVec3::new(low + size * x, low + size * y, 0.0);
        TriMesh::new(vec![corner(0.0, 0.0), corner(1.0, 0.0), corner(0.0, 1.0)], vec![[0, 1, 2]]).unwrap()
    };
    for (low, size) in [(1e9, 1.0), (0.0, 1e-46)] {
        assert_eq!(encode(Format::Stl, &mesh(low, size)), Err(DataError::Collapsed { facet: 0 }), "{low} {size}");
        assert_eq!(decode(Format::Ply, &encode(Format::Ply, &mesh(low, size)).unwrap()).unwrap(), mesh(low, size));
    }
    assert!(encode(Format::Stl, &mesh(1e6, 1.0)).is_ok());
    // A sliver that becomes a line is no loss.
    let corners = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1e-12, 0.]].map(glam::DVec3::from_array).to_vec();
    let sliver = TriMesh::new(corners, vec![[0, 3, 2], [0, 1, 3]]).unwrap();
    assert!(encode(Format::Stl, &sliver).is_ok());
}

/// What names much with few bytes takes neither time nor memory: each of these would be minutes, or more memory than there is.
#[test]
fn much_that_is_named_by_little() {
    let begin = Instant::now();
    let refused = |format: Format, bytes: &[u8], words: &str| {
        let error = decode(format, bytes).unwrap_err().to_string();
        assert!(error.contains(words), "{format:?}: {error}");
        assert_eq!(counts(format, bytes), None, "{format:?}");
    };
    // Nodes that each name a mesh of many primitives, of points.
    let nodes = vec!["{\"mesh\":0}"; 20_000].join(",");
    let primitives = vec!["{\"mode\":0,\"extras\":0}"; 20_000].join(",");
    let text = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"nodes\":[{nodes}],\"meshes\":[{{\"primitives\":[{primitives}]}}]}}"
    );
    refused(Format::Gltf, text.as_bytes(), "repeat");
    refused(Format::Gltf, "[".repeat(1_000_000).as_bytes(), "");
    // Keywords that each begin within the vertices of the one before.
    let mut bytes = [1u32, 2, 3, 24, 3].map(u32::to_le_bytes).concat();
    bytes.extend_from_slice(&[0; 4]);
    let keywords = 20_000;
    for k in 0..keywords {
        let (here, all) = (24 + 12 * k, 24 + 12 * keywords);
        let count = (all - here) / 28;
        [4, here + 12, count].iter().for_each(|n: &u32| bytes.extend_from_slice(&n.to_le_bytes()));
    }
    refused(Format::MeditBinary, &bytes, "leads back");
    // Nodes again and again.
    let nodes: String = (1..=50_000).map(|tag| format!("{} 0 0 0\n", 2 * tag)).collect();
    let again = "$Nodes\n0\n$EndNodes\n".repeat(50_000);
    let text = format!("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n50000\n{nodes}$EndNodes\n{again}");
    refused(Format::Gmsh, text.as_bytes(), "twice");
    // Very many arrays, each of its own name, in several pieces.
    let array = |k: usize| format!("<DataArray type=\"Int8\" Name=\"{k}\">0 0 0</DataArray>");
    let piece = |arrays: String| {
        format!(
            "<Piece NumberOfPoints=\"3\" NumberOfPolys=\"1\"><PointData>{arrays}</PointData><Points><DataArray \
             type=\"Int8\">0 0 0 1 0 0 0 1 0</DataArray></Points><Polys><DataArray type=\"Int8\" Name=\"connectivity\">\
             0 1 2</DataArray><DataArray type=\"Int8\" Name=\"offsets\">3</DataArray></Polys></Piece>"
        )
    };
    let count = 60_000;
    let one = piece((0..count).map(array).collect());
    let other = piece((count..2 * count).map(array).collect());
    for pieces in [one.clone(), one + &other] {
        let text = format!("<VTKFile type=\"PolyData\">{pieces}</VTKFile>");
        let loaded = decode_with_attributes(Format::Vtp, text.as_bytes()).unwrap();
        assert!(loaded.attributes.scalars().len() <= 4096 && !loaded.left_aside.is_empty());
    }
    assert!(begin.elapsed().as_secs() < 60, "{:?}", begin.elapsed());
}

/// What arrays of a file say that is packed in them is known before they are unpacked.
#[test]
fn packed_arrays_are_counted_by_what_they_say() {
    let header = [2u32, 1 << 20, 1 << 19, 9, 9].map(u32::to_le_bytes).concat();
    let data = base64(&header);
    let text = format!(
        "<VTKFile type=\"PolyData\" compressor=\"vtkZLibDataCompressor\"><Piece NumberOfPoints=\"131072\" NumberOfPolys=\"1\">\
         <Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"binary\">{data}</DataArray></Points><Polys>\
         <DataArray type=\"Int8\" Name=\"connectivity\">0 1 2</DataArray><DataArray type=\"Int8\" Name=\"offsets\">3\
         </DataArray></Polys></Piece></VTKFile>"
    );
    assert_eq!(counts(Format::Vtp, text.as_bytes()), None, "more than a file of this size may unpack to");
    let longer = text.replace("</Polys>", &format!("</Polys>{}", " ".repeat(40_000)));
    assert_eq!(counts(Format::Vtp, longer.as_bytes()), Some((131_072, 1)));
    assert!(decode(Format::Vtp, longer.as_bytes()).is_err());
}

/// Base64 of bytes that are a multiple of three, or not.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let group = |three: &[u8]| {
        let all = three.iter().chain(&[0, 0]).take(3).fold(0usize, |all, &byte| all << 8 | usize::from(byte));
        let digit = |k: usize| if k <= three.len() { DIGITS[all >> (18 - 6 * k) & 63] as char } else { '=' };
        [digit(0), digit(1), digit(2), digit(3)]
    };
    bytes.chunks(3).flat_map(group).collect()
}
