//! Keys of callers: creation, verification and storage.
//!
//! Purpose: [`KeySet`] is the server's record of keys; [`Secret`] is a key as the caller has it; [`KeyFile`] stores a set
//! on disk. Invariant: a secret is shown once, when it is created. Only its SHA-256 is stored, and neither appears in an
//! error or a log line. Must not know: calls, the command line.

mod file;
mod secret;
mod shared;

use std::collections::HashSet;
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};

pub use file::KeyFile;
pub(crate) use file::Stamp;
pub(crate) use secret::Hash;
pub use secret::Secret;
#[cfg(test)]
pub(crate) use secret::work;
pub use shared::DOCUMENT;
pub(crate) use shared::of_document;
#[cfg(feature = "postgres")]
pub use shared::{change_shared, read_shared};

/// Keys of one server.
const MOST: usize = 10_000;

/// The longest name, bytes.
const LONGEST: usize = 64;

/// The role of a key. Each includes the rights of those before it.
#[derive(
    Clone,
    Copy,
    Debug,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    strum::Display,
    strum::EnumString,
    strum::IntoStaticStr,
)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase", parse_err_ty = String, parse_err_fn = no_role)]
pub enum Role {
    /// Ask about its tenant's jobs and blobs, and read them.
    Read,
    /// Upload, create jobs and end them, in the name of its tenant.
    Submit,
    /// All calls, in the name of any tenant.
    Admin,
}

impl Role {
    pub fn name(self) -> &'static str {
        self.into()
    }
}

fn no_role(_: &str) -> String {
    "a role is read, submit or admin".to_owned()
}

/// Limits of a key. An unset limit is off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyLimits {
    /// Calls a second, and the size of a burst.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub in_flight: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// Its tenant's share of the work beside others; 1 if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weight: Option<f64>,
}

impl KeyLimits {
    /// Whether each of them can be kept.
    fn is_sound(&self) -> bool {
        self.rate != Some(0)
            && self.in_flight != Some(0)
            && self.weight.is_none_or(|weight| weight.is_finite() && weight > 0.0)
    }
}

/// The stored part of a key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Key {
    /// Identifier: the first part of the secret.
    pub id: String,
    /// Name of the owner, and so the tenant.
    pub name: String,
    pub role: Role,
    pub sha256: Hash,
    /// When it was made, seconds since 1970.
    pub created: u64,
    /// Seconds since 1970.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires: Option<u64>,
    #[serde(default)]
    pub limits: KeyLimits,
}

impl Key {
    pub fn is_expired(&self, now: u64) -> bool {
        self.expires.is_some_and(|end| now >= end)
    }
}

/// The time now, seconds since 1970.
pub fn now() -> u64 {
    SystemTime::UNIX_EPOCH.elapsed().map_or(0, |time| time.as_secs())
}

#[derive(Clone, Debug)]
pub struct NewKey {
    pub name: String,
    pub role: Role,
    /// After how long it ends.
    pub lasts: Option<Duration>,
    pub limits: KeyLimits,
    /// Whether the name may have a key already.
    pub is_second: bool,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeySet {
    keys: Vec<Key>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    version: u32,
    keys: Vec<Key>,
}

const VERSION: u32 = 1;

#[derive(Debug, thiserror::Error)]
pub enum KeysError {
    #[error("{} is damaged: {reason}; put a copy of it in its place, or remove it and make new keys", .path.display())]
    Damaged { path: std::path::PathBuf, reason: String },
    #[error("cannot {action} {}: {source}", .path.display())]
    Io { action: &'static str, path: std::path::PathBuf, source: std::io::Error },
    #[error("{name} has a key already; revoke it first, or make a second one with --rotate")]
    Exists { name: String },
    #[error("there is no key of {name}; `tessera keys list` shows all")]
    Absent {
        /// The name, or the id.
        name: String,
    },
    #[error(
        "{name:?} is no name for a key: take a letter and then at most 63 letters, digits, dots, hyphens and underscores"
    )]
    Name { name: String },
    #[error("limits of a key are above 0")]
    Limits,
    #[error("there are {MOST} keys, as many as may be; revoke unused ones")]
    TooMany,
    #[error("the keys in the database cannot be used: {0}")]
    Shared(String),
    #[error("the operating system gives no random numbers: {0}")]
    Random(String),
}

/// Whether a text can be a key's name. Never that of an address, which stands for callers without a key.
pub fn is_name(text: &str) -> bool {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    text.len() <= LONGEST && text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.bytes().all(is_plain)
}

impl KeySet {
    pub fn keys(&self) -> &[Key] {
        &self.keys
    }

    /// Makes a key. Its secret is nowhere else than in the answer. Errors: `Name`, `Exists`, `Limits`, `TooMany`, `Random`.
    pub fn add(&mut self, new: NewKey) -> Result<(Key, Secret), KeysError> {
        let NewKey { name, role, lasts, limits, is_second } = new;
        if !is_name(&name) {
            return Err(KeysError::Name { name });
        }
        if !limits.is_sound() {
            return Err(KeysError::Limits);
        }
        if !is_second && self.keys.iter().any(|key| key.name == name) {
            return Err(KeysError::Exists { name });
        }
        if self.keys.len() >= MOST {
            return Err(KeysError::TooMany);
        }
        let secret = loop {
            let secret = Secret::random()?;
            if self.keys.iter().all(|key| key.id != secret.id()) {
                break secret;
            }
        };
        let created = now();
        let expires = lasts.map(|time| created.saturating_add(time.as_secs()));
        let key = Key { id: secret.id().to_owned(), name, role, sha256: secret.hash(), created, expires, limits };
        self.keys.push(key.clone());
        Ok((key, secret))
    }

    /// Removes the keys of a name, or the one with an id. Errors: `Absent`.
    pub fn revoke(&mut self, name_or_id: &str) -> Result<Vec<Key>, KeysError> {
        let is_meant = |key: &mut Key| key.name == name_or_id || key.id == name_or_id;
        let gone: Vec<Key> = self.keys.extract_if(.., is_meant).collect();
        match gone.is_empty() {
            true => Err(KeysError::Absent { name: name_or_id.to_owned() }),
            false => Ok(gone),
        }
    }

    fn to_json(&self) -> String {
        let stored = Stored { version: VERSION, keys: self.keys.clone() };
        // A set is names and numbers: it can always be written.
        serde_json::to_string_pretty(&stored).map(|text| text + "\n").unwrap_or_default()
    }

    /// Parses the output of [`Self::to_json`].
    fn from_json(bytes: &[u8]) -> Result<Self, String> {
        let Stored { version, keys } = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        if version != VERSION {
            return Err(format!("its version is {version}, and this program reads {VERSION}"));
        }
        if keys.len() > MOST {
            return Err(format!("it has {} keys; at most {MOST} may be", keys.len()));
        }
        let mut ids = HashSet::new();
        for (index, key) in keys.iter().enumerate() {
            let wrong = |what: &str| Err(format!("{what} of keys[{index}] cannot be"));
            if !is_name(&key.name) {
                return wrong("the name");
            }
            if !secret::is_id(&key.id) || !ids.insert(key.id.as_str()) {
                return wrong("the id");
            }
            if !key.limits.is_sound() {
                return wrong("a limit");
            }
        }
        Ok(Self { keys })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn new(name: &str) -> NewKey {
        let (lasts, limits) = (Some(Duration::from_secs(90)), KeyLimits { rate: Some(5), ..KeyLimits::default() });
        NewKey { name: name.to_owned(), role: Role::Submit, lasts, limits, is_second: false }
    }

    #[test]
    fn a_set_comes_back_as_it_was_and_holds_no_secret() {
        let mut set = KeySet::default();
        let (key, secret) = set.add(new("ci")).unwrap();
        assert!(!key.is_expired(key.created) && key.is_expired(key.created + 90));
        let text = set.to_json();
        assert!(!text.contains(secret.reveal().rsplit_once('_').unwrap().1));
        assert_eq!(KeySet::from_json(text.as_bytes()).unwrap(), set);
        for (from, to) in [
            ("\"version\": 1", "\"version\": 2"),
            ("\"ci\"", "\"1ci\""),
            ("\"rate\": 5", "\"rate\": 0"),
            ("\"rate\"", "\"rates\""),
            ("\"submit\"", "\"root\""),
            (&key.id, "tooshort"),
            ("}\n", "\n"),
        ] {
            let damaged = text.replacen(from, to, 1);
            assert!(damaged != text && KeySet::from_json(damaged.as_bytes()).is_err(), "{from}");
        }
        let mut twice = set.clone();
        twice.keys.push(key);
        assert!(KeySet::from_json(twice.to_json().as_bytes()).is_err());
    }

    #[test]
    fn a_name_has_one_key_unless_it_rotates() {
        let mut set = KeySet::default();
        set.add(new("ci")).unwrap();
        assert!(matches!(set.add(new("ci")), Err(KeysError::Exists { .. })));
        let (second, _) = set.add(NewKey { is_second: true, ..new("ci") }).unwrap();
        set.add(new("other")).unwrap();
        assert_eq!(set.revoke(&second.id).unwrap(), [second]);
        assert_eq!((set.revoke("ci").unwrap().len(), set.keys().len()), (1, 1));
        assert!(matches!(set.revoke("ci"), Err(KeysError::Absent { .. })));
        for wrong in ["", "7a", "a b", "ä", "10.0.0.1", "a:b", "a/b", &"x".repeat(65)] {
            assert!(matches!(set.add(new(wrong)), Err(KeysError::Name { .. })), "{wrong}");
        }
        let limits = KeyLimits { weight: Some(0.0), ..KeyLimits::default() };
        assert!(matches!(set.add(NewKey { limits, ..new("b") }), Err(KeysError::Limits)));
    }
}
