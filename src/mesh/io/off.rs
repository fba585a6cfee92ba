//! Geomview OFF, text. Our own reader: no well-kept crate reads it.
//!
//! Purpose: bytes to triangles and back. One vertex and one face a line; what follows the
//! position (normals of NOFF, colours of COFF) or the corners (colours) is left aside.
//! Must not know: other formats.

use glam::DVec3;

use super::held::Held;
use super::{DataError, Soup};
use crate::mesh::TriMesh;

mod attributes;
pub(super) use attributes::{attributes, encode_with};

pub(super) fn decode(bytes: &[u8]) -> Result<Soup, DataError> {
    let mut lines = Lines { rest: bytes, line: 0 };
    let (vertices, faces) = header(&mut lines)?;
    let mut soup = Soup::default();
    // Counts are the file's word. A line of a vertex has at least 6 bytes, of a face 8.
    soup.positions.reserve(vertices.min(bytes.len() / 6));
    soup.facets.reserve(faces.min(bytes.len() / 8));
    for index in 0..vertices {
        let (line, text) = lines.next()?.ok_or_else(|| cut("vertices", index, vertices))?;
        let mut words = text.split_ascii_whitespace().map(|w| w.parse::<f64>().ok());
        let (Some(Some(x)), Some(Some(y)), Some(Some(z))) = (words.next(), words.next(), words.next()) else {
            // A cut through the last number's line leaves too few of them.
            if lines.rest.is_empty() && text.split_ascii_whitespace().count() < 3 {
                return Err(cut("vertices", index, vertices));
            }
            return Err(DataError::Syntax { line, message: "a vertex needs three numbers, x y z".to_owned() });
        };
        soup.positions.push(DVec3::new(x, y, z));
    }
    let mut corners = Vec::new();
    for index in 0..faces {
        let (line, text) = lines.next()?.ok_or_else(|| cut("faces", index, faces))?;
        let mut words = text.split_ascii_whitespace().map(|w| w.parse::<i64>().ok());
        let syntax = |message: String| DataError::Syntax { line, message };
        let Some(count) = words.next().flatten().and_then(|n| usize::try_from(n).ok()) else {
            return Err(syntax("a face begins with the number of its corners".to_owned()));
        };
        corners.clear();
        for word in words.by_ref().take(count) {
            corners.push(word.ok_or_else(|| syntax("a corner is a whole number, the vertex from 0".to_owned()))?);
        }
        if corners.len() < count {
            return Err(if lines.rest.is_empty() {
                cut("faces", index, faces)
            } else {
                syntax(format!("{count} corners are announced and {} are there", corners.len()))
            });
        }
        soup.push_polygon(&corners).map_err(syntax)?;
    }
    Ok(soup)
}

/// Vertices and facets, of every line its first word at most.
pub(super) fn counts(bytes: &[u8]) -> Option<(u64, u64)> {
    let mut lines = Lines { rest: bytes, line: 0 };
    let (vertices, faces) = header(&mut lines).ok()?;
    for _ in 0..vertices {
        lines.next().ok()??;
    }
    let mut facets = 0u64;
    for _ in 0..faces {
        let (_, text) = lines.next().ok()??;
        let corners: usize = text.split_ascii_whitespace().next()?.parse().ok()?;
        // A corner has two bytes at least.
        facets += corners.min(text.len() / 2).saturating_sub(2) as u64;
    }
    Some((vertices as u64, facets))
}

pub(super) fn encode(mesh: &TriMesh) -> Vec<u8> {
    encode_with(mesh, &Held::default())
}

/// Reads the keyword, which may be missing, and the counts, which may be on its line.
fn header(lines: &mut Lines) -> Result<(usize, usize), DataError> {
    let short = || DataError::Truncated("it ends inside the header".to_owned());
    let (mut line, mut text) = lines.next()?.ok_or_else(short)?;
    let first = text.split_ascii_whitespace().next().unwrap_or_default();
    if !first.starts_with(|c: char| c.is_ascii_digit()) || first.ends_with("OFF") {
        if !matches!(first, "OFF" | "COFF" | "NOFF" | "CNOFF" | "STOFF" | "STCOFF" | "STNOFF" | "STCNOFF") {
            let message = format!("\"{}\" is not one of OFF, COFF, NOFF", first.chars().take(16).collect::<String>());
            return Err(DataError::Syntax { line, message });
        }
        text = text.trim_start()[first.len()..].trim();
        if text.starts_with("BINARY") {
            return Err(DataError::Header("binary OFF is not read; export it as text or as .ply".to_owned()));
        }
        if text.is_empty() {
            (line, text) = lines.next()?.ok_or_else(short)?;
        }
    }
    let mut counts = text.split_ascii_whitespace().map(|w| w.parse::<usize>().ok());
    let (Some(Some(vertices)), Some(Some(faces))) = (counts.next(), counts.next()) else {
        if lines.rest.is_empty() {
            return Err(short());
        }
        return Err(DataError::Syntax {
            line,
            message: "expected the numbers of vertices, faces and edges".to_owned(),
        });
    };
    Ok((vertices, faces))
}

fn cut(what: &str, read: usize, declared: usize) -> DataError {
    DataError::Truncated(format!("{declared} {what} are declared and {read} are there"))
}

/// Lines that hold something, with their number, comments removed.
struct Lines<'a> {
    rest: &'a [u8],
    line: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Result<Option<(usize, &'a str)>, DataError> {
        while !self.rest.is_empty() {
            self.line += 1;
            let end = self.rest.iter().position(|&b| b == b'\n').unwrap_or(self.rest.len());
            let text = &self.rest[..end];
            self.rest = &self.rest[(end + 1).min(self.rest.len())..];
            let text = text[..text.iter().position(|&b| b == b'#').unwrap_or(end)].trim_ascii();
            if !text.is_empty() {
                let message = || DataError::Syntax { line: self.line, message: "this is not text".to_owned() };
                return std::str::from_utf8(text).map(|text| Some((self.line, text))).map_err(|_| message());
            }
        }
        Ok(None)
    }
}
