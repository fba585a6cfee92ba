//! Types of numbers, and their bytes.
//!
//! Purpose: arrays of any [`NumberType`] become doubles or indices, and doubles become bytes. Files, messages and blobs share
//! it. Invariant: bytes that do not fill a number are left out. Must not know: what the numbers are for.

/// A type of numbers.
#[allow(missing_docs, reason = "the names are those of Rust's types")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NumberType {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    #[default]
    F64,
}

/// Which byte of a number comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Order {
    /// The lowest.
    #[default]
    Little,
    /// The highest.
    Big,
}

/// Calls `read` with its arguments and a function that makes a number, as one of another type, of bytes, the lowest first.
macro_rules! numbers {
    ($kind:expr, $as:ty, $read:ident($($argument:expr),*)) => {
        match $kind {
            Kind::I8 => $read($($argument,)* |b| i8::from_le_bytes(b) as $as),
            Kind::U8 => $read($($argument,)* |b| u8::from_le_bytes(b) as $as),
            Kind::I16 => $read($($argument,)* |b| i16::from_le_bytes(b) as $as),
            Kind::U16 => $read($($argument,)* |b| u16::from_le_bytes(b) as $as),
            Kind::I32 => $read($($argument,)* |b| i32::from_le_bytes(b) as $as),
            Kind::U32 => $read($($argument,)* |b| u32::from_le_bytes(b) as $as),
            Kind::I64 => $read($($argument,)* |b| i64::from_le_bytes(b) as $as),
            Kind::U64 => $read($($argument,)* |b| u64::from_le_bytes(b) as $as),
            Kind::F32 => $read($($argument,)* |b| f32::from_le_bytes(b) as $as),
            Kind::F64 => $read($($argument,)* |b| f64::from_le_bytes(b) as $as),
        }
    };
}
pub(super) use numbers;

use NumberType as Kind;

fn all<const N: usize, T>(bytes: &[u8], order: Order, number: impl Fn([u8; N]) -> T) -> Vec<T> {
    bytes.as_chunks::<N>().0.iter().map(|&b| number(lowest_first(b, order))).collect()
}

/// Takes the next number off `rest`.
pub(super) fn next<const N: usize, T>(rest: &mut &[u8], order: Order, number: impl Fn([u8; N]) -> T) -> Option<T> {
    let (bytes, after) = rest.split_first_chunk::<N>()?;
    *rest = after;
    Some(number(lowest_first(*bytes, order)))
}

fn lowest_first<const N: usize>(mut bytes: [u8; N], order: Order) -> [u8; N] {
    if order == Order::Big {
        bytes.reverse();
    }
    bytes
}

/// A number as an index; what is none is the greatest.
pub(super) fn index(number: i64) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

impl NumberType {
    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Whether it has fractions.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// Whether a number of this type of whole numbers has this value.
    pub(super) fn has(self, value: f64) -> bool {
        let bits = 8 * self.bytes() as i32;
        let (least, above) = match self {
            Self::U8 | Self::U16 | Self::U32 | Self::U64 => (0.0, 2f64.powi(bits)),
            _ => (-(2f64.powi(bits - 1)), 2f64.powi(bits - 1)),
        };
        (least..above).contains(&value) && value.fract() == 0.0
    }

    /// The numbers that bytes of this type are.
    pub fn floats(self, bytes: &[u8], order: Order) -> Vec<f64> {
        numbers!(self, f64, all(bytes, order))
    }

    /// Fractions are cut off. What 64 bits with a sign cannot hold becomes negative or the greatest.
    pub(super) fn integers(self, bytes: &[u8], order: Order) -> Vec<i64> {
        numbers!(self, i64, all(bytes, order))
    }

    /// The same as indices; what is none is the greatest.
    pub(super) fn indices(self, bytes: &[u8], order: Order) -> Vec<u32> {
        let mut all = Vec::with_capacity(bytes.len() / self.bytes());
        for part in bytes.chunks(4096 * self.bytes()) {
            all.extend(self.integers(part, order).into_iter().map(index));
        }
        all
    }

    /// Appends a number as one of this type. What the type cannot hold becomes its nearest number.
    pub fn put(self, number: f64, order: Order, out: &mut Vec<u8>) {
        let begin = out.len();
        match self {
            Self::I8 => out.extend((number as i8).to_le_bytes()),
            Self::U8 => out.push(number as u8),
            Self::I16 => out.extend((number as i16).to_le_bytes()),
            Self::U16 => out.extend((number as u16).to_le_bytes()),
            Self::I32 => out.extend((number as i32).to_le_bytes()),
            Self::U32 => out.extend((number as u32).to_le_bytes()),
            Self::I64 => out.extend((number as i64).to_le_bytes()),
            Self::U64 => out.extend((number as u64).to_le_bytes()),
            Self::F32 => out.extend((number as f32).to_le_bytes()),
            Self::F64 => out.extend(number.to_le_bytes()),
        }
        if order == Order::Big {
            out[begin..].reverse();
        }
    }
}
