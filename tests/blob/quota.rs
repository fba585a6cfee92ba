//! Room, eviction and pins, on each kind of store.

use std::time::Duration;

use jobs::blob::{BlobError, BlobOptions, BlobStore, Digest, UploadId, put as put_bytes};

use crate::{CHUNK, content, each, files, put, read, send, upload_of};

const SIZE: u64 = CHUNK as u64;

fn three_blobs() -> BlobOptions {
    BlobOptions { quota_bytes: 3 * SIZE, ..BlobOptions::default() }
}

#[tokio::test]
async fn the_least_recently_used_goes_first_and_never_a_pinned_one() {
    for (kind, store, folder) in each(three_blobs()).await {
        let blobs: Vec<_> = (0..8).map(|k| content(k, CHUNK)).collect();
        let digests: Vec<Digest> = blobs.iter().map(|bytes| Digest::of(bytes)).collect();
        for bytes in &blobs[..3] {
            put(&store, bytes).await.unwrap();
        }
        // Used: 0 by a read, then 1 by a question. A stat is no use.
        read(&store, digests[0], 0..1).await.unwrap();
        store.find_missing(&digests[1..2]).await.unwrap();
        store.stat(digests[2]).await.unwrap();
        put(&store, &blobs[3]).await.unwrap();
        assert_eq!(store.find_missing(&digests[2..3]).await.unwrap(), digests[2..3], "{kind}");
        store.pin("job 1", &digests[0..1]).await.unwrap();
        store.pin("job 2", &digests[0..2]).await.unwrap();
        put(&store, &blobs[4]).await.unwrap();
        assert_eq!(store.find_missing(&digests[..5]).await.unwrap(), digests[2..4], "{kind}");
        store.unpin("job 2").await.unwrap();
        store.pin("result", &digests[4..5]).await.unwrap();
        put_bytes(&store, blobs[5].clone(), Some("job 1")).await.unwrap();
        assert_eq!(store.find_missing(&digests[..6]).await.unwrap(), digests[1..4], "{kind}");
        let full = BlobError::QuotaExceeded {
            needed_bytes: SIZE,
            limit_bytes: 3 * SIZE,
            used_bytes: 3 * SIZE,
            pinned_bytes: 3 * SIZE,
            uploading_bytes: 0,
        };
        assert!(full.is_temporary());
        assert_eq!(put(&store, &blobs[6]).await, Err(full), "{kind}");
        assert_eq!(store.delete(digests[4]).await, Err(BlobError::Pinned { digest: digests[4] }));
        let absent = BlobError::NotFound { digest: digests[1] };
        assert_eq!(store.pin("result", &[digests[5], digests[1]]).await, Err(absent));
        if let Some(folder) = &folder {
            assert_eq!(files(folder.path()).len(), 3, "what was refused left something");
        }
        store.unpin("result").await.unwrap();
        store.delete(digests[4]).await.unwrap();
        assert_eq!(store.delete(digests[4]).await, Err(BlobError::NotFound { digest: digests[4] }));
        put(&store, &blobs[7]).await.unwrap();
        let usage = store.usage().await.unwrap();
        assert_eq!((usage.blob_bytes, usage.pinned_bytes, usage.blobs), (3 * SIZE, 2 * SIZE, 3), "{kind}");
    }
}

#[tokio::test]
async fn uploads_keep_their_room_and_give_it_back() {
    for (kind, store, folder) in each(BlobOptions { uploads: 2, ..three_blobs() }).await {
        let old = content(9, CHUNK);
        put(&store, &old).await.unwrap();
        let promise = |k: u8, size| UploadId::new(Digest::of(&[k]), size);
        store.begin(promise(0, 2 * SIZE)).await.unwrap();
        store.stat(Digest::of(&old)).await.expect("there is room for both");
        let never = BlobError::TooLarge { size_bytes: 3 * SIZE + 1, limit_bytes: 3 * SIZE };
        assert_eq!(store.begin(promise(1, 3 * SIZE + 1)).await, Err(never));
        let now = store.begin(promise(1, 2 * SIZE)).await.unwrap_err();
        assert!(matches!(now, BlobError::QuotaExceeded { uploading_bytes, .. } if uploading_bytes == 2 * SIZE));
        store.stat(Digest::of(&old)).await.expect("nothing goes for what does not fit anyway");
        store.begin(promise(1, SIZE)).await.unwrap();
        assert!(store.stat(Digest::of(&old)).await.is_err(), "{kind}");
        // Places are counted for those who own their uploads; what the process stores for itself gets in.
        let own = |k| promise(k, 0).of("somebody");
        // Nor do promises take all of the room.
        let crowds = store.begin(promise(5, 1).of("somebody")).await.unwrap_err();
        assert!(matches!(crowds, BlobError::QuotaExceeded { .. }));
        store.begin(own(2)).await.unwrap();
        store.begin(own(3)).await.unwrap();
        assert_eq!(store.begin(own(4)).await, Err(BlobError::TooManyUploads { limit: 2 }));
        for k in [2, 3] {
            store.abandon(own(k)).await.unwrap();
        }
        store.abandon(promise(0, 2 * SIZE)).await.unwrap();
        store.abandon(promise(1, SIZE)).await.unwrap();
        let usage = store.usage().await.unwrap();
        assert_eq!((usage.uploads, usage.uploading_bytes), (0, 0));
        if let Some(folder) = &folder {
            assert_eq!(files(folder.path()), []);
        }
    }
}

#[tokio::test]
async fn uploads_that_nobody_continues_are_removed() {
    for (kind, store, folder) in each(BlobOptions { keep_uploads: Duration::ZERO, ..three_blobs() }).await {
        let bytes = content(1, CHUNK);
        send(&store, upload_of(&bytes), &bytes).await.unwrap();
        assert_eq!(store.sweep().await.unwrap(), 1, "{kind}");
        assert_eq!(store.sweep().await.unwrap(), 0);
        assert_eq!(store.usage().await.unwrap().uploading_bytes, 0);
        if let Some(folder) = &folder {
            assert_eq!(files(folder.path()), []);
        }
    }
    for (kind, store, _folder) in each(three_blobs()).await {
        store.begin(upload_of(&content(1, CHUNK))).await.unwrap();
        assert_eq!(store.sweep().await.unwrap(), 0, "{kind}: it is young");
    }
}

#[tokio::test]
async fn uploads_that_were_left_make_room_for_others() {
    let promise = |k: u8, size, owner| UploadId::new(Digest::of(&[k]), size).of(owner);
    for (kind, store, _folder) in
        each(BlobOptions { uploads: 4, keep_crowded_uploads: Duration::ZERO, ..three_blobs() }).await
    {
        for k in 0..4 {
            store.begin(promise(k, 0, "left")).await.unwrap();
        }
        // Places: one's own go first, then those of others.
        store.begin(promise(4, 0, "other")).await.unwrap();
        store.begin(promise(5, 0, "other")).await.unwrap();
        assert_eq!(store.usage().await.unwrap().uploads, 4, "{kind}");
        assert!(store.upload_status(promise(4, 0, "other")).await.is_err(), "{kind}: its own oldest went");
        for k in 1..4 {
            store.upload_status(promise(k, 0, "left")).await.unwrap();
        }
    }
    for (kind, store, _folder) in each(BlobOptions { keep_crowded_uploads: Duration::ZERO, ..three_blobs() }).await {
        // Room: what was promised and never sent.
        store.begin(promise(0, SIZE, "left")).await.unwrap();
        store.begin(promise(1, 2 * SIZE, "other")).await.unwrap();
        store.begin(promise(2, 2 * SIZE, "third")).await.unwrap();
        assert!(store.upload_status(promise(0, SIZE, "left")).await.is_err(), "{kind}");
        // What can never fit displaces nobody.
        let never = store.begin(promise(3, 3 * SIZE + 1, "left")).await.unwrap_err();
        assert!(matches!(never, BlobError::TooLarge { .. }), "{never}");
        store.upload_status(promise(2, 2 * SIZE, "third")).await.unwrap();
    }
}

/// Uploads, reads, pins and evictions from many tasks: a pinned blob is always there, and the room is never exceeded.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn many_at_once_stay_within_the_quota() {
    for (kind, store, folder) in
        each(BlobOptions { quota_bytes: 6 * SIZE, fsync: false, ..BlobOptions::default() }).await
    {
        let mut tasks = tokio::task::JoinSet::new();
        for writer in 0_u64..4 {
            let store = store.clone();
            tasks.spawn(async move {
                for round in 0..30 {
                    let bytes = content((7 * writer + round) % 11, CHUNK);
                    let name = format!("writer {writer}");
                    match put_bytes(&store, bytes.clone(), Some(&name)).await {
                        Ok(info) => {
                            assert_eq!(read(&store, info.digest, 0..SIZE).await.unwrap(), bytes);
                            store.unpin(&name).await.unwrap();
                        }
                        // Another writer of the same bytes keeps beginning and losing them; or no room.
                        Err(BlobError::QuotaExceeded { .. } | BlobError::UploadNotFound { .. }) => {}
                        Err(error) => panic!("{error}"),
                    }
                    let usage = store.usage().await.unwrap();
                    assert!(usage.blob_bytes + usage.uploading_bytes <= 6 * SIZE, "{kind}: {usage:?}");
                }
            });
        }
        tasks.join_all().await;
        let usage = store.usage().await.unwrap();
        assert_eq!((usage.pinned_bytes, usage.uploads, usage.uploading_bytes), (0, 0, 0), "{kind}");
        if let Some(folder) = &folder {
            assert_eq!(files(folder.path()).len(), usage.blobs, "{kind}");
        }
    }
}
