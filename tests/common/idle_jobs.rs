//! Jobs that are kept, none of which is done: the tests say what becomes of each.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use jobs::blob::{BlobError, BlobStore, Digest};
use jobs::executor::api::{Estimate, JobApi, JobApiError, Preview, Reuse};
use jobs::record::event::Events;
use jobs::record::*;
use jobs::store::*;
use tokio::sync::watch;

/// See the module's head.
pub struct Idle {
    pub store: MemoryStore,
    pub blobs: Arc<dyn BlobStore>,
    /// Why nothing can be stored.
    pub storage: watch::Sender<Option<BlobError>>,
    names: AtomicU64,
}

impl Idle {
    /// `blobs` has the index of `store`.
    pub fn new(store: MemoryStore, blobs: Arc<dyn BlobStore>) -> Self {
        Self { store, blobs, storage: watch::Sender::new(None), names: AtomicU64::new(0) }
    }

    async fn own(&self, tenant: &str, id: JobId) -> Result<Job, JobApiError> {
        match self.store.get(id).await? {
            job if job.spec.tenant == tenant => Ok(job),
            _ => Err(StoreError::NotFound { id }.into()),
        }
    }

    fn input(spec: &Spec) -> Vec<Digest> {
        match &spec.task().mesh {
            MeshSource::File { blob, .. } => vec![*blob],
            MeshSource::Arrays { positions, facets, .. } => vec![positions.blob, facets.blob],
        }
    }
}

#[tonic::async_trait]
impl JobApi for Idle {
    async fn create(&self, spec: Spec, _: Reuse) -> Result<Created, JobApiError> {
        for blob in Self::input(&spec) {
            self.blobs.stat(blob).await?;
        }
        let random = self.names.fetch_add(1, Ordering::SeqCst).into();
        Ok(self.store.create(NewJob { random, spec, needs: Bytes::default(), cost: Cost::default() }).await?)
    }

    async fn get(&self, tenant: &str, id: JobId) -> Result<Job, JobApiError> {
        self.own(tenant, id).await
    }

    async fn list(&self, query: Query) -> Result<Page, JobApiError> {
        Ok(self.store.list(query).await?)
    }

    async fn events(&self, tenant: &str, id: JobId, after: u64, most: usize) -> Result<Events, JobApiError> {
        self.own(tenant, id).await?;
        Ok(self.store.events(id, after, most).await?)
    }

    async fn wait(&self, tenant: &str, id: JobId, after: u64) -> Result<(), JobApiError> {
        self.own(tenant, id).await?;
        Ok(self.store.wait(id, after).await?)
    }

    async fn preview(&self, tenant: &str, id: JobId) -> Result<watch::Receiver<Option<Preview>>, JobApiError> {
        self.own(tenant, id).await?;
        Ok(watch::channel(None).1)
    }

    async fn cancel(&self, tenant: &str, id: JobId) -> Result<Job, JobApiError> {
        self.own(tenant, id).await?;
        Ok(self.store.cancel(id).await?)
    }

    async fn delete(&self, tenant: &str, id: JobId) -> Result<(), JobApiError> {
        self.own(tenant, id).await?;
        Ok(self.store.delete(id).await?)
    }

    async fn estimate(&self, spec: Spec, vertices: Option<u64>, _: Option<u64>) -> Result<Estimate, JobApiError> {
        let _ = spec;
        let host_bytes = 100 * vertices.unwrap_or(1);
        Ok(Estimate {
            host_bytes,
            host_limit_bytes: 1000,
            seconds: 0.5,
            fits: host_bytes <= 1000,
            ..Estimate::default()
        })
    }

    async fn failed(&self) {
        std::future::pending().await
    }

    fn storage(&self) -> watch::Receiver<Option<BlobError>> {
        self.storage.subscribe()
    }

    async fn drain(&self) {}
}
