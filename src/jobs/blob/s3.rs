//! The way to a bucket.
//!
//! Purpose: makes the client of an S3-compatible store from a URL, settings and variables.
//! Invariant: no request is made here. Must not know: blobs.

use object_store::aws::{AmazonS3, AmazonS3Builder, AmazonS3ConfigKey};
use object_store::prefix::PrefixStore;

use super::BlobError;
use super::error::object;

/// The bucket and prefix of `url`; see [`ObjectBlobs::s3`](super::ObjectBlobs::s3).
pub(super) fn open(
    url: &str,
    settings: impl IntoIterator<Item = (String, String)>,
) -> Result<PrefixStore<AmazonS3>, BlobError> {
    let rest = url.strip_prefix("s3://").unwrap_or_default();
    let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
    if bucket.is_empty() {
        return Err(BlobError::Unavailable(format!("{url} names no bucket; write s3://bucket or s3://bucket/prefix")));
    }
    let mut builder = AmazonS3Builder::from_env();
    for (key, value) in settings {
        let key: AmazonS3ConfigKey = key.parse().map_err(object("read a setting of S3"))?;
        builder = builder.with_config(key, value);
    }
    // A provider that was installed before stays; any will do.
    drop(rustls::crypto::ring::default_provider().install_default());
    let store = builder.with_bucket_name(bucket).build().map_err(object("open the bucket"))?;
    Ok(PrefixStore::new(store, prefix))
}
