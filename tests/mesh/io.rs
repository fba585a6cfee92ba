//! Promise: every format reads back what was written, and no bytes break a reader.

use std::path::Path;

use crate::readers;
use glam::{DVec3, dvec2, dvec3};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Encoding};
use ply_rs_bw::writer::Writer;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::mesh::attributes::{Attributes, PerCorner, Scalar};
use tessera::mesh::io::{
    DataError, FileError, Format, decode, decode_with_attributes, encode, encode_with_attributes, read, write,
};
use tessera::mesh::shapes::Shape;
use tessera::mesh::{MeshError, TriMesh};

fn corners(mesh: &TriMesh) -> Vec<[DVec3; 3]> {
    (0..mesh.facets().len()).map(|f| mesh.corners(f)).collect()
}

fn tetrahedron() -> TriMesh {
    let far = 1e17 + 16.0;
    let points = vec![dvec3(0.1, -0.0, 1e-300), dvec3(far / 3.0, 0., 0.), dvec3(0., far, 0.), dvec3(0., 0., -far)];
    TriMesh::new(points, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]).unwrap()
}

fn text(format: Format, text: &str) -> Result<TriMesh, DataError> {
    decode(format, text.as_bytes())
}

#[test]
fn round_trips_keep_the_bits() {
    for mesh in [tetrahedron(), Shape::Torus.build(500), Shape::Hills.build(300)] {
        let exact = |format: &Format| *format != Format::Obj && !readers::is_single(*format);
        for format in Format::ALL.into_iter().filter(exact) {
            assert_eq!(decode(format, &encode(format, &mesh).unwrap()).unwrap(), mesh, "{format:?}");
        }
        let obj = decode(Format::Obj, &encode(Format::Obj, &mesh).unwrap()).unwrap();
        assert_eq!(corners(&obj), corners(&mesh));
        assert_eq!(obj.positions().len(), mesh.positions().len());
    }
    let mesh = Shape::Sphere.build(500);
    let single = |mesh: &TriMesh| -> Vec<[DVec3; 3]> {
        corners(mesh).iter().map(|t| t.map(|p| p.as_vec3().as_dvec3())).collect()
    };
    for format in Format::ALL.into_iter().filter(|&format| readers::is_single(format)) {
        let rounded = decode(format, &encode(format, &mesh).unwrap()).unwrap();
        assert_eq!(rounded.positions().len(), mesh.positions().len(), "{format:?}");
        assert_eq!(corners(&rounded), single(&mesh), "{format:?}");
    }
}

#[test]
fn files_and_their_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shape.PLY");
    let mesh = Shape::Block.build(600);
    write(&path, &mesh).unwrap();
    assert_eq!(read(&path).unwrap(), mesh);
    assert!(matches!(read(Path::new("a.xyz")), Err(FileError::UnknownFormat { extension, .. }) if extension == "xyz"));
    assert!(matches!(read(Path::new("noextension")), Err(FileError::UnknownFormat { .. })));
    let missing = read(&folder.path().join("none.obj")).unwrap_err();
    assert!(matches!(missing, FileError::Io { action: "read", .. }));
    assert!(matches!(write(&folder.path().join("no/such.obj"), &mesh), Err(FileError::Io { action: "write", .. })));
    let bad = folder.path().join("bad.off");
    std::fs::write(&bad, "OFF 1 1 0\nx y z\n3 0 0 0\n").unwrap();
    let error = read(&bad).unwrap_err();
    assert!(matches!(error, FileError::Data { .. }) && error.to_string().contains("bad.off: line 2"), "{error}");
}

#[test]
fn obj_dialects() {
    let mesh = text(
        Format::Obj,
        "# comment\r\nmtllib none.mtl\r\no one\r\nv 0 0 0 # here\r\nv 1 0 0 0.5 0.5 0.5\r\nv 1 1 0\r\nv 0 2 0 2\r\n\
         vt 0\r\nvn x\r\nusemtl\r\ng a\r\nf 1/9/9 2//7 3 \\\r\n 4\r\ng b\r\nl 1 2 3\r\np 1\r\nf -4 -2 -1\r\n",
    )
    .unwrap();
    assert_eq!(mesh.facets(), [[0, 1, 2], [0, 2, 3], [0, 2, 3]]);
    assert_eq!(mesh.positions()[3], dvec3(0., 1., 0.));
    let line = |source: &str| match text(Format::Obj, source) {
        Err(DataError::Syntax { line, .. }) => line,
        other => panic!("{source:?}: {other:?}"),
    };
    let v = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    assert_eq!(line(&format!("{v}f 1 2 3\nf 1 2 4\n")), 5);
    assert_eq!(line(&format!("{v}f 1 2 0\n")), 4);
    assert_eq!(line(&format!("{v}f 1 2 -4\n")), 4);
    assert_eq!(line(&format!("{v}f 1 2 -9223372036854775808\n")), 4);
    assert_eq!(line(&format!("{v}f 1 2 x\n")), 4);
    assert_eq!(line(&format!("{v}\nf 1 2\n")), 5);
    assert_eq!(line(&format!("{v}v 1 2\nf 1 2 3\n")), 4);
    assert_eq!(line(&format!("v 1 \u{e9} 2\n{v}f 1 2 3\n")), 1);
    let nan = text(Format::Obj, &format!("{v}v 0 nan 0\nf 1 2 4\n"));
    assert!(matches!(nan, Err(DataError::Mesh(MeshError::NonFinitePosition { vertex: 3, .. }))), "{nan:?}");
    assert_eq!(text(Format::Obj, v), Err(DataError::Mesh(MeshError::NoFacets)));
    assert_eq!(text(Format::Obj, " \n"), Err(DataError::Empty));
}

const PLY: &str = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\nproperty double y\n\
    property int z\nproperty uchar red\nelement face 1\nproperty list uchar ushort vertex_index\n\
    property list uchar float texcoord\nelement edge 1\nproperty int vertex1\nend_header\n\
    0 0 0 9\n1 0 0 9\n1 1 0 9\n0 1 0 9\n4 0 1 2 3 2 0.5 0.5\n7\n";

#[test]
fn ply_dialects() {
    let mesh = text(Format::Ply, PLY).unwrap();
    assert_eq!((mesh.facets(), mesh.area()), (&[[0, 1, 2], [0, 2, 3]][..], 1.0));
    assert_eq!(text(Format::Ply, &PLY.replace('\n', "\r\n")).unwrap(), mesh);
    assert_eq!(text(Format::Ply, &PLY.replace("1 1 0 9\n", " 1. +.1e1\n 0 9 ")).unwrap(), mesh);
    let wrong = |from: &str, to: &str| {
        assert!(PLY.contains(from));
        text(Format::Ply, &PLY.replace(from, to)).unwrap_err()
    };
    assert!(matches!(wrong("4 0 1 2 3 2", "2 0 1 2"), DataError::Element { index: 0, .. }));
    assert!(matches!(wrong("4 0 1 2 3 2", "4 0 1 2 4 2"), DataError::Element { index: 0, .. }));
    assert!(matches!(wrong("1 1 0 9", "1 nan 0 9"), DataError::Mesh(MeshError::NonFinitePosition { vertex: 2, .. })));
    assert!(matches!(wrong("1 1 0 9", "1 b 0 9"), DataError::Syntax { .. }));
    assert!(matches!(wrong("vertex_index", "corners"), DataError::Header(_)));
    assert!(matches!(wrong("property double y\n", ""), DataError::Header(_)));
    assert!(matches!(wrong("element vertex 4", "element vertex 4000000000"), DataError::Truncated(_)));
    assert!(matches!(wrong("element edge 1", "element edge 18446744073709551615"), DataError::Truncated(_)));
    assert!(matches!(wrong("ply\n", "plx\n"), DataError::Syntax { .. }));

    let mut big = b"ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
        property float z\nelement face 1\nproperty list int uint vertex_indices\nend_header\n"
        .to_vec();
    [0., 0., 0., 1., 0., 0., 0., 1., 0f32].iter().for_each(|x| big.extend(x.to_be_bytes()));
    [3u32, 0, 1, 2].iter().for_each(|x| big.extend(x.to_be_bytes()));
    assert_eq!(decode(Format::Ply, &big).unwrap().area(), 0.5);
    let count = big.len() - 16;
    big[count] = 0x7f;
    assert!(matches!(decode(Format::Ply, &big), Err(DataError::Truncated(_))));
    // No bytes an element: any number of them fits, and is passed over at once.
    big[count] = 0;
    let at = big.windows(12).position(|window| window == b"element face").unwrap();
    let void = [&big[..at], b"element void 18446744073709551615\n", &big[at..]].concat();
    assert_eq!(decode(Format::Ply, &void).unwrap().area(), 0.5);
}

/// A PLY file as the crate `ply-rs-bw` writes it again in another encoding.
fn rewritten(bytes: &[u8], encoding: Encoding) -> Vec<u8> {
    let mut ply = Parser::<DefaultElement>::new().read_ply(&mut &bytes[..]).unwrap();
    ply.header.encoding = encoding;
    let mut out = Vec::new();
    Writer::new().write_ply(&mut out, &mut ply).unwrap();
    out
}

/// Another reader understands what we write, and we understand what it writes, in every encoding.
#[test]
fn ply_as_another_program_has_it() {
    let mesh = Shape::Torus.build(300);
    let mut carried = Attributes::new(&mesh);
    let corners = (0..mesh.facets().len() as u32).map(|f| [f, f + 1, 0]).collect();
    let values = (0..=mesh.facets().len()).map(|k| dvec2(k as f64, 0.25)).collect();
    carried.set_texture(PerCorner { values, corners }).unwrap();
    carried.add_scalar(Scalar::new("height", (0..mesh.positions().len()).map(|k| 0.1 * k as f64).collect())).unwrap();
    let plain = encode(Format::Ply, &mesh).unwrap();
    let (carrying, _) = encode_with_attributes(Format::Ply, &mesh, &carried).unwrap();
    for encoding in [Encoding::Ascii, Encoding::BinaryBigEndian, Encoding::BinaryLittleEndian] {
        assert_eq!(decode(Format::Ply, &rewritten(&plain, encoding)).unwrap(), mesh, "{encoding:?}");
        let there = decode_with_attributes(Format::Ply, &rewritten(&carrying, encoding)).unwrap();
        let here = decode_with_attributes(Format::Ply, &carrying).unwrap();
        assert_eq!(there, here, "{encoding:?}");
        assert_eq!(there.attributes.scalars(), carried.scalars());
        assert_eq!(readers::on_corners(&mesh, &there.attributes), readers::on_corners(&mesh, &carried));
    }
}

/// Headers as files have them: other programs read these.
#[test]
fn ply_headers_off_the_beaten_track() {
    let mesh = text(Format::Ply, PLY).unwrap();
    let bytes = |from: &str, to: &[u8]| {
        let (before, after) = PLY.split_once(from).unwrap();
        [before.as_bytes(), to, after.as_bytes()].concat()
    };
    for (from, to) in [
        ("comment made by hand", &b"comment M\xfcller \x80"[..]),
        ("comment made by hand", b"obj_info \xe9"),
        ("comment made by hand", b""),
        ("comment made by hand", b"  \t"),
        ("element vertex 4", b"  element  vertex\t4 "),
        ("property uchar red", b"property uchar scalar_C2C_distances[<10]"),
        ("property uchar red", b"property uchar 1.5"),
        ("property uchar red", b"property uchar \xb0C (inside)"),
        ("property uchar red", b"property uchar line_3"),
        ("texcoord", b"tex.coord"),
        ("ply\n", b"PLY\n"),
    ] {
        assert_eq!(decode(Format::Ply, &bytes(from, to)).unwrap(), mesh, "{}", String::from_utf8_lossy(to));
    }
    assert_eq!(text(Format::Ply, &PLY.replace('\n', "\r")).unwrap(), mesh);
    // Two properties of one name are two all the same.
    let twice = PLY.replace("red", "q\nproperty uchar q\nproperty uchar q_again").replace(" 9\n", " 9 8 7\n");
    assert_eq!(text(Format::Ply, &twice).unwrap(), mesh);
    // Errors name the line in the file.
    for (from, to, line) in [
        ("property float x", "property flaot x", 5),
        ("element face 1", "element vertex 1", 9),
        ("element face 1", "elemant face 1", 9),
        ("1 1 0 9", "1 b 0 9", 17),
        ("ply\n", "a picture\n", 1),
    ] {
        let wrong = PLY.replace(from, to).replace("comment made by hand", "\ncomment a[b]");
        let line = line + usize::from(line > 2);
        let error = text(Format::Ply, &wrong).unwrap_err();
        assert!(matches!(error, DataError::Syntax { line: found, .. } if found == line), "{to}: {error}");
    }
    assert!(matches!(text(Format::Ply, "ply\nformat ascii 1.0\n"), Err(DataError::Truncated(_))));
    assert!(matches!(text(Format::Ply, "ply"), Err(DataError::Truncated(_))));
}

const STL: &str = "solid\nfacet normal 0 0 1\n outer loop\n  vertex 0 0 0\n  VERTEX 1E0 0 0\n  vertex 0 1 0\n endloop\n\
    endfacet\nendsolid\n\nSOLID second\nfacet normal 0 0 1\nouter loop\nvertex 1 0 -0\nvertex 1 1 0\nvertex 0 1 0\n\
    endloop\nendfacet\nendsolid second\n";

#[test]
fn stl_dialects() {
    let mesh = text(Format::Stl, STL).unwrap();
    assert_eq!((mesh.positions().len(), mesh.facets()), (4, &[[0, 1, 2], [1, 3, 2]][..]));
    assert!(matches!(text(Format::Stl, &STL.replace("1 1 0", "1 1 x")), Err(DataError::Element { index: 1, .. })));
    let mut binary = encode(Format::Stl, &mesh).unwrap();
    binary[..16].copy_from_slice(b"solid of a CAD  ");
    assert_eq!(decode(Format::Stl, &binary).unwrap(), mesh);
    let cut = decode(Format::Stl, &binary[..binary.len() - 1]);
    assert!(matches!(cut, Err(DataError::Truncated(_))), "{cut:?}");
    binary[80..84].fill(0xff);
    assert!(matches!(decode(Format::Stl, &binary), Err(DataError::Truncated(_))));
    binary_stl_dialects();
    let wide = TriMesh::new(vec![DVec3::ZERO, DVec3::X * 1e40, DVec3::Y * 1e40], vec![[0, 1, 2]]).unwrap();
    assert!(matches!(encode(Format::Stl, &wide), Err(DataError::SinglePrecision { vertex: 1, .. })));
}

/// Other counts in the header than there are facets, and bytes behind one or all of them.
fn binary_stl_dialects() {
    let mesh = Shape::Sphere.build(400);
    let file = encode(Format::Stl, &mesh).unwrap();
    let whole = decode(Format::Stl, &file).unwrap();
    let count = whole.facets().len();
    let read = |bytes: &[u8]| decode(Format::Stl, bytes).unwrap();
    for declared in [0, 1, count / 2, count - 1] {
        let mut other = file.clone();
        other[80..84].copy_from_slice(&(declared as u32).to_le_bytes());
        assert_eq!(read(&other), whole, "{declared} of {count} declared");
    }
    for (behind, byte) in
        [1, 49, 92, 100, 5000].into_iter().flat_map(|behind| [0, b' ', 0xff].map(|byte| (behind, byte)))
    {
        assert_eq!(read(&[&file[..], &vec![byte; behind]].concat()), whole, "{behind} bytes {byte} behind the last");
    }
    // Bytes of a program behind each facet, as many as the facet says.
    for most in [1, 4, 300] {
        let records = file[84..].as_chunks::<50>().0.iter().enumerate().flat_map(|(k, record)| {
            let own = k % (most + 1);
            [&record[..48], &(own as u16).to_le_bytes(), &vec![0xee; own]].concat()
        });
        let extended: Vec<u8> = file[..84].iter().copied().chain(records).collect();
        assert_eq!(read(&extended), whole, "up to {most} bytes behind each");
    }
    let cut = decode(Format::Stl, &file[..file.len() - 60]).unwrap_err().to_string();
    assert!(cut.contains(&format!("{count} facets are declared and {} are there", count - 2)), "{cut}");
}

#[test]
fn off_dialects() {
    let square = ["0 0 0", "1 0 0", "1 1 0", "0 1 0"];
    let plain = format!("OFF\n4 1 0\n{}\n4 0 1 2 3\n", square.join("\n"));
    let mesh = text(Format::Off, &plain).unwrap();
    assert_eq!(mesh.facets(), [[0, 1, 2], [0, 2, 3]]);
    let lines = square.join(" 255 0 0 255\r\n");
    let coloured = format!("# x\nCOFF 4 1 0 # y\n\n{lines} 255 0 0 255\n4 0 1 2 3 0.1 0.2 0.3\n");
    assert_eq!(text(Format::Off, &coloured).unwrap(), mesh);
    assert_eq!(text(Format::Off, &plain[4..]).unwrap(), mesh);
    let wrong = [("4 0 1 2 3", "4 0 1 2 4", 7), ("4 0 1 2 3", "2 0 1", 7), ("1 1 0", "1 b 0", 5), ("OFF", "OFX", 1)];
    for (from, to, line) in wrong {
        let error = text(Format::Off, &plain.replace(from, to)).unwrap_err();
        assert!(matches!(error, DataError::Syntax { line: found, .. } if found == line), "{error}");
    }
    let huge = text(Format::Off, &plain.replace("4 1 0", "4000000000 1 0"));
    assert!(matches!(huge, Err(DataError::Truncated(_) | DataError::Syntax { .. })), "{huge:?}");
    assert!(matches!(text(Format::Off, "OFF BINARY\n"), Err(DataError::Header(_))));
}

/// Common OBJ and PLY files are read on all threads, all others from beginning to end; both are to be the same.
#[test]
fn in_place_and_through_the_crates() {
    let words = [
        "v ",
        "v 0 0 0",
        "v 1 0 0\n",
        "v 0 1. .5e-3\n",
        "v 1 1 1 1 0 0.5\n",
        "v 0 0 0 2\n",
        "v 1 2 3 4 5\n",
        "f 1 2 3\n",
        "f 1/1 2/2/2 3//4\n",
        "f 3 2 1 4",
        "f 1 2\n",
        "f -1 -2 -3\n",
        "f 1 2 3 # 4\n",
        "f 1 2 3 #4\\\n",
        "f 1 2 3#\n",
        "vt 0 0\n",
        "vn 0 0 1\n",
        "\n",
        "\\\n",
        "\r\n",
        " ",
        "\t",
        "#",
        "# x \\\n",
        "g \\\n",
        "g a\\b\n",
        "nan",
        "1e999",
        "f 1 +2 3\n",
        "f 0 1 2\n",
        "f 1 2 99\n",
        "f 4294967297 1 2\n",
        "f 1 2 3 4 5\n",
        "x\\",
        "\u{b}",
        "\u{e9}",
        "0",
    ];
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut read, mut refused) = (0, 0);
    for _ in 0..20_000 {
        let mut source = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n".to_owned();
        (0..rng.random_range(1..6)).for_each(|_| source.push_str(words[rng.random_range(0..words.len())]));
        readers::check(Format::Obj, source.as_bytes()).unwrap_or_else(|error| panic!("{error}:\n{source}"));
        match text(Format::Obj, &source) {
            Ok(_) => read += 1,
            Err(_) => refused += 1,
        }
    }
    assert!(read > 2000 && refused > 2000, "{read} {refused}");

    let kinds = ["char", "uchar", "short", "ushort", "int", "uint", "float", "double"];
    let mut planes = 0;
    for round in 0..400u32 {
        let kind = |rng: &mut ChaCha8Rng| kinds[rng.random_range(0..8)];
        let position = if round % 3 == 0 { kind(&mut rng) } else { ["float", "double"][round as usize % 2] };
        let (before, after, face) = (kind(&mut rng), kind(&mut rng), kind(&mut rng));
        let index = if round % 5 == 0 { kind(&mut rng) } else { ["int", "uint"][round as usize % 2] };
        let order = if round % 7 == 0 { "big" } else { "little" };
        let mut file = format!(
            "ply\nformat binary_{order}_endian 1.0\nelement vertex 4\nproperty {before} w\nproperty {position} x\n\
             property {position} y\nproperty {after} t\nproperty {position} z\nelement other 2\nproperty {face} a\n\
             element face 2\nproperty {face} b\nproperty list uchar {index} vertex_index\nproperty {after} c\nend_header\n"
        )
        .into_bytes();
        let size = |kind: &str| match kind {
            "char" | "uchar" => 1,
            "short" | "ushort" => 2,
            "double" => 8,
            _ => 4,
        };
        let mut noise =
            |file: &mut Vec<u8>, kind: &str| file.extend((0..size(kind)).map(|_| rng.random_range(0..64u8)));
        let start = file.len();
        for _ in 0..4 {
            [before, position, position, after, position].iter().for_each(|kind| noise(&mut file, kind));
        }
        [face, face].iter().for_each(|kind| noise(&mut file, kind));
        for corners in [[0u8, 1, 2], [2, 1, 3]] {
            noise(&mut file, face);
            file.push(3);
            for corner in corners {
                let mut bytes = vec![0; size(index)];
                bytes[if order == "big" { size(index) - 1 } else { 0 }] = corner;
                file.extend(bytes);
            }
            noise(&mut file, after);
        }
        if round % 2 == 0 {
            let at = rng.random_range(start..file.len());
            file[at] = rng.random_range(0..=255);
        }
        if round % 11 == 0 {
            file.truncate(rng.random_range(start..file.len()));
        }
        planes += usize::from(decode(Format::Ply, &file).is_ok());
        readers::check(Format::Ply, &file).unwrap_or_else(|error| panic!("{error}: round {round}"));
    }
    assert!((100..380).contains(&planes), "{planes}");
}

/// A piece of text ends between lines, and faces name vertices of other pieces.
#[test]
fn long_files() {
    let mesh = Shape::Torus.build(60_000);
    for format in [Format::Obj, Format::Ply] {
        let file = encode(format, &mesh).unwrap();
        let other = decode(format, &readers::detour(format, &file).unwrap()).unwrap();
        assert!(file.len() > 1 << 20 && decode(format, &file).unwrap() == other && corners(&other) == corners(&mesh));
        let count = |end: usize| decode(format, &file[..end]).map(|mesh| mesh.facets().len()).unwrap_or(0);
        assert!(count(file.len()) == mesh.facets().len() && count(file.len() - 9) < mesh.facets().len());
    }
}

/// Files cut anywhere and files with one byte changed: any answer, no panic. Cut binary files are refused.
#[test]
fn no_bytes_break_a_reader() {
    let mesh = Shape::Torus.build(24);
    let mut files: Vec<(Format, Vec<u8>)> =
        Format::ALL.into_iter().map(|format| (format, encode(format, &mesh).unwrap())).collect();
    files.push((Format::Ply, PLY.into()));
    files.push((Format::Stl, STL.into()));
    for (format, bytes) in &files {
        let binary = std::str::from_utf8(bytes).is_err();
        for end in 0..bytes.len() {
            let cut = decode(*format, &bytes[..end]);
            assert!(!binary || cut.is_err(), "{format:?} {end}");
        }
        for at in 0..bytes.len() {
            for value in [0, b' ', b'\n', b'-', b'9', b'/', b'\\', 0x7f, 0xff] {
                let mut changed = bytes.clone();
                changed[at] = value;
                let _ = decode(*format, &changed);
            }
        }
        for other in Format::ALL {
            let _ = decode(other, bytes);
        }
    }
}
