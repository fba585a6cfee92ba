//! OBJ text as nearly all files have it: vertices of three numbers, faces of plain positive indices, a line each.
//!
//! Purpose: reads such text in place, in pieces on all threads. The crate needs a cleaned copy of it, a string for
//! each line, a list for each face and a hash map of the vertices, and is half as fast on one thread.
//! Invariant: gives what the crate gives, to the bit, or nothing; what is wrong with a file is for others to say. The
//! same whatever the number of threads. Must not know: attributes, but for whether there are any.

use glam::DVec3;
use rayon::prelude::*;

use super::super::Soup;
use super::super::polygons::Fan;

/// About so many bytes are one task.
const PIECE: usize = 1 << 19;

/// The surface, if every line that matters is as the head of this file says.
pub(super) fn decode(bytes: &[u8]) -> Option<Soup> {
    let parts: Vec<Part> = pieces(bytes).into_par_iter().map(Part::read).collect::<Option<_>>()?;
    let mut positions = Vec::with_capacity(parts.iter().map(|part| part.positions.len()).sum());
    parts.iter().for_each(|part| positions.extend_from_slice(&part.positions));
    let facets = parts.iter().map(|part| part.facets.len()).sum();
    let mut soup = Soup { bare: parts.iter().all(|part| part.bare), ..Soup::default() };
    soup.facets.reserve_exact(facets);
    soup.positions.reserve(positions.len());
    // Vertices get their numbers by first use.
    const UNUSED: u32 = u32::MAX;
    let mut number = vec![UNUSED; positions.len()];
    let mut before = 0;
    for part in &parts {
        let begin = u32::try_from(before).ok()?;
        soup.fans.extend(part.fans.iter().map(|&(first, count)| (begin + first, count)));
        before += part.facets.len();
    }
    for facet in parts.iter().flat_map(|part| &part.facets) {
        let mut corners = [0; 3];
        for (corner, &index) in corners.iter_mut().zip(facet) {
            let slot = number.get_mut(index as usize - 1)?;
            if *slot == UNUSED {
                *slot = u32::try_from(soup.positions.len()).ok().filter(|&n| n < UNUSED)?;
                soup.positions.push(positions[index as usize - 1]);
            }
            *corner = *slot;
        }
        soup.facets.push(corners);
    }
    (!soup.facets.is_empty()).then_some(soup)
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

/// The surface's lines among some.
struct Part {
    positions: Vec<DVec3>,
    /// Vertices counted from 1, over the whole file.
    facets: Vec<[u32; 3]>,
    /// Polygons with more than three corners, by the facets of this part.
    fans: Vec<Fan>,
    /// Whether no line has any attribute.
    bare: bool,
}

impl Part {
    fn read(text: &[u8]) -> Option<Self> {
        let mut part = Self { positions: Vec::new(), facets: Vec::new(), fans: Vec::new(), bare: true };
        let mut words = Words { rest: text, last: b' ' };
        while !words.rest.is_empty() {
            match words.next() {
                Some(b"v") => part.vertex(&mut words)?,
                Some(b"f") => part.face(&mut words)?,
                Some(b"vt" | b"vn") => part.bare = false,
                _ => {}
            }
            words.end_line()?;
        }
        Some(part)
    }

    fn vertex(&mut self, words: &mut Words<'_>) -> Option<()> {
        let mut number = || std::str::from_utf8(words.next()?).ok()?.parse::<f64>().ok();
        let position = DVec3::new(number()?, number()?, number()?);
        match words.count()? {
            0 => {}
            // A colour. Four numbers are a point over its last coordinate; other counts are unclear.
            3 => self.bare = false,
            _ => return None,
        }
        self.positions.push(position);
        position.is_finite().then_some(())
    }

    fn face(&mut self, words: &mut Words<'_>) -> Option<()> {
        let (first, mut last) = (self.corner(words.next()?)?, self.corner(words.next()?)?);
        let third = self.corner(words.next()?)?;
        let begin = self.facets.len();
        self.facets.push([first, last, third]);
        last = third;
        while let Some(word) = words.next() {
            if word[0] == b'#' {
                break;
            }
            let next = self.corner(word)?;
            self.facets.push([first, last, next]);
            last = next;
        }
        let count = self.facets.len() - begin;
        if count > 1 {
            self.fans.push((u32::try_from(begin).ok()?, u32::try_from(count).ok()?));
        }
        Some(())
    }

    fn corner(&mut self, word: &[u8]) -> Option<u32> {
        let mut index = 0u32;
        for (at, &byte) in word.iter().enumerate() {
            match byte {
                b'0'..=b'9' => index = index.checked_mul(10)?.checked_add(u32::from(byte - b'0'))?,
                b'/' => {
                    self.bare = false;
                    if word[at..].contains(&b'\\') {
                        return None;
                    }
                    break;
                }
                _ => return None,
            }
        }
        (index > 0).then_some(index)
    }
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
