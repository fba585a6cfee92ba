//! `POST /v1/remesh`: a mesh in, a mesh out.
//!
//! Purpose: it is a job inside: the body is stored, a job is created, awaited and read, and then deleted, so that limits, keys,
//! quotas and counts are those of jobs. Invariant: whatever becomes of the request, its job does not outlive it. Must not
//! know: how a surface is remeshed.

use std::sync::Arc;

use axum::extract::{Extension, Request, State};
use axum::http::HeaderMap;
use axum::http::header::{ACCEPT, CONTENT_TYPE};
use axum::http::request::Parts;
use tokio::runtime::Handle;

use super::blobs::store;
use super::body::coding;
use super::form::one_file;
use super::guard::Whose;
use super::jobs::{MESH, send_result};
use super::options::{Asked, format_names, format_of_types};
use super::problem::{Answered, wrong};
use crate::service::{self, Caller, Desk, RequestError, to_the_end};
use geometry::mesh::io::Format;
use jobs::blob::Digest;
use jobs::executor::api::{JobApi, Reuse};
use jobs::record::state::State as JobState;
use jobs::record::{Job, JobId, Spec};
use transport::Phase;
use wire::proto::{self, JobSpec, job_mesh, result_format};

pub(super) async fn remesh(State(desk): State<Desk>, Extension(client): Whose, request: Request) -> Answered {
    let (parts, body) = one_file(&desk, request).await?.into_parts();
    let wanted = wanted(&parts, &client)?;
    let (info, bytes) = store(&desk, &client, &parts.headers, body).await?;
    let spec = wanted.of(info.digest, &bytes)?;
    drop(bytes);
    let mine = to_the_end(Mine::of(desk.clone(), client.clone(), spec)).await?;
    let job = ended(&desk, &client.tenant, mine.id).await?;
    send_result(&desk, &client, &job, MESH, &HeaderMap::new(), mine).await
}

/// What is asked for, before the surface is there.
struct Asking {
    message: JobSpec,
    request_id: String,
    tenant: String,
    format: Option<Format>,
    to: Option<Format>,
}

/// What a request asks for. What can be refused without its body is refused here.
fn wanted(parts: &Parts, client: &Caller) -> Result<Asking, RequestError> {
    let mut asked = Asked::of_query(parts.uri.query())?;
    coding(&parts.headers)?;
    let header = |name| parts.headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let format = asked.format("format")?.or_else(|| format_of_types(header(CONTENT_TYPE)));
    let to = asked.format("to")?.or_else(|| format_of_types(header(ACCEPT)));
    let any = Format::Ply;
    let nothing = Digest::of(&[]);
    let (message, request_id) = asked.remesh(nothing, format.unwrap_or(any), to.or(format).unwrap_or(any))?;
    Spec::new(message.clone(), client.tenant.clone(), request_id.clone())?;
    Ok(Asking { message, request_id, tenant: client.tenant.clone(), format, to })
}

impl Asking {
    /// The job, of a surface that is stored now.
    fn of(self, digest: Digest, bytes: &[u8]) -> Result<Spec, RequestError> {
        let Self { mut message, request_id, tenant, format, to } = self;
        let found = format.or_else(|| Format::of_bytes(bytes)).ok_or_else(|| {
            wrong("format", format!("is missing, and the body does not say; it must be one of {}", format_names()))
        })?;
        if let Some(proto::JobMesh { source: Some(job_mesh::Source::File(file)) }) = &mut message.mesh {
            (file.digest, file.format) = (digest.to_string(), found.number());
        }
        let form = Some(result_format::Form::File(to.unwrap_or(found).number()));
        message.result = Some(proto::ResultFormat { form });
        Ok(Spec::new(message, tenant, request_id)?)
    }
}

/// The job once it has ended. While the server drains, one that has not begun never will.
async fn ended(desk: &Desk, tenant: &str, id: JobId) -> Result<Job, RequestError> {
    let following = service::follow(&*desk.api, tenant, id, 0, |_| async { Ok(()) });
    tokio::pin!(following);
    tokio::select! {
        result = &mut following => result?,
        () = desk.gate.reached(Phase::Draining) => {
            if desk.api.get(tenant, id).await?.status.state == JobState::Queued {
                return Err(RequestError::Draining);
            }
            following.await?;
        }
    }
    Ok(desk.api.get(tenant, id).await?)
}

/// A job of a request: cancelled and forgotten when this is dropped.
struct Mine {
    api: Arc<dyn JobApi>,
    tenant: String,
    id: JobId,
}

impl Mine {
    /// Its job is its own from the first: a request may end while a job is created.
    async fn of(desk: Desk, client: Caller, spec: Spec) -> Result<Self, RequestError> {
        let api = Arc::clone(&desk.api);
        let created = service::create(Arc::clone(&api), &*desk.blobs, client.bytes, (spec, Reuse::Never)).await?;
        Ok(Self { api, tenant: client.tenant, id: created.job.id })
    }
}

impl Drop for Mine {
    fn drop(&mut self) {
        let (api, tenant, id) = (Arc::clone(&self.api), std::mem::take(&mut self.tenant), self.id);
        // Without a runtime the process ends.
        let Ok(runtime) = Handle::try_current() else { return };
        runtime.spawn(async move {
            // One that has ended is not cancelled.
            let _ = api.cancel(&tenant, id).await;
            if let Err(error) = api.delete(&tenant, id).await {
                tracing::debug!(%error, job = %id, "the job of a request is not deleted; it is kept as others are");
            }
        });
    }
}
