//! The process ends in the middle, and another opens the folder.

use std::fs::{self, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use jobs::blob::{BlobError, BlobOptions, BlobStore, Digest, ObjectBlobs};
use tokio::runtime::Runtime;

use crate::{CHUNK, chunk_at, content, cut, files, local, put, read, read_all, send, upload_of};

#[tokio::test]
async fn a_restart_keeps_blobs_and_uploads_and_the_order_of_use() {
    let folder = tempfile::tempdir().unwrap();
    let options = BlobOptions { quota_bytes: 4 * CHUNK as u64, ..BlobOptions::default() };
    let blobs: Vec<_> = (0..4).map(|k| content(k, CHUNK)).collect();
    let half = content(5, CHUNK);
    let store = local(folder.path(), options).await;
    for bytes in &blobs[..3] {
        put(&store, bytes).await.unwrap();
    }
    read(&store, Digest::of(&blobs[0]), 0..1).await.unwrap();
    store.begin(upload_of(&half)).await.unwrap();
    store.write(upload_of(&half), chunk_at(&half, 0, 600)).await.unwrap();
    let before = store.usage().await.unwrap();
    let second = ObjectBlobs::local(folder.path(), options).await.unwrap_err();
    assert!(matches!(second, BlobError::InUse { folder: path } if path == folder.path()));
    drop(store);

    let store = local(folder.path(), options).await;
    assert_eq!(store.usage().await.unwrap(), before);
    let status = store.upload_status(upload_of(&half)).await.unwrap();
    assert_eq!((status.kept_bytes, status.complete), (600, false));
    assert_eq!(send(&store, upload_of(&half), &half).await.unwrap(), 400);
    store.finish(upload_of(&half), None).await.unwrap();
    put(&store, &blobs[3]).await.unwrap();
    // 0 was used after 1.
    assert_eq!(store.find_missing(&[0, 1, 2].map(|k| Digest::of(&blobs[k]))).await.unwrap(), [Digest::of(&blobs[1])]);
    for bytes in [&blobs[0], &blobs[2], &blobs[3], &half] {
        assert_eq!(read_all(&store, Digest::of(bytes)).await.unwrap(), *bytes);
    }
}

fn only(folder: &Path, ending: &str) -> PathBuf {
    let (name, _) = files(folder).into_iter().find(|(name, _)| name.ends_with(ending)).unwrap();
    folder.join(name)
}

/// What a cut write or a loss of power may leave in the two files of an upload.
#[tokio::test]
async fn only_whole_and_right_chunks_count_after_a_crash() {
    let bytes = content(1, 6 * CHUNK);
    let id = upload_of(&bytes);
    let chunk = CHUNK as u64;
    let append =
        |path: PathBuf, what: &[u8]| OpenOptions::new().append(true).open(path).unwrap().write_all(what).unwrap();
    let shorten = |path: PathBuf, by: u64| {
        let file = OpenOptions::new().write(true).open(path).unwrap();
        file.set_len(file.metadata().unwrap().len() - by).unwrap();
    };
    let damages: [Damage<'_>; 9] = [
        ("half a chunk without its sum", &|f| append(only(f, ".part"), &bytes[4 * CHUNK..4 * CHUNK + 300]), 4),
        ("zeros, and a sum of zeros", &|f| append(only(f, ".sums"), &[0; 24]), 4),
        ("a sum before its chunk", &|f| append(only(f, ".sums"), &(5 * chunk).to_le_bytes().repeat(3)[..12]), 4),
        ("half a sum", &|f| shorten(only(f, ".sums"), 5), 3),
        ("no sums", &|f| fs::remove_file(only(f, ".sums")).unwrap(), 0),
        ("half of the last chunk", &|f| shorten(only(f, ".part"), 500), 3),
        ("an empty part", &|f| shorten(only(f, ".part"), 4 * chunk), 0),
        ("sums that end far away", &|f| append(only(f, ".sums"), &[0xff; 12]), 4),
        (
            "a damaged byte in the second chunk",
            &|f| {
                let mut data = fs::read(only(f, ".part")).unwrap();
                data[CHUNK + 7] ^= 1;
                fs::write(only(f, ".part"), data).unwrap();
            },
            1,
        ),
    ];
    for (what, damage, kept_chunks) in damages {
        let folder = tempfile::tempdir().unwrap();
        let store = local(folder.path(), BlobOptions::default()).await;
        store.begin(id).await.unwrap();
        for k in 0..4 {
            store.write(id, chunk_at(&bytes, k * chunk, CHUNK)).await.unwrap();
        }
        drop(store);
        damage(folder.path());
        let store = local(folder.path(), BlobOptions::default()).await;
        let status = store.upload_status(id).await.unwrap();
        // The sum of zeros closes an empty chunk, and an empty chunk is right.
        assert_eq!(status.kept_bytes, kept_chunks * chunk, "{what}");
        send(&store, id, &bytes).await.unwrap();
        store.finish(id, None).await.unwrap();
        assert_eq!(read_all(&store, id.digest).await.unwrap(), bytes, "{what}");
        assert_eq!(files(folder.path()).len(), 1, "{what}");
    }
}

#[tokio::test]
async fn what_is_no_blob_and_no_upload_is_left_alone_or_removed() {
    let folder = tempfile::tempdir().unwrap();
    let id = upload_of(&content(1, CHUNK));
    fs::create_dir_all(folder.path().join("blobs/zz")).unwrap();
    fs::create_dir_all(folder.path().join("uploads")).unwrap();
    for name in ["blobs/zz/notes.txt", "uploads/notes.txt", "uploads/x.part"] {
        fs::write(folder.path().join(name), "mine").unwrap();
    }
    fs::write(folder.path().join(format!("uploads/{id}.sums")), "alone").unwrap();
    let store = local(folder.path(), BlobOptions::default()).await;
    let usage = store.usage().await.unwrap();
    assert_eq!((usage.blobs, usage.uploads), (0, 0));
    assert_eq!(files(folder.path()).len(), 3);
}

/// What it is, what does it to the folder, and what is left, bytes.
type Damage<'a> = (&'a str, &'a dyn Fn(&Path), u64);

/// The runtime ends between two awaits of a call; the next one goes on.
#[test]
fn a_runtime_that_ends_in_the_middle_loses_nothing_that_was_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = content(3, 40 * CHUNK);
    let id = upload_of(&bytes);
    let mut acknowledged = 0;
    for life in 0..60_u64 {
        let runtime = Runtime::new().unwrap();
        let done = runtime.block_on(async {
            let store = local(folder.path(), BlobOptions::default()).await;
            let status = store.begin(id).await.unwrap();
            assert!(status.kept_bytes >= acknowledged);
            if status.complete {
                return true;
            }
            for _ in 0..2 {
                let offset = store.upload_status(id).await.unwrap().kept_bytes;
                if offset == id.size_bytes {
                    return cut(10 * life, store.finish(id, None)).await.is_some_and(|finished| finished.is_ok());
                }
                let write = store.write(id, chunk_at(&bytes, offset, CHUNK));
                acknowledged = match cut(3 * life, write).await {
                    Some(Ok(status)) => status.kept_bytes,
                    // What was cut before went on to its end.
                    Some(Err(BlobError::WrongOffset { expected, .. })) => expected,
                    Some(Err(error)) => panic!("{error}"),
                    None => acknowledged,
                }
            }
            false
        });
        drop(runtime);
        if done {
            break;
        }
    }
    let runtime = Runtime::new().unwrap();
    runtime.block_on(async {
        let store = local(folder.path(), BlobOptions::default()).await;
        send(&store, id, &bytes).await.unwrap();
        store.finish(id, None).await.unwrap();
        assert_eq!(read_all(&store, id.digest).await.unwrap(), bytes);
    });
}

const CHILD: &str = "TESSERA_BLOB_CHILD";

/// The process that is killed: uploads blob after blob, and says what was acknowledged. Does nothing by itself.
#[test]
fn child() {
    let Ok(folder) = std::env::var(CHILD) else { return };
    let print = |k: u64, kept: u64| {
        let mut out = std::io::stdout().lock();
        writeln!(out, "kept {k} {kept}").and_then(|()| out.flush()).unwrap();
    };
    Runtime::new().unwrap().block_on(async {
        let store = local(Path::new(&folder), BlobOptions::default()).await;
        for k in 0..1000 {
            let bytes = content(k, 5 * CHUNK);
            let mut status = store.begin(upload_of(&bytes)).await.unwrap();
            while !status.complete && status.kept_bytes < 5 * CHUNK as u64 {
                status = store.write(upload_of(&bytes), chunk_at(&bytes, status.kept_bytes, CHUNK)).await.unwrap();
                print(k, status.kept_bytes);
            }
            store.finish(upload_of(&bytes), None).await.unwrap();
            print(k, u64::MAX);
        }
    });
}

#[test]
fn a_killed_process_loses_nothing_that_was_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    // Blob and bytes that were acknowledged last; all blobs before it are whole.
    let (mut blob, mut kept) = (0, 0);
    for life in 0..12 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "crash::child", "--nocapture"])
            .env(CHILD, folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let said = lines.map_while(Result::ok).filter_map(|line| {
            let mut words = line.split_whitespace().skip_while(|word| *word != "kept").skip(1);
            Some((words.next()?.parse().ok()?, words.next()?.parse().ok()?))
        });
        for (k, bytes) in said.take(1 + 7 * life % 23) {
            (blob, kept) = (k, bytes);
        }
        // The process is somewhere after this line.
        child.kill().unwrap();
        child.wait().unwrap();
        Runtime::new().unwrap().block_on(async {
            let store = local(folder.path(), BlobOptions::default()).await;
            for k in 0..blob {
                let bytes = content(k, 5 * CHUNK);
                assert_eq!(read_all(&store, Digest::of(&bytes)).await.unwrap(), bytes);
            }
            let status = store.upload_status(upload_of(&content(blob, 5 * CHUNK))).await.unwrap();
            assert!(status.complete || (kept != u64::MAX && status.kept_bytes >= kept), "{status:?} after {kept}");
        });
    }
    assert!(blob > 0);
}
