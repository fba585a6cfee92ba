//! Stanford PLY: ascii and both binary orders. Writes little-endian binary.
//!
//! Purpose: bytes to triangles with what they carry, in one pass over the data, and back. `vertex` needs scalar properties x,
//! y, z; `face` a list property `vertex_indices` or `vertex_index`, or so `tristrips`, whose strips end at negative numbers. Other
//! scalar properties of vertices are attributes, and so is `texcoord`, six numbers for a triangle, of faces, which is how seams are
//! stored. A scalar property of faces gives regions if it is chosen. All else is skipped. Invariant: declared counts are checked against the bytes that are there before anything is read.
//! Must not know: other formats.

mod carried;
mod data;
mod header;
mod places;

use std::ops::RangeInclusive;

use super::held::{By, Held, Holds, Labelled, eight_bit};
use super::numbers::{Encoding, Kind, Order};
use super::regions::{ARRAY, numbers};
use super::{Codec, Counts, DataError, RegionChoice, Signature, Soup, VertexNumbers, Wanted};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{ColourDepth, Colours, Scalar};
use carried::{Carried, PREFIX, TAKEN};
use header::Header;
pub(in crate::mesh) use places::{Places, places, triangle};

pub(super) const CODEC: Codec = Codec {
    extension: "ply",
    media_types: &["application/x-ply", "model/ply", "model/x-ply", "application/ply"],
    // Half a vertex of three floats, and a face of a byte and three indices.
    facet_bytes: 19,
    signature: Signature::Start(|head| head.bytes.starts_with(b"ply\n") || head.bytes.starts_with(b"ply\r")),
    decode,
    encode,
    counts,
    holds: Holds {
        normals: By::Vertex,
        texture: By::VertexOrCorner,
        colours: true,
        opacity: true,
        scalars: true,
        regions: Labelled::Number,
    },
    vertices: VertexNumbers::Kept,
};

fn decode(bytes: &[u8], wanted: Wanted<'_>) -> Result<Soup, DataError> {
    let header = header::read(bytes)?;
    check_header(&header)?;
    let chosen = wanted.and_then(RegionChoice::of_cells);
    let mut carried = if wanted.is_some() { Carried::of(&header, chosen) } else { Carried::default() };
    let mut soup = data::read(&header, &mut carried)?;
    soup.raw = carried.finish(&soup.facets);
    if wanted.is_some() {
        carried::left_aside(&header, chosen, &mut soup.raw);
    }
    Ok(soup)
}

fn counts(bytes: &[u8]) -> Option<Counts> {
    let header = header::read(bytes).ok()?;
    check_header(&header).ok()?;
    data::counts(&header)
}

/// Refuses headers without a surface.
fn check_elements(header: &Header<'_>) -> Result<(), DataError> {
    let missing = |name: &str| DataError::Header(format!("there is no element \"{name}\""));
    let vertex = header.element("vertex").ok_or_else(|| missing("vertex"))?;
    let is_scalar =
        |name: &&str| vertex.properties.iter().any(|p| p.name == *name && p.length.is_none() && p.odd.is_none());
    if let Some(missing) = ["x", "y", "z"].into_iter().find(|name| !is_scalar(name)) {
        return Err(DataError::Header(format!("element \"vertex\" has no scalar property \"{missing}\"")));
    }
    let faces = header::FACES.map(|name| header.element(name));
    let face = faces.into_iter().flatten().next().ok_or_else(|| missing("face"))?;
    if !faces.into_iter().flatten().any(|face| face.properties.iter().any(header::Property::is_corners)) {
        let name = &face.name;
        let message =
            format!("element \"{name}\" has no list property \"vertex_indices\" or \"vertex_index\" of integers");
        return Err(DataError::Header(message));
    }
    Ok(())
}

/// Refuses headers without a surface, and counts that the remaining bytes cannot hold.
fn check_header(header: &Header<'_>) -> Result<(), DataError> {
    check_elements(header)?;
    let mut needed = 0u128;
    for element in &header.elements {
        // An ascii number is a digit and what separates it from the next. Of a list its length is there.
        let least = |p: &header::Property| {
            if header.encoding == Encoding::Text { 2 } else { p.length.unwrap_or(p.item).bytes() }
        };
        let each: usize = element.properties.iter().map(least).sum();
        needed += each as u128 * element.count as u128;
    }
    // The last line of an ascii file may lack its line break.
    let remaining = header.data.len();
    if needed > remaining as u128 + 1 {
        let message = format!("the header declares at least {needed} bytes of data and {remaining} follow");
        return Err(DataError::Truncated(message));
    }
    Ok(())
}

/// A name as a property has it: a word of ASCII.
pub(super) fn word(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_graphic() { c } else { '_' }).collect()
}

/// Labels of faces are whole numbers that doubles hold.
pub(super) const LABELS: RangeInclusive<i64> = 1 - (1 << 53)..=(1 << 53) - 1;

/// Properties of the vertices: their names, their type, and a function that writes them.
type Column<'a> = (&'a str, &'a str, Box<dyn Fn(&mut Vec<u8>, usize) + 'a>);

fn encode(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (vertices, faces) = (mesh.positions().len(), mesh.facets().len());
    fn doubles(out: &mut Vec<u8>, numbers: &[f64]) {
        numbers.iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes()));
    }
    let plain = |name: String| if TAKEN.contains(&name.as_str()) { format!("{PREFIX}{name}") } else { name };
    // A vector is a property for each of its numbers.
    let name = |scalar: &Scalar, i: usize| match scalar.components {
        1 => plain(word(&scalar.name)),
        _ => format!("{}_{i}", word(&scalar.name)),
    };
    let names: Vec<String> =
        held.scalars.iter().map(|s| (0..s.components).map(|i| name(s, i)).collect::<Vec<_>>().join(" ")).collect();
    let positions = |out: &mut Vec<u8>, v: usize| doubles(out, &mesh.positions()[v].to_array());
    let mut columns: Vec<Column<'_>> = vec![("x y z", "double", Box::new(positions))];
    if let Some(normals) = &held.normals {
        columns.push(("nx ny nz", "double", Box::new(|out, v| doubles(out, &normals[v].to_array()))));
    }
    if let Some(Colours { values, depth }) = held.colours {
        let opaque = values.iter().all(|c| c[3] == 1.0);
        let (names, n) = if opaque { ("red green blue", 3) } else { ("red green blue alpha", 4) };
        let eight = move |out: &mut Vec<u8>, v: usize| out.extend(values[v][..n].iter().map(|&x| eight_bit(x)));
        columns.push(match depth {
            ColourDepth::Eight => (names, "uchar", Box::new(eight)),
            ColourDepth::Float => (names, "double", Box::new(move |out, v| doubles(out, &values[v][..n]))),
        });
    }
    if let Some(uv) = &held.uv {
        columns.push(("s t", "double", Box::new(|out, v| doubles(out, &uv[v].to_array()))));
    }
    for (name, scalar) in names.iter().zip(held.scalars) {
        let (kind, n) = (header::written(scalar), scalar.components);
        let numbers = move |out: &mut Vec<u8>, v: usize| {
            scalar.values[n * v..][..n].iter().for_each(|&x| kind.put(x, Order::Little, out));
        };
        columns.push((name, header::name(kind), Box::new(numbers)));
    }
    let mut head = format!("ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\n");
    for (names, kind, _) in &columns {
        names.split(' ').for_each(|name| head.push_str(&format!("property {kind} {name}\n")));
    }
    head.push_str(&format!("element face {faces}\nproperty list uchar int vertex_indices\n"));
    if held.corner_uv.is_some() {
        head.push_str("property list uchar double texcoord\n");
    }
    let labels = held.regions.map_or_else(Vec::new, |regions| numbers(regions, &LABELS));
    let fit = labels.iter().all(|&number| i32::try_from(number).is_ok());
    let kind = if fit { Kind::I32 } else { Kind::F64 };
    if held.regions.is_some() {
        head.push_str(&format!("property {} {ARRAY}\n", header::name(kind)));
    }
    head.push_str("end_header\n");
    let mut out = head.into_bytes();
    out.reserve((24 + 8 * held.components()) * vertices + 13 * faces);
    for vertex in 0..vertices {
        columns.iter().for_each(|(.., write)| write(&mut out, vertex));
    }
    for (index, facet) in mesh.facets().iter().enumerate() {
        out.push(3);
        facet.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
        if let Some(texture) = held.corner_uv {
            out.push(6);
            for corner in texture.corners[index] {
                doubles(&mut out, &texture.values[corner as usize].to_array());
            }
        }
        if let Some(regions) = held.regions {
            kind.put(labels[regions.of_facet()[index] as usize] as f64, Order::Little, &mut out);
        }
    }
    Ok(out)
}
