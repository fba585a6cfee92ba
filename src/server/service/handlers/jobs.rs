//! `JobService`: questions about jobs, and watches of one.
//!
//! Invariant: every question is asked in the name of the caller's tenant. A watch holds the events that it sends now, and
//! ends with the job, or with an error. Must not know: how jobs are done, where they are kept, how statuses look.

use std::sync::Arc;

use tonic::Request;

use super::Reply;
use crate::service::RequestError;
use crate::service::access::Caller;
use crate::service::convert::{self, job_id};
use crate::service::desk::{self, DESK_TIME, tenant_of, to_the_end};
use crate::service::stream::{Answers, Gate, Kind, Outbox, answer, respond};
use jobs::blob::BlobStore;
use jobs::executor::api::JobApi;
use jobs::record::Spec;
use jobs::record::event::Event;
use jobs::store::Created;
use transport::{Budget, Phase};
use wire::{WireError, proto};

pub(in crate::service) struct Jobs {
    api: Arc<dyn JobApi>,
    /// Asked how much a tenant has.
    blobs: Arc<dyn BlobStore>,
    budget: Budget,
    gate: Gate,
}

impl Jobs {
    pub(in crate::service) fn new(api: Arc<dyn JobApi>, blobs: Arc<dyn BlobStore>, budget: Budget, gate: Gate) -> Self {
        Self { api, blobs, budget, gate }
    }

    /// A question with one answer, in the name of a tenant.
    async fn ask<M, T, F: Future<Output = Result<T, RequestError>>>(
        &self,
        method: &'static str,
        request: Request<M>,
        work: impl FnOnce(M, String, Arc<dyn JobApi>) -> F,
    ) -> Reply<T> {
        let (metadata, extensions, message) = request.into_parts();
        let tenant = tenant_of(metadata.as_ref(), &extensions)?;
        let work = work(message, tenant.clone(), Arc::clone(&self.api));
        answer((method, Kind::Call, &tenant), &metadata, &extensions, &self.gate, Some(DESK_TIME), work).await
    }
}

#[tonic::async_trait]
impl proto::job_service_server::JobService for Jobs {
    type WatchJobStream = Answers<proto::WatchJobResponse>;

    async fn create_job(&self, request: Request<proto::CreateJobRequest>) -> Reply<proto::CreateJobResponse> {
        let most = request.extensions().get::<Caller>().and_then(|caller| caller.bytes);
        let blobs = Arc::clone(&self.blobs);
        self.ask("CreateJob", request, |message, tenant, api| async move {
            let reuse = convert::reuse(message.reuse)?;
            let wanted = spec(message.spec, tenant, message.request_id)?;
            let Created { job, existed, reused } = desk::create(api, &*blobs, most, (wanted, reuse)).await?;
            Ok(proto::CreateJobResponse { job: Some(convert::message(&job)), existed, reused })
        })
        .await
    }

    async fn get_job(&self, request: Request<proto::GetJobRequest>) -> Reply<proto::GetJobResponse> {
        self.ask("GetJob", request, |message, tenant, api| async move {
            let found = api.get(&tenant, job_id(&message.id)?).await?;
            let unschedulable = match api.cluster() {
                Some(cluster) => cluster.unschedulable(&found).await?.unwrap_or_default(),
                None => String::new(),
            };
            Ok(proto::GetJobResponse { job: Some(proto::Job { unschedulable, ..convert::message(&found) }) })
        })
        .await
    }

    async fn list_jobs(&self, request: Request<proto::ListJobsRequest>) -> Reply<proto::ListJobsResponse> {
        self.ask("ListJobs", request, |message, tenant, api| async move {
            Ok(convert::page(&api.list(convert::query(message, tenant)?).await?))
        })
        .await
    }

    async fn watch_job(&self, request: Request<proto::WatchJobRequest>) -> Reply<Self::WatchJobStream> {
        let (metadata, extensions, message) = request.into_parts();
        let tenant = tenant_of(metadata.as_ref(), &extensions)?;
        let id = job_id(&message.id).map_err(RequestError::from)?;
        let (api, gate, name) = (Arc::clone(&self.api), self.gate.clone(), tenant.clone());
        Ok(respond(
            ("WatchJob", Kind::Watch, &name),
            &metadata,
            &extensions,
            (&self.gate, &self.budget),
            |out| async move {
                tokio::select! {
                    biased;
                    result = desk::follow(&*api, &tenant, id, message.after, |event| tell(&out, event)) => result,
                    // The job goes on, and can be watched again from where this ends.
                    () = gate.reached(Phase::Draining) => Err(RequestError::Draining),
                }
            },
        )?)
    }

    async fn cancel_job(&self, request: Request<proto::CancelJobRequest>) -> Reply<proto::CancelJobResponse> {
        self.ask("CancelJob", request, |message, tenant, api| async move {
            let id = job_id(&message.id)?;
            let cancelled = to_the_end(async move { api.cancel(&tenant, id).await }).await?;
            Ok(proto::CancelJobResponse { job: Some(convert::message(&cancelled)) })
        })
        .await
    }

    async fn delete_job(&self, request: Request<proto::DeleteJobRequest>) -> Reply<proto::DeleteJobResponse> {
        self.ask("DeleteJob", request, |message, tenant, api| async move {
            let id = job_id(&message.id)?;
            to_the_end(async move { api.delete(&tenant, id).await }).await?;
            Ok(proto::DeleteJobResponse {})
        })
        .await
    }

    async fn estimate_job(&self, request: Request<proto::EstimateJobRequest>) -> Reply<proto::EstimateJobResponse> {
        self.ask("EstimateJob", request, |message, tenant, api| async move {
            let proto::EstimateJobRequest { spec: wanted, vertices, facets } = message;
            let wanted = spec(wanted, tenant, String::new())?;
            Ok(convert::estimate(api.estimate(wanted, vertices, facets).await?))
        })
        .await
    }
}

fn spec(message: Option<proto::JobSpec>, tenant: String, request_id: String) -> Result<Spec, WireError> {
    let message = message.ok_or_else(|| WireError::field("spec", "is missing; say what the job is to do"))?;
    Spec::new(message, tenant, request_id)
}

async fn tell(outbox: &Outbox<proto::WatchJobResponse>, event: Event) -> Result<(), RequestError> {
    outbox.send(proto::WatchJobResponse { event: Some(convert::event(event)) }).await
}
