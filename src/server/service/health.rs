//! Health of the server.
//!
//! Purpose: [`Told`] passes changes of [`Readiness`] to `grpc.health.v1` and the metrics. [`follow_engine`], [`probes`] and
//! [`follow_blobs`] check the engine and the store of blobs.
//! Invariant: a fault shows within a second of being found, until a probe has passed. Work under way proves the device; only
//! an idle one is probed. Must not know: how a probe is done.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{Mutex, watch};
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use super::{BLOB_SERVICE_NAME, JOB_SERVICE_NAME};
use crate::metrics::Metrics;
use crate::readiness::{Condition, Readiness, Reason};
use jobs::blob::{BlobError, BlobStore};
use jobs::engine::probe::probe;
use jobs::{Device, Engine, Work};

const PROBE_AGAIN: Duration = Duration::from_secs(5);

const LOOK_AT_BLOBS: Duration = Duration::from_secs(5);

/// Health of each service and of the server.
pub(super) struct Told {
    health: HealthReporter,
    names: &'static [&'static str],
    metrics: Metrics,
    last: Mutex<Option<Condition>>,
}

impl Told {
    pub(super) fn new(health: HealthReporter, names: &'static [&'static str], metrics: Metrics) -> Self {
        Self { health, names, metrics, last: Mutex::default() }
    }

    /// Publishes a condition, for each service whose health it changes.
    pub(super) async fn tell(&self, condition: Condition) {
        // Held to the end: two calls at once do not mix.
        let mut last = self.last.lock().await;
        self.metrics.condition(condition);
        for name in self.names.iter().chain([&""]) {
            let now = status(name, condition);
            if last.is_none_or(|last| status(name, last) != now) {
                self.health.set_service_status(*name, now).await;
            }
        }
        *last = Some(condition);
    }

    pub(super) async fn follow(self: Arc<Self>, readiness: Readiness) {
        let mut condition = readiness.watch();
        loop {
            let now = *condition.borrow_and_update();
            self.tell(now).await;
            if condition.changed().await.is_err() {
                return;
            }
            tracing::info!(condition = %*condition.borrow(), "readiness");
        }
    }
}

/// Streams keep nothing, and work without the storage.
fn status(service: &str, condition: Condition) -> ServingStatus {
    let stores = service.is_empty() || service == BLOB_SERVICE_NAME || service == JOB_SERVICE_NAME;
    match condition.reasons().any(|reason| stores || !reason.is_of_storage()) {
        true => ServingStatus::NotServing,
        false => ServingStatus::Serving,
    }
}

/// Sets the reasons of the engine. Returns when it has ended, or with the stage of work that will not stop.
pub(super) async fn follow_engine(engine: &Engine, readiness: &Readiness, metrics: &Metrics) -> Option<&'static str> {
    let (mut device, mut work) = (engine.watch_device(), engine.watch_work());
    loop {
        let (now, works) = (*device.borrow_and_update(), *work.borrow_and_update());
        if now == Device::Gone {
            tracing::error!("the engine has ended");
            return None;
        }
        if now == Device::Missing {
            tracing::error!("the device did not come back; the process ends, so that its supervisor can start it anew");
            return None;
        }
        if let Work::Lost { stage } = works {
            tracing::error!(stage, "work does not stop; the process ends, so that its supervisor can start it anew");
            return Some(stage);
        }
        readiness.set(Reason::WorkStuck, works != Work::Stops);
        readiness.set(Reason::OnCpu, now == Device::Replaced);
        if now == Device::Lost {
            readiness.set(Reason::DeviceLost, true);
        } else if readiness.condition().has(Reason::DeviceLost) {
            // It is back if it computes what it should.
            check(engine, readiness, metrics).await;
            readiness
                .set(Reason::DeviceLost, !matches!(*engine.watch_device().borrow(), Device::Ready | Device::Replaced));
            continue;
        }
        let changed = tokio::select! {
            changed = device.changed() => changed,
            changed = work.changed() => changed,
        };
        if changed.is_err() {
            return None;
        }
    }
}

pub(super) async fn check(engine: &Engine, readiness: &Readiness, metrics: &Metrics) {
    let outcome = probe(engine).await;
    if let Err(error) = &outcome {
        tracing::error!(%error, "the probe of the backend failed");
    }
    metrics.probed(outcome.is_ok(), 1);
    readiness.set(Reason::ProbeFailed, outcome.is_err());
}

/// Probes the engine while it is idle, and until it is well.
pub(super) async fn probes(engine: Engine, readiness: Readiness, metrics: Metrics, every: Duration) {
    loop {
        let has_failed = readiness.condition().has(Reason::ProbeFailed);
        tokio::time::sleep(if has_failed { every.min(PROBE_AGAIN) } else { every }).await;
        match *engine.watch_device().borrow() {
            Device::Gone | Device::Missing => return,
            // Probed once it is made anew.
            Device::Lost => continue,
            Device::Ready | Device::Replaced => {}
        }
        if readiness.condition().has(Reason::ProbeFailed) || engine.load() == (0, false) {
            check(&engine, &readiness, &metrics).await;
        }
    }
}

/// Publishes the bytes of blobs, and whether more can be stored.
pub(super) async fn follow_blobs(
    blobs: Arc<dyn BlobStore>,
    mut storage: watch::Receiver<Option<BlobError>>,
    readiness: Readiness,
    metrics: Metrics,
) {
    loop {
        match blobs.usage().await {
            Ok(usage) => {
                metrics.blobs(usage.blob_bytes + usage.uploading_bytes, usage.limit_bytes);
            }
            Err(error) => tracing::warn!(%error, "what blobs take is not known"),
        }
        let copies = blobs.cache_use();
        metrics.blob_cache(copies.hits, copies.misses);
        let trouble = storage.borrow_and_update().clone();
        readiness.set(Reason::DiskFull, trouble == Some(BlobError::StorageFull));
        readiness.set(Reason::StoreAway, trouble.is_some_and(|error| error != BlobError::StorageFull));
        tokio::select! {
            // A closed channel leaves the timer.
            Ok(()) = storage.changed() => {}
            () = tokio::time::sleep(LOOK_AT_BLOBS) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::SERVICE_NAME;

    #[test]
    fn faults_of_the_storage_leave_streams_alone() {
        let readiness = Readiness::new();
        let of = |name, readiness: &Readiness| status(name, readiness.condition());
        assert_eq!(of("", &readiness), ServingStatus::Serving);
        readiness.set(Reason::DiskFull, true);
        for (name, expected) in [
            ("", ServingStatus::NotServing),
            (JOB_SERVICE_NAME, ServingStatus::NotServing),
            (BLOB_SERVICE_NAME, ServingStatus::NotServing),
            (SERVICE_NAME, ServingStatus::Serving),
        ] {
            assert_eq!(of(name, &readiness), expected, "{name:?}");
        }
        readiness.set(Reason::DeviceLost, true);
        assert_eq!(of(SERVICE_NAME, &readiness), ServingStatus::NotServing);
    }
}
