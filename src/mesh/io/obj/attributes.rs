//! What an OBJ file carries: `vt`, `vn`, colours after the position.
//!
//! Corners without a texture coordinate get (0, 0), as renderers take them, and corners without a normal none;
//! vertices without a colour are white. A `v` line with six numbers ends in a colour; with seven it is not
//! clear what they are, and they are left aside.

use std::fmt::Write as _;

use glam::{DVec2, DVec3};

use super::super::held::{Held, Raw};
use super::{Words, number, shown, statements};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{AttributeError, ColourDepth, Colours, Normals, PerCorner};

const NONE: u32 = u32::MAX;
const WHITE: [f64; 4] = [1.0; 4];

/// What one corner names, from 0, or [`NONE`].
#[derive(Clone, Copy)]
struct Corner {
    vertex: u32,
    texture: u32,
    normal: u32,
}

/// The lines of a file.
#[derive(Default)]
struct Lines {
    vertices: usize,
    /// As many as vertices up to the last one with a colour; empty if there is none.
    colours: Vec<[f64; 4]>,
    texture: Vec<DVec2>,
    normals: Vec<DVec3>,
    facets: Vec<[Corner; 3]>,
    texture_used: bool,
    normals_used: bool,
    raw: Raw,
}

/// `bytes` are those that `mesh` was read from.
pub(in super::super) fn attributes(bytes: &[u8], mesh: &TriMesh) -> Raw {
    let mut lines = Lines::default();
    let mut corners = Vec::new();
    for (line, statement) in statements(bytes) {
        let mut words = Words(statement);
        match words.next() {
            Some(b"v") => lines.vertex(line, words),
            Some(b"vt") => lines.take_texture(line, words),
            Some(b"vn") => lines.take_normal(line, words),
            Some(b"f") => lines.take_face(line, words, &mut corners),
            _ => {}
        }
    }
    lines.finish(mesh)
}

impl Lines {
    fn vertex(&mut self, line: usize, words: Words<'_>) {
        let mut values: [&[u8]; 8] = [&[]; 8];
        let mut count = 0;
        for (slot, word) in values.iter_mut().zip(words) {
            *slot = word;
            count += 1;
        }
        if count == 6 {
            self.colours.resize(self.vertices, WHITE);
            // What is no number is refused with the others that are not finite.
            let [r, g, b] = [values[3], values[4], values[5]].map(|word| number(word).unwrap_or(f64::NAN));
            self.colours.push([r, g, b, 1.0]);
        } else if count > 6 && self.colours.is_empty() {
            let message = format!("line {line}: {count} numbers, of which only 3, 4 or 6 can be understood");
            self.leave_aside("colours", message);
        }
        self.vertices += 1;
    }

    fn take_texture(&mut self, line: usize, mut words: Words<'_>) {
        let u = words.next().and_then(number);
        let v = words.next().map_or(Some(0.0), number);
        let (Some(u), Some(v)) = (u, v) else {
            self.leave_aside("texture coordinates", format!("line {line}: \"vt\" needs one or two numbers"));
            return self.texture.push(DVec2::ZERO);
        };
        self.texture.push(DVec2::new(u, v));
    }

    fn take_normal(&mut self, line: usize, words: Words<'_>) {
        let mut numbers = words.map(number);
        let (Some(Some(x)), Some(Some(y)), Some(Some(z))) = (numbers.next(), numbers.next(), numbers.next()) else {
            self.leave_aside("normals", format!("line {line}: \"vn\" needs three numbers"));
            return self.normals.push(DVec3::ZERO);
        };
        self.normals.push(DVec3::new(x, y, z));
    }

    fn take_face(&mut self, line: usize, words: Words<'_>, corners: &mut Vec<Corner>) {
        corners.clear();
        for word in words {
            let mut parts = word.split(|&b| b == b'/');
            let position = parts.next().unwrap_or_default();
            // The plain reader has taken the position's index; this one is right, or no facet comes of it.
            let vertex = number(position).and_then(|i| from_zero(i, self.vertices)).unwrap_or(NONE);
            let (texture, normal) = (parts.next(), parts.next());
            let texture = self.index(line, word, texture, self.texture.len(), "texture coordinates");
            let normal = self.index(line, word, normal, self.normals.len(), "normals");
            self.texture_used |= texture != NONE;
            self.normals_used |= normal != NONE;
            corners.push(Corner { vertex, texture, normal });
        }
        let [first, rest @ ..] = &corners[..] else { return };
        self.facets.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
    }

    /// The index in one part of a corner's word, if there is one.
    fn index(&mut self, line: usize, word: &[u8], part: Option<&[u8]>, count: usize, what: &str) -> u32 {
        let Some(part) = part.filter(|part| !part.is_empty()) else { return NONE };
        number(part).and_then(|i| from_zero(i, count)).unwrap_or_else(|| {
            self.leave_aside(what, format!("line {line}: \"{}\" names none", shown(word)));
            NONE
        })
    }

    fn leave_aside(&mut self, what: &str, message: String) {
        if !self.is_aside(what) {
            self.raw.unreadable(what, message);
        }
    }

    fn is_aside(&self, what: &str) -> bool {
        self.raw.unreadable.iter().any(|error| attribute(error) == what)
    }

    /// Numbers everything as `mesh` does.
    fn finish(mut self, mesh: &TriMesh) -> Raw {
        let facets = mesh.facets();
        if self.facets.len() != facets.len() {
            let message = format!("{} facets name them and the surface has {}", self.facets.len(), facets.len());
            self.raw.unreadable("all attributes", message);
            return self.raw;
        }
        if !self.colours.is_empty() && !self.is_aside("colours") {
            self.colours.resize(self.vertices, WHITE);
            let mut values = vec![WHITE; mesh.positions().len()];
            for (corner, &vertex) in self.facets.iter().flatten().zip(facets.iter().flatten()) {
                values[vertex as usize] = self.colours.get(corner.vertex as usize).copied().unwrap_or(WHITE);
            }
            let depth = depth(&values);
            self.raw.colours = Some(Colours { values, depth });
        }
        if self.texture_used && !self.is_aside("texture coordinates") {
            let corners = indices(&self.facets, |c| c.texture, &mut self.texture);
            self.raw.texture = Some(PerCorner { values: std::mem::take(&mut self.texture), corners });
        }
        if self.normals_used && !self.is_aside("normals") {
            let corners = indices(&self.facets, |c| c.normal, &mut self.normals);
            let normals = PerCorner { values: std::mem::take(&mut self.normals), corners };
            // Checked before they are looked up: an index may still be too large.
            let known = normals.corners.iter().flatten().all(|&i| (i as usize) < normals.values.len());
            let per_vertex = known.then(|| normals.per_vertex(facets, mesh.positions().len())).flatten();
            self.raw.normals = Some(per_vertex.map_or(Normals::PerCorner(normals), Normals::PerVertex));
        }
        self.raw
    }
}

fn attribute(error: &AttributeError) -> &str {
    match error {
        AttributeError::Unreadable { attribute, .. } => attribute,
        _ => "",
    }
}

/// An index from 1, or from the end if negative, as one from 0. Later lines may still bring what it names.
fn from_zero(index: i64, count: usize) -> Option<u32> {
    let index = match index {
        0 => return None,
        1.. => index - 1,
        _ => i64::try_from(count).ok()?.checked_add(index)?,
    };
    u32::try_from(index).ok().filter(|&i| i != NONE)
}

/// Indices of the corners; those that name nothing get a default value of their own.
fn indices<T: Default>(facets: &[[Corner; 3]], of: impl Fn(&Corner) -> u32, values: &mut Vec<T>) -> Vec<[u32; 3]> {
    let missing = u32::try_from(values.len()).unwrap_or(NONE);
    let mut corners: Vec<[u32; 3]> = facets.iter().map(|f| [of(&f[0]), of(&f[1]), of(&f[2])]).collect();
    if facets.iter().flatten().any(|c| of(c) == NONE) {
        // An index that is too large must stay so, and not become the default's.
        corners.iter_mut().flatten().filter(|i| **i == missing).for_each(|i| *i = missing + 1);
        values.push(T::default());
        corners.iter_mut().flatten().filter(|i| **i == NONE).for_each(|i| *i = missing);
    }
    corners
}

/// Eight bits if every component is a 255th, and one of them is between 0 and 1.
fn depth(values: &[[f64; 4]]) -> ColourDepth {
    let mut between = false;
    for &x in values.iter().flatten() {
        let k = (x * 255.0).round();
        if !(0.0..=255.0).contains(&k) || k / 255.0 != x {
            return ColourDepth::Float;
        }
        between |= k != 0.0 && k != 255.0;
    }
    if between { ColourDepth::Eight } else { ColourDepth::Float }
}

pub(in super::super) fn encode_with(mesh: &TriMesh, held: &Held<'_>) -> Vec<u8> {
    let mut text = String::with_capacity(128 * mesh.positions().len() + 32 * mesh.facets().len());
    for (vertex, p) in mesh.positions().iter().enumerate() {
        let _ = write!(text, "v {:?} {:?} {:?}", p.x, p.y, p.z);
        if let Some([r, g, b, _]) = held.colours.map(|c| c.values[vertex]) {
            let _ = write!(text, " {r:?} {g:?} {b:?}");
        }
        text.push('\n');
    }
    if let Some(texture) = held.corner_uv {
        for uv in &texture.values {
            let _ = writeln!(text, "vt {:?} {:?}", uv.x, uv.y);
        }
    }
    let normals = held.corner_normals.map(|n| &n.values).or(held.normals.as_ref());
    for n in normals.into_iter().flatten() {
        let _ = writeln!(text, "vn {:?} {:?} {:?}", n.x, n.y, n.z);
    }
    for (facet, vertices) in mesh.facets().iter().enumerate() {
        text.push('f');
        for (corner, &vertex) in vertices.iter().enumerate() {
            let texture = held.corner_uv.map(|t| u64::from(t.corners[facet][corner]) + 1);
            let normal = held.corner_normals.map(|n| n.corners[facet][corner]);
            let normal = normal.or(held.normals.as_ref().map(|_| vertex)).map(|n| u64::from(n) + 1);
            let vertex = u64::from(vertex) + 1;
            let _ = match (texture, normal) {
                (None, None) => write!(text, " {vertex}"),
                (Some(t), None) => write!(text, " {vertex}/{t}"),
                (None, Some(n)) => write!(text, " {vertex}//{n}"),
                (Some(t), Some(n)) => write!(text, " {vertex}/{t}/{n}"),
            };
        }
        text.push('\n');
    }
    text.into_bytes()
}
