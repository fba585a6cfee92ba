//! Whose a blob is.
//!
//! Purpose: [`Owner`] stands for a tenant in the names of uploads and in the marks beside blobs. Invariant: two names never
//! give the same owner, as far as SHA-256 goes; the name cannot be read from it. Must not know: keys, who calls.

use std::fmt;
use std::str::FromStr;

use super::digest::{from_hex, to_hex};
use super::{Digest, DigestError};

/// See the module's head.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Owner([u8; 16]);

impl Owner {
    /// Whoever has this name. Any text will do.
    pub fn of(name: &str) -> Self {
        let digest = Digest::of(name.as_bytes());
        let mut short = [0; 16];
        short.copy_from_slice(&digest.as_bytes()[..16]);
        Self(short)
    }

    /// From what [`Self::bytes`] gave; nobody for zeros.
    pub(super) fn from_bytes(bytes: [u8; 16]) -> Option<Self> {
        (bytes != [0; 16]).then_some(Self(bytes))
    }

    pub(super) const fn bytes(self) -> [u8; 16] {
        self.0
    }
}

impl fmt::Display for Owner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&to_hex(&self.0))
    }
}

impl fmt::Debug for Owner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Owner({self})")
    }
}

impl FromStr for Owner {
    type Err = DigestError;

    fn from_str(text: &str) -> Result<Self, DigestError> {
        from_hex(text).map(Self)
    }
}
