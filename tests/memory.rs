//! Promise: bytes that describe much with little take memory in proportion to what has come, to be counted and to be read.
//!
//! One test alone, since an allocator counts for the whole process.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "common/long.rs"]
mod long;

use std::fmt::Write as _;
use std::io::Write as _;

use flate2::Compression;
use flate2::write::GzEncoder;
use peak_alloc::PeakAlloc;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::mesh::attributes::{Attributes, ColourDepth, Colours, Normals};
use tessera::mesh::io::{self, Format};
use tessera::mesh::shapes::Shape;

use self::long::{is_long, some};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Bytes that `work` takes at its peak, beyond those before it.
fn peak<T>(work: impl FnOnce() -> T) -> usize {
    MEMORY.reset_peak_usage();
    let before = MEMORY.current_usage();
    drop(work());
    MEMORY.peak_usage().saturating_sub(before)
}

/// Bytes of each of these files.
const BYTES: usize = 6 << 20;

/// A text of about [`BYTES`] that begins and ends so, with as many copies of a part as fit.
fn filled(begin: &str, part: &str, end: &str) -> Vec<u8> {
    let mut text = String::with_capacity(BYTES + 64);
    text.push_str(begin);
    while text.len() < BYTES {
        text.push_str(part);
    }
    text.push_str(end);
    text.into_bytes()
}

/// The same as one of a chain, where each part names the next.
fn chain() -> Vec<u8> {
    let mut text = String::from("{\"nodes\":[");
    for k in 1.. {
        let _ = write!(text, "{{\"children\":[{k},0]}},");
        if text.len() > BYTES {
            break;
        }
    }
    text.push_str("{}]}");
    text.into_bytes()
}

/// Surfaces whose texts say nothing many times over.
fn hostile() -> Vec<(&'static str, Format, Vec<u8>)> {
    // As many parts as fit are announced, and the numbers in them.
    let counted = |head: &str, part: &str, each: usize, tail: &str| {
        let count = BYTES / part.len();
        let head = head.replace("@N", &(count * each).to_string()).replace("@M", &count.to_string());
        [head.as_str(), &part.repeat(count), tail].concat().into_bytes()
    };
    let vtk = "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 1 float\n0 0 0\n";
    let medit = "MeshVersionFormatted 2\nDimension 3\nVertices\n3\n0 0 0 0\n1 0 0 0\n0 1 0 0\n";
    // Lists of bytes that name three vertices over and over, with texture coordinates; or none, but for one face.
    let textured = |corners: usize, is_bare: bool| {
        let face = |is_bare: bool| {
            let list = |count: usize| (0..count).map(|k| [0, 1, 2, 3, 4, 3, 2, 1][k % 8]).collect::<Vec<u8>>();
            let [corners, pairs] = [corners as u32, if is_bare { 0 } else { 2 * corners as u32 }];
            [&corners.to_le_bytes()[..], &list(corners as usize), &pairs.to_le_bytes(), &list(pairs as usize)].concat()
        };
        let (each, first) = (face(is_bare), face(false));
        let faces = 1 + BYTES / each.len();
        let head = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex 5\nproperty uchar x\nproperty uchar y\nproperty uchar z\n\
             element face {faces}\nproperty list uint uchar vertex_indices\nproperty list uint uchar texcoord\nend_header\n"
        );
        let places = [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 1, 0, 0, 1];
        [head.as_bytes(), &places, &first, &each.repeat(faces - 1)].concat()
    };
    // Numbers of a byte, many for each vertex, that are read one by one.
    let columns = {
        let vertices = BYTES / 12;
        let names: String = (0..5).map(|k| format!("property uchar n{k}\n")).collect();
        let head = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty uchar x\nproperty uchar y\n\
             property uchar z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n{names}\
             element face 1\nproperty list uchar uint vertex_indices\nproperty list uchar uchar n\nend_header\n"
        );
        let all: Vec<u8> = (0..12 * vertices).map(|k| (k * k % 251) as u8).collect();
        [head.as_bytes(), &all, &[3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 0]].concat()
    };
    let textured_text = filled(
        &format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty uchar x\nproperty uchar y\nproperty uchar z\nelement face {}\n\
             property list uchar uchar vertex_indices\nproperty list uint float texcoord\nend_header\n0 0 0\n1 0 0\n0 1 0\n",
            BYTES / 22 - 40
        ),
        "3 0 1 2 6 0 1 0 1 1 0\n",
        "",
    );
    vec![
        ("textured triangles", Format::Ply, textured(3, false)),
        ("textured polygons", Format::Ply, textured(50, false)),
        ("a few long textured polygons", Format::Ply, textured(500_000, false)),
        ("polygons without texture but for one", Format::Ply, textured(50, true)),
        ("long ones without texture but for one", Format::Ply, textured(500_000, true)),
        ("textured triangles of a text", Format::Ply, textured_text),
        ("numbers of a byte", Format::Ply, columns),
        ("empty nodes", Format::Gltf, filled("{\"nodes\":[", "{},", "{}]}")),
        ("children", Format::Gltf, filled("{\"nodes\":[{\"children\":[", "0,", "0]}]}")),
        ("a chain", Format::Gltf, chain()),
        ("meshes", Format::Gltf, filled("{\"meshes\":[", "{},", "{}]}")),
        ("primitives", Format::Gltf, filled("{\"meshes\":[{\"primitives\":[", "{},", "{}]}]}")),
        ("scenes", Format::Gltf, filled("{\"scenes\":[", "{},", "{}]}")),
        ("scene", Format::Gltf, filled("{\"scenes\":[{\"nodes\":[", "0,", "0]}]}")),
        ("buffers", Format::Gltf, filled("{\"buffers\":[", "{},", "{}]}")),
        ("views", Format::Gltf, filled("{\"bufferViews\":[", "{\"buffer\":0,\"byteLength\":1},", "{}]}")),
        ("extensions", Format::Gltf, filled("{\"extensionsRequired\":[", "\"\",", "\"\"]}")),
        ("extras", Format::Gltf, filled("{\"extras\":[", "[[[],{}],\"\\n\"],", "0]}")),
        ("brackets", Format::Gltf, filled("{\"extras\":", "[", "")),
        ("an escaped buffer", Format::Gltf, filled("{\"buffers\":[{\"uri\":\"data:;base64,", "\\/", "\"}]}")),
        ("pieces", Format::Vtp, filled("<VTKFile type=\"PolyData\">", "<Piece/>", "</VTKFile>")),
        (
            "pieces with points",
            Format::Vtp,
            filled("<VTKFile type=\"PolyData\">", "<Piece NumberOfPoints=\"1\"/>", "</VTKFile>"),
        ),
        (
            "arrays",
            Format::Vtp,
            filled(
                "<VTKFile type=\"PolyData\"><Piece NumberOfPoints=\"1\"><PointData>",
                "<DataArray/>",
                "</PointData></Piece></VTKFile>",
            ),
        ),
        ("elements", Format::Vtp, filled("<VTKFile type=\"PolyData\"><Piece>", "<a>", "</VTKFile>")),
        ("empty cells", Format::Vtk, counted(&format!("{vtk}CELLS @M @M\n"), "0\n", 1, "CELL_TYPES 0\n")),
        ("cells", Format::Vtk, counted(&format!("{vtk}CELLS @M @N\n"), "3 0 0 0\n", 4, "CELL_TYPES 0\n")),
        ("lines", Format::Vtk, counted(&format!("{vtk}LINES @M @N\n"), "1 0\n", 2, "")),
        ("faces", Format::Medit, counted(&format!("{medit}Triangles\n@M\n"), "1 1 1 0\n", 1, "End\n")),
        (
            "elements of one node",
            Format::Gmsh,
            counted(
                "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n$Elements\n@M\n",
                "1 15 0 1\n",
                1,
                "$EndElements\n",
            ),
        ),
        ("solids", Format::Stl, filled("solid\n", "endsolid\n", "")),
    ]
}

fn packed(plain: &[u8]) -> Vec<u8> {
    let mut packer = GzEncoder::new(Vec::new(), Compression::best());
    packer.write_all(plain).unwrap();
    packer.finish().unwrap()
}

/// Empty nodes beside so much noise that gzip packs them to a little more than a 64th.
fn nodes_that_pack() -> Vec<u8> {
    let mut state = 1u64;
    let noise = (0..BYTES / 45).map(|_| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        char::from(b'0' + (state >> 58) as u8 % 64)
    });
    let noise: String = noise.filter(|letter| *letter != '\\').collect();
    filled(&format!("{{\"extras\":\"{noise}\",\"nodes\":["), "{},", "{}]}")
}

/// Vertices of a comb of this many corners, a tooth every four: a polygon that is not convex. Short numbers.
fn comb(corners: usize) -> Vec<[usize; 2]> {
    let teeth = (0..corners - 2).map(|k| [k / 2, 2 + 9 * usize::from(k % 4 < 2)]);
    teeth.chain([[corners / 2, 0], [0, 0]]).collect()
}

/// How a polygon names its vertices.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Named {
    /// Each has vertices of its own.
    Apart,
    /// All have the same few, over and over.
    Again,
    /// Each is in any order: it crosses itself.
    Crossing,
}

/// Surfaces of polygons, in each format that has some, of this many corners each.
fn polygons(per_face: usize, named: Named) -> Vec<(String, Format, Vec<u8>)> {
    // Half a megabyte at least, and two faces but for the largest.
    let faces = (200_000 / per_face).max(if per_face > 20_000 { 1 } else { 2 });
    let vertices = match named {
        Named::Apart => comb(per_face).repeat(faces),
        Named::Again => comb(9),
        Named::Crossing => {
            let place = |k: usize| [k * 7919 % 30_011, k * 104_729 % 251];
            (0..per_face * faces).map(place).collect()
        }
    };
    let corner = |face: usize, k: usize| match named {
        Named::Apart | Named::Crossing => face * per_face + k,
        Named::Again => k % vertices.len(),
    };
    let each = |before: &dyn Fn(usize) -> String, word: &dyn Fn(usize) -> String, after: &str| {
        let mut text = String::new();
        for face in 0..faces {
            text.push_str(&before(face));
            (0..per_face).for_each(|k| text.push_str(&word(corner(face, k))));
            text.push_str(after);
        }
        text
    };
    let places = |before: &str, after: &str| -> String {
        vertices.iter().map(|[x, y]| format!("{before}{x} {y} 0{after}\n")).collect()
    };
    let (v, all) = (vertices.len(), faces * per_face);
    let counted = |_: usize| per_face.to_string();
    let plain = each(&counted, &|v| format!(" {v}"), "\n");
    let list = each(&|_| String::new(), &|v| format!("{v} "), "");
    let ends: String = (1..=faces).map(|face| format!("{} ", face * per_face)).collect();
    let ply = |count: &str, item: &str, form: &str| {
        let head = format!("element vertex {v}\nproperty short x\nproperty uchar y\nproperty uchar z\n");
        let face = format!("element face {faces}\nproperty list {count} {item} vertex_indices\n");
        (
            format!("ply\nformat {form} 1.0\n{head}{face}end_header\n"),
            format!("ply\nformat {form} 1.0\n{face}{head}end_header\n"),
        )
    };
    let short = |n: usize| (n as u16).to_le_bytes();
    let binary = {
        let places = vertices.iter().flat_map(|[x, y]| [short(*x).as_slice(), &[*y as u8, 0]].concat());
        let wide = v > 256;
        let mut bytes = ply("int", if wide { "uint" } else { "uchar" }, "binary_little_endian").0.into_bytes();
        bytes.extend(places);
        for face in 0..faces {
            bytes.extend((per_face as u32).to_le_bytes());
            for k in 0..per_face {
                let v = corner(face, k) as u32;
                bytes.extend_from_slice(&v.to_le_bytes()[..if wide { 4 } else { 1 }]);
            }
        }
        bytes
    };
    let xml = |kind: &str, cells: &str, number: &str| {
        let array = |name: &str, of: &str, text: &str| {
            format!(
                "<DataArray type=\"{of}\" Name=\"{name}\" NumberOfComponents=\"3\" format=\"ascii\">{text}</DataArray>\n"
            )
        };
        let types = array("types", "UInt8", &"7 ".repeat(faces));
        format!(
            "<VTKFile type=\"{kind}\"><{kind}><Piece NumberOfPoints=\"{v}\" {number}=\"{faces}\"><Points>{}</Points>\n<{cells}>{}{}{}</{cells}></Piece></{kind}></VTKFile>",
            array("p", "Float32", &places("", "")),
            array("connectivity", "Int32", &list),
            array("offsets", "Int32", &ends),
            if cells == "Cells" { types } else { String::new() },
        )
    };
    let vtk =
        format!("# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET POLYDATA\nPOINTS {v} float\n{}", places("", ""));
    let obj = |word: &dyn Fn(usize) -> String, before: &str| {
        each(
            &|face| format!("{before}{}f", if before.is_empty() { String::new() } else { format!("g {face}\n") }),
            word,
            "\n",
        )
    };
    let vt: String = vertices.iter().map(|[x, _]| format!("vt {x} 0\nvn 0 0 1\n")).collect();
    let v_lines = places("v ", "");
    let named_as = |v: usize| v + 1;
    let texts = vec![
        ("plain", Format::Obj, format!("{v_lines}{}", obj(&|v| format!(" {}", named_as(v)), ""))),
        ("from the end", Format::Obj, format!("{v_lines}{}", obj(&|i| format!(" {}", i as i64 - v as i64), ""))),
        (
            "over the fourth",
            Format::Obj,
            format!("{}{}", places("v ", " 1"), obj(&|v| format!(" {}", named_as(v)), "")),
        ),
        (
            "with colours",
            Format::Obj,
            format!("{}{}", places("v ", " 1 0 1"), obj(&|v| format!(" {}", named_as(v)), "")),
        ),
        ("groups", Format::Obj, format!("{v_lines}{}", obj(&|v| format!(" {}", named_as(v)), "usemtl a\n"))),
        ("normals", Format::Obj, format!("{v_lines}{vt}{}", obj(&|v| format!(" {0}//{0}", named_as(v)), ""))),
        ("triples", Format::Obj, format!("{v_lines}{vt}{}", obj(&|v| format!(" {0}/{0}/{0}", named_as(v)), ""))),
        (
            "triples from the end",
            Format::Obj,
            format!(
                "{v_lines}{vt}{}",
                obj(
                    &|i| {
                        let k = i as i64 - v as i64;
                        format!(" {k}/{k}/{k}")
                    },
                    ""
                )
            ),
        ),
        (
            "names no vertex",
            Format::Obj,
            format!("{v_lines}{}f 1 2 9999999\n", obj(&|v| format!(" {}", named_as(v)), "")),
        ),
        ("text", Format::Ply, format!("{}{}{plain}", ply("int", "int", "ascii").0, places("", ""))),
        ("faces first", Format::Ply, format!("{}{plain}{}", ply("int", "int", "ascii").1, places("", ""))),
        ("text", Format::Off, format!("OFF\n{v} {faces} 0\n{}{plain}", places("", ""))),
        ("polygons", Format::Vtk, format!("{vtk}POLYGONS {faces} {}\n{plain}", all + faces)),
        (
            "polygons of version 5",
            Format::Vtk,
            format!(
                "{vtk}POLYGONS {} {all}\nOFFSETS vtktypeint64\n0 {ends}\nCONNECTIVITY vtktypeint64\n{list}\n",
                faces + 1
            ),
        ),
        ("text", Format::Vtp, xml("PolyData", "Polys", "NumberOfPolys")),
        ("text", Format::Vtu, xml("UnstructuredGrid", "Cells", "NumberOfCells")),
    ];
    let mut files: Vec<_> = texts.into_iter().map(|(name, format, text)| (name, format, text.into_bytes())).collect();
    files.push(("binary", Format::Ply, binary));
    let name = |name: &str| format!("{name}, polygons of {per_face}, vertices {named:?}");
    files.into_iter().map(|(what, format, bytes)| (name(what), format, bytes)).collect()
}

/// Bytes that reading takes at its peak, beyond what it gives back.
fn peak_of_reading(format: Format, bytes: &[u8]) -> usize {
    MEMORY.reset_peak_usage();
    let before = MEMORY.current_usage();
    let loaded = io::decode_with_attributes(format, bytes);
    let (peak, kept) = (MEMORY.peak_usage(), MEMORY.current_usage().saturating_sub(before));
    drop(loaded);
    peak.saturating_sub(before + kept)
}

/// Tables of decompressors, and lists that have room for more than one element from the start.
const FLOOR: usize = 256 << 10;

/// What gzip or zip packed counts with its unpacked length, up to which readers may unpack it.
fn whole_length(format: Format, bytes: &[u8]) -> usize {
    if format != Format::ThreeMf {
        return bytes.len();
    }
    let unpacked = io::encode(Format::Obj, &mesh_of_files()).unwrap();
    // The text of a 3MF has names beside its numbers.
    bytes.len().max(2 * unpacked.len())
}

fn mesh_of_files() -> tessera::TriMesh {
    Shape::Torus.build(4000)
}

/// A file of each format, with everything that it can hold, and some as other programs write them.
fn originals() -> Vec<(Format, Vec<u8>)> {
    let mesh = mesh_of_files();
    let mut all = Attributes::new(&mesh);
    all.set_normals(Normals::PerVertex(mesh.positions().iter().map(|p| p.normalize_or_zero()).collect())).unwrap();
    let values = mesh.positions().iter().map(|p| [0.2, if p.z > 0.0 { 1.0 } else { 0.0 }, 0.4, 1.0]).collect();
    all.set_colours(Colours { values, depth: ColourDepth::Eight }).unwrap();
    all.add_scalar(tessera::mesh::attributes::Scalar::new("height", mesh.positions().iter().map(|p| p.z).collect()))
        .unwrap();
    let of = |format| (format, io::encode_with_attributes(format, &mesh, &all).unwrap().0);
    let mut files: Vec<_> = Format::ALL.into_iter().map(of).collect();
    // Polygons are changed too, a text and a binary file.
    let some = polygons(9, Named::Again).into_iter().map(|(_, format, bytes)| (format, bytes));
    files.extend(some.filter(|(format, _)| matches!(format, Format::Obj | Format::Ply)).step_by(4));
    files
}

/// Cut off, with counts enlarged, numbers replaced, or sections there twice.
fn changed(original: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = original.to_vec();
    // Headers are changed more often than their length says.
    let place = |rng: &mut ChaCha8Rng| match rng.random_range(0..2) {
        0 => rng.random_range(0..original.len().min(600)),
        _ => rng.random_range(0..original.len()),
    };
    match rng.random_range(0..5) {
        0 => bytes.truncate(rng.random_range(1..original.len())),
        1 | 2 => {
            let at = place(rng);
            let digit = bytes[at..].iter().position(u8::is_ascii_digit).map_or(at, |more| at + more);
            let end = bytes[digit..].iter().position(|b| !b.is_ascii_digit()).map_or(digit + 1, |more| digit + more);
            let number =
                ["0", "1", "77", "4000", "99999999", "4294967295", "18446744073709551615"][rng.random_range(0..7)];
            bytes.splice(digit..end.max(digit + 1).min(original.len()), number.bytes());
        }
        3 => {
            let at = place(rng).min(original.len() - 4);
            bytes[at..at + 4]
                .copy_from_slice(&[[0xff, 0xff, 0xff, 0x7f], [0, 0, 1, 0], [9, 0, 0, 0]][rng.random_range(0..3)]);
        }
        _ => {
            let at = rng.random_range(0..original.len());
            let end = (at + rng.random_range(1..original.len())).min(original.len());
            bytes.splice(at..at, original[at..end].iter().copied());
        }
    }
    bytes
}

/// How often each file is changed, and how often without `TESSERA_LONG=1`.
const CHANGES: [usize; 2] = [200, 60];

/// What reading may take beside the surface, in lengths of the file.
const MOST: f64 = 8.0;

/// Files that are changed take no more than a multiple of their bytes, beyond the surface that is read.
fn changed_files(wrong: &mut Vec<String>) {
    let mut rng = ChaCha8Rng::seed_from_u64(42);
    for (format, original) in originals() {
        let (mut most, mut largest) = (0.0f64, 0);
        for change in 0..=CHANGES[usize::from(!is_long())] {
            let bytes = if change == 0 { original.clone() } else { changed(&original, &mut rng) };
            let taken = peak_of_reading(format, &bytes);
            let size = whole_length(format, &bytes);
            most = most.max(taken.saturating_sub(FLOOR) as f64 / size as f64);
            largest = largest.max(taken);
        }
        let line =
            format!("{format:?}, a file of {} bytes: {most:.1} times its bytes, {largest} at most", original.len());
        println!("{line}");
        if most > MOST {
            wrong.push(line);
        }
    }
}

/// Polygons of any length take no more, whether they are convex or not, whatever else their format says beside them.
fn files_of_polygons(wrong: &mut Vec<String>) {
    for named in [Named::Apart, Named::Again, Named::Crossing] {
        for per_face in some(3, [4, 9, 100, 1000, 10_000, 100_000]) {
            for (name, format, bytes) in polygons(per_face, named) {
                let taken = [peak_of_reading(format, &bytes), peak(|| io::counts(format, &bytes))];
                let times = taken.map(|taken| taken.saturating_sub(FLOOR) as f64 / bytes.len() as f64);
                if times[0] > MOST || times[1] > MOST {
                    wrong.push(format!(
                        "{format:?}, {name}: {} bytes, read and counted with {times:?} times",
                        bytes.len()
                    ));
                }
            }
        }
    }
}

#[test]
fn memory_is_in_proportion_to_what_has_come() {
    // Pools of threads are made once.
    drop(io::decode(Format::Glb, &io::encode(Format::Glb, &Shape::Torus.build(2000)).unwrap()));
    let mut wrong = Vec::new();
    changed_files(&mut wrong);
    files_of_polygons(&mut wrong);
    for (name, format, plain) in hostile() {
        let (counted, read) = (peak(|| io::counts(format, &plain)), peak_of_reading(format, &plain));
        let times = |bytes: usize| bytes as f64 / plain.len() as f64;
        let line = format!(
            "{format:?}, {name}: counted with {:.1} times its bytes, read with {:.1}, is a surface: {}",
            times(counted),
            times(read),
            io::decode(format, &plain).is_ok()
        );
        println!("{line}");
        if times(counted) > MOST || times(read.saturating_sub(FLOOR)) > MOST {
            wrong.push(line);
        }
    }
    // What gzip packed may be unpacked to 64 times its bytes, and no more is made of that than of others.
    let plain = nodes_that_pack();
    let packed = packed(&plain);
    assert!(io::unpack(&packed, io::UNPACKED_RATIO * packed.len() + (1 << 20)).is_ok(), "{}", packed.len());
    for taken in [peak(|| io::counts(Format::Gltf, &packed)), peak(|| io::decode(Format::Gltf, &packed))] {
        println!("{} bytes, packed to {}: taken {taken}", plain.len(), packed.len());
        assert!(taken < 12 * io::UNPACKED_RATIO * packed.len(), "{taken}");
    }
    // An honest file is no burden either.
    let mesh = Shape::Torus.build(100_000);
    for format in Format::ALL {
        let bytes = io::encode(format, &mesh).unwrap();
        let counted = peak(|| assert!(io::counts(format, &bytes).is_some()));
        if counted > bytes.len() + (1 << 16) {
            wrong.push(format!("{format:?}: {counted} bytes for {}", bytes.len()));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
