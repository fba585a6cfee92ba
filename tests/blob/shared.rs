//! Two processes over one store: neither knows what the other did, except through the store.

use std::sync::Arc;

use bytes::Bytes;
use jobs::blob::{BlobError, BlobOptions, BlobStore, Chunk, Digest, ObjectBlobs};
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

async fn send_large(store: &ObjectBlobs, bytes: &Bytes, to: u64) {
    let id = upload_of(bytes);
    let mut kept = store.begin(id).await.unwrap().kept_bytes;
    while kept < to {
        let start = usize::try_from(kept).unwrap();
        let end = usize::try_from((kept + (1 << 20)).min(to)).unwrap();
        kept = store.write(id, Chunk::new(kept, bytes.slice(start..end))).await.unwrap().kept_bytes;
    }
}

#[tokio::test]
async fn an_upload_goes_on_in_another_process_after_the_last_part() {
    let (one, two) = two().await;
    let bytes = content(2, 2 * usize::try_from(PART).unwrap() + 12_345);
    let id = upload_of(&bytes);
    send_large(&one, &bytes, PART + (3 << 20)).await;
    assert_eq!(one.upload_status(id).await.unwrap().kept_bytes, PART + (3 << 20));
    assert_eq!(two.upload_status(id).await.unwrap().kept_bytes, PART);
    send_large(&two, &bytes, id.size_bytes).await;
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
    let id = jobs::blob::UploadId::new(Digest::of(b"other"), wrong.len() as u64);
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
