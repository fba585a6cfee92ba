//! The header, as files in use have it.
//!
//! Purpose: the crate's grammar knows UTF-8, line feeds, and names that begin with a letter and go on with letters, digits,
//! `_` and `-`. Files have comments in Latin-1, blank and indented lines, a carriage return for each line break, and names like
//! `scalar_distance[<10]`. Here such a header is written anew, line by line, so that the crate can read it.
//! Invariant: lines keep their numbers, and properties the names that the file gives them. What is wrong otherwise is the crate's to say.
//! Must not know: data.

use std::collections::{HashMap, HashSet};

use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::Header;

use super::{DataError, Vertex, header_error};

/// A line that is longer is none of a header, and is shown so far.
const LONGEST: usize = 4096;

/// Elements and properties of one header, together. Files in use have dozens.
const MOST_NAMES: usize = 4096;

/// A header and what comes after it.
pub(super) struct Parted<'a> {
    pub(super) header: Header,
    pub(super) data: &'a [u8],
    /// The line that the data begin at, from 1.
    pub(super) line: usize,
}

/// What a name begins with that stands for another one; the number of its line comes after it.
const BY_LINE: &str = "line_";

/// Reads the header.
pub(super) fn read(bytes: &[u8]) -> Result<Parted<'_>, DataError> {
    let mut plain = Plain::default();
    let mut lines = Lines { rest: bytes, line_break: line_break(bytes) };
    let mut line = 1;
    while let Some(text) = lines.next() {
        line += 1;
        if !plain.push(&text)? {
            break;
        }
    }
    let mut reader = Reader::new(plain.text.as_bytes());
    let mut header = Parser::<Vertex>::new().read_header(&mut reader).map_err(header_error)?;
    for element in header.elements.values_mut() {
        let properties = std::mem::take(&mut element.properties).into_iter();
        element.properties = properties.map(|(name, p)| (plain.given.remove(&name).unwrap_or(name), p)).collect();
    }
    Ok(Parted { header, data: lines.rest, line })
}

/// The first character that ends a line ends all of them; a line feed may have a carriage return before it.
fn line_break(bytes: &[u8]) -> u8 {
    match bytes.iter().position(|b| matches!(b, b'\n' | b'\r')) {
        Some(at) if bytes[at] == b'\r' && bytes.get(at + 1) != Some(&b'\n') => b'\r',
        _ => b'\n',
    }
}

struct Lines<'a> {
    rest: &'a [u8],
    line_break: u8,
}

impl Lines<'_> {
    /// The next line without its break, if there is one.
    fn next(&mut self) -> Option<String> {
        if self.rest.is_empty() {
            return None;
        }
        let end = self.rest.iter().position(|&b| b == self.line_break).unwrap_or(self.rest.len());
        let line = &self.rest[..end];
        self.rest = self.rest.get(end + 1..).unwrap_or_default();
        Some(String::from_utf8_lossy(&line[..line.len().min(LONGEST)]).into_owned())
    }
}

/// A header as the crate can read it.
#[derive(Default)]
struct Plain {
    text: String,
    /// Names in the file of properties that are called otherwise here.
    given: HashMap<String, String>,
    elements: HashSet<String>,
    /// Properties of the element at hand.
    names: HashSet<String>,
    /// Elements and properties so far.
    declared: usize,
    lines: usize,
}

impl Plain {
    /// Takes one more line. Returns whether the header goes on.
    fn push(&mut self, line: &str) -> Result<bool, DataError> {
        self.lines += 1;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        self.declared += usize::from(matches!(words[..], ["element" | "property", ..]));
        if self.declared > MOST_NAMES {
            let message = format!("the header has more than {MOST_NAMES} elements and properties");
            return Err(DataError::Syntax { line: self.lines, message });
        }
        let mut goes_on = true;
        match words[..] {
            ["ply" | "PLY"] if self.lines == 1 => self.text.push_str("ply"),
            // The crate says of any other first line that it is no PLY file, and what a line should be that it does not know.
            _ if self.lines == 1 => {
                self.text.push_str(line);
                goes_on = false;
            }
            [] | ["comment" | "obj_info", ..] => self.text.push_str("comment"),
            ["property", "list", length, item, ref name @ ..] if !name.is_empty() => {
                let name = self.name(name);
                self.text.push_str(&format!("property list {length} {item} {name}"));
            }
            ["property", kind, ref name @ ..] if kind != "list" && !name.is_empty() => {
                let name = self.name(name);
                self.text.push_str(&format!("property {kind} {name}"));
            }
            ["element", name, ..] => {
                self.names.clear();
                if !self.elements.insert(name.to_owned()) {
                    return Err(DataError::Syntax {
                        line: self.lines,
                        message: format!("element \"{name}\" is declared a second time"),
                    });
                }
                self.text.push_str(&words.join(" "));
            }
            ref words => {
                self.text.push_str(&words.join(" "));
                goes_on = matches!(words, ["format", ..]);
            }
        }
        self.text.push('\n');
        Ok(goes_on)
    }

    /// What a property of these words is called here: as it is, or by its line.
    fn name(&mut self, words: &[&str]) -> String {
        let name = words.join("_");
        let mut given = name.clone();
        // Of two with one name the crate would keep the second, in the place of the first.
        while !self.names.insert(given.clone()) {
            given.push_str("_again");
        }
        let fits = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '-'));
        if fits && given == name && !name.starts_with(BY_LINE) {
            return name;
        }
        let by_line = format!("{BY_LINE}{}", self.lines);
        self.given.insert(by_line.clone(), given);
        by_line
    }
}
