//! Promise: bytes that describe much with little take memory in proportion to what has come, to be counted and to be read.
//!
//! One test alone, since an allocator counts for the whole process.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

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
    vec![
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
    // Short numbers and a polygon of very many corners.
    let corners = 100_000;
    let mut obj = String::new();
    (0..corners).for_each(|k| obj.push_str(&format!("v {} {} 0\n", k % 9, k / 9 % 7)));
    obj.push('f');
    (1..=corners).for_each(|k| obj.push_str(&format!(" {k}")));
    files.push((Format::Obj, obj.into_bytes()));
    let polygons = |per_face: usize| {
        let faces = corners / per_face;
        let mut text = format!(
            "ply\nformat ascii 1.0\nelement vertex 9\nproperty int x\nproperty int y\nproperty int z\nelement face \
             {faces}\nproperty list int int vertex_indices\nend_header\n"
        );
        (0..9).for_each(|k| text.push_str(&format!("{} {} 0\n", k % 3, k / 3)));
        (0..faces).for_each(|_| {
            text.push_str(&per_face.to_string());
            (0..per_face).for_each(|k| text.push_str(&format!(" {}", k % 9)));
            text.push('\n');
        });
        text.into_bytes()
    };
    files.extend([3, 9, corners].map(|per_face| (Format::Ply, polygons(per_face))));
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

/// How often each file is changed.
const CHANGES: usize = 200;

/// What reading may take beside the surface, in lengths of the file. Polygons of an OBJ have two bytes a corner, and
/// take more: the crate's lists of corners grow by doubling.
fn bound(format: Format, has_polygons: bool) -> f64 {
    match (format, has_polygons) {
        (Format::Obj, true) => 20.0,
        // What cuts a polygon has lists of its corners.
        (Format::Ply, true) => 9.0,
        _ => 8.0,
    }
}

/// Files that are changed take no more than a multiple of their bytes, beyond the surface that is read.
fn changed_files(wrong: &mut Vec<String>) {
    let mut rng = ChaCha8Rng::seed_from_u64(42);
    for (number, (format, original)) in originals().into_iter().enumerate() {
        let (mut most, mut largest) = (0.0f64, 0);
        for change in 0..=CHANGES {
            let bytes = if change == 0 { original.clone() } else { changed(&original, &mut rng) };
            let taken = peak_of_reading(format, &bytes);
            let size = whole_length(format, &bytes);
            most = most.max(taken.saturating_sub(FLOOR) as f64 / size as f64);
            largest = largest.max(taken);
        }
        let line = format!(
            "{format:?}, file {number} of {} bytes: {most:.1} times its bytes, {largest} at most",
            original.len()
        );
        println!("{line}");
        if most > bound(format, number >= Format::ALL.len()) {
            wrong.push(line);
        }
    }
}

#[test]
fn memory_is_in_proportion_to_what_has_come() {
    // Pools of threads are made once.
    drop(io::decode(Format::Glb, &io::encode(Format::Glb, &Shape::Torus.build(2000)).unwrap()));
    let mut wrong = Vec::new();
    changed_files(&mut wrong);
    for (name, format, plain) in hostile() {
        let (counted, read) = (peak(|| io::counts(format, &plain)), peak_of_reading(format, &plain));
        let times = |bytes: usize| bytes as f64 / plain.len() as f64;
        let line = format!(
            "{format:?}, {name}: counted with {:.1} times its bytes, read with {:.1}",
            times(counted),
            times(read)
        );
        println!("{line}");
        if times(counted) > 8.0 || times(read.saturating_sub(FLOOR)) > 8.0 {
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
