//! Promise: a store pins the blobs of its jobs, in the step that changes the job; its index keeps quotas, owners and pins.
//!
//! The suite for every store: `pins_follow_the_job` and `the_index_is_kept` take any [`JobStore`]. `tests/blob` drives the same
//! index at random, through a store of blobs.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use jobs::blob::index::{BlobIndex, Stored, Terms};
use jobs::blob::{BlobError, BlobInfo, Digest, Owner, UploadId, Usage};
use jobs::record::*;
use jobs::store::*;

use super::stores::on_every_store;
use super::{KEEP, input, knowing, open_journal, spec, wait};

const PLENTY: Terms = Terms { quota_bytes: 1000, places: 100, own_quota_bytes: None };

fn blob(name: &str) -> Digest {
    Digest::of(name.as_bytes())
}

/// An upload of a tenant.
fn upload(name: &str, size_bytes: u64, owner: &str) -> UploadId {
    UploadId::new(blob(name), size_bytes).of(owner)
}

fn result() -> ResultSet {
    ResultSet { blobs: [("mesh".to_owned(), blob("result"))].into(), ..ResultSet::default() }
}

fn new(number: u128) -> NewJob {
    NewJob { random: number, spec: spec(&format!("r{number}"), 1), needs: Bytes::default(), cost: Cost::default() }
}

/// Stores a blob as an upload of a tenant.
async fn put(index: &dyn BlobIndex, name: &str, size: u64, owner: &str) {
    let id = upload(name, size, owner);
    index.admit(id, PLENTY).await.unwrap().unwrap();
    index.publish(id, None).await.unwrap();
}

async fn pinned(index: &Arc<dyn BlobIndex>) -> u64 {
    index.usage().await.unwrap().pinned_bytes
}

async fn claim(store: &dyn JobStore, id: JobId) -> u64 {
    let offer = Offer::of("x", Duration::from_secs(60), id);
    let at = store.claim_next(offer).await.unwrap().unwrap().status.version;
    // As whoever does the job stores its result.
    store.index().pin(None, &result_pin(id), &[blob("result")]).await.unwrap();
    at
}

async fn pins_follow_the_job(store: &dyn JobStore) {
    let (index, tenant) = (store.index(), Owner::of("t"));
    let missing = store.create(new(1)).await.unwrap_err();
    assert_eq!(missing, StoreError::InputMissing { digest: input() });
    assert_eq!((store.list(Query::default()).await.unwrap().jobs.len(), pinned(&index).await), (0, 0));
    let stored = [(input(), 1), (blob("result"), 2)];
    let blobs = stored.map(|(digest, size_bytes)| (BlobInfo { digest, size_bytes }, 1)).into();
    index.enter(Stored { blobs, ..Stored::default() }).await.unwrap();
    index.give(tenant, input()).await.unwrap();

    // Twice the same request is one job, and one pin.
    let id = store.create(new(1)).await.unwrap().job.id;
    assert!(store.create(new(1)).await.unwrap().existed);
    assert_eq!(pinned(&index).await, 1);
    assert_eq!(index.disown(tenant, input()).await, Err(BlobError::Pinned { digest: input() }));
    // An attempt that comes to nothing lets go of its result.
    let at = claim(store, id).await;
    assert_eq!(pinned(&index).await, 3);
    store.change(id, at, Change::Release).await.unwrap();
    assert_eq!(pinned(&index).await, 1);
    // A change that is refused lets go of nothing.
    let at = claim(store, id).await;
    store.change(id, at + 1, Change::Cancel).await.unwrap_err();
    assert_eq!(pinned(&index).await, 3);
    store.change(id, at, Change::Succeed(result())).await.unwrap();
    assert_eq!(pinned(&index).await, 2);
    store.delete(id).await.unwrap();
    assert_eq!(pinned(&index).await, 0);

    // However a job ends.
    let at = async |number| {
        let id = store.create(new(number)).await.unwrap().job.id;
        (id, claim(store, id).await)
    };
    let failure = Failure { kind: FailureKind::BadInput, message: "no".to_owned() };
    for (number, change) in [(2, Change::Fail(failure)), (3, Change::Expire(Cause::RunDeadline)), (4, Change::Cancel)] {
        let (id, at) = at(number).await;
        store.change(id, at, change).await.unwrap();
        assert_eq!(pinned(&index).await, 0);
    }
    let (id, _) = at(5).await;
    store.cancel(id).await.unwrap();
    assert_eq!(pinned(&index).await, 0);
    let (id, at) = at(6).await;
    store.change(id, at, Change::Succeed(result())).await.unwrap();
    tokio::time::sleep(KEEP.results).await;
    assert_eq!(pinned(&index).await, 2);
    assert!(store.expire(KEEP, 100).await.unwrap().expired.contains(&id));
    assert_eq!(pinned(&index).await, 0);
    index.disown(tenant, input()).await.unwrap();
}

async fn the_index_is_kept(store: &dyn JobStore) {
    let index = &*store.index();
    let terms = Terms { quota_bytes: 100, places: 8, own_quota_bytes: Some(60) };
    let [a, b] = ["a", "b"].map(Owner::of);
    // An upload counts until it has become a blob, and is admitted once.
    let id = upload("1", 25, "a");
    assert!(index.admit(id, terms).await.unwrap().is_some() && index.admit(id, terms).await.unwrap().is_none());
    let usage = index.usage().await.unwrap();
    assert_eq!(usage, Usage { uploads: 1, uploading_bytes: 25, ..Usage::default() });
    let first = index.publish(id, Some("pin")).await.unwrap().stamp;
    let usage = index.usage().await.unwrap();
    assert_eq!(usage, Usage { blobs: 1, blob_bytes: 25, pinned_bytes: 25, ..Usage::default() });
    assert!(index.has(a, id.digest).await.unwrap() && !index.has(b, id.digest).await.unwrap());
    // What is pinned in nobody's name may be disowned, and stays.
    assert_eq!(index.give(b, id.digest).await.unwrap(), None);
    assert_eq!((index.owned_bytes(a).await.unwrap(), index.owned_bytes(b).await.unwrap()), (25, 25));
    assert_eq!(index.disown(a, id.digest).await.unwrap(), None);
    assert_eq!(index.disown(b, id.digest).await.unwrap(), None);
    assert_eq!(index.disown(b, id.digest).await, Err(BlobError::NotFound { digest: id.digest }));
    assert_eq!(index.delete(id.digest).await, Err(BlobError::Pinned { digest: id.digest }));
    // All or none.
    let absent = BlobError::NotFound { digest: blob("none") };
    assert_eq!(index.pin(None, "two", &[id.digest, blob("none")]).await.unwrap_err(), absent);
    index.unpin("pin").await.unwrap();
    assert_eq!(index.usage().await.unwrap().pinned_bytes, 0);

    // The owner's quota: its oldest blob goes. The quota of all: the least recently used goes.
    put(index, "2", 25, "a").await;
    put(index, "3", 25, "a").await;
    let used = index.touch(&[id.digest, blob("none")]).await.unwrap();
    assert!(used[0].is_some_and(|used| used.stamp > first) && used[1].is_none());
    let room = index.admit(upload("4", 20, "a"), terms).await.unwrap().unwrap();
    assert_eq!(room.victims, [BlobInfo { digest: blob("2"), size_bytes: 25 }]);
    // It is out of the index until its bytes are gone.
    assert!(!index.found(room.victims[0], 1).await.unwrap());
    index.removed(room.victims[0], true).await.unwrap();
    index.end_upload(upload("4", 20, "a")).await.unwrap();
    let room = index.admit(upload("5", 60, "b"), Terms { own_quota_bytes: None, ..terms }).await.unwrap().unwrap();
    assert_eq!(room.victims, [BlobInfo { digest: blob("3"), size_bytes: 25 }]);
    // Bytes that stay are back in the index.
    index.removed(room.victims[0], false).await.unwrap();
    assert!(index.get(blob("3")).await.unwrap().is_some());
    let full = index.admit(upload("6", 30, "a"), terms).await.unwrap_err();
    assert!(matches!(full, BlobError::QuotaExceeded { uploading_bytes: 60, .. }), "{full}");
    let own = index.admit(upload("7", 70, "a"), terms).await.unwrap_err();
    assert!(matches!(own, BlobError::OwnQuotaExceeded { needed_bytes: 70, limit_bytes: 60, .. }), "{own}");
    let large = index.admit(upload("8", 101, "b"), Terms { own_quota_bytes: None, ..terms }).await.unwrap_err();
    assert_eq!(large, BlobError::TooLarge { size_bytes: 101, limit_bytes: 100 });
    assert_eq!(index.usage().await.unwrap().uploads, 1, "what is refused is not kept");

    // Idle uploads, and places.
    let old = SystemTime::now() - Duration::from_secs(100);
    let uploads = (0..7).map(|k| (upload(&format!("old {k}"), 0, "c"), old)).collect();
    index.enter(Stored { uploads, ..Stored::default() }).await.unwrap();
    let places = index.admit(upload("9", 0, "a"), terms).await.unwrap_err();
    assert_eq!(places, BlobError::TooManyUploads { limit: 8 });
    assert_eq!(index.idle_uploads(Duration::from_secs(50)).await.unwrap().len(), 7);
    let stalest = index.stalest_upload(upload("9", 0, "a"), Duration::from_secs(50)).await.unwrap().unwrap();
    assert!(index.idle_time(stalest).await.unwrap().is_some_and(|time| time > Duration::from_secs(50)));
    index.touch_upload(stalest).await.unwrap();
    assert!(index.idle_time(stalest).await.unwrap().is_some_and(|time| time < Duration::from_secs(50)));
    index.end_upload(stalest).await.unwrap();
    assert_eq!(index.idle_time(stalest).await.unwrap(), None);
    index.admit(upload("9", 0, "a"), terms).await.unwrap().unwrap();
}

on_every_store!(pins_follow_the_job, the_index_is_kept);

#[test]
fn a_restart_pins_again_what_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let stored = [(input(), 1), (blob("result"), 2)];
    let open = || open_journal(folder.path()).unwrap();
    let store = knowing(open(), &stored);
    wait(async {
        let done = store.create(new(1)).await.unwrap().job.id;
        let at = claim(&store, done).await;
        store.change(done, at, Change::Succeed(result())).await.unwrap();
        // One that was at work when the process went down.
        let id = store.create(new(2)).await.unwrap().job.id;
        claim(&store, id).await;
    });
    drop(store);
    let store = knowing(open(), &stored);
    wait(async {
        assert_eq!(pinned(&store.index()).await, 0);
        let recovered = store.recover(Orphans::All, MAX_CRASHES).await.unwrap();
        let owner = Owner::of("t");
        assert_eq!(recovered.pinned, [(owner, vec![blob("result")]), (owner, vec![input()])]);
        assert_eq!(pinned(&store.index()).await, 3);
    });
    drop(store);
    // Without the result, the job is still what it is.
    let store = knowing(open(), &stored[..1]);
    wait(async {
        store.recover(Orphans::All, MAX_CRASHES).await.unwrap();
        assert_eq!(pinned(&store.index()).await, 1);
        assert_eq!(store.list(Query::default()).await.unwrap().jobs.len(), 2);
    });
}
