//! PLY data number by number: text, either byte order, lists of any length.
//!
//! Purpose: [`read`] takes positions, corners and what is carried in the order that the header declares; [`counts`] passes over
//! the data and reads the lengths of lists alone.
//! Invariant: takes no more steps than there are bytes, whatever is declared. Must not know: what attributes mean.

use glam::DVec3;

use super::carried::{Carried, Role};
use super::header::{Element, Header};
use super::{DataError, Soup};
use crate::mesh::io::numbers::{Cursor, Encoding, Kind};

/// `data` begins at `line`, from 1, right after the header.
pub(super) fn read(data: &[u8], line: usize, header: &Header, carried: &mut Carried) -> Result<Soup, DataError> {
    let mut rows = Rows { cursor: cursor(data, line, header), positions: Vec::new(), corners: Vec::new(), carried };
    // A face may stand before the vertices that it names, so faces are made at the end.
    let mut ends: Vec<usize> = Vec::new();
    for element in &header.elements {
        let roles: Vec<Role> = element.properties.iter().map(|p| rows.carried.role(element, p)).collect();
        for index in 0..element.count {
            let first = rows.corners.len();
            rows.row(element, &roles).map_err(|error| match error {
                DataError::Truncated(_) => {
                    let (count, name) = (element.count, &element.name);
                    DataError::Truncated(format!("{count} of element \"{name}\" are declared and {index} are there"))
                }
                other => other,
            })?;
            if element.name == "face" {
                rows.carried.end_face(rows.corners.len() - first);
                ends.push(rows.corners.len());
            }
        }
    }
    let mut soup = Soup { positions: rows.positions, ..Soup::default() };
    let mut start = 0;
    for (index, end) in ends.into_iter().enumerate() {
        let pushed = soup.push_polygon(&rows.corners[start..end]);
        pushed.map_err(|message| DataError::Element { element: "face", index, message })?;
        start = end;
    }
    Ok(soup)
}

struct Rows<'a> {
    cursor: Cursor<'a>,
    positions: Vec<DVec3>,
    /// Corners of all faces.
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
                    for _ in 0..count {
                        self.corners.push(cursor.integer(property.item, "a vertex number")?);
                    }
                }
                Role::Carried(to) => {
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

fn cursor<'a>(data: &'a [u8], line: usize, header: &Header) -> Cursor<'a> {
    Cursor { line, encoding: header.encoding, ..Cursor::new(data) }
}

/// The length of a list.
fn length(cursor: &mut Cursor<'_>, kind: Kind) -> Result<usize, DataError> {
    if cursor.encoding == Encoding::Text {
        return cursor.parsed("a list's length");
    }
    let length = usize::try_from(cursor.integer(kind, "a list's length")?).ok().filter(|_| !kind.is_float());
    length.ok_or_else(|| DataError::Header("the length of a list is negative or of a type for fractions".to_owned()))
}

/// Vertices and facets; nothing where the data end before what is declared.
pub(super) fn counts(data: &[u8], line: usize, header: &Header) -> Option<(u64, u64)> {
    let mut cursor = cursor(data, line, header);
    let (mut vertices, mut facets) = (0, 0);
    for element in &header.elements {
        let rows = element.count;
        if element.name == "vertex" {
            vertices = rows as u64;
        }
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
                if element.name == "face" && property.is_corners() {
                    facets += length.saturating_sub(2) as u64;
                }
            }
        }
        if element.name == "face" && vertices > 0 {
            break;
        }
    }
    Some((vertices, facets))
}
