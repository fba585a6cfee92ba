//! PLY data.
//!
//! Purpose: [`read`] takes positions, corners and what is carried in the order that the header declares. Binary little-endian
//! data whose elements all have one size each, as nearly all files have (vertices of numbers, faces of three corners), are read
//! in place by [`Layout`], all records at once and on all threads; all others number by number ([`Rows`]). [`counts`] passes
//! over the data and reads the lengths of lists alone. Invariant: takes no more steps than there are bytes, whatever is
//! declared. Both ways give the same; what is wrong with a file is said by [`Rows`]. Must not know: what attributes mean.

use glam::DVec3;
use rayon::prelude::*;

use super::carried::{Carried, Role};
use super::header::{Element, FACES, Header, STRIPS};
use super::{Counts, DataError, Soup};
use crate::mesh::io::numbers::{Cursor, Encoding, Kind, Order, numbers};

pub(super) fn read(header: &Header<'_>, carried: &mut Carried) -> Result<Soup, DataError> {
    if let Some(soup) = records(header, carried) {
        return Ok(soup);
    }
    let mut rows = Rows { cursor: cursor(header), positions: Vec::new(), corners: Vec::new(), carried };
    let mut soup = Soup::default();
    // Faces that stand before the vertices that they name are made at the end.
    let mut early: Vec<(usize, bool)> = Vec::new();
    // Rows without properties are none.
    for element in header.elements.iter().filter(|element| !element.properties.is_empty()) {
        let (is_strips, is_face) = (element.name == STRIPS, element.name == "face");
        let is_early = soup.positions.is_empty() || !early.is_empty();
        let roles: Vec<Role> = element.properties.iter().map(|p| rows.carried.role(element, p)).collect();
        // Two bytes a number, at the least, or four a face.
        let (most, count) = (rows.cursor.rest.len(), element.count);
        match element.name.as_str() {
            "vertex" => rows.positions.reserve_exact(count.min(most / 3 + 1)),
            "face" if is_early => {
                early.reserve_exact(count.min(most / 4 + 1));
                rows.corners.reserve_exact(count.saturating_mul(3).min(most / 2 + 1));
            }
            "face" => soup.facets.reserve_exact(count.min(most / 4 + 1)),
            _ => {}
        }
        for index in 0..element.count {
            let first = rows.corners.len();
            rows.row(element, &roles).map_err(|error| match error {
                DataError::Truncated(_) => {
                    let (count, name) = (element.count, &element.name);
                    DataError::Truncated(format!("{count} of element \"{name}\" are declared and {index} are there"))
                }
                other => other,
            })?;
            if is_strips {
                triangles(&rows.corners[first..]).for_each(|_| rows.carried.end_face(3));
            } else if is_face {
                rows.carried.end_face(rows.corners.len() - first);
            } else {
                continue;
            }
            if is_early {
                early.push((rows.corners.len(), is_strips));
            } else {
                push(&mut soup, index, &rows.corners, is_strips)?;
                rows.corners.clear();
            }
        }
        if element.name == "vertex" {
            soup.positions = std::mem::take(&mut rows.positions);
        }
    }
    let mut start = 0;
    for (index, (end, is_strips)) in early.into_iter().enumerate() {
        push(&mut soup, index, &rows.corners[start..end], is_strips)?;
        start = end;
    }
    Ok(soup)
}

/// Adds a face, or the triangles of strips.
fn push(soup: &mut Soup, index: usize, corners: &[i64], is_strips: bool) -> Result<(), DataError> {
    let pushed = match is_strips {
        true => triangles(corners).try_for_each(|triangle| soup.push_polygon(&triangle)),
        false => soup.push_polygon(corners),
    };
    pushed.map_err(|message| DataError::Element { element: "face", index, message })
}

/// The triangles of strips, each of which ends at a negative number. Those with a vertex twice lead from one part to another.
fn triangles(strips: &[i64]) -> impl Iterator<Item = [i64; 3]> {
    let of_strip = |strip| <[i64]>::windows(strip, 3).enumerate();
    let turned = |(k, t): (usize, &[i64])| if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
    let all = strips.split(|&vertex| vertex < 0).flat_map(of_strip).map(turned);
    all.filter(|[a, b, c]| a != b && b != c && c != a)
}

struct Rows<'a> {
    cursor: Cursor<'a>,
    positions: Vec<DVec3>,
    corners: Vec<i64>,
    carried: &'a mut Carried,
}

impl Rows<'_> {
    fn row(&mut self, element: &Element, roles: &[Role]) -> Result<(), DataError> {
        let cursor = &mut self.cursor;
        let mut position = [0.0; 3];
        for (property, role) in element.properties.iter().zip(roles) {
            let count = property.length.map_or(Ok(1), |kind| length(cursor, kind))?;
            match *role {
                Role::Axis(axis) => position[axis] = cursor.float(property.item, "a coordinate")?,
                Role::Corners => {
                    // A number has two bytes at least.
                    let most = count.min(cursor.rest.len() / 2 + 1);
                    match self.corners.is_empty() {
                        true => self.corners.reserve_exact(most),
                        false => self.corners.reserve(most),
                    }
                    for _ in 0..count {
                        self.corners.push(cursor.integer(property.item, "a vertex number")?);
                    }
                }
                to @ (Role::Column(_) | Role::Wedges) => {
                    for _ in 0..count {
                        self.carried.push(to, cursor.any_float(property.item, "a property")?);
                    }
                }
                Role::Skipped => cursor.pass(count, property.item, "a property")?,
            }
        }
        if element.name == "vertex" {
            self.positions.push(DVec3::from_array(position));
        }
        Ok(())
    }
}

fn cursor<'a>(header: &Header<'a>) -> Cursor<'a> {
    Cursor { line: header.line, encoding: header.encoding, ..Cursor::new(header.data) }
}

fn length(cursor: &mut Cursor<'_>, kind: Kind) -> Result<usize, DataError> {
    if cursor.encoding == Encoding::Text {
        return cursor.parsed("a list's length");
    }
    let length = usize::try_from(cursor.integer(kind, "a list's length")?).ok().filter(|_| !kind.is_float());
    length.ok_or_else(|| DataError::Header("the length of a list is negative or of a type for fractions".to_owned()))
}

/// Vertices and facets; nothing where the data end before what is declared.
pub(super) fn counts(header: &Header<'_>) -> Option<Counts> {
    let mut cursor = cursor(header);
    let (mut vertices, mut facets) = (0, 0);
    for element in &header.elements {
        let rows = element.count;
        if element.name == "vertex" {
            vertices = rows as u64;
        }
        let is_faces = FACES.contains(&element.name.as_str());
        if element.properties.iter().all(|p| p.length.is_none()) {
            // All rows at once, as bytes or words.
            let each = match header.encoding {
                Encoding::Text => element.properties.len(),
                Encoding::Binary(_) => element.properties.iter().map(|p| p.item.bytes()).sum(),
            };
            cursor.pass(rows.checked_mul(each)?, Kind::U8, "rows").ok()?;
            continue;
        }
        for _ in 0..rows {
            for property in &element.properties {
                let length = property.length.map_or(Ok(1), |kind| length(&mut cursor, kind)).ok()?;
                cursor.pass(length, property.item, "a property").ok()?;
                if is_faces && property.is_corners() {
                    facets += length.saturating_sub(2) as u64;
                }
            }
        }
    }
    Some(Counts { vertices, facets, made_bytes: 0 })
}

/// The surface, if the data are records of one size; what it carries is put into `carried`.
fn records(header: &Header<'_>, carried: &mut Carried) -> Option<Soup> {
    if header.encoding != Encoding::Binary(Order::Little) {
        return None;
    }
    let vertices = header.element("vertex")?.count;
    let mut soup = Soup::default();
    let mut columns = Vec::new();
    let mut rest = header.data;
    for element in header.elements.iter().filter(|element| !element.properties.is_empty()) {
        let layout = Layout::of(element)?;
        let (records, after) = rest.split_at_checked(element.count.checked_mul(layout.stride)?)?;
        rest = after;
        match element.name.as_str() {
            "vertex" => {
                soup.positions = layout.positions(records)?;
                let column = |name| {
                    let (at, kind) = layout.scalar(name)?;
                    Some(numbers!(kind, f64, column(records, layout.stride, at)))
                };
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
}

fn vectors<const N: usize>(rows: &[u8], size: usize, at: [usize; 3], of: impl Fn([u8; N]) -> f64 + Sync) -> Vec<DVec3> {
    let vector = |r: &[u8]| DVec3::from_array(at.map(|at| of(bytes(r, at))));
    rows.par_chunks_exact(size).map(vector).collect()
}

fn column<const N: usize>(rows: &[u8], size: usize, at: usize, of: impl Fn([u8; N]) -> f64 + Sync) -> Vec<f64> {
    rows.par_chunks_exact(size).map(|r| of(bytes(r, at))).collect()
}

/// Bytes of one number; a record has them all, by how the layout was made.
fn bytes<const N: usize>(record: &[u8], at: usize) -> [u8; N] {
    record.get(at..).and_then(|rest| rest.first_chunk::<N>()).copied().unwrap_or([0; N])
}
