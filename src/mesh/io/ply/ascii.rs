//! The data part of an ascii PLY file: words, in the order that the header declares.

use glam::DVec3;
use ply_rs_bw::ply::{Header, PropertyType};

use super::super::{DataError, Soup};
use super::is_index_name;

/// `data` begins at `line`, from 1, right after the header.
pub(super) fn decode(data: &[u8], line: usize, header: &Header) -> Result<Soup, DataError> {
    let mut words = Words { rest: data, line };
    let mut soup = Soup::default();
    // A face may stand before the vertices it names, so faces are made at the end.
    let mut corners: Vec<i64> = Vec::new();
    let mut ends: Vec<usize> = Vec::new();
    for (name, element) in &header.elements {
        let (is_vertex, is_face) = (name == "vertex", name == "face");
        let axis = |property: &str| ["x", "y", "z"].iter().position(|&axis| is_vertex && axis == property);
        let plan: Vec<(Option<usize>, bool, bool)> = element
            .properties
            .iter()
            .map(|(property, p)| {
                (axis(property), matches!(p.data_type, PropertyType::List(..)), is_face && is_index_name(property))
            })
            .collect();
        for index in 0..element.count {
            let cut = || {
                DataError::Truncated(format!(
                    "{} of element \"{name}\" are declared and {index} are there",
                    element.count
                ))
            };
            let mut position = [0.0; 3];
            for &(axis, is_list, is_corners) in &plan {
                let length = if is_list { words.number::<usize>("a list's length")?.ok_or_else(cut)? } else { 1 };
                for _ in 0..length {
                    if let Some(axis) = axis {
                        position[axis] = words.number("a coordinate")?.ok_or_else(cut)?;
                    } else if is_corners {
                        corners.push(words.number("a vertex number")?.ok_or_else(cut)?);
                    } else {
                        words.next().ok_or_else(cut)?;
                    }
                }
            }
            if is_vertex {
                soup.positions.push(DVec3::from_array(position));
            } else if is_face {
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

struct Words<'a> {
    rest: &'a [u8],
    /// Of the last word.
    line: usize,
}

impl<'a> Words<'a> {
    fn next(&mut self) -> Option<&'a [u8]> {
        let start = self.rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let (blank, rest) = self.rest.split_at(start);
        self.line += blank.iter().filter(|&&b| b == b'\n').count();
        let (word, rest) = rest.split_at(rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len()));
        self.rest = rest;
        Some(word)
    }

    /// Nothing at the end of the data.
    fn number<T: std::str::FromStr>(&mut self, what: &str) -> Result<Option<T>, DataError> {
        let Some(word) = self.next() else {
            return Ok(None);
        };
        let number = std::str::from_utf8(word).ok().and_then(|text| text.parse().ok());
        number.map(Some).ok_or_else(|| {
            let word: String = String::from_utf8_lossy(word).chars().take(40).collect();
            DataError::Syntax { line: self.line, message: format!("\"{word}\" is not {what}") }
        })
    }
}
