//! Records between their types and bytes.
//!
//! A record is one byte, the version of its layout, and JSON. JSON because it says its fields' names: an option that a later
//! release adds needs no new version and no copy of the old types, one that an older release does not know is refused
//! instead of misread, and a person with the file or a broker's tool can read it. Numbers come back with the same bits. It
//! costs a few hundred bytes a job.
//!
//! Purpose: [`encode`], [`decode`]. Invariant: decoding is strict: an unknown version, an unknown field or bytes too many are
//! errors. Must not know: tables.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::StoreError;
use crate::record::{Bytes, Status};

/// The layout that is written. Layout 2 added the memory that a job needs, layout 3 has specifications as messages. Older ones
/// are read.
const VERSION: u8 = 3;

/// What is kept of a job beside its specification: what changes, and what lists look for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Head {
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub tenant: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub request_id: String,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<String, String>,
    pub status: Status,
    /// Memory that it is expected to need; journals of earlier releases do not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) needs: Option<Bytes>,
    /// Number of the next event that is stored.
    pub next_event: u64,
    /// First event number that is not reserved. Numbers from `next_event` to this one belong to progress events that are not
    /// stored yet.
    pub reserved_events: u64,
}

fn damaged(what: &str, cause: &dyn std::fmt::Display) -> StoreError {
    StoreError::Damaged { path: PathBuf::from(what), what: cause.to_string() }
}

pub(crate) fn encode<T: Serialize>(what: &str, value: &T) -> Result<Vec<u8>, StoreError> {
    let mut bytes = vec![VERSION];
    serde_json::to_writer(&mut bytes, value).map_err(|e| damaged(what, &e))?;
    Ok(bytes)
}

pub(crate) fn decode<T: DeserializeOwned>(what: &str, bytes: &[u8]) -> Result<T, StoreError> {
    match bytes.split_first() {
        Some((1..=VERSION, rest)) => serde_json::from_slice(rest).map_err(|e| damaged(what, &e)),
        Some((&found, _)) => Err(StoreError::UnknownVersion {
            what: format!("the record {what}"),
            found: found.into(),
            known: VERSION.into(),
        }),
        None => Err(damaged(what, &"it is empty")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn older_layouts_are_read_and_newer_ones_refused() {
        let mut record = encode("a", &7).unwrap();
        for layout in 1..=VERSION {
            record[0] = layout;
            assert_eq!(decode::<i32>("a", &record).unwrap(), 7);
        }
        for layout in [0, VERSION + 1] {
            record[0] = layout;
            let refused = decode::<i32>("a", &record).unwrap_err();
            assert!(
                matches!(refused, StoreError::UnknownVersion { found, known, .. }
                    if found == u32::from(layout) && known == u32::from(VERSION)),
                "{refused:?}"
            );
        }
    }
}
