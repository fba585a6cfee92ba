//! Wavefront OBJ: common text read in place ([`plain`]), all other through the `tobj` crate.
//!
//! Purpose: bytes to triangles and back. Vertices are numbered by their first use in a facet;
//! those that no facet uses are left out.
//! Why `tobj` gets a copy of the positions and faces alone ([`geometry`]): it splits vertices at groups,
//! makes facets of polylines (`l 1 2 3`), refuses files for their texture or material lines, which do not
//! matter here, and its errors name no line.
//! Must not know: other formats.

use glam::DVec3;
use tobj::LoadOptions;

use super::held::Held;
use super::{DataError, Soup};
use crate::mesh::{MeshError, TriMesh};

mod attributes;
mod plain;
pub(super) use attributes::{attributes, encode_with};

pub(super) fn decode(bytes: &[u8]) -> Result<Soup, DataError> {
    if let Some(soup) = plain::decode(bytes) {
        return Ok(soup);
    }
    let text = geometry(bytes)?;
    let options = LoadOptions { ignore_points: true, ignore_lines: true, ..LoadOptions::default() };
    let no_materials = |_: &std::path::Path| Ok((Vec::new(), Default::default()));
    let (models, _) = tobj::load_obj_buf(&mut text.as_slice(), &options, no_materials)
        .map_err(|error| locate(bytes).unwrap_or_else(|| DataError::Header(error.to_string())))?;
    let Some(mesh) = models.into_iter().next().map(|model| model.mesh) else {
        return Ok(Soup::default());
    };
    let (positions, _) = mesh.positions.as_chunks::<3>();
    let positions: Vec<DVec3> = positions.iter().map(|&p| DVec3::from_array(p)).collect();
    if positions.iter().any(|p| !p.is_finite()) {
        return Err(locate(bytes).unwrap_or_else(|| DataError::Header("a coordinate is not finite".into())));
    }
    let mut soup = Soup { positions, ..Soup::default() };
    if mesh.face_arities.is_empty() {
        soup.facets = mesh.indices.as_chunks::<3>().0.to_vec();
        return Ok(soup);
    }
    let mut rest = &mesh.indices[..];
    for &corners in &mesh.face_arities {
        let (face, after) = rest.split_at_checked(corners as usize).unwrap_or((rest, &[]));
        let corners: Vec<i64> = face.iter().map(|&v| i64::from(v)).collect();
        soup.push_polygon(&corners).map_err(DataError::Header)?;
        rest = after;
    }
    Ok(soup)
}

/// Vertices, used or not, and facets.
pub(super) fn counts(bytes: &[u8]) -> (u64, u64) {
    let (mut vertices, mut facets) = (0, 0);
    for (_, statement) in statements(bytes) {
        let mut words = Words(statement);
        match words.next() {
            Some(b"v") => vertices += 1,
            Some(b"f") => facets += words.count().saturating_sub(2) as u64,
            _ => {}
        }
    }
    (vertices, facets)
}

pub(super) fn encode(mesh: &TriMesh) -> Vec<u8> {
    encode_with(mesh, &Held::default())
}

/// The `v` and `f` lines alone, with position indices alone, continued lines joined.
fn geometry(bytes: &[u8]) -> Result<Vec<u8>, DataError> {
    let mut out = Vec::with_capacity(bytes.len());
    for (line, words) in statements(bytes) {
        let mut words = Words(words);
        match words.next() {
            Some(b"v") => {
                out.push(b'v');
                let values: Vec<_> = words.take(8).collect();
                // A fourth value alone is the homogeneous coordinate; more are colours.
                let kept = if values.len() == 4 { 4 } else { values.len().min(3) };
                for value in &values[..kept] {
                    out.push(b' ');
                    out.extend_from_slice(value);
                }
                out.push(b'\n');
            }
            Some(b"f") => {
                out.push(b'f');
                let mut corners = 0;
                for word in words {
                    let index = position_index(word);
                    if index.is_empty() {
                        // `//3`: the crate would not see the corner, and take a smaller face or none.
                        return Err(DataError::Syntax {
                            line,
                            message: format!("\"{}\" names no vertex", shown(word)),
                        });
                    }
                    out.push(b' ');
                    out.extend_from_slice(index);
                    corners += 1;
                }
                out.push(b'\n');
                if corners < 3 {
                    let message = format!("a face needs at least 3 corners and has {corners}");
                    return Err(DataError::Syntax { line, message });
                }
            }
            _ => {}
        }
    }
    Ok(out)
}

/// After a failure: the first line that is to blame.
fn locate(bytes: &[u8]) -> Option<DataError> {
    let mut vertices = 0;
    let mut faces = Vec::new();
    for (line, statement) in statements(bytes) {
        let mut words = Words(statement);
        match words.next() {
            Some(b"v") => {
                let values: Vec<Option<f64>> = words.map(number).take(8).collect();
                let divisor = if values.len() == 4 { values[3] } else { Some(1.0) };
                let (Some([Some(x), Some(y), Some(z)]), Some(w)) = (values.first_chunk(), divisor) else {
                    let message = "\"v\" needs three numbers, x y z".to_owned();
                    return Some(DataError::Syntax { line, message });
                };
                if w == 0.0 {
                    let message = "the fourth coordinate is 0, a point at infinity".to_owned();
                    return Some(DataError::Syntax { line, message });
                }
                let p = DVec3::new(*x, *y, *z) / w;
                if !p.is_finite() {
                    return Some(MeshError::NonFinitePosition { vertex: vertices, x: p.x, y: p.y, z: p.z }.into());
                }
                vertices += 1;
            }
            Some(b"f") => {
                for word in words {
                    let Some(index) = number::<i64>(position_index(word)) else {
                        let message = format!("\"{}\" is no vertex number", shown(word));
                        return Some(DataError::Syntax { line, message });
                    };
                    let from_start =
                        if index < 0 { i64::try_from(vertices).ok()?.wrapping_add(index) } else { index - 1 };
                    faces.push((line, index, from_start));
                }
            }
            _ => {}
        }
    }
    // Faces may come before their vertices, so only now is their number known.
    let bad = faces.into_iter().find(|&(_, _, i)| usize::try_from(i).map_or(true, |i| i >= vertices));
    bad.map(|(line, index, _)| {
        let message = format!("vertex {index} is named, but there are {vertices} (1 to {vertices})");
        DataError::Syntax { line, message }
    })
}

fn number<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// The beginning of a word, for a message: a file may hold one of any length.
fn shown(word: &[u8]) -> String {
    String::from_utf8_lossy(&word[..word.len().min(160)]).chars().take(40).collect()
}

fn position_index(word: &[u8]) -> &[u8] {
    &word[..word.iter().position(|&b| b == b'/').unwrap_or(word.len())]
}

/// Statements with the number of their first line. A backslash at a line's end continues it.
fn statements(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
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
struct Words<'a>(&'a [u8]);

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
