//! Where the records of a binary file are, for those that read a part of it.
//!
//! Purpose: [`places`] of a header; [`triangle`] of a record. Invariant: all records that it names are within the file. Must not
//! know: how files are read.

use super::data::Layout;
use super::header::{self, Element};
use super::{DataError, check_elements};
use crate::mesh::MeshError;
use crate::mesh::io::Unfit;
use crate::mesh::io::numbers::{Encoding, Kind, Order};

/// Records of one size, one after the other.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::mesh) struct Records {
    pub(in crate::mesh) at: u64,
    pub(in crate::mesh) stride: usize,
    pub(in crate::mesh) count: usize,
}

/// Vertices and triangles.
#[derive(Clone, Copy, Debug)]
pub(in crate::mesh) struct Places {
    pub(in crate::mesh) vertices: Records,
    /// Where x, y and z are in a vertex.
    pub(in crate::mesh) axes: [usize; 3],
    /// The type of coordinates: float or double.
    pub(in crate::mesh) number: Kind,
    pub(in crate::mesh) facets: Records,
    /// Where the count of a facet's corners is; the corners follow it.
    pub(in crate::mesh) list: usize,
}

/// Finds them by the first bytes of a file of this length.
pub(in crate::mesh) fn places(head: &[u8], bytes: u64) -> Result<Places, Unfit> {
    let not = |reason: &str| Unfit::Kind(reason.to_owned());
    let header = header::read(head)?;
    check_elements(&header)?;
    if header.encoding != Encoding::Binary(Order::Little) {
        return Err(not("the file is text, or big-endian"));
    }
    let mut at = (head.len() - header.data.len()) as u64;
    let (mut vertices, mut facets) = (None, None);
    let elements = header.elements.iter().filter(|element| !element.properties.is_empty());
    for element in elements.take_while(|element| is_needed(&header.elements, element)) {
        let layout = Layout::of(element).ok_or_else(|| not("its records differ in length"))?;
        let records = Records { at, stride: layout.stride, count: element.count };
        at = (element.count as u64)
            .checked_mul(layout.stride as u64)
            .and_then(|length| at.checked_add(length))
            .filter(|&end| end <= bytes)
            .ok_or_else(|| {
                let (count, name) = (element.count, &element.name);
                DataError::Truncated(format!("{count} of element \"{name}\" are declared, more than the file holds"))
            })?;
        match element.name.as_str() {
            "vertex" => {
                let axes = ["x", "y", "z"].map(|name| layout.scalar(name));
                let [Some(x), Some(y), Some(z)] = axes else { return Err(not("a vertex lacks a coordinate")) };
                if x.1 != y.1 || y.1 != z.1 || !matches!(x.1, Kind::F32 | Kind::F64) {
                    return Err(not("its coordinates are not all float, or all double"));
                }
                vertices = Some((records, [x.0, y.0, z.0], x.1));
            }
            "face" => facets = Some((records, layout.list.ok_or_else(|| not("its faces are no lists of corners"))?)),
            _ => {}
        }
    }
    match (vertices, facets) {
        (Some((vertices, axes, number)), Some((facets, list))) => Ok(Places { vertices, axes, number, facets, list }),
        _ => Err(not("its surface is made of strips")),
    }
}

/// Whether vertices or faces are this element or come after it.
fn is_needed(elements: &[Element], element: &Element) -> bool {
    let from = elements.iter().position(|e| std::ptr::eq(e, element)).unwrap_or(0);
    elements[from..].iter().any(|e| matches!(e.name.as_str(), "vertex" | "face"))
}

/// The corners of facet `facet`, whose record this is.
pub(in crate::mesh) fn triangle(record: &[u8], list: usize, vertices: usize, facet: usize) -> Result<[u32; 3], Unfit> {
    let corners = record.get(list + 1..).and_then(|bytes| bytes.first_chunk::<12>());
    let Some((3, corners)) = record.get(list).zip(corners).map(|(&count, corners)| (count, corners)) else {
        let count = record.get(list).copied().unwrap_or(0);
        let reason = format!("face {facet} has {count} corners");
        return Err(Unfit::Kind(reason));
    };
    let corners = [0, 1, 2].map(|c| u32::from_le_bytes([0, 1, 2, 3].map(|b| corners[4 * c + b])));
    match corners.iter().position(|&v| v as usize >= vertices) {
        None => Ok(corners),
        Some(corner) => Err(MeshError::IndexOutOfRange { facet, corner, index: corners[corner], vertices }.into()),
    }
}
