//! Two processes over one store: neither knows what the other did, except through the store.

use std::sync::Arc;

use bytes::Bytes;
use jobs::blob::{BlobError, BlobOptions, BlobStore, Chunk, Digest, ObjectBlobs, UploadId};
use object_store::memory::InMemory;

use crate::{CHUNK, content, put, read_all, send, upload_of};

/// As in `blob::staging::multipart`.
const PART: u64 = 8 << 20;

async fn two() -> (ObjectBlobs, ObjectBlobs) {
    let store = Arc::new(InMemory::new());
    let one = ObjectBlobs::shared(Arc::clone(&store), BlobOptions::default()).await.unwrap();
    let two = ObjectBlobs::shared(store, BlobOptions::default()).await.unwrap();
    (one, two)
}

#[tokio::test]
async fn a_blob_of_one_process_is_seen_pinned_and_removed_by_another() {
    let (one, two) = two().await;
    let bytes = content(1, 3 * CHUNK);
    let digest = put(&one, &bytes).await.unwrap();
    assert_eq!(two.find_missing(&[digest, Digest::of(b"none")]).await.unwrap(), [Digest::of(b"none")]);
    assert_eq!(read_all(&two, digest).await.unwrap(), bytes);
    assert!(two.begin(upload_of(&bytes)).await.unwrap().complete);
    two.pin("job", &[digest]).await.unwrap();
    assert_eq!(two.delete(digest).await, Err(BlobError::Pinned { digest }));
    two.unpin("job").await.unwrap();
    two.delete(digest).await.unwrap();
    // The first process learns of it when it looks.
    assert_eq!(read_all(&one, digest).await, Err(BlobError::NotFound { digest }));
    assert_eq!(one.stat(digest).await, Err(BlobError::NotFound { digest }));
}

async fn send_large(store: &ObjectBlobs, id: UploadId, bytes: &Bytes, to: u64) {
    let mut kept = store.begin(id).await.unwrap().kept_bytes;
    while kept < to {
        let start = usize::try_from(kept).unwrap();
        let end = usize::try_from((kept + (1 << 20)).min(to)).unwrap();
        kept = store.write(id, Chunk::new(kept, bytes.slice(start..end))).await.unwrap().kept_bytes;
    }
}

#[tokio::test]
async fn an_upload_goes_on_in_another_process_after_the_last_chunk_but_one() {
    let (one, two) = two().await;
    let bytes = content(2, 2 * usize::try_from(PART).unwrap() + 12_345);
    let id = upload_of(&bytes).of("a");
    send_large(&one, id, &bytes, PART + (3 << 20)).await;
    assert_eq!(one.upload_status(id).await.unwrap().kept_bytes, PART + (3 << 20));
    assert_eq!(two.upload_status(id).await.unwrap().kept_bytes, PART + (2 << 20));
    send_large(&two, id, &bytes, id.size_bytes).await;
    assert!(matches!(one.finish(id, None).await, Err(BlobError::Incomplete { .. })));
    two.finish(id, None).await.unwrap();
    assert_eq!(read_all(&one, id.digest).await.unwrap(), bytes);
    one.abandon(id).await.unwrap();
    assert_eq!(read_all(&two, id.digest).await.unwrap(), bytes);
}

#[tokio::test]
async fn wrong_bytes_of_many_parts_leave_nothing() {
    use futures_util::TryStreamExt;
    use object_store::ObjectStore;
    let store = Arc::new(InMemory::new());
    let blobs = ObjectBlobs::shared(Arc::clone(&store), BlobOptions::default()).await.unwrap();
    let wrong = content(3, usize::try_from(PART).unwrap() + 1);
    let id = UploadId::new(Digest::of(b"other"), wrong.len() as u64);
    let mut kept = blobs.begin(id).await.unwrap().kept_bytes;
    while kept < id.size_bytes {
        let start = usize::try_from(kept).unwrap();
        let piece = wrong.slice(start..wrong.len().min(start + (1 << 20)));
        kept = blobs.write(id, Chunk::new(kept, piece)).await.unwrap().kept_bytes;
    }
    assert!(matches!(blobs.finish(id, None).await, Err(BlobError::DigestMismatch { .. })));
    let left: Vec<_> = store.list(None).try_collect().await.unwrap();
    assert!(left.is_empty(), "{left:?}");
    // And the same store takes the right ones.
    let right = content(4, CHUNK);
    send(&blobs, upload_of(&right), &right).await.unwrap();
    blobs.finish(upload_of(&right), None).await.unwrap();
}

/// Two processes, one bucket, one index: the room is never exceeded, and what one removes the other does not miss.
#[cfg(all(unix, feature = "postgres"))]
#[needs::needs(postgres)]
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn processes_with_one_index_stay_within_the_quota() {
    use jobs::blob::put as put_bytes;
    use jobs::store::JobStore;
    const SIZE: u64 = CHUNK as u64;
    let database = crate::postgres_server::database();
    let bucket = Arc::new(InMemory::new());
    let options = BlobOptions { quota_bytes: 6 * SIZE, ..BlobOptions::default() };
    let mut processes = Vec::new();
    for _ in 0..2 {
        let jobs = crate::postgres(&database).await;
        let blobs = ObjectBlobs::shared_with(jobs.index(), Arc::clone(&bucket), options).await.unwrap();
        processes.push((jobs, blobs));
    }
    let mut tasks = tokio::task::JoinSet::new();
    for writer in 0_u64..4 {
        let blobs = processes[usize::try_from(writer % 2).unwrap()].1.clone();
        tasks.spawn(async move {
            for round in 0..25 {
                let bytes = content((7 * writer + round) % 11, CHUNK);
                let name = format!("writer {writer}");
                match put_bytes(&blobs, bytes.clone(), Some(&name)).await {
                    Ok(info) => {
                        assert_eq!(crate::read(&blobs, info.digest, 0..SIZE).await.unwrap(), bytes);
                        blobs.unpin(&name).await.unwrap();
                    }
                    Err(BlobError::QuotaExceeded { .. } | BlobError::UploadNotFound { .. }) => {}
                    Err(error) => panic!("{error}"),
                }
                let usage = blobs.usage().await.unwrap();
                assert!(usage.blob_bytes + usage.uploading_bytes <= 6 * SIZE, "{usage:?}");
            }
        });
    }
    tasks.join_all().await;
    let usage = processes[0].1.usage().await.unwrap();
    assert_eq!((usage.pinned_bytes, usage.uploads), (0, 0), "{usage:?}");
    let mut kept = 0;
    for seed in 0..11 {
        let bytes = content(seed, CHUNK);
        let digest = Digest::of(&bytes);
        if processes[1].0.index().get(digest).await.unwrap().is_some() {
            kept += 1;
            assert_eq!(read_all(&processes[1].1, digest).await.unwrap(), bytes);
        }
    }
    assert_eq!(kept, usage.blobs);
}

#[cfg(all(unix, feature = "postgres"))]
mod one_index {
    use std::time::Duration;

    use futures_util::TryStreamExt;
    use jobs::postgres::PostgresStore;
    use jobs::store::JobStore;
    use needs::needs;
    use object_store::multipart::{MultipartStore, PartId};
    use object_store::path::Path;
    use object_store::{ObjectStore, ObjectStoreExt};

    use super::*;
    use crate::postgres_server::{Database, database};

    const CHUNK: u64 = 1 << 20;

    /// A process on the database and the bucket. It goes down when it is dropped: nothing is said then.
    struct Process {
        blobs: ObjectBlobs,
        _jobs: PostgresStore,
    }

    async fn process(database: &Database, bucket: &Arc<InMemory>, options: BlobOptions) -> Process {
        let jobs = crate::postgres(database).await;
        let blobs = ObjectBlobs::shared_with(jobs.index(), Arc::clone(bucket), options).await.unwrap();
        Process { blobs, _jobs: jobs }
    }

    fn usual() -> BlobOptions {
        BlobOptions::default()
    }

    async fn left(bucket: &InMemory, folder: &str) -> Vec<String> {
        let left = bucket.list(Some(&Path::from(folder))).map_ok(|object| object.location.to_string());
        left.try_collect().await.unwrap()
    }

    fn large(seed: u64) -> (UploadId, Bytes) {
        let bytes = content(seed, 2 * usize::try_from(PART).unwrap() + 12_345);
        (upload_of(&bytes).of("a"), bytes)
    }

    #[needs(postgres)]
    #[tokio::test]
    async fn an_upload_is_finished_where_it_was_not_begun_with_one_chunk_again_at_most() {
        let (database, bucket) = (database(), Arc::new(InMemory::new()));
        let (_, all) = large(0);
        let size = all.len() as u64;
        let cuts = [0, 1, CHUNK, 3 * CHUNK + 7, PART - 1, PART, PART + 1, PART + 3 * CHUNK, 2 * PART, size - 1, size];
        for (seed, cut) in cuts.into_iter().enumerate() {
            let (id, bytes) = large(seed as u64);
            let one = process(&database, &bucket, usual()).await;
            send_large(&one.blobs, id, &bytes, cut).await;
            drop(one);
            let two = process(&database, &bucket, usual()).await;
            let kept = two.blobs.begin(id).await.unwrap().kept_bytes;
            assert!(kept <= cut && cut - kept <= CHUNK, "{kept} bytes of {cut} are kept");
            assert_eq!(two.blobs.upload_status(id).await.unwrap().kept_bytes, kept);
            send_large(&two.blobs, id, &bytes, size).await;
            two.blobs.finish(id, None).await.unwrap();
            assert_eq!(read_all(&two.blobs, id.digest).await.unwrap(), bytes);
            assert_eq!(left(&bucket, "uploads").await, [""; 0], "{cut}");
        }
        assert_eq!(database.sql("select count(*) from tessera.uploads"), "0");
        assert_eq!(database.sql("select count(*) from tessera.upload_parts"), "0");
    }

    /// Each chunk goes to another process, as a load balancer may have it.
    #[needs(postgres)]
    #[tokio::test]
    async fn an_upload_that_wanders_is_whole() {
        let (database, bucket) = (database(), Arc::new(InMemory::new()));
        let (id, bytes) = large(1);
        let mut processes = Vec::new();
        for _ in 0..3 {
            processes.push(process(&database, &bucket, usual()).await.blobs);
        }
        let (mut turn, mut kept, mut sent) = (0, 0, 0);
        while kept < id.size_bytes {
            let at = &processes[turn % 3];
            kept = at.begin(id).await.unwrap().kept_bytes;
            let to = (kept + 3 * CHUNK).min(id.size_bytes);
            send_large(at, id, &bytes, to).await;
            (sent, turn) = (sent + to - kept, turn + 1);
            kept = to;
        }
        assert!(sent <= id.size_bytes + turn as u64 * CHUNK, "{sent} bytes in {turn} turns");
        processes[(turn - 1) % 3].finish(id, None).await.unwrap();
        for blobs in &processes {
            assert!(blobs.begin(id).await.unwrap().complete);
            assert_eq!(read_all(blobs, id.digest).await.unwrap(), bytes);
        }
    }

    #[needs(postgres)]
    #[tokio::test]
    async fn wrong_bytes_of_another_process_are_refused() {
        let (database, bucket) = (database(), Arc::new(InMemory::new()));
        for cut in [2 * CHUNK, PART + 2 * CHUNK] {
            let (id, bytes) = large(2);
            let wrong = content(3, bytes.len());
            let one = process(&database, &bucket, usual()).await;
            send_large(&one.blobs, id, &wrong, cut).await;
            drop(one);
            let two = process(&database, &bucket, usual()).await;
            send_large(&two.blobs, id, &bytes, id.size_bytes).await;
            assert!(matches!(two.blobs.finish(id, None).await, Err(BlobError::DigestMismatch { .. })));
            let usage = two.blobs.usage().await.unwrap();
            assert_eq!((usage.uploads, usage.blobs, left(&bucket, "").await.len()), (0, 0, 0));
            send_large(&two.blobs, id, &bytes, id.size_bytes).await;
            two.blobs.finish(id, None).await.unwrap();
            assert_eq!(read_all(&two.blobs, id.digest).await.unwrap(), bytes);
            two.blobs.disown(id.owner.unwrap(), id.digest).await.unwrap();
            while !left(&bucket, "").await.is_empty() {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        }
    }

    /// Clients that send one upload at once, to two processes. One of them sends wrong bytes at first.
    #[needs(postgres)]
    #[tokio::test(flavor = "multi_thread", worker_threads = 4)]
    async fn an_upload_at_two_processes_at_once_is_whole_or_refused() {
        let (database, bucket) = (database(), Arc::new(InMemory::new()));
        let mut processes = Vec::new();
        for _ in 0..2 {
            processes.push(process(&database, &bucket, usual()).await.blobs);
        }
        for round in 0..4 {
            let (id, bytes) = large(10 + round);
            let mut clients = tokio::task::JoinSet::new();
            for client in 0..4_usize {
                let (blobs, bytes) = (processes[client % 2].clone(), bytes.clone());
                let wrong = content(99, bytes.len());
                clients.spawn(async move {
                    for attempt in 0..1000 {
                        let sent = if client == 1 && attempt < 3 && round % 2 == 1 { &wrong } else { &bytes };
                        let done = async {
                            let mut status = blobs.begin(id).await?;
                            while !status.complete && status.kept_bytes < id.size_bytes {
                                let length = usize::try_from(CHUNK).unwrap();
                                let chunk = crate::chunk_at(sent, status.kept_bytes, length);
                                status = blobs.write(id, chunk).await?;
                            }
                            blobs.finish(id, None).await
                        };
                        match done.await {
                            Ok(info) => return info,
                            Err(
                                BlobError::WrongOffset { .. }
                                | BlobError::UploadNotFound { .. }
                                | BlobError::Incomplete { .. }
                                | BlobError::DigestMismatch { .. }
                                | BlobError::Busy { .. },
                            ) => {}
                            Err(error) => panic!("{error}"),
                        }
                        tokio::time::sleep(Duration::from_millis(client as u64)).await;
                    }
                    panic!("never whole");
                });
            }
            clients.join_all().await;
            for blobs in &processes {
                assert_eq!(read_all(blobs, id.digest).await.unwrap(), bytes);
                assert!(blobs.is_owned(id.owner.unwrap(), id.digest).await.unwrap());
            }
        }
        assert_eq!(database.sql("select count(*) from tessera.uploads"), "0");
    }

    /// Its place is free for others, too.
    #[needs(postgres)]
    #[tokio::test]
    async fn an_upload_that_nobody_continues_is_removed_by_another_process() {
        let (database, bucket) = (database(), Arc::new(InMemory::new()));
        for crowded in [false, true] {
            let (id, bytes) = large(4);
            let one = process(&database, &bucket, usual()).await;
            send_large(&one.blobs, id, &bytes, PART + 3 * CHUNK).await;
            let multipart = database.sql("select multipart from tessera.uploads");
            let options = match crowded {
                true => BlobOptions { uploads: 1, keep_crowded_uploads: Duration::ZERO, ..usual() },
                false => BlobOptions { keep_uploads: Duration::ZERO, ..usual() },
            };
            let two = process(&database, &bucket, options).await;
            if crowded {
                let other = UploadId::new(Digest::of(b"b"), 1).of("b");
                two.blobs.begin(other).await.unwrap();
                two.blobs.abandon(other).await.unwrap();
            } else {
                assert_eq!(two.blobs.sweep().await.unwrap(), 1);
            }
            assert_eq!(two.blobs.usage().await.unwrap().uploads, 0);
            assert_eq!(left(&bucket, "").await, [""; 0]);
            let path = Path::from(format!("blobs/{}/{}", &id.digest.to_string()[..2], id.digest));
            assert!(bucket.abort_multipart(&path, &multipart).await.is_err(), "its parts are still there");
            // The process where it was begun learns of it, and lets go of what it holds.
            assert!(matches!(one.blobs.upload_status(id).await, Err(BlobError::UploadNotFound { .. })));
            assert_eq!(one.blobs.begin(id).await.unwrap().kept_bytes, 0);
            one.blobs.abandon(id).await.unwrap();
        }
    }

    /// Objects that no process knows of, as a crash or a database of yesterday leaves them.
    #[needs(postgres)]
    #[tokio::test]
    async fn objects_that_nothing_needs_are_removed() {
        let (database, bucket) = (database(), Arc::new(InMemory::new()));
        let options = BlobOptions { keep_unneeded: Duration::ZERO, scan_period: Duration::ZERO, ..usual() };
        let Process { blobs, .. } = process(&database, &bucket, options).await;
        let owned = content(1, 100);
        send_large(&blobs, upload_of(&owned).of("a"), &owned, 100).await;
        blobs.finish(upload_of(&owned).of("a"), None).await.unwrap();
        let pinned = jobs::blob::put(&blobs, content(2, 100), Some("job")).await.unwrap().digest;
        let (half, bytes) = large(3);
        send_large(&blobs, half, &bytes, 3 * CHUNK).await;
        let kept = left(&bucket, "").await;
        // A blob without a row, one with the mark of an owner, and what is left of an upload.
        let place = |digest: Digest| format!("{}/{digest}", &digest.to_string()[..2]);
        let [lost, marked] = [5, 6].map(|seed| content(seed, 100));
        let (gone, found) = (upload_of(&content(7, 5)).of("a"), upload_of(&marked).of("b"));
        let mark = format!("owners/{}-{}", place(found.digest), found.owner.unwrap());
        for (path, bytes) in [
            (format!("blobs/{}", place(Digest::of(&lost))), lost.clone()),
            (format!("blobs/{}", place(found.digest)), marked.clone()),
            (mark.clone(), Bytes::new()),
            (format!("uploads/{gone}/0"), content(7, 3)),
            (format!("uploads/{gone}.json"), Bytes::from_static(b"{}")),
        ] {
            bucket.put(&Path::from(path), bytes.into()).await.unwrap();
        }
        blobs.sweep().await.unwrap();
        let mut now = left(&bucket, "").await;
        now.retain(|path| !path.contains(&found.digest.to_string()));
        assert_eq!(now, kept);
        assert_eq!(read_all(&blobs, found.digest).await.unwrap(), marked);
        assert!(blobs.is_owned(found.owner.unwrap(), found.digest).await.unwrap());
        // What nothing holds any more goes as well.
        blobs.unpin("job").await.unwrap();
        blobs.sweep().await.unwrap();
        assert!(!left(&bucket, "").await.iter().any(|path| path.contains(&pinned.to_string())));
        assert_eq!(blobs.begin(half).await.unwrap().kept_bytes, 3 * CHUNK);
        let usage = blobs.usage().await.unwrap();
        assert_eq!((usage.blobs, usage.uploads), (2, 1));
    }

    /// A blob is fetched once, and only for those that may have it.
    #[needs(postgres)]
    #[tokio::test]
    async fn copies_on_the_local_disk_serve_what_is_stored() {
        let (database, bucket, folder) = (database(), Arc::new(InMemory::new()), tempfile::tempdir().unwrap());
        let one = process(&database, &bucket, usual()).await.blobs;
        let two = process(&database, &bucket, usual()).await.blobs;
        let two = two.with_cache(folder.path().join("cache"), 1 << 20).await.unwrap();
        let bytes = content(1, 300_000);
        let digest = jobs::blob::put_of(&one, "a", None, bytes.clone()).await.unwrap().digest;
        let uses = || (two.cache_use().hits, two.cache_use().misses);
        assert_eq!(read_all(&two, digest).await.unwrap(), bytes);
        assert_eq!(crate::read(&two, digest, 5..10).await.unwrap(), bytes[5..10]);
        assert_eq!(uses(), (0, 1));
        // Without the bucket.
        let path = Path::from(format!("blobs/{}/{digest}", &digest.to_string()[..2]));
        bucket.delete(&path).await.unwrap();
        assert_eq!(read_all(&two, digest).await.unwrap(), bytes);
        assert_eq!(uses(), (1, 1));
        let copy = folder.path().join("cache").join(digest.to_string());
        std::fs::write(copy, &bytes[1..]).unwrap();
        bucket.put(&path, bytes.clone().into()).await.unwrap();
        assert_eq!(read_all(&two, digest).await.unwrap(), bytes);
        assert_eq!(uses(), (1, 2));
        // Results that are written are there at once. What is removed is gone, whether there is a copy or not.
        let result = jobs::blob::put(&two, content(2, 1000), None).await.unwrap().digest;
        read_all(&two, result).await.unwrap();
        assert_eq!(uses(), (2, 2));
        one.delete(result).await.unwrap();
        assert_eq!(read_all(&two, result).await, Err(BlobError::NotFound { digest: result }));
    }

    /// The process goes down after the object was made, and before the index had it.
    #[needs(postgres)]
    #[tokio::test]
    async fn an_upload_is_finished_where_its_object_was_made() {
        let (database, bucket) = (database(), Arc::new(InMemory::new()));
        for is_right in [true, false] {
            let bytes = content(5, 2 * usize::try_from(PART).unwrap());
            let id = upload_of(&bytes).of("a");
            let one = process(&database, &bucket, usual()).await;
            send_large(&one.blobs, id, &bytes, id.size_bytes).await;
            drop(one);
            let multipart = database.sql("select multipart from tessera.uploads");
            let path = Path::from(format!("blobs/{}/{}", &id.digest.to_string()[..2], id.digest));
            if !is_right {
                // As a process that was overtaken leaves it.
                bucket.put_part(&path, &multipart, 0, content(6, 1000).into()).await.unwrap();
            }
            let part = PartId { content_id: String::new() };
            bucket.complete_multipart(&path, &multipart, vec![part.clone(), part]).await.unwrap();
            let two = process(&database, &bucket, usual()).await;
            let status = two.blobs.begin(id).await.unwrap();
            assert!(status.complete || status.kept_bytes == id.size_bytes);
            let finished = two.blobs.finish(id, None).await;
            if !is_right {
                let anew = BlobError::Incomplete { kept_bytes: 0, size_bytes: id.size_bytes };
                assert_eq!(finished, Err(anew));
                send_large(&two.blobs, id, &bytes, id.size_bytes).await;
                two.blobs.finish(id, None).await.unwrap();
            }
            assert_eq!(read_all(&two.blobs, id.digest).await.unwrap(), bytes);
            two.blobs.disown(id.owner.unwrap(), id.digest).await.unwrap();
            while !left(&bucket, "").await.is_empty() {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        }
    }
}
