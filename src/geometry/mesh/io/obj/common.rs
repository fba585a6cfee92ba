//! OBJ statements as nearly all files have them: one a line, vertices of three numbers with or without a colour, indices that
//! count from 1.
//!
//! Purpose: reads a file of such statements in place, in pieces on all threads. The crate needs a copy of it, a string for each
//! line and a hash map of the vertices, and takes twice as long on one thread. Invariant: gives
//! what [`super::dialects`] gives, to the bit, or nothing; what is wrong with a file is said there. Must not know: messages.

use glam::{DVec2, DVec3};

use super::{Corner, Face, NONE, Statements, WHITE};
use crate::tasks;

/// About so many bytes are one task.
const PIECE: usize = 1 << 19;

/// The statements, if all that matter are as the head of this file says. What a surface carries is read if it is `wanted`.
pub(super) fn read(bytes: &[u8], wanted: bool) -> Option<Statements> {
    let pieces = pieces(bytes);
    let parts = tasks::alone(pieces.len(), |k| Part::read(pieces[k], wanted));
    let mut parts: Vec<Statements> = parts.into_iter().collect::<Option<_>>()?;
    // One that names no vertex is another's to say, before there are lists of all.
    let vertices: usize = parts.iter().map(|part| part.vertices).sum();
    let is_known = |part: usize| parts[part].facets.iter().flatten().all(|&v| (v as usize) < vertices);
    if tasks::alone(parts.len(), is_known).contains(&false) {
        return None;
    }
    let positions = parts.iter_mut().map(|part| std::mem::take(&mut part.positions)).collect();
    let facets: Vec<_> = parts.iter_mut().map(|part| std::mem::take(&mut part.facets)).collect();
    let counts: Vec<usize> = facets.iter().map(Vec::len).collect();
    let (positions, facets) = rayon::join(|| joined(positions), || joined(facets));
    let mut all = Statements { positions, facets, ..Statements::default() };
    let mut begin = 0;
    for (part, count) in parts.into_iter().zip(counts) {
        let first = u32::try_from(begin).ok()?;
        append(&mut all.colours, part.colours, all.vertices, all.positions.len(), WHITE);
        append(&mut all.texture_corners, part.texture_corners, begin, all.facets.len(), [NONE; 3]);
        append(&mut all.normal_corners, part.normal_corners, begin, all.facets.len(), [NONE; 3]);
        all.fans.extend(part.fans.iter().map(|&(fan, count)| (first + fan, count)));
        all.texture.extend(part.texture);
        all.normals.extend(part.normals);
        all.vertices += part.vertices;
        begin += count;
    }
    (!all.facets.is_empty()).then_some(all)
}

/// Gives back room for many more elements.
fn shrink<T>(list: &mut Vec<T>) {
    if list.capacity() > 2 * list.len() {
        list.shrink_to_fit();
    }
}

/// The lists as one, each freed once it is there.
fn joined<T: Copy>(mut lists: Vec<Vec<T>>) -> Vec<T> {
    if lists.len() == 1 {
        return lists.pop().unwrap_or_default();
    }
    let mut all = Vec::with_capacity(lists.iter().map(Vec::len).sum());
    lists.into_iter().for_each(|list| all.extend_from_slice(&list));
    all
}

/// Appends a part's list to one that has as many as there were before it, or stops earlier; `most` are there at the end.
fn append<T: Copy>(all: &mut Vec<T>, part: Vec<T>, before: usize, most: usize, fill: T) {
    if part.is_empty() {
        return;
    }
    if all.is_empty() {
        all.reserve_exact(most);
    }
    all.resize(before, fill);
    all.extend(part);
}

/// Whole lines, about [`PIECE`] bytes of them at a time.
fn pieces(bytes: &[u8]) -> Vec<&[u8]> {
    let mut pieces = Vec::with_capacity(bytes.len() / PIECE + 1);
    let mut rest = bytes;
    while rest.len() > PIECE {
        let end = rest[PIECE..].iter().position(|&b| b == b'\n').map_or(rest.len(), |n| PIECE + n + 1);
        let (piece, after) = rest.split_at(end);
        pieces.push(piece);
        rest = after;
    }
    pieces.push(rest);
    pieces
}

/// A reader of some lines. Every method gives nothing where a statement is another's to read.
struct Part<'a> {
    words: Words<'a>,
    wanted: bool,
    found: Statements,
}

impl<'a> Part<'a> {
    fn read(text: &'a [u8], wanted: bool) -> Option<Statements> {
        let words = Words { rest: text, last: b' ' };
        let mut part = Part { words, wanted, found: Statements { bytes: text.len(), ..Statements::default() } };
        // A corner stands behind a blank. A list that grows would take twice as much for a while.
        let blanks = text.iter().filter(|byte| matches!(byte, b' ' | b'\t' | b'\r' | 0x0c)).count();
        part.found.facets.reserve_exact(blanks.min(text.len() / 2));
        while !part.words.rest.is_empty() {
            match part.words.next() {
                Some(b"v") => part.vertex()?,
                Some(b"f") => part.face()?,
                Some(b"vt") if wanted => part.texture()?,
                Some(b"vn") if wanted => part.normal()?,
                // A backslash is a blank: there may be one of the above.
                Some(word) if word[0] != b'#' && word.contains(&b'\\') => return None,
                _ => {}
            }
            part.words.end_line()?;
        }
        // All parts are held until they are joined.
        shrink(&mut part.found.positions);
        shrink(&mut part.found.facets);
        shrink(&mut part.found.texture_corners);
        shrink(&mut part.found.normal_corners);
        Some(part.found)
    }

    fn vertex(&mut self) -> Option<()> {
        let position = DVec3::new(self.words.number()?, self.words.number()?, self.words.number()?);
        // A colour may follow. Four numbers are a point over its last coordinate; other counts are unclear.
        if !self.wanted {
            if !matches!(self.words.count()?, 0 | 3) {
                return None;
            }
        } else if let Some(red) = self.words.value()? {
            let colour = [red, self.words.value()??, self.words.value()??, 1.0];
            if self.words.value()?.is_some() {
                return None;
            }
            self.found.push_colour(colour);
        }
        self.found.push_position(position, self.words.rest.len());
        self.found.vertices += 1;
        position.is_finite().then_some(())
    }

    fn texture(&mut self) -> Option<()> {
        let u = self.words.number()?;
        let v = self.words.value()?.unwrap_or(0.0);
        self.found.texture.push(DVec2::new(u, v));
        Some(())
    }

    fn normal(&mut self) -> Option<()> {
        let normal = DVec3::new(self.words.number()?, self.words.number()?, self.words.number()?);
        self.found.normals.push(normal);
        Some(())
    }

    fn face(&mut self) -> Option<()> {
        let mut face = Face::default();
        while let Some(word) = self.words.next().filter(|word| word[0] != b'#') {
            let plain = |vertex| Corner { vertex, texture: NONE, normal: NONE };
            let corner = if self.wanted { corner(word)? } else { plain(vertex(word)?) };
            self.found.push_corner(&mut face, corner, self.words.rest.len());
        }
        self.found.end_face(&face);
        (face.corners >= 3).then_some(())
    }
}

/// The vertex of a corner.
fn vertex(word: &[u8]) -> Option<u32> {
    let (vertex, rest) = index(word)?;
    (rest.is_empty() || !rest.contains(&b'\\')).then_some(vertex)
}

/// `v`, `v/vt`, `v//vn` or `v/vt/vn`.
fn corner(word: &[u8]) -> Option<Corner> {
    let (vertex, rest) = index(word)?;
    let mut corner = Corner { vertex, texture: NONE, normal: NONE };
    let Some((_, rest)) = rest.split_first() else { return Some(corner) };
    let mut parts = rest.split(|&b| b == b'/');
    for slot in [&mut corner.texture, &mut corner.normal] {
        if let Some(part) = parts.next().filter(|part| !part.is_empty()) {
            let (index, rest) = index(part)?;
            *slot = index;
            if !rest.is_empty() {
                return None;
            }
        }
    }
    parts.all(|part| !part.contains(&b'\\')).then_some(corner)
}

/// An index from 1, up to a slash, as one from 0.
fn index(word: &[u8]) -> Option<(u32, &[u8])> {
    let mut index = 0u32;
    let mut end = word.len();
    for (at, &byte) in word.iter().enumerate() {
        match byte {
            b'0'..=b'9' => index = index.checked_mul(10)?.checked_add(u32::from(byte - b'0'))?,
            b'/' => {
                end = at;
                break;
            }
            _ => return None,
        }
    }
    Some((index.checked_sub(1)?, &word[end..]))
}

/// Words of a line, then of the next.
struct Words<'a> {
    rest: &'a [u8],
    /// The last byte of the line's last word so far.
    last: u8,
}

impl<'a> Words<'a> {
    /// Nothing at the line's end.
    fn next(&mut self) -> Option<&'a [u8]> {
        let start = self.rest.iter().position(|&b| b == b'\n' || !b.is_ascii_whitespace()).unwrap_or(self.rest.len());
        let rest = &self.rest[start..];
        let (word, after) = rest.split_at(rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len()));
        self.rest = after;
        self.last = *word.last()?;
        Some(word)
    }

    /// A number that has to be there.
    fn number(&mut self) -> Option<f64> {
        super::dialects::number(self.next()?)
    }

    /// A number, or `None` at the end of the line or before a comment.
    #[expect(clippy::option_option, reason = "nothing at all is a word that is no number")]
    fn value(&mut self) -> Option<Option<f64>> {
        let word = self.next().filter(|word| word[0] != b'#');
        word.map_or(Some(None), |word| super::dialects::number(word).map(Some))
    }

    /// How many words are left in the line before a comment; nothing if a backslash is in one.
    fn count(&mut self) -> Option<usize> {
        let mut count = 0;
        while let Some(word) = self.next().filter(|word| word[0] != b'#') {
            if word.contains(&b'\\') {
                return None;
            }
            count += 1;
        }
        Some(count)
    }

    /// Goes to the next line; nothing if this one is continued there.
    fn end_line(&mut self) -> Option<()> {
        let end = self.rest.iter().position(|&b| b == b'\n').unwrap_or(self.rest.len());
        let (line, rest) = self.rest.split_at(end);
        let last = *line.trim_ascii_end().last().unwrap_or(&self.last);
        (self.rest, self.last) = (rest.get(1..).unwrap_or_default(), b' ');
        (last != b'\\').then_some(())
    }
}
