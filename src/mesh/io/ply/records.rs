//! Binary little-endian PLY data whose elements all have one size each, as nearly all files have: vertices of
//! numbers, faces of three corners.
//!
//! Purpose: reads such data in place, all records at once, where the crate goes from number to number through a
//! call for each of them, a tenth as fast.
//! Invariant: gives what the crate gives, or nothing; what is wrong with a file is the crate's to say.
//! Must not know: text, big-endian data, lists of any other length.

use glam::DVec3;
use ply_rs_bw::ply::{ElementDef, Encoding, Header, PropertyType, ScalarType};
use rayon::prelude::*;

use super::super::Soup;
use super::is_index_name;

/// The surface, if `data` are such.
pub(super) fn decode(data: &[u8], header: &Header) -> Option<Soup> {
    if header.encoding != Encoding::BinaryLittleEndian {
        return None;
    }
    let vertices = header.elements.get("vertex")?.count;
    let mut soup = Soup::default();
    let mut rest = data;
    for (name, element) in &header.elements {
        let layout = Layout::of(name, element)?;
        let (records, after) = rest.split_at_checked(element.count.checked_mul(layout.stride)?)?;
        rest = after;
        match name.as_str() {
            "vertex" => soup.positions = layout.positions(records)?,
            "face" => soup.facets = layout.facets(records, vertices)?,
            _ => {}
        }
    }
    Some(soup)
}

/// Numbers of the vertices' scalar properties, one column for each name, if they lie in records of one size.
pub(super) fn columns(data: &[u8], header: &Header, names: &[&str]) -> Option<Vec<Vec<f64>>> {
    if header.encoding != Encoding::BinaryLittleEndian {
        return None;
    }
    let mut rest = data;
    for (name, element) in &header.elements {
        let layout = Layout::of(name, element)?;
        let (records, after) = rest.split_at_checked(element.count.checked_mul(layout.stride)?)?;
        if name == "vertex" {
            let column = |name: &&str| Some(layout.column(records, layout.scalar(name)?));
            return names.iter().map(column).collect();
        }
        rest = after;
    }
    None
}

/// Where the properties of an element's records are.
struct Layout<'a> {
    /// Bytes of a record, more than 0.
    stride: usize,
    scalars: Vec<(&'a str, usize, &'a ScalarType)>,
    /// Of a list of three corners: the count's place. The corners follow it.
    list: Option<usize>,
}

impl<'a> Layout<'a> {
    /// Nothing if a record has a list, but for that of a face's corners.
    fn of(name: &str, element: &'a ElementDef) -> Option<Self> {
        let mut layout = Self { stride: 0, scalars: Vec::new(), list: None };
        for (property, p) in &element.properties {
            match &p.data_type {
                PropertyType::Scalar(kind) => {
                    layout.scalars.push((property, layout.stride, kind));
                    layout.stride += size(kind);
                }
                PropertyType::List(ScalarType::UChar, ScalarType::Int | ScalarType::UInt)
                    if name == "face" && is_index_name(property) && layout.list.is_none() =>
                {
                    layout.list = Some(layout.stride);
                    layout.stride += 13;
                }
                PropertyType::List(..) => return None,
            }
        }
        (layout.stride > 0).then_some(layout)
    }

    fn scalar(&self, name: &str) -> Option<(usize, &'a ScalarType)> {
        self.scalars.iter().find(|(n, ..)| *n == name).map(|&(_, at, kind)| (at, kind))
    }

    fn positions(&self, records: &[u8]) -> Option<Vec<DVec3>> {
        let [x, y, z] = [self.scalar("x")?, self.scalar("y")?, self.scalar("z")?];
        let all = |kind: &ScalarType| [x, y, z].iter().all(|(_, k)| *k == kind);
        let (x, y, z) = (x.0, y.0, z.0);
        let records = records.par_chunks_exact(self.stride);
        if all(&ScalarType::Double) {
            let number = |r: &[u8], at| f64::from_le_bytes(bytes(r, at));
            Some(records.map(|r| DVec3::new(number(r, x), number(r, y), number(r, z))).collect())
        } else if all(&ScalarType::Float) {
            let number = |r: &[u8], at| f64::from(f32::from_le_bytes(bytes(r, at)));
            Some(records.map(|r| DVec3::new(number(r, x), number(r, y), number(r, z))).collect())
        } else {
            None
        }
    }

    fn facets(&self, records: &[u8], vertices: usize) -> Option<Vec<[u32; 3]>> {
        let list = self.list?;
        // A negative number is one above this.
        let most = u32::try_from(vertices).ok().filter(|&n| n <= i32::MAX as u32)?;
        let facet = |record: &[u8]| match bytes(record, list) {
            [3u8] => [1, 5, 9].map(|at| u32::from_le_bytes(bytes(record, list + at))),
            _ => [u32::MAX; 3],
        };
        let facets: Vec<[u32; 3]> = records.par_chunks_exact(self.stride).map(facet).collect();
        facets.par_iter().all(|facet| facet.iter().all(|&v| v < most)).then_some(facets)
    }

    fn column(&self, records: &[u8], (at, kind): (usize, &ScalarType)) -> Vec<f64> {
        let records = records.par_chunks_exact(self.stride);
        match kind {
            ScalarType::Char => records.map(|r| f64::from(i8::from_le_bytes(bytes(r, at)))).collect(),
            ScalarType::UChar => records.map(|r| f64::from(u8::from_le_bytes(bytes(r, at)))).collect(),
            ScalarType::Short => records.map(|r| f64::from(i16::from_le_bytes(bytes(r, at)))).collect(),
            ScalarType::UShort => records.map(|r| f64::from(u16::from_le_bytes(bytes(r, at)))).collect(),
            ScalarType::Int => records.map(|r| f64::from(i32::from_le_bytes(bytes(r, at)))).collect(),
            ScalarType::UInt => records.map(|r| f64::from(u32::from_le_bytes(bytes(r, at)))).collect(),
            ScalarType::Float => records.map(|r| f64::from(f32::from_le_bytes(bytes(r, at)))).collect(),
            ScalarType::Double => records.map(|r| f64::from_le_bytes(bytes(r, at))).collect(),
        }
    }
}

fn size(kind: &ScalarType) -> usize {
    match kind {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}

/// Bytes of one number; a record has them all, by how the layout was made.
fn bytes<const N: usize>(record: &[u8], at: usize) -> [u8; N] {
    record.get(at..).and_then(|rest| rest.first_chunk::<N>()).copied().unwrap_or([0; N])
}
