//! Promise: a result is found by its tenant and by what decides its bits, as long as it is kept.

use std::time::Duration;

use jobs::blob::Digest;
use jobs::record::*;
use jobs::store::*;

use super::stores::on_every_store;
use super::{input, knowing, message, open_journal, wait};

const FINGERPRINT: [u8; 32] = [9; 32];

/// A job of a tenant; `random` rises with its name.
async fn create(store: &dyn JobStore, tenant: &str, random: u128) -> JobId {
    let spec = Spec::new(message(1), tenant.to_owned(), String::new()).unwrap();
    let new = NewJob { random, spec, needs: Bytes::default(), cost: Cost::default() };
    store.create(new).await.unwrap().job.id
}

async fn succeed(store: &dyn JobStore, id: JobId, fingerprint: Option<Digest>) {
    let offer = Offer::of("x", Duration::from_secs(60), id);
    let at = store.claim_next(offer).await.unwrap().unwrap().status.version;
    let result = ResultSet { fingerprint, ..ResultSet::default() };
    store.change(id, at, Change::Succeed(result)).await.unwrap();
}

async fn same(store: &dyn JobStore, tenant: &str, fingerprint: [u8; 32]) -> Option<JobId> {
    let found = store.same(tenant.to_owned(), fingerprint.into()).await.unwrap();
    if let Some(job) = &found {
        assert_eq!(*job, store.get(job.id).await.unwrap());
    }
    found.map(|job| job.id)
}

async fn know_input(store: &dyn JobStore) {
    let blobs = vec![(jobs::blob::BlobInfo { digest: input(), size_bytes: 1 }, 1)];
    store.index().enter(jobs::blob::index::Stored { blobs, ..Default::default() }).await.unwrap();
}

async fn a_kept_result_is_found_by_its_tenant_and_fingerprint(store: &dyn JobStore) {
    know_input(store).await;
    let mut ids = Vec::new();
    for random in 0..3 {
        // Names rise with the clock of the store, in milliseconds.
        tokio::time::sleep(Duration::from_millis(3)).await;
        ids.push(create(store, "t", random).await);
    }
    assert_eq!(same(store, "t", FINGERPRINT).await, None, "none has a result");
    // The newest job counts, whichever ended last.
    succeed(store, ids[1], Some(FINGERPRINT.into())).await;
    assert_eq!(same(store, "t", FINGERPRINT).await, Some(ids[1]));
    succeed(store, ids[2], Some(FINGERPRINT.into())).await;
    succeed(store, ids[0], Some(FINGERPRINT.into())).await;
    assert_eq!(same(store, "t", FINGERPRINT).await, Some(ids[2]));
    // No other tenant's, also of a name that begins alike, and no other fingerprint.
    for (tenant, fingerprint) in [("u", FINGERPRINT), ("", FINGERPRINT), ("tt", FINGERPRINT), ("t", [8; 32])] {
        assert_eq!(same(store, tenant, fingerprint).await, None, "{tenant}");
    }
    // Deleted, then expired.
    store.delete(ids[2]).await.unwrap();
    assert_eq!(same(store, "t", FINGERPRINT).await, Some(ids[1]));
    let at = store.get(ids[1]).await.unwrap().status.version;
    store.change(ids[1], at, Change::Expire(Cause::Kept)).await.unwrap();
    assert_eq!(same(store, "t", FINGERPRINT).await, Some(ids[0]));
    let keep = Retention { results: Duration::ZERO, records: Duration::from_secs(60) };
    tokio::time::sleep(Duration::from_millis(3)).await;
    store.expire(keep, 10).await.unwrap();
    assert_eq!(same(store, "t", FINGERPRINT).await, None);
    // What has no result, or does not say what decided its bits.
    let failed = create(store, "t", 10).await;
    let failure = Failure { kind: FailureKind::BadInput, message: "no".to_owned() };
    store.change(failed, 1, Change::Fail(failure)).await.unwrap();
    let silent = create(store, "t", 11).await;
    succeed(store, silent, None).await;
    assert_eq!(same(store, "t", FINGERPRINT).await, None);
    assert_eq!(store.get(silent).await.unwrap().status.fingerprint(), None);
}

on_every_store!(a_kept_result_is_found_by_its_tenant_and_fingerprint);

#[test]
fn the_journal_knows_fingerprints_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let open = || knowing(open_journal(folder.path()).unwrap(), &[(input(), 1)]);
    let store = open();
    let id = wait(create(&store, "t", 1));
    wait(succeed(&store, id, Some(FINGERPRINT.into())));
    drop(store);
    assert_eq!(wait(same(&open(), "t", FINGERPRINT)), Some(id));
}
