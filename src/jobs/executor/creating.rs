//! Whether a new job is kept.
//!
//! Purpose: what an executor checks before its store keeps a job: a place, bounds, memory, its input, and whether an earlier job is
//! the answer. Invariant: nothing here keeps anything, and what costs most comes last. Must not know: messages, how a job is done.

use std::time::Duration;

use super::Inner;
use super::api::{JobApiError, Reuse};
use super::fingerprint::fingerprint;
use crate::JobError;
use crate::admission::estimate::{Counts, Need};
use crate::admission::forecast::must_fit;
use crate::blob::{BlobError, Owner};
use crate::lock;
use crate::places::may_take;
use crate::record::{Job, Outcome, Spec};
use crate::store::Created;
use crate::store::shared::Unschedulable;

impl Inner {
    pub(super) fn within_bounds(&self, counts: &Counts) -> Result<(), JobApiError> {
        let bounds = &self.options.bounds;
        for (field, what, count, most) in [
            // An STL file is counted with three vertices a facet.
            ("spec.mesh", "vertices", counts.vertices, bounds.max_vertices.saturating_mul(3)),
            ("spec.mesh", "facets", counts.facets, bounds.max_facets),
            ("spec", "seeds", counts.points, bounds.max_seeds),
            ("spec", "steps", counts.steps, bounds.max_iterations.into()),
        ] {
            if count > most {
                let problem = format!("asks for {count} {what}; this server takes at most {most}");
                return Err(JobApiError::Input { field: field.to_owned(), problem });
            }
        }
        Ok(())
    }

    /// The blobs that a job names must be its tenant's: those of others do not exist for it. They are used now, so that they
    /// are the last to go before the store pins them.
    pub(super) async fn check_input(&self, spec: &Spec) -> Result<(), JobApiError> {
        let missing = self.stores.blobs.find_missing_of(Owner::of(&spec.tenant), &spec.task().blobs()).await?;
        missing.first().map_or(Ok(()), |digest| Err(BlobError::NotFound { digest: *digest }.into()))
    }

    /// Whether one more job of a tenant may wait. Asks a shared store once a second, and no other, so that excess calls are
    /// refused at once.
    async fn has_place(&self, tenant: &str) -> Result<(), JobApiError> {
        if self.is_draining() {
            return Err(JobError::Draining.into());
        }
        let (own, waiting) = match self.shared() {
            Some(shared) => self.waiting(shared, tenant).await?,
            None => {
                let jobs = &lock(&self.held).jobs;
                let held_own = jobs.iter().filter(|job| job.spec.tenant == tenant).count();
                (self.engine.kept(Some(tenant)) + held_own, self.engine.kept(None) + jobs.len())
            }
        };
        let full = JobError::QueueFull { waiting, retry_after: Duration::from_secs(5) };
        if may_take(own, waiting, self.options.waiting_jobs) { Ok(()) } else { Err(full.into()) }
    }

    /// What must be known before the input is looked at: an earlier job that is the answer. Errors: as [`Self::has_place`]; in a
    /// shared store `Blob` if blobs cannot be stored now.
    pub(super) async fn begin_create(&self, spec: &Spec, reuse: Reuse) -> Result<Option<Created>, JobApiError> {
        // Its input may be gone by now, and is not needed.
        if !spec.request_id.is_empty()
            && let Some(job) = self.stores.jobs.requested(spec.clone()).await?
        {
            return Ok(Some(Created::before(job)));
        }
        // Servers that share a bucket know within seconds that it is away.
        if self.shared().is_some()
            && let Some(error) = self.storage.trouble()
        {
            return Err(error.into());
        }
        if reuse == Reuse::SameBits
            && let Some(job) = self.same(spec).await?
        {
            self.engine.observer().reused(spec.task().operation.kind());
            return Ok(Some(Created::reused(job)));
        }
        self.has_place(&spec.tenant).await.map(|()| None)
    }

    /// A job of the tenant whose whole result is kept, and is what this one's would be if it was done here.
    async fn same(&self, spec: &Spec) -> Result<Option<Job>, JobApiError> {
        // Without the backend the job is refused, or done elsewhere.
        let Ok(backend) = self.engine.backend(spec.task().backend) else { return Ok(None) };
        let wanted = fingerprint(spec.message(), &backend, &self.options.bounds);
        let Some(job) = self.stores.jobs.same(spec.tenant.clone(), wanted).await? else { return Ok(None) };
        let Some(Outcome::Succeeded(result)) = &job.status.outcome else { return Ok(None) };
        // A blob that was found damaged is gone.
        let blobs: Vec<_> = result.blobs.values().copied().collect();
        let missing = self.stores.blobs.find_missing_of(Owner::of(&spec.tenant), &blobs).await?;
        Ok(missing.is_empty().then_some(job))
    }

    /// Checks all that can be checked before a job is kept; gives the memory that it needs.
    pub(super) async fn admit(&self, spec: &Spec) -> Result<Need, JobApiError> {
        self.has_place(&spec.tenant).await?;
        let is_shared = self.shared().is_some();
        if !is_shared {
            self.engine.backend(spec.task().backend)?;
        }
        let counts = self.forecast.counts(spec, None).await?;
        self.within_bounds(&counts)?;
        let need = self.forecast.need(&counts);
        match self.why_not(&need, spec).await? {
            // One that can may come: the job says so as long as it waits.
            Some(Unschedulable::NoServer | Unschedulable::NoGpu) => {}
            None if is_shared => {}
            _ => must_fit(&need, self.largest().await?)?,
        }
        Ok(need)
    }
}
