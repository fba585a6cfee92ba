//! Whose a call is.
//!
//! Purpose: [`of`] reads the tenant of a call: that of its key, else what the caller says, else the address it comes from.
//! Invariant: what a caller with a key says beside it counts for nothing here; `access` has looked at it. A tenant is 1 to 128 printable ASCII characters without spaces. Two callers from different networks that say
//! nothing are never the same tenant. Must not know: what tenants have.

use tonic::Extensions;
use tonic::codegen::http::HeaderMap;
use tonic::metadata::MetadataMap;

use super::access::{Caller, TENANT};
use super::connections::Peer;
use wire::WireError;

/// The longest name, bytes.
const LONGEST: usize = 128;

/// The tenant of a call.
pub(super) fn of(metadata: &MetadataMap, extensions: &Extensions) -> Result<String, WireError> {
    of_headers(metadata.as_ref(), extensions)
}

/// The tenant of a request.
pub(crate) fn of_headers(headers: &HeaderMap, extensions: &Extensions) -> Result<String, WireError> {
    if let Some(caller) = extensions.get::<Caller>() {
        return Ok(caller.tenant.clone());
    }
    let wrong = |reason: &str| WireError::field(TENANT, reason);
    if let Some(value) = headers.get(TENANT) {
        let name = value.to_str().unwrap_or_default();
        let is_good = (1..=LONGEST).contains(&name.len()) && name.bytes().all(|byte| byte.is_ascii_graphic());
        return match is_good {
            true => Ok(name.to_owned()),
            false => Err(wrong("is no name: take 1 to 128 printable ASCII characters without spaces")),
        };
    }
    let peer = extensions.get::<Peer>().ok_or_else(|| wrong("is missing, and the caller's address is not known"))?;
    Ok(peer.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &str) -> Result<String, WireError> {
        let mut metadata = MetadataMap::new();
        metadata.insert(TENANT, name.parse().unwrap());
        of(&metadata, &Extensions::default())
    }

    #[test]
    fn a_name_is_taken_as_it_is() {
        assert_eq!(named("team-7/a").unwrap(), "team-7/a");
        assert_eq!(named(&"x".repeat(128)).unwrap().len(), 128);
        for wrong in ["", "a b", "a\tb", &"x".repeat(129)] {
            assert!(matches!(named(wrong), Err(WireError::Field { path, .. }) if path == TENANT), "{wrong:?}");
        }
    }

    #[test]
    fn a_key_counts_more_than_words() {
        let (mut metadata, mut extensions) = (MetadataMap::new(), Extensions::default());
        metadata.insert(TENANT, "other".parse().unwrap());
        extensions.insert(Caller { tenant: "ci".to_owned(), bytes: None });
        assert_eq!(of(&metadata, &extensions).unwrap(), "ci");
    }

    #[test]
    fn who_says_nothing_is_his_address() {
        let from = |address: &str| {
            let mut extensions = Extensions::default();
            extensions.insert(Peer::of(address.parse().unwrap()));
            of(&MetadataMap::new(), &extensions).unwrap()
        };
        assert_eq!(from("10.0.0.1:5"), "10.0.0.1");
        assert_eq!(from("[::ffff:10.0.0.1]:5"), "10.0.0.1");
        assert_eq!(from("[2001:db8::7]:5"), "2001:db8::");
        assert!(of(&MetadataMap::new(), &Extensions::default()).is_err());
    }
}
