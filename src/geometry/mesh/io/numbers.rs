//! Words and numbers of a file that is text, binary, or one after the other.
//!
//! Purpose: [`Cursor`] goes over the bytes once; arrays are read at once, of any [`Kind`]. Invariant: a declared count is
//! checked against the bytes that are left before room is made for it. Must not know: formats.

use super::{DataError, syntax};
pub(super) use crate::mesh::numbers::{NumberType as Kind, Order, numbers};
use crate::mesh::numbers::{index, next};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Encoding {
    #[default]
    Text,
    Binary(Order),
}

pub(super) fn parse<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// A word that is no number: NaN for a spelling of it, as `nan(ind)` and `-1.#IND`, else infinite, which no surface takes.
fn odd(word: &[u8]) -> f64 {
    let word = word.to_ascii_lowercase();
    let word = word.strip_prefix(b"-").unwrap_or(&word);
    let is_nan = word.starts_with(b"nan") || word.starts_with(b"1.#") && word != b"1.#inf";
    if is_nan { f64::NAN } else { f64::INFINITY }
}

/// The beginning of a word, for a message.
pub(super) fn shown(word: &[u8]) -> String {
    plain(&String::from_utf8_lossy(&word[..word.len().min(160)]), 40)
}

/// The first characters of a text, without control characters, for a message.
pub(super) fn plain(text: &str, most: usize) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(most).collect()
}

#[derive(Clone, Default)]
pub(super) struct Cursor<'a> {
    pub(super) rest: &'a [u8],
    /// Line of the last word, from 1.
    pub(super) line: usize,
    pub(super) encoding: Encoding,
    /// Whether `#` begins a comment, up to the end of the line.
    pub(super) has_comments: bool,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, line: 1, ..Self::default() }
    }

    pub(super) fn syntax(&self, message: impl Into<String>) -> DataError {
        syntax(self.line, message)
    }

    /// The next word, over as many lines as need be.
    pub(super) fn word(&mut self) -> Option<&'a [u8]> {
        loop {
            self.pass_blank();
            let end = self.rest.iter().position(u8::is_ascii_whitespace).unwrap_or(self.rest.len());
            let word = self.take(end).filter(|word| !word.is_empty())?;
            if !(self.has_comments && word[0] == b'#') {
                return Some(word);
            }
            self.end_line();
        }
    }

    pub(super) fn peek(&self) -> Option<&'a [u8]> {
        self.clone().word()
    }

    /// The rest of the line, without its break.
    pub(super) fn end_line(&mut self) -> &'a [u8] {
        let end = self.rest.iter().position(|&b| b == b'\n').unwrap_or(self.rest.len());
        let (line, rest) = self.rest.split_at(end);
        self.line += usize::from(!rest.is_empty());
        self.rest = rest.get(1..).unwrap_or_default();
        line.trim_ascii()
    }

    /// Binary data begin right after the line.
    pub(super) fn begin_data(&mut self) {
        if self.encoding != Encoding::Text {
            self.end_line();
        }
    }

    pub(super) fn pass_blank(&mut self) {
        let rest = self.rest.trim_ascii_start();
        let blank = &self.rest[..self.rest.len() - rest.len()];
        self.line += blank.iter().filter(|&&b| b == b'\n').count();
        self.rest = rest;
    }

    pub(super) fn parsed<T: std::str::FromStr>(&mut self, what: &str) -> Result<T, DataError> {
        let word = self.word().ok_or_else(|| DataError::Truncated(format!("it ends where {what} should be")))?;
        parse(word).ok_or_else(|| self.syntax(format!("\"{}\" is not {what}", shown(word))))
    }

    pub(super) fn take(&mut self, bytes: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(bytes)?;
        self.rest = rest;
        Some(taken)
    }

    /// Checks that `count` numbers can follow; returns their bytes, if they are binary.
    pub(super) fn check(&self, count: usize, kind: Kind, what: &str) -> Result<usize, DataError> {
        // A number of text is a digit and what separates it from the next.
        let least = if self.encoding == Encoding::Text { 2 } else { kind.bytes() };
        let left = self.rest.len();
        count.checked_mul(least).filter(|&bytes| bytes <= left.saturating_add(1)).ok_or_else(|| {
            DataError::Truncated(format!("{count} numbers of {what} are declared and {left} bytes follow"))
        })
    }

    fn array<T>(
        &mut self,
        (count, kind, what): (usize, Kind, &str),
        binary: impl Fn(Kind, &[u8], Order) -> Vec<T>,
        mut word: impl FnMut(&mut Self) -> Result<T, DataError>,
    ) -> Result<Vec<T>, DataError> {
        let bytes = self.check(count, kind, what)?;
        match self.encoding {
            Encoding::Text => {
                let mut numbers = Vec::with_capacity(count);
                for _ in 0..count {
                    numbers.push(word(self)?);
                }
                Ok(numbers)
            }
            Encoding::Binary(order) => self.take(bytes).map(|b| binary(kind, b, order)).ok_or_else(|| cut(what)),
        }
    }

    pub(super) fn floats(&mut self, count: usize, kind: Kind, what: &str) -> Result<Vec<f64>, DataError> {
        self.array((count, kind, what), Kind::floats, |cursor| cursor.parsed("a number"))
    }

    pub(super) fn integers(&mut self, count: usize, kind: Kind, what: &str) -> Result<Vec<i64>, DataError> {
        self.array((count, kind, what), Kind::integers, |cursor| cursor.parsed("a whole number"))
    }

    /// Numbers of vertices; what is none is the greatest.
    pub(super) fn indices(&mut self, count: usize, kind: Kind, what: &str) -> Result<Vec<u32>, DataError> {
        self.array((count, kind, what), Kind::indices, |cursor| cursor.parsed("a whole number").map(index))
    }

    /// Numbers that matter for no surface: a word that is none is NaN.
    pub(super) fn lenient(&mut self, count: usize, kind: Kind, what: &str) -> Result<Vec<f64>, DataError> {
        self.array((count, kind, what), Kind::floats, |cursor| cursor.any_float(kind, what))
    }

    pub(super) fn pass(&mut self, count: usize, kind: Kind, what: &str) -> Result<(), DataError> {
        let bytes = self.check(count, kind, what)?;
        let passed = match self.encoding {
            Encoding::Text => (0..count).try_for_each(|_| self.word().map(|_| ())),
            Encoding::Binary(_) => self.take(bytes).map(|_| ()),
        };
        passed.ok_or_else(|| cut(what))
    }

    pub(super) fn float(&mut self, kind: Kind, what: &str) -> Result<f64, DataError> {
        match self.encoding {
            Encoding::Text => self.parsed(what),
            Encoding::Binary(order) => numbers!(kind, f64, next(&mut self.rest, order)).ok_or_else(|| cut(what)),
        }
    }

    /// One number, as in [`Self::lenient`].
    pub(super) fn any_float(&mut self, kind: Kind, what: &str) -> Result<f64, DataError> {
        match self.encoding {
            Encoding::Text => self.word().map(|word| parse(word).unwrap_or_else(|| odd(word))).ok_or_else(|| cut(what)),
            Encoding::Binary(_) => self.float(kind, what),
        }
    }

    pub(super) fn integer(&mut self, kind: Kind, what: &str) -> Result<i64, DataError> {
        match self.encoding {
            Encoding::Text => self.parsed(what),
            Encoding::Binary(order) => numbers!(kind, i64, next(&mut self.rest, order)).ok_or_else(|| cut(what)),
        }
    }

    pub(super) fn count(&mut self, kind: Kind, what: &str) -> Result<usize, DataError> {
        let count = self.integer(kind, what)?;
        usize::try_from(count).map_err(|_| self.syntax(format!("{count} is not {what}")))
    }
}

pub(super) fn cut(what: &str) -> DataError {
    DataError::Truncated(format!("it ends inside {what}"))
}
