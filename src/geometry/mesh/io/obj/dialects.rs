//! OBJ statements of any kind: continued lines, indices from the end, points over their last coordinate, faces before their
//! vertices.
//!
//! Purpose: reads a file as one piece. The `tobj` crate reads the vertices, some at a time, and nothing else: for each face it
//! takes several times the bytes, splits vertices at groups, makes facets of polylines (`l 1 2 3`), refuses files for their
//! texture or material lines, which do not matter here, and its errors name no line.
//! Invariant: an attribute that cannot be understood is given up and named, and spoils nothing else. Must not know: threads.

use glam::{DVec2, DVec3};
use tobj::LoadOptions;

use super::super::held::Raw;
pub(super) use super::super::numbers::parse as number;
use super::super::{DataError, Soup, syntax};
use super::{COLOURS, Corner, Face, NONE, NORMALS, Statements, TEXTURE};
use crate::mesh::MeshError;

/// Vertices that the crate reads at a time, and bytes of their text.
const VERTICES: usize = 1 << 10;
const TEXT_BYTES: usize = 1 << 16;

pub(super) fn decode(bytes: &[u8], wanted: bool) -> Result<Soup, DataError> {
    let (statements, raw) = read(bytes, wanted)?;
    let blame = |message: &str| locate(bytes).unwrap_or_else(|| DataError::Header(message.to_owned()));
    let soup = statements.surface(raw).ok_or_else(|| blame("a face names no vertex"))?;
    if soup.positions.iter().any(|p| !p.is_finite()) {
        return Err(blame("a coordinate is not finite"));
    }
    Ok(soup)
}

/// The statements, and what could not be understood.
pub(super) fn read(bytes: &[u8], wanted: bool) -> Result<(Statements, Raw), DataError> {
    let mut found = Statements { bytes: bytes.len(), ..Statements::default() };
    // At once: while it grows, a list takes twice as much.
    let facets = super::counts(bytes).and_then(|counts| usize::try_from(counts.facets).ok());
    found.facets.reserve_exact(facets.unwrap_or(0));
    let mut reader = Reader { wanted, found, left: bytes.len(), text: Vec::new(), waiting: 0, raw: Raw::default() };
    let wrong = |error: String| locate(bytes).unwrap_or(DataError::Header(error));
    for (line, statement) in statements(bytes) {
        let mut words = Words(statement);
        reader.left = reader.left.saturating_sub(statement.len());
        match words.next() {
            Some(b"v") => reader.vertex(line, words),
            Some(b"f") => reader.face(line, words)?,
            Some(b"vt") if wanted => reader.texture(line, words),
            Some(b"vn") if wanted => reader.normal(line, words),
            _ => {}
        }
        if reader.waiting == VERTICES || reader.text.len() > TEXT_BYTES {
            reader.positions().map_err(wrong)?;
        }
    }
    if reader.waiting > 0 {
        reader.positions().map_err(wrong)?;
    }
    Ok((reader.found, reader.raw))
}

struct Reader {
    wanted: bool,
    found: Statements,
    /// Bytes of the file that are left.
    left: usize,
    /// The `v` statements that the crate has to read yet, a line each, without colours, and how many there are.
    text: Vec<u8>,
    waiting: usize,
    raw: Raw,
}

impl Reader {
    fn vertex(&mut self, line: usize, words: Words<'_>) {
        let values: Vec<&[u8]> = words.take(8).collect();
        let count = values.len();
        self.text.push(b'v');
        // A fourth value alone is the homogeneous coordinate; more are colours.
        for value in &values[..if count == 4 { 4 } else { count.min(3) }] {
            self.text.push(b' ');
            self.text.extend_from_slice(value);
        }
        self.text.push(b'\n');
        self.waiting += 1;
        if self.wanted && count == 6 {
            // What is no number is refused with the others that are not finite.
            let [r, g, b] = [values[3], values[4], values[5]].map(|word| number(word).unwrap_or(f64::NAN));
            self.found.push_colour([r, g, b, 1.0]);
        } else if self.wanted && count > 6 && self.found.colours.is_empty() {
            let message = format!("line {line}: {count} numbers, of which only 3, 4 or 6 can be understood");
            self.give_up(COLOURS, message);
        }
        self.found.vertices += 1;
    }

    /// Has the crate read the vertices that wait. The message says what is wrong with one of them.
    fn positions(&mut self) -> Result<(), String> {
        // A face of all of them, so that each is kept, in order.
        self.text.push(b'f');
        (1..=self.waiting).for_each(|v| self.text.extend_from_slice(format!(" {v}").as_bytes()));
        let no_materials = |_: &std::path::Path| Ok((Vec::new(), Default::default()));
        let read = tobj::load_obj_buf(&mut self.text.as_slice(), &LoadOptions::default(), no_materials);
        let (models, _) = read.map_err(|error| error.to_string())?;
        for &position in models.iter().flat_map(|model| model.mesh.positions.as_chunks::<3>().0) {
            self.found.push_position(DVec3::from_array(position), self.left);
        }
        self.text.clear();
        self.waiting = 0;
        Ok(())
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

    fn face(&mut self, line: usize, mut words: Words<'_>) -> Result<(), DataError> {
        let mut face = Face::default();
        while let Some(word) = words.next() {
            let mut parts = word.split(|&b| b == b'/');
            let position = parts.next().unwrap_or_default();
            if position.is_empty() {
                return Err(syntax(line, format!("\"{}\" names no vertex", shown(word))));
            }
            // One that names none is said once all vertices are known.
            let vertex = number(position).and_then(|i| from_zero(i, self.found.vertices)).unwrap_or(NONE);
            let mut corner = Corner { vertex, texture: NONE, normal: NONE };
            if self.wanted {
                let (texture, normal) = (self.found.texture.len(), self.found.normals.len());
                corner.texture = self.index(line, word, parts.next(), texture, TEXTURE);
                corner.normal = self.index(line, word, parts.next(), normal, NORMALS);
            }
            self.found.push_corner(&mut face, corner, self.left + words.0.len());
        }
        if face.corners < 3 {
            return Err(syntax(line, format!("a face needs at least 3 corners and has {}", face.corners)));
        }
        self.found.end_face(&face);
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

/// After a failure: the first line that is to blame.
fn locate(bytes: &[u8]) -> Option<DataError> {
    // Faces may come before their vertices.
    let all = statements(bytes).filter(|(_, statement)| Words(statement).next() == Some(b"v")).count();
    let mut vertices = 0;
    for (line, statement) in statements(bytes) {
        let mut words = Words(statement);
        match words.next() {
            Some(b"v") => {
                let values: Vec<Option<f64>> = words.map(number).take(8).collect();
                let divisor = if values.len() == 4 { values[3] } else { Some(1.0) };
                let (Some([Some(x), Some(y), Some(z)]), Some(w)) = (values.first_chunk(), divisor) else {
                    return Some(syntax(line, "\"v\" needs three numbers, x y z"));
                };
                if w == 0.0 {
                    return Some(syntax(line, "the fourth coordinate is 0, a point at infinity"));
                }
                let p = DVec3::new(*x, *y, *z) / w;
                if !p.is_finite() {
                    return Some(MeshError::NonFinitePosition { vertex: vertices, position: p }.into());
                }
                vertices += 1;
            }
            Some(b"f") => {
                for word in words {
                    let Some(index) = word.split(|&b| b == b'/').next().and_then(number::<i64>) else {
                        return Some(syntax(line, format!("\"{}\" is no vertex number", shown(word))));
                    };
                    let from_start =
                        if index < 0 { i64::try_from(vertices).ok()?.wrapping_add(index) } else { index - 1 };
                    if usize::try_from(from_start).map_or(true, |i| i >= all) {
                        let message = format!("vertex {index} is named, but there are {all} (1 to {all})");
                        return Some(syntax(line, message));
                    }
                }
            }
            _ => {}
        }
    }
    None
}

/// The beginning of a word, for a message: a file may hold one of any length.
fn shown(word: &[u8]) -> String {
    String::from_utf8_lossy(&word[..word.len().min(160)]).chars().take(40).collect()
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
