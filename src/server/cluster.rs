//! What this server tells operators of all servers that share its store.
//!
//! Purpose: [`follow`] keeps metrics and readiness up to date; [`scale`] answers an autoscaler. Invariant: an overview is at most some
//! seconds old, and what cannot be read is not told. Must not know: SQL, which servers there are.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use serde_json::{Value, json};

use crate::metrics::Metrics;
use crate::readiness::{Readiness, Reason};
use jobs::executor::api::JobApi;

/// Between two looks.
const LOOK: Duration = Duration::from_secs(5);

/// Work that waits or is done, in servers. `None` if no other server shares the store, or if the store does not answer.
pub async fn scale(api: &dyn JobApi) -> Option<Value> {
    let overview = api.cluster()?.overview().await.ok()?;
    let (nodes, capacity) = overview.capacity();
    // Two digits are enough for an autoscaler.
    let value = (overview.load() * 100.0).ceil() / 100.0;
    let (queued, running) = (overview.queued(), overview.running());
    Some(json!({ "value": value, "queued": queued, "running": running, "nodes": nodes, "capacity": capacity }))
}

/// Follows the store for as long as the server lives. Returns at once if no other server shares it.
pub(crate) async fn follow(api: Arc<dyn JobApi>, metrics: Metrics, readiness: Readiness) -> Option<Infallible> {
    let cluster = api.cluster()?;
    let mut drained = cluster.drained();
    loop {
        readiness.set(Reason::Drained, *drained.borrow_and_update());
        match cluster.overview().await {
            Ok(overview) => metrics.cluster(&overview),
            Err(_) => metrics.no_cluster(),
        }
        // Without a sender the executor is gone.
        tokio::select! {
            changed = drained.changed() => changed.ok()?,
            () = tokio::time::sleep(LOOK) => {}
        }
    }
}
