//! Jobs as data: specifications, states, and the stores that keep them.
//!
//! Promise: all stores do what a simple model does, whatever the order of operations, crashes and restarts; what was
//! acknowledged is never lost; a journal that is damaged or in use is never taken for an empty one. Pins follow the jobs.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[cfg(all(unix, feature = "postgres"))]
#[path = "../common/certificates.rs"]
#[allow(dead_code)] // for servers of our own, too
mod certificates;
#[cfg(all(unix, feature = "postgres"))]
#[path = "../common/postgres.rs"]
mod postgres_server;
#[path = "../common/process.rs"]
mod process;

#[cfg(all(unix, feature = "postgres"))]
mod clients;
#[cfg(all(unix, feature = "postgres"))]
mod cluster;
mod disk;
mod figures;
mod index;
mod journal;
mod model;
#[cfg(all(unix, feature = "postgres"))]
mod outage;
#[cfg(all(unix, feature = "postgres"))]
mod postgres;
mod random;
mod reuse;
#[cfg(all(unix, feature = "postgres"))]
mod scaling;
#[cfg(all(unix, feature = "postgres"))]
mod shared;
mod specs;
mod states;
mod stores;

use std::future::Future;
use std::path::Path;
use std::time::{Duration, Instant};

use jobs::blob::index::Stored;
use jobs::blob::{BlobInfo, Digest};
use jobs::record::Spec;
use jobs::store::{JobStore, RedbOptions, RedbStore, Retention, StoreError};
use tessera::proto::*;

/// The blob that the jobs below name as their input.
pub fn input() -> Digest {
    [7; 32].into()
}

/// How long a folder that was closed may still be in use.
const CLOSING: Duration = Duration::from_secs(60);

/// Opens a journal that no store has. A process that another test starts holds all files of this one until it is another program, so
/// that the lock of a store that was closed may be there for a moment.
pub fn open_journal(folder: &Path) -> Result<RedbStore, StoreError> {
    let begin = Instant::now();
    loop {
        match RedbStore::open(folder, RedbOptions::default()) {
            Err(StoreError::InUse { .. }) if begin.elapsed() < CLOSING => std::thread::sleep(Duration::from_millis(10)),
            opened => return opened,
        }
    }
}

/// A store whose index has these blobs, with their sizes.
pub fn knowing<S: JobStore>(store: S, blobs: &[(Digest, u64)]) -> S {
    let blobs = blobs.iter().map(|(digest, size)| (BlobInfo { digest: *digest, size_bytes: *size }, 1)).collect();
    wait(store.index().enter(Stored { blobs, ..Stored::default() })).unwrap();
    store
}

/// A small job; `body` makes it differ from others.
pub fn message(body: u64) -> JobSpec {
    let file = MeshFile { digest: input().to_string(), format: MeshFormat::Ply.into(), attributes: None };
    JobSpec {
        mesh: Some(JobMesh { source: Some(job_mesh::Source::File(file)) }),
        work: Some(job_spec::Work::Remesh(RemeshOptions { points: Some(100 + body as u32), ..Default::default() })),
        labels: [("body".to_owned(), body.to_string())].into(),
        ..JobSpec::default()
    }
}

/// A duration.
pub fn millis(ms: i32) -> Option<prost_types::Duration> {
    Some(prost_types::Duration { seconds: 0, nanos: 1_000_000 * ms })
}

/// The same, checked.
pub fn spec(request: &str, body: u64) -> Spec {
    Spec::new(message(body), "t".to_owned(), request.to_owned()).unwrap()
}

/// How long things are kept in these tests.
pub const KEEP: Retention =
    Retention { results: std::time::Duration::from_millis(500), records: std::time::Duration::from_millis(200) };

thread_local! {
    // Never dropped: at the end of a thread it could not end the connections of a pool.
    static RUNTIME: &'static tokio::runtime::Runtime =
        Box::leak(Box::new(tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()));
}

/// Runs a future to its end.
pub fn wait<T>(future: impl Future<Output = T>) -> T {
    RUNTIME.with(|runtime| runtime.block_on(future))
}
