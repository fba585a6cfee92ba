//! The tenant of a call.
//!
//! Purpose: [`of`] reads it: the tenant of the call's key, else the named one, else the address that the call comes from.
//! Invariant: of a call with a key `access` has checked the name, and only the key's tenant counts here. Callers from
//! different networks that name no tenant are never the same one. Must not know: what tenants have.

use tonic::Extensions;
use tonic::codegen::http::HeaderMap;
use tonic::metadata::MetadataMap;

use super::access::{Caller, TENANT, tenant};
use super::connections::Peer;
use wire::WireError;

pub(super) fn of(metadata: &MetadataMap, extensions: &Extensions) -> Result<String, WireError> {
    of_headers(metadata.as_ref(), extensions)
}

/// The tenant of a request.
pub(crate) fn of_headers(headers: &HeaderMap, extensions: &Extensions) -> Result<String, WireError> {
    if let Some(caller) = extensions.get::<Caller>() {
        return Ok(caller.tenant.clone());
    }
    let wrong = |reason: &str| WireError::field(TENANT, reason);
    let named = tenant(headers);
    let named = named.map_err(|_| wrong("is no name: take 1 to 128 printable ASCII characters without spaces"))?;
    if let Some(name) = named {
        return Ok(name);
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
