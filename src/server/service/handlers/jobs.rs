//! `JobService`: questions about jobs, and watches of one.
//!
//! Invariant: every question is asked in the name of the caller's tenant. A watch holds the events that it sends now, and
//! ends with the job, or with an error. Must not know: how jobs are done, where they are kept, how statuses look.

use std::sync::Arc;

use tonic::{Request, Response, Status};

use crate::service::access::Caller;
use crate::service::budget::Budget;
use crate::service::convert::{job, job_id};
use crate::service::desk::{self, DESK_TIME, to_the_end};
use crate::service::stream::{Answers, Gate, Kind, Outbox, answer, respond};
use crate::service::{Phase, RequestError, tenant};
use jobs::blob::BlobStore;
use jobs::executor::api::JobApi;
use jobs::record::Spec;
use jobs::record::event::Event;
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
    ) -> Result<Response<T>, Status> {
        let (metadata, extensions, message) = request.into_parts();
        let tenant = tenant::of(&metadata, &extensions).map_err(RequestError::from)?;
        let work = work(message, tenant, Arc::clone(&self.api));
        answer((method, Kind::Call), &metadata, &extensions, &self.gate, Some(DESK_TIME), work).await
    }
}

#[tonic::async_trait]
impl proto::job_service_server::JobService for Jobs {
    type WatchJobStream = Answers<proto::WatchJobResponse>;

    async fn create_job(
        &self,
        request: Request<proto::CreateJobRequest>,
    ) -> Result<Response<proto::CreateJobResponse>, Status> {
        let most = request.extensions().get::<Caller>().and_then(|caller| caller.bytes);
        let blobs = Arc::clone(&self.blobs);
        self.ask("CreateJob", request, |message, tenant, api| async move {
            let wanted = spec(message.spec, tenant, message.request_id)?;
            let created = desk::create(api, &*blobs, most, wanted).await?;
            Ok(proto::CreateJobResponse { job: Some(job::message(&created.job)), existed: created.existed })
        })
        .await
    }

    async fn get_job(&self, request: Request<proto::GetJobRequest>) -> Result<Response<proto::GetJobResponse>, Status> {
        self.ask("GetJob", request, |message, tenant, api| async move {
            let found = api.get(&tenant, job_id(&message.id)?).await?;
            Ok(proto::GetJobResponse { job: Some(job::message(&found)) })
        })
        .await
    }

    async fn list_jobs(
        &self,
        request: Request<proto::ListJobsRequest>,
    ) -> Result<Response<proto::ListJobsResponse>, Status> {
        self.ask("ListJobs", request, |message, tenant, api| async move {
            Ok(job::page(&api.list(job::query(message, tenant)?).await?))
        })
        .await
    }

    async fn watch_job(
        &self,
        request: Request<proto::WatchJobRequest>,
    ) -> Result<Response<Self::WatchJobStream>, Status> {
        let (metadata, extensions, message) = request.into_parts();
        let tenant = tenant::of(&metadata, &extensions).map_err(RequestError::from)?;
        let id = job_id(&message.id).map_err(RequestError::from)?;
        let (api, gate) = (Arc::clone(&self.api), self.gate.clone());
        Ok(respond(("WatchJob", Kind::Watch), &metadata, &extensions, (&self.gate, &self.budget), |out| async move {
            tokio::select! {
                biased;
                result = desk::follow(&*api, &tenant, id, message.after, |event| tell(&out, event)) => result,
                // The job goes on, and can be watched again from where this ends.
                () = gate.reached(Phase::Draining) => Err(RequestError::Draining),
            }
        })?)
    }

    async fn cancel_job(
        &self,
        request: Request<proto::CancelJobRequest>,
    ) -> Result<Response<proto::CancelJobResponse>, Status> {
        self.ask("CancelJob", request, |message, tenant, api| async move {
            let id = job_id(&message.id)?;
            let cancelled = to_the_end(async move { api.cancel(&tenant, id).await }).await?;
            Ok(proto::CancelJobResponse { job: Some(job::message(&cancelled)) })
        })
        .await
    }

    async fn delete_job(
        &self,
        request: Request<proto::DeleteJobRequest>,
    ) -> Result<Response<proto::DeleteJobResponse>, Status> {
        self.ask("DeleteJob", request, |message, tenant, api| async move {
            let id = job_id(&message.id)?;
            to_the_end(async move { api.delete(&tenant, id).await }).await?;
            Ok(proto::DeleteJobResponse {})
        })
        .await
    }

    async fn estimate_job(
        &self,
        request: Request<proto::EstimateJobRequest>,
    ) -> Result<Response<proto::EstimateJobResponse>, Status> {
        self.ask("EstimateJob", request, |message, tenant, api| async move {
            let proto::EstimateJobRequest { spec: wanted, vertices, facets } = message;
            let wanted = spec(wanted, tenant, String::new())?;
            Ok(job::estimate(api.estimate(wanted, vertices, facets).await?))
        })
        .await
    }
}

fn spec(message: Option<proto::JobSpec>, tenant: String, request_id: String) -> Result<Spec, WireError> {
    let message = message.ok_or_else(|| WireError::field("spec", "is missing; say what the job is to do"))?;
    Spec::new(message, tenant, request_id)
}

async fn tell(outbox: &Outbox<proto::WatchJobResponse>, event: Event) -> Result<(), RequestError> {
    outbox.send(proto::WatchJobResponse { event: Some(job::event(event)) }).await
}
