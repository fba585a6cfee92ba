//! Uploads and reads, on each kind of store.

use jobs::blob::{BlobError, BlobOptions, BlobStore, Chunk, Digest, DigestError, READ_BYTES, UploadId};

use crate::{CHUNK, chunk_at, content, cut, each, files, put, read, read_all, send, upload_of};

#[test]
fn a_digest_has_one_text() {
    let digest = Digest::of(b"abc");
    let text = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert_eq!(digest.to_string(), text);
    assert_eq!(text.parse(), Ok(digest));
    assert_eq!(text.to_uppercase().parse::<Digest>(), Err(DigestError::Digit { at: 0 }));
    assert_eq!(text[1..].parse::<Digest>(), Err(DigestError::Length { length: 63 }));
    assert_eq!("é".repeat(32).parse::<Digest>(), Err(DigestError::Digit { at: 0 }));
    let json = serde_json::to_string(&digest).unwrap();
    assert_eq!(json, format!("\"{text}\""));
    assert_eq!(serde_json::from_str::<Digest>(&json).unwrap(), digest);
    assert!(serde_json::from_str::<Digest>("\"abc\"").is_err());
}

#[tokio::test]
async fn what_is_put_is_read_whole_and_by_range() {
    for (kind, store, _folder) in each(BlobOptions::default()).await {
        for length in [0, 1, CHUNK, 10 * CHUNK + 7, READ_BYTES + 1, 2 * READ_BYTES] {
            let bytes = content(length as u64, length);
            let size = length as u64;
            let info = jobs::blob::put(&store, bytes.clone(), None).await.unwrap();
            assert_eq!((info.digest, info.size_bytes), (Digest::of(&bytes), size), "{kind}");
            assert_eq!(store.stat(info.digest).await.unwrap(), info);
            assert_eq!(read_all(&store, info.digest).await.unwrap(), bytes, "{kind} {length}");
            for (start, end) in [(0, 0), (size / 3, size / 2), (size / 2, u64::MAX), (size, u64::MAX), (size / 2, 0)] {
                let end_in = usize::try_from(end.min(size).max(start)).unwrap();
                let part = read(&store, info.digest, start..end).await.unwrap();
                assert_eq!(part, bytes[usize::try_from(start).unwrap()..end_in], "{kind} {start}..{end}");
            }
            let after = store.read(info.digest, size + 1..size + 2).await.err().unwrap();
            assert_eq!(after, BlobError::OutOfRange { offset: size + 1, size_bytes: size });
        }
        let none = Digest::of(b"none");
        assert_eq!(store.stat(none).await, Err(BlobError::NotFound { digest: none }));
        assert_eq!(read_all(&store, none).await, Err(BlobError::NotFound { digest: none }));
    }
}

#[tokio::test]
async fn pieces_of_a_read_are_short() {
    use futures_util::TryStreamExt;
    for (kind, store, _folder) in each(BlobOptions::default()).await {
        let digest = jobs::blob::put(&store, content(1, 3 * READ_BYTES), None).await.unwrap().digest;
        let read = store.read(digest, 5..u64::MAX).await.unwrap();
        assert_eq!(read.range, 5..3 * READ_BYTES as u64);
        let pieces: Vec<bytes::Bytes> = read.bytes.try_collect().await.unwrap();
        assert!(pieces.iter().all(|piece| piece.len() <= READ_BYTES), "{kind}");
    }
}

/// A file below the store, as another program, a person or a failing disk would change it.
#[tokio::test]
async fn a_blob_that_was_changed_is_never_read_as_whole() {
    let folder = tempfile::tempdir().unwrap();
    let store = crate::local(folder.path(), BlobOptions::default()).await;
    for length in [1, 100, READ_BYTES, READ_BYTES + 1, 3 * READ_BYTES] {
        let bytes = content(length as u64, length);
        let digest = put(&store, &bytes).await.unwrap();
        let name = digest.to_string();
        let path = folder.path().join("blobs").join(&name[..2]).join(&name);
        let flipped = |at: usize| {
            let mut changed = bytes.to_vec();
            changed[at] ^= 1;
            changed
        };
        let longer = [&bytes[..], b"x"].concat();
        let damages =
            [flipped(0), flipped(length / 2), flipped(length - 1), longer, bytes[..length / 2].to_vec(), vec![]];
        for (i, damage) in damages.iter().enumerate() {
            std::fs::write(&path, damage).unwrap();
            assert_eq!(read_all(&store, digest).await, Err(BlobError::Damaged { digest }), "{length} {i}");
            // Nobody is served by it: it can be uploaded again.
            assert_eq!(read_all(&store, digest).await, Err(BlobError::NotFound { digest }));
            put(&store, &bytes).await.unwrap();
            assert_eq!(read_all(&store, digest).await.unwrap(), bytes);
        }
    }
}

/// What readiness asks.
#[tokio::test]
async fn a_store_says_that_its_folder_is_gone() {
    let folder = tempfile::tempdir().unwrap();
    let store = crate::local(folder.path(), BlobOptions::default()).await;
    store.check().await.unwrap();
    let (there, away) = (folder.path().join("uploads"), folder.path().join("elsewhere"));
    std::fs::rename(&there, &away).unwrap();
    assert!(matches!(store.check().await, Err(BlobError::Unavailable(_))));
    std::fs::rename(&away, &there).unwrap();
    store.check().await.unwrap();
    std::fs::remove_dir_all(folder.path()).unwrap();
    assert!(matches!(store.check().await, Err(BlobError::Unavailable(_))));
}

/// The caller goes away at each boundary, and comes back.
#[tokio::test]
async fn a_cut_upload_goes_on_where_it_was_and_is_never_whole_early() {
    for (kind, store, _folder) in each(BlobOptions::default()).await {
        for cut in 0..20 {
            let bytes = content(cut, 20 * CHUNK);
            let id = upload_of(&bytes);
            let size_bytes = id.size_bytes;
            store.begin(id).await.unwrap();
            for k in 0..cut {
                let status = store.write(id, chunk_at(&bytes, k * CHUNK as u64, CHUNK)).await.unwrap();
                assert!(!status.complete);
            }
            let kept_bytes = cut * CHUNK as u64;
            assert_eq!(store.stat(id.digest).await, Err(BlobError::NotFound { digest: id.digest }));
            assert_eq!(store.find_missing(&[id.digest]).await.unwrap(), [id.digest]);
            assert_eq!(store.finish(id, None).await, Err(BlobError::Incomplete { kept_bytes, size_bytes }), "{kind}");
            assert_eq!(send(&store, id, &bytes).await.unwrap(), size_bytes - kept_bytes, "{kind}: bytes sent again");
            store.finish(id, None).await.unwrap();
            // Said once more, and begun once more: nothing is left to do.
            store.finish(id, None).await.unwrap();
            assert!(store.begin(id).await.unwrap().complete);
            assert!(store.upload_status(id).await.unwrap().complete);
            assert_eq!(read_all(&store, id.digest).await.unwrap(), bytes);
        }
        assert_eq!(store.usage().await.unwrap().uploads, 0);
    }
}

#[tokio::test]
async fn bad_chunks_are_refused_and_change_nothing() {
    let options = BlobOptions { blob_bytes: 5 << 20, ..BlobOptions::default() };
    for (kind, store, _folder) in each(options).await {
        let bytes = content(1, 5 << 20);
        let (id, size_bytes) = (upload_of(&bytes), 5 << 20);
        let nobody = BlobError::UploadNotFound { digest: id.digest };
        assert_eq!(store.write(id, chunk_at(&bytes, 0, CHUNK)).await, Err(nobody.clone()));
        assert_eq!(store.upload_status(id).await, Err(nobody.clone()));
        assert_eq!(store.finish(id, None).await, Err(nobody.clone()));
        assert_eq!(store.abandon(id).await, Err(nobody));
        store.begin(id).await.unwrap();
        store.write(id, chunk_at(&bytes, 0, CHUNK)).await.unwrap();
        let expected = CHUNK as u64;
        for got in [0, 1, expected - 1, expected + 1, 2 * expected] {
            let refused = store.write(id, chunk_at(&bytes, got, CHUNK)).await;
            assert_eq!(refused, Err(BlobError::WrongOffset { expected, got }), "{kind}");
        }
        let far = Chunk::new(u64::MAX, bytes.slice(..CHUNK));
        assert_eq!(store.write(id, far).await, Err(BlobError::WrongOffset { expected, got: u64::MAX }));
        let mut damaged = chunk_at(&bytes, expected, CHUNK);
        damaged.crc32c ^= 1;
        let refused = store.write(id, damaged).await.unwrap_err();
        assert!(matches!(refused, BlobError::ChecksumMismatch { offset, .. } if offset == expected), "{kind}");
        let refused = store.write(id, chunk_at(&bytes, expected, (4 << 20) + 1)).await.unwrap_err();
        assert_eq!(refused, BlobError::ChunkTooLarge { bytes: (4 << 20) + 1, limit_bytes: 4 << 20 });
        let long = UploadId::new(Digest::of(&bytes[..9]), 9);
        store.begin(long).await.unwrap();
        let refused = store.write(long, chunk_at(&bytes, 0, 10)).await;
        assert_eq!(refused, Err(BlobError::PastEnd { end: 10, size_bytes: 9 }));
        assert_eq!(send(&store, id, &bytes).await.unwrap(), size_bytes - expected, "{kind}");
        store.finish(id, None).await.unwrap();
        let large = UploadId::new(Digest::of(b"large"), size_bytes + 1);
        let limit = BlobError::TooLarge { size_bytes: size_bytes + 1, limit_bytes: size_bytes };
        assert_eq!(store.begin(large).await, Err(limit));
        let other = UploadId::new(id.digest, 1);
        let differs = BlobError::WrongSize { digest: id.digest, promised_bytes: 1, actual_bytes: size_bytes };
        assert_eq!(store.begin(other).await, Err(differs));
    }
}

#[tokio::test]
async fn a_wrong_digest_leaves_nothing() {
    for (kind, store, folder) in each(BlobOptions::default()).await {
        let (right, wrong) = (content(1, 3 * CHUNK), content(2, 3 * CHUNK));
        let id = upload_of(&right);
        send(&store, id, &wrong).await.unwrap();
        let expected = BlobError::DigestMismatch { expected: id.digest, actual: Digest::of(&wrong) };
        assert_eq!(store.finish(id, Some("job")).await, Err(expected), "{kind}");
        let usage = store.usage().await.unwrap();
        assert_eq!((usage.uploads, usage.uploading_bytes, usage.blobs), (0, 0, 0));
        if let Some(folder) = &folder {
            assert_eq!(files(folder.path()), []);
        }
        assert_eq!(put(&store, &right).await.unwrap(), id.digest);
    }
}

#[tokio::test]
async fn nobody_spoils_the_upload_of_another() {
    for (kind, store, folder) in each(BlobOptions::default()).await {
        let (right, wrong) = (content(1, 3 * CHUNK), content(2, 3 * CHUNK));
        let (good, bad) = (upload_of(&right).of("good"), upload_of(&right).of("bad"));
        send(&store, good, &right).await.unwrap();
        send(&store, bad, &wrong).await.unwrap();
        assert!(matches!(store.finish(bad, None).await, Err(BlobError::DigestMismatch { .. })), "{kind}");
        let late = upload_of(&right).of("late");
        let early = upload_of(&right).of("early");
        store.begin(late).await.unwrap();
        store.begin(early).await.unwrap();
        store.finish(good, None).await.unwrap();
        // Others do not learn of it: each sends all of it, and nobody has it for less.
        assert!(!store.upload_status(late).await.unwrap().complete && !store.begin(late).await.unwrap().complete);
        store.write(late, chunk_at(&right, 0, 3 * CHUNK)).await.unwrap();
        assert!(!store.is_owned(late.owner.unwrap(), late.digest).await.unwrap());
        store.finish(late, None).await.unwrap();
        assert!(store.begin(late).await.unwrap().complete);
        let short = store.finish(early, None).await;
        assert_eq!(short, Err(BlobError::Incomplete { kept_bytes: 0, size_bytes: right.len() as u64 }), "{kind}");
        store.abandon(early).await.unwrap();
        assert_eq!(read_all(&store, good.digest).await.unwrap(), right);
        let usage = store.usage().await.unwrap();
        assert_eq!((usage.uploads, usage.uploading_bytes, usage.blob_bytes), (0, 0, right.len() as u64));
        if let Some(folder) = &folder {
            assert_eq!(files(folder.path()).len(), 1);
        }
    }
}

/// Writers of one owner and of several, all at once, some of which go away in the middle of a call.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn uploads_of_one_blob_at_once_give_one_blob() {
    for (kind, store, _folder) in each(BlobOptions::default()).await {
        for round in 0..8 {
            let bytes = content(round, 12 * CHUNK);
            let mut tasks = tokio::task::JoinSet::new();
            for writer in 0..6 {
                let (store, bytes) = (store.clone(), bytes.clone());
                tasks.spawn(async move {
                    let id = upload_of(&bytes).of(if writer < 4 { "shared" } else { "alone" });
                    for attempt in 0.. {
                        let done = async {
                            match send(&store, id, &bytes).await {
                                // Another writer was faster.
                                Err(BlobError::WrongOffset { .. }) => Ok(None),
                                Err(error) => Err(error),
                                Ok(_) => store.finish(id, Some("job")).await.map(Some),
                            }
                        };
                        match cut(20 * (writer + 1) + 10 * attempt, done).await {
                            Some(Ok(Some(info))) => return info,
                            // The upload ended between two calls.
                            Some(Ok(None) | Err(BlobError::UploadNotFound { .. })) | None => {}
                            Some(Err(error)) => panic!("{error}"),
                        }
                    }
                    unreachable!("attempts have no end");
                });
            }
            let infos = tasks.join_all().await;
            assert!(infos.iter().all(|info| info.digest == Digest::of(&bytes)), "{kind}");
            assert_eq!(read_all(&store, Digest::of(&bytes)).await.unwrap(), bytes, "{kind}");
        }
        // A call whose caller has gone goes on: it may still begin an upload anew, or pin what it finishes.
        let begin = std::time::Instant::now();
        loop {
            store.unpin("job").await.unwrap();
            for id in (0..8).map(|round| upload_of(&content(round, 12 * CHUNK))) {
                for owner in ["shared", "alone"] {
                    let _ = store.abandon(id.of(owner)).await;
                }
            }
            let usage = store.usage().await.unwrap();
            let left = (usage.blobs, usage.uploads, usage.uploading_bytes, usage.pinned_bytes);
            if left == (8, 0, 0, 0) {
                break;
            }
            assert!(begin.elapsed() < crate::PATIENCE, "{kind}: {left:?}");
            tokio::time::sleep(std::time::Duration::from_millis(5)).await;
        }
    }
}
