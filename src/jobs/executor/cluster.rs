//! This server among those that share its store.
//!
//! Purpose: says what it is and that it is alive, and what all servers are and have to do. Invariant: what others say is a moment old;
//! nothing here claims a job. Must not know: leases, how a job is done, which store it is.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use async_trait::async_trait;
use tokio::sync::watch;

use super::api::{ClusterApi, JobApiError};
use super::sharing::GPU;
use super::{Executor, Inner};
use crate::admission::estimate::Need;
use crate::record::state::State;
use crate::record::{Bytes, Job, JobId, Spec};
use crate::store::shared::{Node, Overview, Role, Unschedulable};
use crate::store::{SharedStore, StoreError};

/// Between two words that this process is alive.
const BEAT: Duration = Duration::from_secs(4);
/// How long it is used what all servers have to do.
const OVERVIEW: Duration = Duration::from_secs(2);

/// Says that this process is alive, for as long as the executor lives. Waits for nothing else, such as a bucket that is away.
pub(super) async fn beat(inner: Weak<Inner>) {
    loop {
        let Some(this) = inner.upgrade() else { return };
        // Once it drains it is about to leave.
        if let Some(shared) = this.shared()
            && !this.is_draining()
        {
            this.beat(shared).await;
        }
        drop(this);
        tokio::time::sleep(BEAT).await;
    }
}

/// How this process shows itself to others that share its store.
#[derive(Clone, Debug, Default)]
pub struct NodeOptions {
    /// As operators call it.
    pub name: String,
    pub role: Role,
    pub version: String,
}

/// The name of this machine.
pub fn host_name() -> String {
    let told = std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let host = told.or_else(|| std::env::var("HOSTNAME").ok()).unwrap_or_default();
    Some(host.trim()).filter(|host| !host.is_empty()).unwrap_or("unknown").to_owned()
}

/// A name for the holder of leases that no other process has.
#[cfg(all(feature = "postgres", feature = "s3"))]
pub(super) fn unique_name(node: &str) -> Result<String, crate::admission::JobApiError> {
    Ok(crate::record::Holder::name(node, std::process::id(), super::getrandom_u128()? as u32))
}

#[async_trait]
impl ClusterApi for Executor {
    async fn at_work_elsewhere(&self, tenant: &str, id: JobId) -> Result<Option<String>, JobApiError> {
        let job = self.inner.of_tenant(tenant, id).await?;
        let running = job.status.holder.filter(|_| job.status.state == State::Running);
        Ok(running.map(|holder| holder.name).filter(|name| *name != self.inner.name))
    }

    async fn unschedulable(&self, job: &Job) -> Result<Option<String>, JobApiError> {
        match self.inner.shared() {
            Some(shared) if job.status.state == State::Queued => {
                Ok(shared.unschedulable(job.id).await?.map(|unschedulable| unschedulable.to_string()))
            }
            _ => Ok(None),
        }
    }

    async fn overview(&self) -> Result<Arc<Overview>, JobApiError> {
        Ok(self.inner.overview().await.unwrap_or_else(|| Ok(Arc::default()))?)
    }

    async fn streams_elsewhere(&self) -> Option<Option<String>> {
        let inner = &self.inner;
        if inner.options.node.role.works() && !*inner.drained.borrow() {
            return None;
        }
        let overview = inner.overview().await.and_then(Result::ok);
        let found = overview.iter().flat_map(|overview| &overview.members);
        let mut able = found.filter(|member| member.works() && !member.node.address.is_empty());
        Some(able.next().map(|member| member.node.address.clone()))
    }

    async fn share_calls(&self, open: BTreeMap<String, u32>) -> BTreeMap<String, u32> {
        match self.inner.shared() {
            Some(shared) => shared.share_calls(open).await.unwrap_or_default(),
            None => BTreeMap::new(),
        }
    }

    fn advertise(&self, address: String) {
        drop(self.inner.address.set(address));
    }

    fn drained(&self) -> watch::Receiver<bool> {
        self.inner.drained.subscribe()
    }
}

impl Inner {
    /// What this process says of itself to the others.
    fn node(&self) -> Node {
        let NodeOptions { name, role, version } = self.options.node.clone();
        Node {
            name,
            role,
            version,
            address: self.address.get().cloned().unwrap_or_default(),
            has_gpu: self.engine.backend(GPU).is_ok(),
            places: if role.works() { u32::try_from(self.engine.places()).unwrap_or(u32::MAX) } else { 0 },
            memory: self.engine.memory(),
            at_work: u32::try_from(self.leases.len()).unwrap_or(u32::MAX),
            planned: self.engine.planned(),
        }
    }

    /// Says that this process is alive, and hears whether it is to take no more work.
    async fn beat(&self, shared: &dyn SharedStore) {
        match shared.beat(self.node()).await {
            Ok(drain) => {
                let differs = |now: &mut bool| std::mem::replace(now, drain) != drain;
                if self.drained.send_if_modified(differs) {
                    let text = if drain { "takes no more work, as an operator wants" } else { "takes work again" };
                    tracing::info!("this server {text}");
                }
            }
            Err(error) => tracing::debug!(%error, "the others do not hear that this server is alive"),
        }
    }

    /// Whether this process sweeps now.
    pub(super) async fn sweeps(&self) -> Result<bool, StoreError> {
        match self.shared() {
            Some(shared) => shared.sweeps().await,
            None => Ok(true),
        }
    }

    /// All servers and all work of a shared store, as they were a moment ago.
    pub(super) async fn overview(&self) -> Option<Result<Arc<Overview>, StoreError>> {
        let shared = self.shared()?;
        let mut known = self.overview.lock().await;
        if let Some((at, overview)) = &*known
            && at.elapsed() < OVERVIEW
        {
            return Some(Ok(Arc::clone(overview)));
        }
        let read = shared.overview().await.map(Arc::new);
        *known = read.as_ref().ok().map(|overview| (Instant::now(), Arc::clone(overview)));
        Some(read)
    }

    /// Why no server that is alive could do a job; `None` if one can, or if this process alone does jobs.
    pub(super) async fn why_not(&self, need: &Need, spec: &Spec) -> Result<Option<Unschedulable>, JobApiError> {
        let Some(overview) = self.overview().await else { return Ok(None) };
        Ok(Unschedulable::of(&overview?.members, need.memory, spec.task().needs_gpu()))
    }

    /// The memory of the largest server that does work: what a job may need.
    pub(super) async fn largest(&self) -> Result<Bytes, JobApiError> {
        let Some(overview) = self.overview().await else { return Ok(self.engine.memory()) };
        let overview = overview?;
        let of_workers = overview.members.iter().filter(|member| member.node.role.works());
        Ok(of_workers
            .map(|member| member.node.memory)
            .max_by_key(|memory| (memory.host, memory.device))
            .unwrap_or_else(|| self.engine.memory()))
    }
}
