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
