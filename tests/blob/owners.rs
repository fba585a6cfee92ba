//! Who has a blob, on each kind of store.

use jobs::blob::{BlobError, BlobOptions, BlobStore, Digest, ObjectBlobs, Owner, UploadId, put as put_bytes};

use crate::{content, each, everything, local, send, upload_of};

async fn upload(store: &dyn BlobStore, id: UploadId, bytes: &bytes::Bytes) {
    send(store, id, bytes).await.unwrap();
    store.finish(id, None).await.unwrap();
}

#[tokio::test]
async fn a_blob_is_theirs_who_sent_it_or_were_given_it() {
    for (kind, store, _folder) in each(BlobOptions::default()).await {
        let bytes = content(1, 500);
        let digest = Digest::of(&bytes);
        let [a, b, c] = ["a", "b", "c"].map(Owner::of);
        put_bytes(&store, bytes.clone(), Some("result")).await.unwrap();
        assert!(!store.is_owned(a, digest).await.unwrap(), "{kind}: what the process stores is nobody's");
        upload(&store, upload_of(&bytes).of("a"), &bytes).await;
        store.claim(b, &[digest, Digest::of(b"not there")]).await.unwrap();
        let has = async |owner| store.is_owned(owner, digest).await.unwrap();
        assert_eq!((has(a).await, has(b).await, has(c).await), (true, true, false), "{kind}");
        let asked = [Digest::of(b"not there"), digest];
        assert_eq!(store.find_missing_of(a, &asked).await.unwrap(), asked[..1], "{kind}");
        assert_eq!(store.find_missing_of(c, &asked).await.unwrap(), asked, "{kind}");
        assert_eq!(store.owned_bytes(b).await.unwrap(), 500, "{kind}");
        // A pin in a's name keeps a from giving it away, and nobody else.
        store.pin_for(a, "job", &[digest]).await.unwrap();
        assert_eq!(store.disown(a, digest).await, Err(BlobError::Pinned { digest }), "{kind}");
        assert_eq!(store.disown(c, digest).await, Err(BlobError::NotFound { digest }), "{kind}");
        store.disown(b, digest).await.unwrap();
        assert_eq!((has(b).await, store.owned_bytes(b).await.unwrap()), (false, 0), "{kind}");
        store.unpin("job").await.unwrap();
        store.disown(a, digest).await.unwrap();
        assert!(store.stat(digest).await.is_ok(), "{kind}: the result is still pinned");
    }
}

#[tokio::test]
async fn what_is_evicted_is_nobody_s_when_it_comes_back() {
    for (kind, store, folder) in each(BlobOptions { quota_bytes: 1000, ..BlobOptions::default() }).await {
        let bytes = content(1, 600);
        let (digest, a) = (Digest::of(&bytes), Owner::of("a"));
        upload(&store, upload_of(&bytes).of("a"), &bytes).await;
        let other = content(2, 600);
        upload(&store, upload_of(&other).of("b"), &other).await;
        assert!(!store.is_owned(a, digest).await.unwrap(), "{kind}");
        store.disown(Owner::of("b"), Digest::of(&other)).await.unwrap();
        let start = std::time::Instant::now();
        while store.stat(Digest::of(&other)).await.is_ok() {
            assert!(start.elapsed().as_secs() < 60);
        }
        upload(&store, upload_of(&bytes).of("c"), &bytes).await;
        assert!(!store.is_owned(a, digest).await.unwrap(), "{kind}: a does not learn that c has it");
        if let Some(folder) = &folder {
            let marks = || everything(folder.path()).iter().filter(|(path, _)| path.starts_with("owners/")).count();
            while marks() > 1 {
                assert!(start.elapsed().as_secs() < 60, "{kind}");
            }
        }
    }
}

#[tokio::test]
async fn owners_come_back_with_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = content(1, 500);
    let digest = Digest::of(&bytes);
    let store = local(folder.path(), BlobOptions::default()).await;
    for name in ["a", "b"] {
        upload(&store, upload_of(&bytes).of(name), &bytes).await;
    }
    store.disown(Owner::of("b"), digest).await.unwrap();
    drop(store);
    let store: ObjectBlobs = local(folder.path(), BlobOptions::default()).await;
    assert!(
        store.is_owned(Owner::of("a"), digest).await.unwrap() && !store.is_owned(Owner::of("b"), digest).await.unwrap()
    );
    assert_eq!(store.owned_bytes(Owner::of("a")).await.unwrap(), 500);
}

#[tokio::test]
async fn an_owner_s_own_room_is_kept() {
    for (kind, store, _folder) in each(BlobOptions::default()).await {
        let owner = Owner::of("a");
        let all: Vec<_> = (0..3).map(|k| content(k, 400)).collect();
        for bytes in &all {
            let id = upload_of(bytes).of("a");
            assert!(!store.begin_within(id, Some(1000)).await.unwrap().complete);
            send(&store, id, bytes).await.unwrap();
            store.finish(id, None).await.unwrap();
        }
        let digests: Vec<_> = all.iter().map(|bytes| Digest::of(bytes)).collect();
        assert_eq!(store.find_missing_of(owner, &digests).await.unwrap(), digests[..1], "{kind}: the oldest went");
        store.pin_for(owner, "job", &digests[1..]).await.unwrap();
        let large = UploadId::new(Digest::of(b"large"), 201).of("a");
        let used = BlobError::OwnQuotaExceeded { needed_bytes: 201, used_bytes: 800, limit_bytes: 1000 };
        assert_eq!(store.begin_within(large, Some(1000)).await, Err(used), "{kind}");
        let one = UploadId::new(Digest::of(b"one"), 150).of("a");
        store.begin_within(one, Some(1000)).await.unwrap();
        // What is promised counts too.
        let two = UploadId::new(Digest::of(b"two"), 51).of("a");
        assert!(matches!(store.begin_within(two, Some(1000)).await, Err(BlobError::OwnQuotaExceeded { .. })), "{kind}");
        store.begin_within(two.of("b"), Some(1000)).await.unwrap();
    }
}
