//! PLY data.
//!
//! Purpose: [`read`] takes positions, corners and what is carried in the order that the header declares. Binary little-endian
//! data whose elements all have one size each, as nearly all files have (vertices of numbers, faces of three corners), are read
//! in place by [`Layout`], all records at once and on all threads; all others number by number ([`Rows`]). [`counts`] passes
//! over the data and reads the lengths of lists alone. Invariant: takes no more steps than there are bytes, whatever is
//! declared. Both ways give the same; what is wrong with a file is said by [`Rows`]. Must not know: what attributes mean.

use glam::DVec3;

use super::carried::{Carried, Role};
use super::header::{Element, FACES, Header, STRIPS};
use super::{Counts, DataError, Soup};
use crate::mesh::io::numbers::{Cursor, Encoding, Kind, Order, numbers};
use crate::tasks;

pub(super) fn read(header: &Header<'_>, carried: &mut Carried) -> Result<Soup, DataError> {
    if let Some(soup) = records(header, carried) {
        return Ok(soup);
    }
    let mut rows = Rows { cursor: cursor(header), soup: Soup::default(), vertices: 0, carried };
    // Faces may stand before the vertices that they name.
    rows.vertices = header.element("vertex").map_or(0, |vertex| vertex.count);
    // A corner may be one byte: a list that grows would take more than the file.
    if header.encoding != Encoding::Text {
        let facets = counts(header).and_then(|counts| usize::try_from(counts.facets).ok());
        rows.soup.facets.reserve_exact(facets.unwrap_or(0));
    }
    // Rows without properties are none.
    for element in header.elements.iter().filter(|element| !element.properties.is_empty()) {
        let roles: Vec<Role> = element.properties.iter().map(|p| rows.carried.role(element, p)).collect();
        // Two bytes a number, at the least, or four a face.
        let (most, count) = (rows.cursor.rest.len(), element.count);
        match element.name.as_str() {
            "vertex" => {
                // Each has three coordinates, and a byte of each column.
                rows.soup.positions.reserve_exact(count.min(most / 3 + 1));
                rows.carried.reserve(count.min(most / 3 + 1));
            }
            "face" => rows.soup.facets.reserve(count.min(most / 4 + 1)),
            _ => {}
        }
        for index in 0..element.count {
            rows.row(element, &roles, index).map_err(|error| match error {
                DataError::Truncated(_) => {
                    let (count, name) = (element.count, &element.name);
                    DataError::Truncated(format!("{count} of element \"{name}\" are declared and {index} are there"))
                }
                other => other,
            })?;
        }
    }
    Ok(rows.soup)
}

/// A triangle strip of which the last two vertices are known, if there are two, and how many triangles there were.
#[derive(Default)]
struct Strip {
    last: [Option<i64>; 2],
    triangles: usize,
}

impl Strip {
    /// The triangle that ends at a vertex. A negative number ends a strip. One with a vertex twice leads from one part to
    /// another.
    fn next(&mut self, vertex: i64) -> Option<[i64; 3]> {
        if vertex < 0 {
            *self = Self::default();
            return None;
        }
        let [a, b] = self.last;
        self.last = [b, Some(vertex)];
        let (a, b) = (a?, b?);
        self.triangles += 1;
        let triangle = if self.triangles % 2 == 1 { [a, b, vertex] } else { [b, a, vertex] };
        (a != b && b != vertex && vertex != a).then_some(triangle)
    }
}

struct Rows<'a> {
    cursor: Cursor<'a>,
    soup: Soup,
    /// As many are declared.
    vertices: usize,
    carried: &'a mut Carried,
}

impl Rows<'_> {
    fn row(&mut self, element: &Element, roles: &[Role], index: usize) -> Result<(), DataError> {
        let Self { cursor, soup, vertices, carried } = self;
        let wrong = |message: String| DataError::Element { element: "face", index, message };
        let mut position = [0.0; 3];
        let (mut polygon, mut strip) = (soup.begin_polygon(*vertices, 0), Strip::default());
        let is_strips = element.name == STRIPS;
        for (property, role) in element.properties.iter().zip(roles) {
            let count = property.length.map_or(Ok(1), |kind| length(cursor, kind))?;
            match *role {
                Role::Axis(axis) => position[axis] = cursor.float(property.item, "a coordinate")?,
                Role::Corners => {
                    cursor.check(count, property.item, "corners")?;
                    soup.begin_polygon(*vertices, count);
                    for _ in 0..count {
                        let vertex = cursor.integer(property.item, "a vertex number")?;
                        if !is_strips {
                            soup.push_corner(&mut polygon, vertex).map_err(wrong)?;
                        } else if let Some(triangle) = strip.next(vertex) {
                            let mut polygon = soup.begin_polygon(*vertices, 3);
                            triangle.iter().try_for_each(|&v| soup.push_corner(&mut polygon, v)).map_err(wrong)?;
                            carried.end_face(3);
                        }
                    }
                }
                Role::Column(column) => carried.push(column, cursor.any_float(property.item, "a property")?),
                Role::Wedges => {
                    cursor.check(count, property.item, "texture coordinates")?;
                    carried.wedges(count, || cursor.any_float(property.item, "a property"))?;
                }
                Role::Label => carried.label_face(cursor.any_float(property.item, "a property")?),
                Role::Skipped => cursor.pass(count, property.item, "a property")?,
            }
        }
        match element.name.as_str() {
            "vertex" => soup.positions.push(DVec3::from_array(position)),
            "face" => {
                soup.end_polygon(&polygon).map_err(wrong)?;
                carried.end_face(polygon.corners);
            }
            _ => {}
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
    let (mut columns, mut labels) = (Vec::new(), Vec::new());
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
            "face" => {
                soup.facets = layout.facets(records, vertices)?;
                if let Some((at, kind)) = carried.label().and_then(|name| layout.scalar(name)) {
                    labels = numbers!(kind, f64, column(records, layout.stride, at));
                }
            }
            _ => {}
        }
    }
    carried.take_columns(columns);
    for label in labels {
        carried.label_face(label);
        carried.end_face(3);
    }
    Some(soup)
}

/// Where the properties of an element's records are.
pub(super) struct Layout<'a> {
    /// Bytes of a record, more than 0.
    pub(super) stride: usize,
    scalars: Vec<(&'a str, usize, Kind)>,
    /// Place of the count of a list of three corners. The corners follow it.
    pub(super) list: Option<usize>,
}

impl<'a> Layout<'a> {
    /// `None` if a record has a list other than a face's corners.
    pub(super) fn of(element: &'a Element) -> Option<Self> {
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

    pub(super) fn scalar(&self, name: &str) -> Option<(usize, Kind)> {
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
        let facets = rows(records, self.stride, facet);
        (!tasks::any(facets.len(), |f| facets[f].iter().any(|&v| v >= most))).then_some(facets)
    }
}

/// What `of` makes of each whole row of this size.
fn rows<T: Default + Send>(rows: &[u8], size: usize, of: impl Fn(&[u8]) -> T + Sync) -> Vec<T> {
    tasks::map(rows.len() / size, |k| of(&rows[k * size..][..size]))
}

fn vectors<const N: usize>(rows: &[u8], size: usize, at: [usize; 3], of: impl Fn([u8; N]) -> f64 + Sync) -> Vec<DVec3> {
    let vector = |r: &[u8]| DVec3::from_array(at.map(|at| of(bytes(r, at))));
    self::rows(rows, size, vector)
}

fn column<const N: usize>(rows: &[u8], size: usize, at: usize, of: impl Fn([u8; N]) -> f64 + Sync) -> Vec<f64> {
    self::rows(rows, size, |r| of(bytes(r, at)))
}

/// Bytes of one number; a record has them all, by how the layout was made.
fn bytes<const N: usize>(record: &[u8], at: usize) -> [u8; N] {
    record.get(at..).and_then(|rest| rest.first_chunk::<N>()).copied().unwrap_or([0; N])
}
