//! Words and numbers of a file that is text, binary, or one after the other.
//!
//! Purpose: [`Cursor`] goes over the bytes once; arrays are read at once, of any [`Kind`].
//! Invariant: a declared count is checked against the bytes that are left before room is made for it.
//! Must not know: formats.

use super::DataError;

/// What a number is in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

/// Which byte of a number comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    Little,
    Big,
}

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Text,
    Binary(Order),
}

macro_rules! numbers {
    ($kind:expr, $bytes:expr, $order:expr, $as:ty) => {
        match $kind {
            Kind::I8 => all($bytes, $order, |b| i8::from_le_bytes(b) as $as),
            Kind::U8 => all($bytes, $order, |b| u8::from_le_bytes(b) as $as),
            Kind::I16 => all($bytes, $order, |b| i16::from_le_bytes(b) as $as),
            Kind::U16 => all($bytes, $order, |b| u16::from_le_bytes(b) as $as),
            Kind::I32 => all($bytes, $order, |b| i32::from_le_bytes(b) as $as),
            Kind::U32 => all($bytes, $order, |b| u32::from_le_bytes(b) as $as),
            Kind::I64 => all($bytes, $order, |b| i64::from_le_bytes(b) as $as),
            Kind::U64 => all($bytes, $order, |b| u64::from_le_bytes(b) as $as),
            Kind::F32 => all($bytes, $order, |b| f32::from_le_bytes(b) as $as),
            Kind::F64 => all($bytes, $order, |b| f64::from_le_bytes(b) as $as),
        }
    };
}

fn all<const N: usize, T>(bytes: &[u8], order: Order, number: impl Fn([u8; N]) -> T) -> Vec<T> {
    let lowest_first = |mut b: [u8; N]| {
        if order == Order::Big {
            b.reverse();
        }
        b
    };
    bytes.as_chunks::<N>().0.iter().map(|&b| number(lowest_first(b))).collect()
}

impl Kind {
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// What does not fill a number is left out.
    pub(super) fn floats(self, bytes: &[u8], order: Order) -> Vec<f64> {
        numbers!(self, bytes, order, f64)
    }

    /// Fractions are cut off. What 64 bits with a sign cannot hold becomes negative or the greatest.
    pub(super) fn integers(self, bytes: &[u8], order: Order) -> Vec<i64> {
        numbers!(self, bytes, order, i64)
    }
}

/// A number of text that fits its type.
pub(super) fn parse<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// The beginning of a word, for who has to find it.
pub(super) fn shown(word: &[u8]) -> String {
    let text = String::from_utf8_lossy(&word[..word.len().min(160)]);
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(40).collect()
}

/// See the module's head.
#[derive(Clone)]
pub(super) struct Cursor<'a> {
    pub(super) rest: &'a [u8],
    /// Of the last word, from 1.
    pub(super) line: usize,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, line: 1 }
    }

    pub(super) fn syntax(&self, message: impl Into<String>) -> DataError {
        DataError::Syntax { line: self.line, message: message.into() }
    }

    /// The next word, over as many lines as need be.
    pub(super) fn word(&mut self) -> Option<&'a [u8]> {
        let start = self.rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let (blank, rest) = self.rest.split_at(start);
        self.line += blank.iter().filter(|&&b| b == b'\n').count();
        let (word, rest) = rest.split_at(rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len()));
        self.rest = rest;
        Some(word)
    }

    /// The next word, which stays.
    pub(super) fn peek(&self) -> Option<&'a [u8]> {
        self.clone().word()
    }

    /// What is left of the line, without its break.
    pub(super) fn end_line(&mut self) -> &'a [u8] {
        let end = self.rest.iter().position(|&b| b == b'\n').unwrap_or(self.rest.len());
        let (line, rest) = self.rest.split_at(end);
        if let Some(rest) = rest.get(1..) {
            self.line += 1;
            self.rest = rest;
        } else {
            self.rest = rest;
        }
        line.trim_ascii()
    }

    /// Passes over blanks and line breaks.
    pub(super) fn pass_blank(&mut self) {
        let blank = self.rest.len() - self.rest.trim_ascii_start().len();
        let (blank, rest) = self.rest.split_at(blank);
        self.line += blank.iter().filter(|&&b| b == b'\n').count();
        self.rest = rest;
    }

    /// A word that is a number of some type.
    pub(super) fn parsed<T: std::str::FromStr>(&mut self, what: &str) -> Result<T, DataError> {
        let word = self.word().ok_or_else(|| DataError::Truncated(format!("it ends where {what} should be")))?;
        parse(word).ok_or_else(|| self.syntax(format!("\"{}\" is not {what}", shown(word))))
    }

    pub(super) fn take(&mut self, bytes: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(bytes)?;
        self.rest = rest;
        Some(taken)
    }

    /// Whether so many numbers can follow.
    fn check(&self, count: usize, kind: Kind, encoding: Encoding, what: &str) -> Result<usize, DataError> {
        // A number of text is a digit and what separates it from the next.
        let least = if encoding == Encoding::Text { 2 } else { kind.bytes() };
        let bytes = count.checked_mul(least);
        if let Some(bytes) = bytes.filter(|&bytes| bytes <= self.rest.len().saturating_add(1)) {
            return Ok(bytes);
        }
        let left = self.rest.len();
        Err(DataError::Truncated(format!("{count} numbers of {what} are declared and {left} bytes follow")))
    }

    /// So many words that are numbers, which are known to fit.
    fn words<T: std::str::FromStr>(&mut self, count: usize, what: &str) -> Result<Vec<T>, DataError> {
        let mut numbers = Vec::with_capacity(count);
        for _ in 0..count {
            numbers.push(self.parsed(what)?);
        }
        Ok(numbers)
    }

    pub(super) fn floats(
        &mut self,
        count: usize,
        kind: Kind,
        encoding: Encoding,
        what: &str,
    ) -> Result<Vec<f64>, DataError> {
        let bytes = self.check(count, kind, encoding, what)?;
        match encoding {
            Encoding::Text => self.words(count, "a number"),
            Encoding::Binary(order) => self.take(bytes).map(|b| kind.floats(b, order)).ok_or_else(|| cut(what)),
        }
    }

    /// Numbers that matter for no surface: a word that is none is NaN. Nothing is given if they are not to be kept.
    pub(super) fn lenient(
        &mut self,
        count: usize,
        kind: Kind,
        encoding: Encoding,
        what: &str,
        keep: bool,
    ) -> Result<Vec<f64>, DataError> {
        let bytes = self.check(count, kind, encoding, what)?;
        match encoding {
            Encoding::Text => {
                let mut numbers = Vec::with_capacity(if keep { count } else { 0 });
                for _ in 0..count {
                    let word = self.word().ok_or_else(|| cut(what))?;
                    if keep {
                        numbers.push(parse(word).unwrap_or(f64::NAN));
                    }
                }
                Ok(numbers)
            }
            Encoding::Binary(order) => {
                let taken = self.take(bytes).ok_or_else(|| cut(what))?;
                Ok(if keep { kind.floats(taken, order) } else { Vec::new() })
            }
        }
    }

    pub(super) fn integers(
        &mut self,
        count: usize,
        kind: Kind,
        encoding: Encoding,
        what: &str,
    ) -> Result<Vec<i64>, DataError> {
        let bytes = self.check(count, kind, encoding, what)?;
        match encoding {
            Encoding::Text => self.words(count, "a whole number"),
            Encoding::Binary(order) => self.take(bytes).map(|b| kind.integers(b, order)).ok_or_else(|| cut(what)),
        }
    }

    /// One whole number.
    pub(super) fn integer(&mut self, kind: Kind, encoding: Encoding, what: &str) -> Result<i64, DataError> {
        match encoding {
            Encoding::Text => self.parsed(what),
            Encoding::Binary(_) => self.integers(1, kind, encoding, what)?.first().copied().ok_or_else(|| cut(what)),
        }
    }

    /// One whole number that counts something.
    pub(super) fn count(&mut self, kind: Kind, encoding: Encoding, what: &str) -> Result<usize, DataError> {
        let count = self.integer(kind, encoding, what)?;
        usize::try_from(count).map_err(|_| self.syntax(format!("{count} is not {what}")))
    }
}

pub(super) fn cut(what: &str) -> DataError {
    DataError::Truncated(format!("it ends inside {what}"))
}
