//! SHA-256 digests, the names of blobs.
//!
//! Purpose: [`Digest`], its text form, and a running hash of bytes that arrive in order. Invariant: the text form is 64
//! lower-case hexadecimal digits, and only that form parses. Must not know: where bytes come from.

use object_store::path::Path;
use sha2::Digest as _;
use sha2::Sha256;
use sha2::digest::common::hazmat::{SerializableState, SerializedState};

/// Text forms of a tuple struct of bytes: lower-case hexadecimal digits.
macro_rules! hex_name {
    ($name:ident) => {
        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(&$crate::blob::digest::to_hex(&self.0))
            }
        }

        impl std::fmt::Debug for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                write!(f, concat!(stringify!($name), "({})"), self)
            }
        }

        impl std::str::FromStr for $name {
            type Err = $crate::blob::DigestError;

            fn from_str(text: &str) -> Result<Self, Self::Err> {
                $crate::blob::digest::from_hex(text).map(Self)
            }
        }
    };
}
pub(super) use hex_name;

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Digest([u8; 32]);

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DigestError {
    #[error("a digest has 64 hexadecimal digits, not {length}; send the SHA-256 of the bytes")]
    Length { length: usize },
    #[error("byte {at} of the digest is not one of 0-9 and a-f; write it in lower case, without a prefix")]
    Digit { at: usize },
}

impl Digest {
    pub fn of(bytes: &[u8]) -> Self {
        Self(Sha256::digest(bytes).into())
    }

    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl From<[u8; 32]> for Digest {
    fn from(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }
}

/// Folder of the blobs in a store of objects. Not too many lie in one folder.
pub(super) const BLOBS: &str = "blobs";

pub(super) fn path_of(digest: &Digest) -> Path {
    let name = digest.to_string();
    Path::from_iter([BLOBS, &name[..2], &name])
}

hex_name!(Digest);

impl TryFrom<String> for Digest {
    type Error = DigestError;

    fn try_from(text: String) -> Result<Self, DigestError> {
        text.parse()
    }
}

impl From<Digest> for String {
    fn from(digest: Digest) -> Self {
        digest.to_string()
    }
}

/// Lower-case hexadecimal digits.
pub(crate) fn to_hex(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    bytes.iter().flat_map(|b| [b >> 4, b & 15]).map(|digit| char::from(DIGITS[usize::from(digit)])).collect()
}

/// Reads exactly `2 N` lower-case hexadecimal digits.
pub(crate) fn from_hex<const N: usize>(text: &str) -> Result<[u8; N], DigestError> {
    if text.len() != 2 * N {
        return Err(DigestError::Length { length: text.len() });
    }
    let mut out = [0; N];
    for (at, byte) in text.bytes().enumerate() {
        let value = match byte {
            b'0'..=b'9' => byte - b'0',
            b'a'..=b'f' => byte - b'a' + 10,
            _ => return Err(DigestError::Digit { at }),
        };
        out[at / 2] = out[at / 2] << 4 | value;
    }
    Ok(out)
}

#[derive(Clone, Debug, Default)]
pub(super) struct Tally {
    sha: Sha256,
    bytes: u64,
}

impl Tally {
    pub(super) fn add(&mut self, bytes: &[u8]) {
        self.sha.update(bytes);
        self.bytes += bytes.len() as u64;
    }

    pub(super) const fn bytes(&self) -> u64 {
        self.bytes
    }

    pub(super) fn digest(&self) -> Digest {
        Digest(self.sha.clone().finalize().into())
    }

    /// The state as text, so that another process can go on from here.
    pub(super) fn save(&self) -> String {
        to_hex(&self.sha.serialize())
    }

    /// What [`Self::save`] wrote after `bytes` bytes. `None` if it is no such text.
    pub(super) fn restore(bytes: u64, text: &str) -> Option<Self> {
        let mut state = SerializedState::<Sha256>::default();
        if text.len() != 2 * state.len() || !text.is_ascii() {
            return None;
        }
        for (k, byte) in state.iter_mut().enumerate() {
            [*byte] = from_hex(&text[2 * k..2 * k + 2]).ok()?;
        }
        Sha256::deserialize(&state).ok().map(|sha| Self { sha, bytes })
    }
}
