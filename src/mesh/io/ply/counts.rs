//! How many vertices and facets a file has.
//!
//! Purpose: rows of scalars alone are passed over at once. Of the others the lengths of lists are read, and nothing else.
//! Invariant: takes no more steps than there are bytes, whatever is declared.
//! Must not know: what the numbers say.

use ply_rs_bw::ply::{Encoding, PropertyType, ScalarType};

use super::header::{self, Parted};
use super::{check_header, is_index_name, least_bytes};

/// Vertices and facets; nothing where the data end before what is declared.
pub(in crate::mesh::io) fn counts(bytes: &[u8]) -> Option<(u64, u64)> {
    let Parted { header, data, .. } = header::read(bytes).ok()?;
    check_header(&header, data.len()).ok()?;
    let mut data = Data { rest: data, encoding: header.encoding };
    let (mut vertices, mut facets) = (0, 0);
    for (name, element) in &header.elements {
        let rows = element.count;
        if name == "vertex" {
            vertices = rows as u64;
        }
        if element.properties.values().all(|p| matches!(p.data_type, PropertyType::Scalar(_))) {
            let types = element.properties.values().map(|p| &p.data_type);
            let bytes = types.map(|t| least_bytes(t, Encoding::BinaryLittleEndian) as usize).sum();
            data.pass(rows.checked_mul(element.properties.len())?, rows.checked_mul(bytes)?)?;
            continue;
        }
        for _ in 0..rows {
            for (property, definition) in &element.properties {
                let length = match &definition.data_type {
                    PropertyType::Scalar(_) => 1,
                    PropertyType::List(length, _) => data.length(length)?,
                };
                let (PropertyType::Scalar(item) | PropertyType::List(_, item)) = &definition.data_type;
                data.pass(length, length.checked_mul(bytes_of(item))?)?;
                if name == "face" && is_index_name(property) {
                    facets += length.saturating_sub(2) as u64;
                }
            }
        }
        if name == "face" && vertices > 0 {
            break;
        }
    }
    Some((vertices, facets))
}

fn bytes_of(number: &ScalarType) -> usize {
    match number {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}

struct Data<'a> {
    rest: &'a [u8],
    encoding: Encoding,
}

impl Data<'_> {
    /// Passes over so many numbers, which are so many bytes if they are not text.
    fn pass(&mut self, numbers: usize, bytes: usize) -> Option<()> {
        match self.encoding {
            Encoding::Ascii => (0..numbers).try_for_each(|_| self.word().map(|_| ())),
            _ => {
                self.rest = self.rest.get(bytes..)?;
                Some(())
            }
        }
    }

    fn word(&mut self) -> Option<&[u8]> {
        let begin = self.rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let rest = &self.rest[begin..];
        let (word, rest) = rest.split_at(rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len()));
        self.rest = rest;
        Some(word)
    }

    /// The length of a list.
    fn length(&mut self, number: &ScalarType) -> Option<usize> {
        if self.encoding == Encoding::Ascii {
            return std::str::from_utf8(self.word()?).ok()?.parse().ok();
        }
        let size = bytes_of(number);
        let mut bytes = [0; 8];
        bytes[..size].copy_from_slice(self.rest.get(..size)?);
        self.rest = &self.rest[size..];
        if self.encoding == Encoding::BinaryBigEndian {
            bytes[..size].reverse();
        }
        let length = u64::from_le_bytes(bytes);
        // A negative one is none, and neither is a fraction.
        let negative = match number {
            ScalarType::Char | ScalarType::Short | ScalarType::Int => length >> (8 * size - 1) == 1,
            ScalarType::Float | ScalarType::Double => true,
            ScalarType::UChar | ScalarType::UShort | ScalarType::UInt => false,
        };
        usize::try_from(length).ok().filter(|_| !negative)
    }
}
