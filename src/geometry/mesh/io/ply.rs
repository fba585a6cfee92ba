//! Stanford PLY: ascii and both binary orders. Writes little-endian binary.
//!
//! Purpose: bytes to triangles with what they carry, in one pass over the data, and back. `vertex` needs scalar properties x, y,
//! z; `face` a list property `vertex_indices` or `vertex_index`. Other scalar properties of vertices are attributes, and so is
//! `texcoord`, six numbers for a triangle, of faces, which is how seams are stored. All else is skipped.
//! How: data of records of one size, as nearly all files have them, are read at once ([`records`]), all others number by number
//! ([`rows`]).
//! Invariant: declared counts are checked against the bytes that are there before anything is read.
//! Must not know: other formats.

mod carried;
mod header;
mod records;
mod rows;

use super::held::{By, Held, Holds, eight_bit};
use super::{Codec, Counts, DataError, Soup, VertexNumbers};
use crate::mesh::TriMesh;
use crate::mesh::attributes::ColourDepth;
use carried::{Carried, PREFIX, TAKEN};
use header::{Encoding, Header, Parted};

/// See [`Codec`].
pub(super) const CODEC: Codec = Codec {
    extension: "ply",
    decode,
    encode,
    counts: |bytes| counts(bytes).map(Counts::from),
    holds: Holds { normals: By::Vertex, texture: By::VertexOrCorner, colours: true, opacity: true, scalars: true },
    vertices: VertexNumbers::Kept,
};

/// Reads a surface; what it carries only if it is `wanted`.
fn decode(bytes: &[u8], wanted: bool) -> Result<Soup, DataError> {
    let Parted { header, data, line } = header::read(bytes)?;
    check_header(&header, data.len())?;
    let mut carried = if wanted { Carried::of(&header) } else { Carried::default() };
    let mut soup = match records::read(data, &header, &mut carried) {
        Some(soup) => soup,
        None => rows::read(data, line, &header, &mut carried)?,
    };
    soup.raw = carried.finish(&soup.facets);
    Ok(soup)
}

/// Vertices and facets; nothing where the data end before what is declared.
fn counts(bytes: &[u8]) -> Option<(u64, u64)> {
    let Parted { header, data, line } = header::read(bytes).ok()?;
    check_header(&header, data.len()).ok()?;
    rows::counts(data, line, &header)
}

/// Refuses headers without a surface, and counts that the remaining bytes cannot hold.
fn check_header(header: &Header, remaining: usize) -> Result<(), DataError> {
    let element = |name: &str| {
        header.element(name).ok_or_else(|| {
            let strips = header.element("tristrips").is_some();
            let hint = if strips { "; strips (\"tristrips\") are not read, write them as faces" } else { "" };
            DataError::Header(format!("there is no element \"{name}\"{hint}"))
        })
    };
    let vertex = element("vertex")?;
    let is_scalar = |name: &&str| vertex.properties.iter().any(|p| p.name == *name && p.length.is_none());
    if let Some(missing) = ["x", "y", "z"].into_iter().find(|name| !is_scalar(name)) {
        return Err(DataError::Header(format!("element \"vertex\" has no scalar property \"{missing}\"")));
    }
    if !element("face")?.properties.iter().any(header::Property::is_corners) {
        let message = "element \"face\" has no list property \"vertex_indices\" or \"vertex_index\" of integers";
        return Err(DataError::Header(message.to_owned()));
    }
    let mut needed = 0u128;
    for element in &header.elements {
        // An ascii number is a digit and what separates it from the next. Of a list its length is there.
        let least = |p: &header::Property| {
            if header.encoding == Encoding::Ascii { 2 } else { p.length.unwrap_or(p.item).bytes() }
        };
        let each: usize = element.properties.iter().map(least).sum();
        // A binary element without properties would be nothing at all, and any number of them would fit.
        if each == 0 && element.count > 0 {
            return Err(DataError::Header(format!("element \"{}\" has no properties", element.name)));
        }
        needed += each as u128 * element.count as u128;
    }
    // The last line of an ascii file may lack its line break.
    if needed > remaining as u128 + 1 {
        let message = format!("the header declares at least {needed} bytes of data and {remaining} follow");
        return Err(DataError::Truncated(message));
    }
    Ok(())
}

fn encode(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (vertices, faces) = (mesh.positions().len(), mesh.facets().len());
    let opaque = held.colours.is_none_or(|c| c.values.iter().all(|c| c[3] == 1.0));
    let mut out = head(mesh, held, opaque).into_bytes();
    out.reserve((24 + 8 * held.scalars.len()) * vertices + 13 * faces);
    let number = |out: &mut Vec<u8>, x: f64| out.extend_from_slice(&x.to_le_bytes());
    for (vertex, p) in mesh.positions().iter().enumerate() {
        p.to_array().into_iter().for_each(|x| number(&mut out, x));
        if let Some(normals) = &held.normals {
            normals[vertex].to_array().into_iter().for_each(|x| number(&mut out, x));
        }
        if let Some(colours) = held.colours {
            let colour = &colours.values[vertex][..if opaque { 3 } else { 4 }];
            match colours.depth {
                ColourDepth::Eight => out.extend(colour.iter().map(|&x| eight_bit(x))),
                ColourDepth::Float => colour.iter().for_each(|&x| number(&mut out, x)),
            }
        }
        if let Some(uv) = &held.uv {
            uv[vertex].to_array().into_iter().for_each(|x| number(&mut out, x));
        }
        held.scalars.iter().for_each(|s| number(&mut out, s.values[vertex]));
    }
    for (index, facet) in mesh.facets().iter().enumerate() {
        out.push(3);
        facet.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
        if let Some(texture) = held.corner_uv {
            out.push(6);
            for corner in texture.corners[index] {
                texture.values[corner as usize].to_array().into_iter().for_each(|x| number(&mut out, x));
            }
        }
    }
    Ok(out)
}

fn head(mesh: &TriMesh, held: &Held<'_>, opaque: bool) -> String {
    let (vertices, faces) = (mesh.positions().len(), mesh.facets().len());
    let mut text = format!("ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\n");
    let mut properties = |names: &[&str], kind: &str| {
        names.iter().for_each(|name| text.push_str(&format!("property {kind} {name}\n")));
    };
    properties(&["x", "y", "z"], "double");
    if held.normals.is_some() {
        properties(&["nx", "ny", "nz"], "double");
    }
    if let Some(colours) = held.colours {
        let kind = if colours.depth == ColourDepth::Eight { "uchar" } else { "double" };
        properties(&["red", "green", "blue", "alpha"][..if opaque { 3 } else { 4 }], kind);
    }
    if held.uv.is_some() {
        properties(&["s", "t"], "double");
    }
    for scalar in held.scalars {
        let taken = TAKEN.contains(&scalar.name.as_str());
        properties(&[&format!("{}{}", if taken { PREFIX } else { "" }, scalar.name)], "double");
    }
    text.push_str(&format!("element face {faces}\nproperty list uchar int vertex_indices\n"));
    if held.corner_uv.is_some() {
        text.push_str("property list uchar double texcoord\n");
    }
    text.push_str("end_header\n");
    text
}
