//! OBJ statements of any kind: continued lines, indices from the end, points over their last coordinate, faces before their
//! vertices.
//!
//! Purpose: reads a file as one piece. The crate `tobj` (4.0) splits vertices at groups, makes facets of polylines (`l 1 2 3`),
//! refuses files for their texture or material lines, which do not matter here, and its errors name no line.
//! Invariant: an attribute that cannot be understood is given up and named, and spoils nothing else. Must not know: threads.

use glam::{DVec2, DVec3};

use super::super::held::Raw;
use super::super::numbers::{parse as number, shown};
use super::super::{DataError, Soup, syntax};
use super::{COLOURS, Corner, NONE, NORMALS, Statements, TEXTURE};
use crate::mesh::MeshError;

pub(super) fn decode(bytes: &[u8], wanted: bool) -> Result<Soup, DataError> {
    let Reader { found, raw, blamed, is_wrong, .. } = read(bytes, wanted)?;
    let vertices = found.positions.len();
    let soup = found.surface(raw).filter(|soup| !is_wrong && soup.positions.iter().all(|p| p.is_finite()));
    soup.ok_or_else(|| blamed.unwrap_or_else(|| names_none(bytes, vertices)))
}

/// The statements, and what could not be understood.
pub(super) fn read(bytes: &[u8], wanted: bool) -> Result<Reader, DataError> {
    let mut reader = Reader { wanted, ..Reader::default() };
    let mut corners = Vec::new();
    for (line, statement) in statements(bytes) {
        let mut words = Words(statement);
        match words.next() {
            Some(b"v") => reader.vertex(line, words),
            Some(b"f") => reader.face(line, words, &mut corners)?,
            Some(b"vt") if wanted => reader.texture(line, words),
            Some(b"vn") if wanted => reader.normal(line, words),
            _ => {}
        }
    }
    Ok(reader)
}

#[derive(Default)]
pub(super) struct Reader {
    wanted: bool,
    pub(super) found: Statements,
    raw: Raw,
    /// What is wrong with the first line that is to blame, if no surface comes of the file.
    blamed: Option<DataError>,
    /// Whether none does, since a position or the vertex of a corner is no number.
    is_wrong: bool,
}

impl Reader {
    fn vertex(&mut self, line: usize, words: Words<'_>) {
        let values: Vec<&[u8]> = words.take(8).collect();
        let count = values.len();
        if self.wanted && count == 6 {
            // What is no number is refused with the others that are not finite.
            let [r, g, b] = [values[3], values[4], values[5]].map(|word| number(word).unwrap_or(f64::NAN));
            self.found.push_colour([r, g, b, 1.0]);
        } else if self.wanted && count > 6 && self.found.colours.is_empty() {
            let message = format!("line {line}: {count} numbers, of which only 3, 4 or 6 can be understood");
            self.give_up(COLOURS, message);
        }
        // A fourth value alone is the homogeneous coordinate; more are colours.
        let [x, y, z] = [0, 1, 2].map(|k| values.get(k).copied().and_then(number));
        let w = if count == 4 { number(values[3]) } else { Some(1.0) };
        let position = match (x, y, z, w) {
            (Some(x), Some(y), Some(z), Some(w)) if w != 0.0 => DVec3::new(x, y, z) / w,
            (Some(_), Some(_), Some(_), Some(_)) => self.wrong(line, "the fourth coordinate is 0, a point at infinity"),
            _ => self.wrong(line, "\"v\" needs three numbers, x y z"),
        };
        if !position.is_finite() {
            let vertex = self.found.positions.len();
            self.blamed.get_or_insert_with(|| MeshError::NonFinitePosition { vertex, position }.into());
        }
        self.found.positions.push(position);
    }

    fn wrong(&mut self, line: usize, message: &str) -> DVec3 {
        self.is_wrong = true;
        self.blamed.get_or_insert_with(|| syntax(line, message));
        DVec3::NAN
    }

    fn texture(&mut self, line: usize, mut words: Words<'_>) {
        let u = words.next().and_then(number);
        let v = words.next().map_or(Some(0.0), number);
        let (Some(u), Some(v)) = (u, v) else {
            self.give_up(TEXTURE, format!("line {line}: \"vt\" needs one or two numbers"));
            return self.found.texture.push(DVec2::ZERO);
        };
        self.found.texture.push(DVec2::new(u, v));
    }

    fn normal(&mut self, line: usize, words: Words<'_>) {
        let mut numbers = words.map(number);
        let (Some(Some(x)), Some(Some(y)), Some(Some(z))) = (numbers.next(), numbers.next(), numbers.next()) else {
            self.give_up(NORMALS, format!("line {line}: \"vn\" needs three numbers"));
            return self.found.normals.push(DVec3::ZERO);
        };
        self.found.normals.push(DVec3::new(x, y, z));
    }

    fn face(&mut self, line: usize, words: Words<'_>, corners: &mut Vec<Corner>) -> Result<(), DataError> {
        corners.clear();
        for word in words {
            let mut parts = word.split(|&b| b == b'/');
            let position = parts.next().unwrap_or_default();
            if position.is_empty() {
                // As in `//3`.
                return Err(syntax(line, format!("\"{}\" names no vertex", shown(word))));
            }
            let index = number(position);
            if index.is_none() {
                self.wrong(line, &format!("\"{}\" is no vertex number", shown(word)));
            }
            let vertex = index.and_then(|i| from_zero(i, self.found.positions.len())).unwrap_or(NONE);
            let mut corner = Corner { vertex, texture: NONE, normal: NONE };
            if self.wanted {
                let (texture, normal) = (self.found.texture.len(), self.found.normals.len());
                corner.texture = self.index(line, word, parts.next(), texture, TEXTURE);
                corner.normal = self.index(line, word, parts.next(), normal, NORMALS);
            }
            corners.push(corner);
        }
        let count = corners.len();
        if count < 3 {
            return Err(syntax(line, format!("a face needs at least 3 corners and has {count}")));
        }
        self.found.push_face(corners);
        Ok(())
    }

    /// The index in one part of a corner's word, if there is one.
    fn index(&mut self, line: usize, word: &[u8], part: Option<&[u8]>, count: usize, what: &str) -> u32 {
        let Some(part) = part.filter(|part| !part.is_empty()) else { return NONE };
        number(part).and_then(|i| from_zero(i, count)).unwrap_or_else(|| {
            self.give_up(what, format!("line {line}: \"{}\" names none", shown(word)));
            NONE
        })
    }

    fn give_up(&mut self, what: &str, message: String) {
        if !self.raw.is_unreadable(what) {
            self.raw.unreadable(what, message);
        }
    }
}

/// An index from 1, or from the end if negative, as one from 0. Later statements may still bring what it names.
fn from_zero(index: i64, count: usize) -> Option<u32> {
    let index = match index {
        0 => return None,
        1.. => index - 1,
        _ => i64::try_from(count).ok()?.checked_add(index)?,
    };
    u32::try_from(index).ok().filter(|&i| i != NONE)
}

/// The first corner that names none of the vertices, which may come after it.
fn names_none(bytes: &[u8], vertices: usize) -> DataError {
    let mut before = 0;
    for (line, statement) in statements(bytes) {
        let mut words = Words(statement);
        match words.next() {
            Some(b"v") => before += 1,
            Some(b"f") => {
                for word in words {
                    let index: i64 = number(position_index(word)).unwrap_or(0);
                    if from_zero(index, before).is_none_or(|vertex| vertex as usize >= vertices) {
                        let message = format!("vertex {index} is named, but there are {vertices} (1 to {vertices})");
                        return syntax(line, message);
                    }
                }
            }
            _ => {}
        }
    }
    DataError::Header("it has more vertices than 32 bits can number".to_owned())
}

fn position_index(word: &[u8]) -> &[u8] {
    &word[..word.iter().position(|&b| b == b'/').unwrap_or(word.len())]
}

/// Statements with the number of their first line. A backslash at a line's end continues it.
pub(super) fn statements(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let mut rest = bytes;
    let mut line = 0;
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let first = line + 1;
        let mut end = 0;
        loop {
            line += 1;
            let length = rest[end..].iter().position(|&b| b == b'\n').unwrap_or(rest.len() - end);
            let text = rest[end..end + length].trim_ascii_end();
            end = (end + length + 1).min(rest.len());
            if end == rest.len() || text.last() != Some(&b'\\') {
                break;
            }
        }
        let (statement, after) = rest.split_at(end);
        rest = after;
        Some((first, statement))
    })
}

/// Words of a statement, up to a comment; a continuing backslash is a blank.
pub(super) struct Words<'a>(pub(super) &'a [u8]);

impl<'a> Iterator for Words<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let blank = |b: &u8| b.is_ascii_whitespace() || *b == b'\\';
        let start = self.0.iter().position(|b| !blank(b))?;
        let rest = &self.0[start..];
        if rest[0] == b'#' {
            return None;
        }
        let (word, rest) = rest.split_at(rest.iter().position(blank).unwrap_or(rest.len()));
        self.0 = rest;
        Some(word)
    }
}
