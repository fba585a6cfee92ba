//! Request handling that gRPC and HTTP share.
//!
//! Purpose: [`Desk`] has the parts that a handler needs; the functions here are the steps of calls.
//! Invariant: a change of jobs runs to its end, even if its caller goes. Nothing is waited for without a limit. A blob
//! exists only for a tenant that has it. Must not know: messages, requests, how errors are worded.

use std::sync::Arc;
use std::time::Duration;

use tonic::Extensions;
use tonic::codegen::http::HeaderMap;

use super::RequestError;
use super::access::{Access, Caller, Refusal, TENANT, tenant};
use super::info::Info;
use super::stream::Gate;
use crate::config::Limits;
use crate::metrics::Metrics;
use jobs::JobError;
use jobs::blob::{BlobError, BlobStore, Digest, Owner, UploadId, UploadStatus};
use jobs::executor::api::{JobApi, Reuse};
use jobs::record::event::{Event, What};
use jobs::record::{JobId, Spec};
use jobs::store::Created;
use telemetry::trace;
use transport::{Budget, Peer};
use wire::WireError;

/// For the storage to answer.
pub(super) const STORE_TIME: Duration = Duration::from_secs(60);

/// For the jobs' API to answer. An estimate may read a mesh.
pub(crate) const DESK_TIME: Duration = Duration::from_secs(60);

/// Between two looks whether a job that says nothing has ended: its watcher may wait for a number that never comes.
const LOOK_EVERY: Duration = Duration::from_secs(10);

/// Events of a watch that are looked up at once.
const EVENTS: usize = 64;

/// The parts that a handler needs.
#[derive(Clone)]
pub struct Desk {
    pub api: Arc<dyn JobApi>,
    pub blobs: Arc<dyn BlobStore>,
    pub limits: Limits,
    pub budget: Budget,
    pub gate: Gate,
    pub access: Access,
    pub metrics: Metrics,
    pub info: Info,
}

/// Creates a job for a tenant that may have `most` bytes of blobs.
pub(crate) async fn create(
    api: Arc<dyn JobApi>,
    blobs: &dyn BlobStore,
    most: Option<u64>,
    (wanted, reuse): (Spec, Reuse),
) -> Result<Created, RequestError> {
    if let Some(limit_bytes) = most {
        // Results are kept whatever their size: a tenant at its limit gets no more of them.
        let used_bytes = blobs.owned_bytes(Owner::of(&wanted.tenant)).await?;
        if used_bytes >= limit_bytes {
            return Err(Refusal::Bytes { used_bytes, limit_bytes }.into());
        }
    }
    to_the_end(async move { api.create(wanted, reuse).await }).await
}

/// Runs a change to its end, even if the caller goes away: half of one would leave blobs pinned for no job.
pub(crate) async fn to_the_end<T: Send + 'static, E: Into<RequestError> + Send + 'static>(
    work: impl Future<Output = Result<T, E>> + Send + 'static,
) -> Result<T, RequestError> {
    match tokio::spawn(trace::carry(work)).await {
        Ok(result) => result.map_err(Into::into),
        Err(panic) => Err(JobError::Panicked(panic.to_string()).into()),
    }
}

/// Passes on the events of a job after number `after`, until it has ended and all were passed on.
pub(crate) async fn follow<F: Future<Output = Result<(), RequestError>>>(
    api: &dyn JobApi,
    tenant: &str,
    id: JobId,
    mut after: u64,
    tell: impl Fn(Event) -> F,
) -> Result<(), RequestError> {
    let mut ended = false;
    loop {
        let found = api.events(tenant, id, after, EVENTS).await?.events;
        for event in found.iter() {
            after = event.number;
            ended |= matches!(event.what, What::State { state, .. } if state.is_ended());
            tell(event.clone()).await?;
        }
        if !found.is_empty() {
            continue;
        }
        if ended {
            return Ok(());
        }
        // A watch after the last event of an ended job would wait for ever. Its events are looked up once more, since
        // it may have ended between the two looks.
        ended = api.get(tenant, id).await?.status.state.is_ended();
        if !ended && let Ok(come) = tokio::time::timeout(LOOK_EVERY, api.wait(tenant, id, after)).await {
            come?;
        }
    }
}

/// Waits for the storage, but not for ever.
pub(crate) async fn timely<T>(work: impl Future<Output = Result<T, BlobError>>) -> Result<T, RequestError> {
    match tokio::time::timeout(STORE_TIME, work).await {
        Ok(result) => result.map_err(RequestError::from),
        Err(_) => Err(RequestError::Slow(STORE_TIME)),
    }
}

/// A blob that the owner does not have is not stored for it.
pub(crate) async fn check_owned(store: &dyn BlobStore, owner: Owner, digest: Digest) -> Result<(), RequestError> {
    match timely(store.is_owned(owner, digest)).await? {
        true => Ok(()),
        false => Err(BlobError::NotFound { digest }.into()),
    }
}

/// Takes an upload away that has no bytes when its stream ends, however that ends: it would hold room for nothing.
pub(crate) struct EmptyUpload {
    store: Arc<dyn BlobStore>,
    upload: UploadId,
}

impl EmptyUpload {
    pub(crate) fn new(store: &Arc<dyn BlobStore>, upload: UploadId) -> Self {
        Self { store: Arc::clone(store), upload }
    }
}

impl Drop for EmptyUpload {
    fn drop(&mut self) {
        let (store, upload) = (Arc::clone(&self.store), self.upload);
        tokio::spawn(async move {
            if let Ok(UploadStatus { kept_bytes: 0, complete: false }) = store.upload_status(upload).await {
                // Somebody else may have taken it away, or written on.
                let _ = store.abandon(upload).await;
            }
        });
    }
}

/// The tenant of a request: that of the call's key, else the named one, else the address that the call comes from. Of a call
/// with a key `access` has checked the name, and only the key's tenant counts here. Callers from different networks that name
/// no tenant are never the same one.
pub(crate) fn tenant_of(headers: &HeaderMap, extensions: &Extensions) -> Result<String, RequestError> {
    if let Some(caller) = extensions.get::<Caller>() {
        return Ok(caller.tenant.clone());
    }
    let wrong = |reason: &str| WireError::field(TENANT, reason);
    let named =
        tenant(headers).map_err(|_| wrong("is no name: take 1 to 128 printable ASCII characters without spaces"))?;
    if let Some(name) = named {
        return Ok(name);
    }
    let peer = extensions.get::<Peer>().ok_or_else(|| wrong("is missing, and the caller's address is not known"))?;
    Ok(peer.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &str) -> Result<String, RequestError> {
        let mut metadata = HeaderMap::new();
        metadata.insert(TENANT, name.parse().unwrap());
        tenant_of(&metadata, &Extensions::default())
    }

    #[test]
    fn a_name_is_taken_as_it_is() {
        assert_eq!(named("team-7/a").unwrap(), "team-7/a");
        assert_eq!(named(&"x".repeat(128)).unwrap().len(), 128);
        for wrong in ["", "a b", "a\tb", &"x".repeat(129)] {
            assert!(
                matches!(named(wrong), Err(RequestError::Wire(WireError::Field { path, .. })) if path == TENANT),
                "{wrong:?}"
            );
        }
    }

    #[test]
    fn a_key_counts_more_than_words() {
        let (mut metadata, mut extensions) = (HeaderMap::new(), Extensions::default());
        metadata.insert(TENANT, "other".parse().unwrap());
        extensions.insert(Caller { tenant: "ci".to_owned(), bytes: None });
        assert_eq!(tenant_of(&metadata, &extensions).unwrap(), "ci");
    }

    #[test]
    fn who_says_nothing_is_his_address() {
        let from = |address: &str| {
            let mut extensions = Extensions::default();
            extensions.insert(Peer::of(address.parse().unwrap()));
            tenant_of(&HeaderMap::new(), &extensions).unwrap()
        };
        assert_eq!(from("10.0.0.1:5"), "10.0.0.1");
        assert_eq!(from("[::ffff:10.0.0.1]:5"), "10.0.0.1");
        assert_eq!(from("[2001:db8::7]:5"), "2001:db8::");
        assert!(tenant_of(&HeaderMap::new(), &Extensions::default()).is_err());
    }
}
