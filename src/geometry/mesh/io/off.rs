//! Geomview OFF, text. Our own reader: no well-kept crate reads it.
//!
//! Purpose: bytes to triangles with what they carry, in one pass, and back. One vertex and one face a line. After the
//! position come normals (N), colours (C) and texture coordinates (ST) of a vertex, in this order, as the keyword announces
//! them; what follows the corners of a face (colours) is left aside and named. Must not know: other formats.

use std::fmt::Write as _;

use glam::{DVec2, DVec3};

use super::held::{By, Held, Holds, Labelled, Raw, eight_bit};
use super::numbers::plain;
use super::{Codec, Counts, DataError, Soup, VertexNumbers, syntax};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{ColourDepth, Colours, Normals, PerCorner};

pub(super) const CODEC: Codec = Codec {
    extension: "off",
    media_types: &["application/x-off", "model/off", "model/x-off"],
    // Half a vertex of three short numbers, and a face of three indices.
    facet_bytes: 30,
    signature: super::packed::Signature::Words(&["OFF", "COFF", "NOFF", "CNOFF", "STOFF"]),
    decode: |bytes, wanted| decode(bytes, wanted.is_some()),
    encode,
    counts,
    holds: Holds {
        normals: By::Vertex,
        texture: By::Vertex,
        colours: true,
        opacity: true,
        scalars: false,
        regions: Labelled::None,
    },
    vertices: VertexNumbers::Kept,
};

fn decode(bytes: &[u8], wanted: bool) -> Result<Soup, DataError> {
    let mut lines = Lines { rest: bytes, line: 0 };
    let (kinds, vertices, faces) = header(&mut lines)?;
    let mut carried = (wanted && !kinds.is_empty()).then(|| Carried::of(kinds));
    let (mut more_of_vertices, mut more_of_faces) = (false, false);
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
            return Err(syntax(line, "a vertex needs three numbers, x y z"));
        };
        soup.positions.push(DVec3::new(x, y, z));
        let numbers = 3 + kinds
            .bytes()
            .map(|kind| match kind {
                b'N' => 3,
                b'C' => 4,
                b'S' => 2,
                _ => 0,
            })
            .sum::<usize>();
        more_of_vertices |= wanted && text.split_ascii_whitespace().nth(numbers).is_some();
        if let Some(carried) = &mut carried {
            carried.push(text.split_ascii_whitespace().skip(3).take(9).collect());
        }
    }
    for index in 0..faces {
        let (line, text) = lines.next()?.ok_or_else(|| cut("faces", index, faces))?;
        let mut words = text.split_ascii_whitespace().map(|w| w.parse::<i64>().ok());
        let syntax = |message: &str| syntax(line, message);
        let Some(count) = words.next().flatten().and_then(|n| usize::try_from(n).ok()) else {
            return Err(syntax("a face begins with the number of its corners"));
        };
        // A corner has two bytes at least.
        let mut polygon = soup.begin_polygon(vertices, count.min(text.len() / 2 + 1));
        let mut there = 0;
        for word in words.by_ref().take(count) {
            let corner = word.ok_or_else(|| syntax("a corner is a whole number, the vertex from 0"))?;
            soup.push_corner(&mut polygon, corner).map_err(|message| syntax(&message))?;
            there += 1;
        }
        if there < count {
            return Err(if lines.rest.is_empty() {
                cut("faces", index, faces)
            } else {
                syntax(&format!("{count} corners are announced and {there} are there"))
            });
        }
        soup.end_polygon(&polygon).map_err(|message| syntax(&message))?;
        more_of_faces |= wanted && words.next().is_some();
    }
    soup.raw = carried.map(|carried| carried.finish(&soup.facets)).unwrap_or_default();
    if more_of_vertices {
        let text = format!("\"{kinds}OFF\" announces none; colours are those of COFF");
        soup.raw.unreadable("more numbers of vertices", text);
    }
    if more_of_faces {
        soup.raw.unreadable("colours of faces", "a surface carries colours of vertices".to_owned());
    }
    Ok(soup)
}

#[derive(Default)]
struct Carried {
    normals: Option<Vec<DVec3>>,
    texture: Option<Vec<DVec2>>,
    /// An opacity that is not there is infinite.
    colours: Option<Vec<[f64; 4]>>,
    /// Eight bits: integers up to 255 throughout, one of them above 1.
    has_fractions: bool,
    above_one: bool,
}

impl Carried {
    /// The attributes that the letters before the keyword announce.
    fn of(kinds: &str) -> Self {
        Self {
            normals: kinds.contains('N').then(Vec::new),
            texture: kinds.starts_with("ST").then(Vec::new),
            colours: kinds.contains('C').then(Vec::new),
            ..Self::default()
        }
    }

    /// Takes the words of a vertex after its position. What is missing or no number is NaN, and refused later.
    fn push(&mut self, mut words: Vec<&str>) {
        let number = |word: Option<&&str>| word.and_then(|w| w.parse::<f64>().ok()).unwrap_or(f64::NAN);
        if let Some(normals) = &mut self.normals {
            normals.push(DVec3::new(number(words.first()), number(words.get(1)), number(words.get(2))));
            words.drain(..words.len().min(3));
        }
        if let Some(texture) = &mut self.texture {
            let uv = words.split_off(words.len().saturating_sub(2));
            texture.push(DVec2::new(number(uv.first()), number(uv.get(1))));
        }
        if let Some(colours) = &mut self.colours {
            let rgb = [words.first(), words.get(1), words.get(2)].map(number);
            let alpha = words.get(3).map(|word| number(Some(word)));
            let are_integers = words.iter().take(4).all(|w| w.bytes().all(|b| b.is_ascii_digit()));
            self.has_fractions |= !(are_integers && rgb.iter().chain(&alpha).all(|x| *x <= 255.0));
            self.above_one |= rgb.iter().chain(&alpha).any(|x| *x > 1.0);
            colours.push([rgb[0], rgb[1], rgb[2], alpha.unwrap_or(f64::INFINITY)]);
        }
    }

    fn finish(self, facets: &[[u32; 3]]) -> Raw {
        let eight = !self.has_fractions && self.above_one;
        let (scale, depth) = if eight { (255.0, ColourDepth::Eight) } else { (1.0, ColourDepth::Float) };
        let component = |x: f64| if x == f64::INFINITY { 1.0 } else { x / scale };
        Raw {
            normals: self.normals.map(Normals::PerVertex),
            texture: self.texture.map(|values| PerCorner { values, corners: facets.to_vec() }),
            colours: self.colours.map(|all| Colours { values: all.iter().map(|c| c.map(component)).collect(), depth }),
            ..Raw::default()
        }
    }
}

/// Vertices and facets, of every line its first word at most.
fn counts(bytes: &[u8]) -> Option<Counts> {
    let mut lines = Lines { rest: bytes, line: 0 };
    let (_, vertices, faces) = header(&mut lines).ok()?;
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
    Some(Counts { vertices: vertices as u64, facets, made_bytes: 0 })
}

fn encode(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let mut text = String::with_capacity(96 * vertices + 24 * facets);
    let mark = |there: bool, letters| if there { letters } else { "" };
    let kinds = [mark(held.uv.is_some(), "ST"), mark(held.colours.is_some(), "C"), mark(held.normals.is_some(), "N")];
    let _ = writeln!(text, "{}OFF\n{vertices} {facets} 0", kinds.concat());
    // Whole numbers none of which is above 1 would be read as floating point.
    let eight = held
        .colours
        .is_some_and(|c| c.depth == ColourDepth::Eight && c.values.iter().flatten().any(|&x| eight_bit(x) > 1));
    // Debug formatting is the shortest text that reads back as the same bits.
    for (vertex, p) in mesh.positions().iter().enumerate() {
        let _ = write!(text, "{:?} {:?} {:?}", p.x, p.y, p.z);
        if let Some(n) = held.normals.as_ref().map(|n| n[vertex]) {
            let _ = write!(text, " {:?} {:?} {:?}", n.x, n.y, n.z);
        }
        if let Some(colours) = held.colours {
            let colour = colours.values[vertex];
            let _ = if eight {
                let [r, g, b, a] = colour.map(eight_bit);
                write!(text, " {r} {g} {b} {a}")
            } else {
                let [r, g, b, a] = colour;
                write!(text, " {r:?} {g:?} {b:?} {a:?}")
            };
        }
        if let Some(uv) = held.uv.as_ref().map(|uv| uv[vertex]) {
            let _ = write!(text, " {:?} {:?}", uv.x, uv.y);
        }
        text.push('\n');
    }
    for [a, b, c] in mesh.facets() {
        let _ = writeln!(text, "3 {a} {b} {c}");
    }
    Ok(text.into_bytes())
}

/// Reads the keyword, if any, and the counts, maybe on its line: letters before it, numbers of vertices and faces.
fn header<'a>(lines: &mut Lines<'a>) -> Result<(&'a str, usize, usize), DataError> {
    let short = || DataError::Truncated("it ends inside the header".to_owned());
    let (mut line, mut text) = lines.next()?.ok_or_else(short)?;
    let mut kinds = "";
    let first = text.split_ascii_whitespace().next().unwrap_or_default();
    if !first.starts_with(|c: char| c.is_ascii_digit()) || first.ends_with("OFF") {
        if !matches!(first, "OFF" | "COFF" | "NOFF" | "CNOFF" | "STOFF" | "STCOFF" | "STNOFF" | "STCNOFF") {
            return Err(syntax(line, format!("\"{}\" is not one of OFF, COFF, NOFF", plain(first, 16))));
        }
        kinds = first.strip_suffix("OFF").unwrap_or_default();
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
        return Err(syntax(line, "expected the numbers of vertices, faces and edges"));
    };
    Ok((kinds, vertices, faces))
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
                let text = std::str::from_utf8(text).map_err(|_| syntax(self.line, "this is not text"))?;
                return Ok(Some((self.line, text)));
            }
        }
        Ok(None)
    }
}
