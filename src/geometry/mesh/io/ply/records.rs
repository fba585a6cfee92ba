//! Binary little-endian PLY data whose elements all have one size each, as nearly all files have: vertices of
//! numbers, faces of three corners.
//!
//! Purpose: reads such data in place, all records at once and on all threads.
//! Invariant: gives what [`super::rows`] gives, or nothing; what is wrong with a file is said there.
//! Must not know: text, big-endian data, lists of any other length.

use glam::DVec3;
use rayon::prelude::*;

use super::Soup;
use super::carried::Carried;
use super::header::{Element, Header};
use crate::mesh::io::numbers::{Encoding, Kind, Order, numbers};

/// The surface, if `data` are such; what it carries is put into `carried`.
pub(super) fn read(data: &[u8], header: &Header, carried: &mut Carried) -> Option<Soup> {
    if header.encoding != Encoding::Binary(Order::Little) {
        return None;
    }
    let vertices = header.element("vertex")?.count;
    let mut soup = Soup::default();
    let mut columns = Vec::new();
    let mut rest = data;
    for element in &header.elements {
        let layout = Layout::of(element)?;
        let (records, after) = rest.split_at_checked(element.count.checked_mul(layout.stride)?)?;
        rest = after;
        match element.name.as_str() {
            "vertex" => {
                soup.positions = layout.positions(records)?;
                let column = |name| Some(layout.column(records, layout.scalar(name)?));
                columns = carried.columns().map(column).collect::<Option<_>>()?;
            }
            "face" => soup.facets = layout.facets(records, vertices)?,
            _ => {}
        }
    }
    carried.take_columns(columns);
    Some(soup)
}

/// Where the properties of an element's records are.
struct Layout<'a> {
    /// Bytes of a record, more than 0.
    stride: usize,
    scalars: Vec<(&'a str, usize, Kind)>,
    /// Place of the count of a list of three corners. The corners follow it.
    list: Option<usize>,
}

impl<'a> Layout<'a> {
    /// `None` if a record has a list other than a face's corners.
    fn of(element: &'a Element) -> Option<Self> {
        let mut layout = Self { stride: 0, scalars: Vec::new(), list: None };
        for property in &element.properties {
            match (property.length, property.item) {
                (None, number) => {
                    layout.scalars.push((&property.name, layout.stride, number));
                    layout.stride += number.bytes();
                }
                (Some(Kind::U8), Kind::I32 | Kind::U32)
                    if element.name == "face" && property.is_corners() && layout.list.is_none() =>
                {
                    layout.list = Some(layout.stride);
                    layout.stride += 13;
                }
                _ => return None,
            }
        }
        (layout.stride > 0).then_some(layout)
    }

    fn scalar(&self, name: &str) -> Option<(usize, Kind)> {
        self.scalars.iter().find(|(n, ..)| *n == name).map(|&(_, at, number)| (at, number))
    }

    /// `None` if coordinates differ in type.
    fn positions(&self, records: &[u8]) -> Option<Vec<DVec3>> {
        let [x, y, z] = [self.scalar("x")?, self.scalar("y")?, self.scalar("z")?];
        let places = [x.0, y.0, z.0];
        (x.1 == y.1 && y.1 == z.1).then(|| numbers!(x.1, f64, vectors(records, self.stride, places)))
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

    fn column(&self, records: &[u8], (at, kind): (usize, Kind)) -> Vec<f64> {
        numbers!(kind, f64, column(records, self.stride, at))
    }
}

fn vectors<const N: usize>(
    records: &[u8],
    stride: usize,
    at: [usize; 3],
    number: impl Fn([u8; N]) -> f64 + Sync,
) -> Vec<DVec3> {
    let vector = |r: &[u8]| DVec3::from_array(at.map(|at| number(bytes(r, at))));
    records.par_chunks_exact(stride).map(vector).collect()
}

fn column<const N: usize>(
    records: &[u8],
    stride: usize,
    at: usize,
    number: impl Fn([u8; N]) -> f64 + Sync,
) -> Vec<f64> {
    records.par_chunks_exact(stride).map(|r| number(bytes(r, at))).collect()
}

/// Bytes of one number; a record has them all, by how the layout was made.
fn bytes<const N: usize>(record: &[u8], at: usize) -> [u8; N] {
    record.get(at..).and_then(|rest| rest.first_chunk::<N>()).copied().unwrap_or([0; N])
}
