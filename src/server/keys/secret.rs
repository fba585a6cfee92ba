//! A key as its owner has it: `tsr_ID_SECRET`.
//!
//! Purpose: [`Secret`] is generated or parsed; [`Hash`] is its stored form. Invariant: a secret has 256 bits of the
//! system's generator, and only [`Secret::reveal`] shows it. Hashes are compared in constant time, and comparing with the
//! hash of no key costs the same work. Must not know: names, roles, files.

use std::fmt;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use subtle::ConstantTimeEq;

use super::KeysError;

const PREFIX: &str = "tsr_";

/// Letters of an id: none looks like another.
const LETTERS: &[u8; 32] = b"0123456789abcdefghjkmnpqrstvwxyz";

/// Letters of an id: 50 bits, so that ids of one server differ.
const ID_LETTERS: usize = 10;

/// Bytes of a secret, which is written in hexadecimal digits.
const SECRET_BYTES: usize = 32;

pub(super) fn is_id(text: &str) -> bool {
    text.len() == ID_LETTERS && text.bytes().all(|byte| LETTERS.contains(&byte))
}

#[derive(Clone, PartialEq, Eq)]
pub struct Secret {
    text: String,
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Secret({})", self.id())
    }
}

impl Secret {
    pub fn random() -> Result<Self, KeysError> {
        let mut bytes = [0; ID_LETTERS + SECRET_BYTES];
        getrandom::fill(&mut bytes).map_err(|error| KeysError::Random(error.to_string()))?;
        let (id, secret) = bytes.split_at(ID_LETTERS);
        let id: String = id.iter().map(|byte| char::from(LETTERS[usize::from(byte % 32)])).collect();
        Ok(Self { text: format!("{PREFIX}{id}_{}", hex(secret)) })
    }

    /// Parses a secret. Invalid text gives no reason.
    pub fn parse(text: &str) -> Option<Self> {
        let (id, secret) = text.strip_prefix(PREFIX)?.split_once('_')?;
        let is_hex = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
        let is_good = is_id(id) && secret.len() == 2 * SECRET_BYTES && secret.bytes().all(is_hex);
        is_good.then(|| Self { text: text.to_owned() })
    }

    /// The identifier, which is no secret.
    pub fn id(&self) -> &str {
        self.text.get(PREFIX.len()..PREFIX.len() + ID_LETTERS).unwrap_or_default()
    }

    /// The full text: for its owner, once, and for the server.
    pub fn reveal(&self) -> &str {
        &self.text
    }

    pub fn hash(&self) -> Hash {
        #[cfg(test)]
        work::add();
        Hash(Sha256::digest(self.text.as_bytes()).into())
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Hash([u8; 32]);

impl Hash {
    /// Of no key: no text is known that has it.
    pub const OF_NONE: Self = Self([0xa5; 32]);

    /// Whether this is the hash of a presented key, in constant time.
    pub fn is_of(&self, secret: &Secret) -> bool {
        let actual = secret.hash();
        #[cfg(test)]
        work::add();
        self.0.ct_eq(&actual.0).into()
    }
}

/// Hashes are not printed.
impl fmt::Debug for Hash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Hash(..)")
    }
}

impl TryFrom<String> for Hash {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        const WRONG: &str = "a hash has 64 hexadecimal digits in lower case";
        let mut bytes = [0; 32];
        if text.len() != 64 || !text.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b)) {
            return Err(WRONG);
        }
        for (byte, pair) in bytes.iter_mut().zip(text.as_bytes().chunks_exact(2)) {
            let pair = std::str::from_utf8(pair).map_err(|_| WRONG)?;
            *byte = u8::from_str_radix(pair, 16).map_err(|_| WRONG)?;
        }
        Ok(Self(bytes))
    }
}

impl From<Hash> for String {
    fn from(hash: Hash) -> Self {
        hex(&hash.0)
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Counts the cost of checks, for tests.
#[cfg(test)]
pub(crate) mod work {
    use std::cell::Cell;

    thread_local!(static DONE: Cell<u64> = const { Cell::new(0) });

    pub(super) fn add() {
        DONE.with(|done| done.set(done.get() + 1));
    }

    /// Hashes and comparisons of this thread so far.
    pub(crate) fn done() -> u64 {
        DONE.with(Cell::get)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_its_own_and_says_nothing() {
        let (one, two) = (Secret::random().unwrap(), Secret::random().unwrap());
        assert!(one != two && one.id() != two.id() && is_id(one.id()));
        assert_eq!(Secret::parse(one.reveal()).unwrap(), one);
        assert!(one.hash().is_of(&one) && !one.hash().is_of(&two) && !Hash::OF_NONE.is_of(&one));
        let shown = format!("{one:?} {:?}", one.hash());
        let part = one.reveal().rsplit_once('_').unwrap().1;
        assert!(!shown.contains(part) && !shown.contains(&String::from(one.hash())));
        assert_eq!(Hash::try_from(String::from(one.hash())).unwrap(), one.hash());
        assert!(Hash::try_from("A".repeat(64)).is_err() && Hash::try_from("ä".repeat(32)).is_err());
    }

    #[test]
    fn what_is_no_key_is_not_taken() {
        let good = Secret::random().unwrap().reveal().to_owned();
        let mut upper = good.clone();
        upper.make_ascii_uppercase();
        for wrong in [
            "",
            "tsr_",
            "tsr__",
            &good[1..],
            &good[..good.len() - 1],
            &format!("{good}0"),
            &upper,
            &good.replace('_', "-"),
        ] {
            assert!(Secret::parse(wrong).is_none(), "{wrong}");
        }
        assert!(Secret::parse(&format!("{good} ")).is_none() && Secret::parse("tsr_ääääääääää_x").is_none());
    }
}
