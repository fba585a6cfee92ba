//! PLY data number by number: text, either byte order, lists of any length.
//!
//! Purpose: [`read`] takes positions, corners and what is carried in the order that the header declares; [`counts`] passes over
//! the data and reads the lengths of lists alone.
//! Invariant: takes no more steps than there are bytes, whatever is declared. Must not know: what attributes mean.

use glam::DVec3;

use super::carried::{Carried, Role};
use super::header::{Encoding, Header, Number};
use super::{DataError, Soup};

/// `data` begins at `line`, from 1, right after the header.
pub(super) fn read(data: &[u8], line: usize, header: &Header, carried: &mut Carried) -> Result<Soup, DataError> {
    let mut source = Source { rest: data, encoding: header.encoding, line };
    let mut soup = Soup::default();
    // A face may stand before the vertices that it names, so faces are made at the end.
    let mut corners: Vec<i64> = Vec::new();
    let mut ends: Vec<usize> = Vec::new();
    for element in &header.elements {
        let (is_vertex, is_face) = (element.name == "vertex", element.name == "face");
        let roles: Vec<Role> = element.properties.iter().map(|p| carried.role(element, p)).collect();
        for index in 0..element.count {
            let cut = || {
                let (count, name) = (element.count, &element.name);
                DataError::Truncated(format!("{count} of element \"{name}\" are declared and {index} are there"))
            };
            let mut position = [0.0; 3];
            let first = corners.len();
            for (property, role) in element.properties.iter().zip(&roles) {
                let count = match property.length {
                    Some(length) => source.length(length)?.ok_or_else(cut)?,
                    None => 1,
                };
                match *role {
                    Role::Axis(axis) => {
                        position[axis] = source.exact(property.item, "a coordinate")?.ok_or_else(cut)?;
                    }
                    Role::Corners => {
                        for _ in 0..count {
                            corners.push(source.index(property.item)?.ok_or_else(cut)?);
                        }
                    }
                    Role::Carried(to) => {
                        for _ in 0..count {
                            carried.push(to, source.number(property.item).ok_or_else(cut)?);
                        }
                    }
                    Role::Skipped => source.pass(count, property.item).ok_or_else(cut)?,
                }
            }
            if is_vertex {
                soup.positions.push(DVec3::from_array(position));
            } else if is_face {
                carried.end_face(corners.len() - first);
                ends.push(corners.len());
            }
        }
    }
    let mut start = 0;
    for (index, end) in ends.into_iter().enumerate() {
        let pushed = soup.push_polygon(&corners[start..end]);
        pushed.map_err(|message| DataError::Element { element: "face", index, message })?;
        start = end;
    }
    Ok(soup)
}

/// Vertices and facets; nothing where the data end before what is declared.
pub(super) fn counts(data: &[u8], line: usize, header: &Header) -> Option<(u64, u64)> {
    let mut source = Source { rest: data, encoding: header.encoding, line };
    let (mut vertices, mut facets) = (0, 0);
    for element in &header.elements {
        let rows = element.count;
        if element.name == "vertex" {
            vertices = rows as u64;
        }
        if element.properties.iter().all(|p| p.length.is_none()) {
            // All rows at once, as so many bytes or words.
            let bytes: usize = element.properties.iter().map(|p| p.item.bytes()).sum();
            match header.encoding {
                Encoding::Ascii => source.pass(rows.checked_mul(element.properties.len())?, Number::U8)?,
                _ => source.pass(rows.checked_mul(bytes)?, Number::U8)?,
            }
            continue;
        }
        for _ in 0..rows {
            for property in &element.properties {
                let length = match property.length {
                    Some(length) => source.length(length).ok()??,
                    None => 1,
                };
                source.pass(length, property.item)?;
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

/// Numbers one after the other. `None` is the end of the data.
struct Source<'a> {
    rest: &'a [u8],
    encoding: Encoding,
    /// Of the last word, from 1.
    line: usize,
}

impl<'a> Source<'a> {
    fn word(&mut self) -> Option<&'a [u8]> {
        let start = self.rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let (blank, rest) = self.rest.split_at(start);
        self.line += blank.iter().filter(|&&b| b == b'\n').count();
        let (word, rest) = rest.split_at(rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len()));
        self.rest = rest;
        Some(word)
    }

    /// A word that is a number of some type.
    fn parsed<T: std::str::FromStr>(&mut self, what: &str) -> Result<Option<T>, DataError> {
        let Some(word) = self.word() else { return Ok(None) };
        parse(word).map(Some).ok_or_else(|| {
            let word: String = String::from_utf8_lossy(word).chars().take(40).collect();
            DataError::Syntax { line: self.line, message: format!("\"{word}\" is not {what}") }
        })
    }

    /// A number that matters for the surface: text that is none is an error.
    fn exact(&mut self, number: Number, what: &str) -> Result<Option<f64>, DataError> {
        match self.encoding {
            Encoding::Ascii => self.parsed(what),
            _ => Ok(self.number(number)),
        }
    }

    fn index(&mut self, number: Number) -> Result<Option<i64>, DataError> {
        match self.encoding {
            Encoding::Ascii => self.parsed("a vertex number"),
            // Integers have 32 bits at most.
            _ => Ok(self.number(number).map(|index| index as i64)),
        }
    }

    /// The length of a list.
    fn length(&mut self, number: Number) -> Result<Option<usize>, DataError> {
        if self.encoding == Encoding::Ascii {
            return self.parsed("a list's length");
        }
        match self.number(number) {
            Some(length) if number.is_float() || length < 0.0 => {
                Err(DataError::Header("the length of a list is negative or of a type for fractions".to_owned()))
            }
            length => Ok(length.map(|length| length as usize)),
        }
    }

    /// Any number. NaN for a word that is none.
    fn number(&mut self, number: Number) -> Option<f64> {
        if self.encoding == Encoding::Ascii {
            return Some(parse(self.word()?).unwrap_or(f64::NAN));
        }
        Some(match number {
            Number::I8 => f64::from(i8::from_le_bytes(self.take()?)),
            Number::U8 => f64::from(u8::from_le_bytes(self.take()?)),
            Number::I16 => f64::from(i16::from_le_bytes(self.take()?)),
            Number::U16 => f64::from(u16::from_le_bytes(self.take()?)),
            Number::I32 => f64::from(i32::from_le_bytes(self.take()?)),
            Number::U32 => f64::from(u32::from_le_bytes(self.take()?)),
            Number::F32 => f64::from(f32::from_le_bytes(self.take()?)),
            Number::F64 => f64::from_le_bytes(self.take()?),
        })
    }

    /// Bytes of a number, the lowest first.
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (bytes, rest) = self.rest.split_first_chunk::<N>()?;
        self.rest = rest;
        let mut bytes = *bytes;
        if self.encoding == Encoding::Big {
            bytes.reverse();
        }
        Some(bytes)
    }

    /// Passes over so many numbers.
    fn pass(&mut self, count: usize, number: Number) -> Option<()> {
        match self.encoding {
            Encoding::Ascii => (0..count).try_for_each(|_| self.word().map(|_| ())),
            _ => {
                self.rest = self.rest.get(count.checked_mul(number.bytes())?..)?;
                Some(())
            }
        }
    }
}

fn parse<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}
