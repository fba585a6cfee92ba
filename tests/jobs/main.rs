//! Jobs as data: specifications, states, and the stores that keep them.
//!
//! Promise: both stores do what a simple model does, whatever the order of operations, crashes and restarts; what was
//! acknowledged is never lost; a journal that is damaged or in use is never taken for an empty one.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/process.rs"]
mod process;

mod disk;
mod figures;
mod journal;
mod model;
mod random;
mod specs;
mod states;

use std::future::Future;

use jobs::blob::Digest;
use jobs::record::*;
use jobs::store::Retention;

/// A small job; `body` makes it differ from others.
pub fn spec(request: &str, body: u64) -> JobSpec {
    let seeds = SeedSource::Sampled { points: Some(100 + body), random_seed: None };
    JobSpec {
        mesh: MeshSource::File { blob: Digest::from([7; 32]), format: MeshFormat::Ply, attributes: None },
        work: WorkSpec::Remesh(Box::new(RemeshWork::new(seeds))),
        backend: None,
        result: None,
        priority: None,
        deadlines: Deadlines::default(),
        labels: [("body".to_owned(), body.to_string())].into(),
        tenant: "t".to_owned(),
        request_id: request.to_owned(),
    }
}

/// How long things are kept in these tests.
pub const KEEP: Retention =
    Retention { results: std::time::Duration::from_millis(500), records: std::time::Duration::from_millis(200) };

thread_local! {
    static RUNTIME: tokio::runtime::Runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
}

/// Runs a future to its end.
pub fn wait<T>(future: impl Future<Output = T>) -> T {
    RUNTIME.with(|runtime| runtime.block_on(future))
}
