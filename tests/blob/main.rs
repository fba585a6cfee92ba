//! Promise: a blob is there whole or not at all, whatever happens to uploads, processes and quotas, on a folder, in
//! memory, and on a store that processes share.
//!
//! `model` drives random operations against a simple model; `TESSERA_BLOB_CASES=10000 cargo test --test blob model` runs
//! more of them, `TESSERA_BLOB_SEED=7` others. `cargo test --release --test blob -- --ignored --nocapture speed` measures
//! a blob of 500 MB, as JSON; `TESSERA_BLOB_FOLDER` says on which disk.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[cfg(all(unix, feature = "postgres"))]
#[path = "../common/postgres.rs"]
mod postgres_server;
#[path = "../common/process.rs"]
mod process;

mod crash;
mod model;
mod owners;
mod quota;
mod shared;
mod speed;
mod uploads;

use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use futures_util::TryStreamExt;
use jobs::blob::index::{BlobIndex, LocalIndex};
use jobs::blob::{BlobError, BlobOptions, BlobStore, Chunk, Digest, ObjectBlobs, UploadId};
use object_store::memory::InMemory;
use tempfile::TempDir;

/// What a busy machine may take for what a quiet one does at once.
const PATIENCE: std::time::Duration = std::time::Duration::from_secs(60);

/// Small chunks, so that a small blob has many.
const CHUNK: usize = 1000;

/// Bytes that differ from each other and with `seed`.
fn content(seed: u64, length: usize) -> Bytes {
    let mut state = seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state.to_le_bytes()[3]
    };
    (0..length).map(|_| next()).collect()
}

fn upload_of(bytes: &Bytes) -> UploadId {
    UploadId::new(Digest::of(bytes), bytes.len() as u64)
}

fn chunk_at(bytes: &Bytes, offset: u64, length: usize) -> Chunk {
    let start = usize::try_from(offset).unwrap();
    Chunk::new(offset, bytes.slice(start..bytes.len().min(start + length)))
}

/// Sends all from where the upload stands; says how many bytes that were.
async fn send(store: &dyn BlobStore, id: UploadId, bytes: &Bytes) -> Result<u64, BlobError> {
    let mut status = store.begin(id).await?;
    let mut sent = 0;
    while !status.complete && status.kept_bytes < id.size_bytes {
        let chunk = chunk_at(bytes, status.kept_bytes, CHUNK);
        sent += chunk.bytes.len() as u64;
        status = store.write(id, chunk).await?;
    }
    Ok(sent)
}

async fn put(store: &dyn BlobStore, bytes: &Bytes) -> Result<Digest, BlobError> {
    send(store, upload_of(bytes), bytes).await?;
    Ok(store.finish(upload_of(bytes), None).await?.digest)
}

async fn read(store: &dyn BlobStore, digest: Digest, range: std::ops::Range<u64>) -> Result<Bytes, BlobError> {
    let pieces: Vec<Bytes> = store.read(digest, range).await?.bytes.try_collect().await?;
    Ok(pieces.concat().into())
}

/// Waits for `work` while the task is polled `polls` times, then lets go of it in the middle.
async fn cut<T>(polls: u64, work: impl Future<Output = T>) -> Option<T> {
    let patience = async {
        for _ in 0..polls {
            tokio::task::yield_now().await;
        }
    };
    tokio::select! {
        biased;
        done = work => Some(done),
        () = patience => None,
    }
}

async fn read_all(store: &dyn BlobStore, digest: Digest) -> Result<Bytes, BlobError> {
    read(store, digest, 0..u64::MAX).await
}

async fn local(folder: &Path, options: BlobOptions) -> ObjectBlobs {
    local_with(|| Arc::new(LocalIndex::default()), folder, options).await
}

async fn local_with(index: impl Fn() -> Arc<dyn BlobIndex>, folder: &Path, options: BlobOptions) -> ObjectBlobs {
    let start = std::time::Instant::now();
    loop {
        match ObjectBlobs::local_with(index(), folder, options).await {
            // A process that another test starts holds all files of this one until it is another program.
            Err(BlobError::InUse { .. }) if start.elapsed() < PATIENCE => {
                tokio::time::sleep(std::time::Duration::from_millis(10)).await;
            }
            opened => return opened.unwrap(),
        }
    }
}

/// A store of jobs in a database that has the index. Each use of a blob counts.
#[cfg(all(unix, feature = "postgres"))]
async fn postgres(database: &postgres_server::Database) -> jobs::postgres::PostgresStore {
    let options = jobs::postgres::PostgresOptions { same_use: std::time::Duration::ZERO, ..database.options("test") };
    jobs::postgres::PostgresStore::open(options).await.unwrap()
}

/// One of each kind. The folder goes with its guard.
async fn each(options: BlobOptions) -> Vec<(&'static str, ObjectBlobs, Option<TempDir>)> {
    let folder = tempfile::tempdir().unwrap();
    let shared = ObjectBlobs::shared(Arc::new(InMemory::new()), options).await.unwrap();
    vec![
        ("folder", local(folder.path(), options).await, Some(folder)),
        ("memory", ObjectBlobs::in_memory(options), None),
        ("shared", shared, None),
    ]
}

/// All files below, as (path below `folder`, length).
fn files(folder: &Path) -> Vec<(String, u64)> {
    let mut all = everything(folder);
    all.retain(|(path, _)| !path.starts_with("owners/"));
    all
}

/// The same with the marks of owners. The store may remove some meanwhile: what is gone when it is looked at is left out.
fn everything(folder: &Path) -> Vec<(String, u64)> {
    fn unless_gone<T>(looked: std::io::Result<T>) -> Option<T> {
        match looked {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
            looked => Some(looked.unwrap()),
        }
    }
    fn walk(root: &Path, at: &Path, out: &mut Vec<(String, u64)>) {
        for entry in unless_gone(std::fs::read_dir(at)).into_iter().flatten() {
            let path = entry.unwrap().path();
            let Some(found) = unless_gone(path.metadata()) else { continue };
            if found.is_dir() {
                walk(root, &path, out);
            } else {
                out.push((path.strip_prefix(root).unwrap().to_string_lossy().into_owned(), found.len()));
            }
        }
    }
    let mut out = Vec::new();
    walk(folder, folder, &mut out);
    out.retain(|(path, _)| path != "lock");
    out.sort();
    out
}
