//! Jobs of `JobService`, with their blobs; and what is left of them afterwards.
//!
//! Invariant: a job has the run's label, so that those whose names got lost are found again. Nothing is removed that the run
//! did not bring about. Must not know: streams.

use std::collections::HashMap;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bytes::Bytes;
use tokio::sync::watch;
use tokio::time::Instant;
use tonic::{Code, Status};

use super::{Answers, Asked, At, End, Ends, Pace, Why, counted, unary};
use crate::load::UploadArg;
use crate::load::amounts::Kind;
use crate::load::compare::Tally;
use crate::load::meshes::Surface;
use crate::remote::{Door, blobs, has_ended, jobs};
use wire::pieces::{Incoming, PIECE_BYTES, piece};
use wire::proto::{
    CancelJobRequest, CreateJobRequest, DeleteJobRequest, DeleteRequest, FindMissingRequest, GetJobRequest, Job,
    JobMesh, JobSpec, JobState, ListJobsRequest, MeshFile, MeshFormat, ReadRequest, WatchJobRequest, WriteRequest,
    job_event, job_mesh, job_spec,
};

/// The label of all jobs of a run; its value is the run's name.
pub(in crate::load) const LABEL: &str = "tessera-load";

/// What a call leaves at the server.
#[derive(Clone, Debug)]
pub(in crate::load) struct Rubbish {
    job: Option<String>,
    /// Files and results.
    blobs: Vec<String>,
}

/// How long a job that was cancelled may take to end.
const CANCEL: Duration = Duration::from_secs(10);

impl At<'_> {
    pub(super) async fn job(&self, kind: Kind, asked: &mut Asked, pace: &mut Pace) -> Result<(), End> {
        let (caller, tally) = (self.caller, &self.caller.tally);
        let mut rubbish = Rubbish { job: None, blobs: Vec::new() };
        let digest = match caller.args.upload == UploadArg::Each {
            true => {
                let (begin, file) = (Instant::now(), caller.uploaded.fetch_add(1, Ordering::Relaxed));
                let (bytes, digest) = self.surface.file_with(&format!("{LABEL} {} {file}", caller.run));
                asked.sent_bytes = bytes.len() as u64;
                rubbish.blobs.push(digest.clone());
                asked.rubbish = Some(rubbish.clone());
                write(tally, self.door, self.ends, &digest, bytes).await?;
                asked.stages.upload = Some(begin.elapsed());
                digest
            }
            false => self.surface.digest.clone(),
        };
        let request = CreateJobRequest { spec: Some(self.spec(kind, digest)), ..CreateJobRequest::default() };
        let call = tally.begin("tessera.v1.JobService/CreateJob");
        let created = unary(call, self.ends, jobs(self.door.clone()).create_job(request)).await?;
        let Some(Job { id, .. }) = created.job else { return Err(End::Wrong("there is no job in it".to_owned())) };
        rubbish.job = Some(id.clone());
        asked.rubbish = Some(rubbish.clone());
        match watch_job(tally, self.door, self.ends, &id).await {
            Err(End::Here(why)) => self.give_up(&id, why).await?,
            watched => watched?,
        }
        let call = tally.begin("tessera.v1.JobService/GetJob");
        let job = unary(call, self.ends, jobs(self.door.clone()).get_job(GetJobRequest { id }))
            .await?
            .job
            .unwrap_or_default();
        rubbish.blobs.extend(job.results.iter().map(|result| result.digest.clone()));
        asked.rubbish = Some(rubbish);
        (asked.stages.queue, asked.stages.compute) = stages(&job);
        match job.state() {
            JobState::Succeeded => {}
            JobState::Cancelled => return Err(End::Here(Why::Cancel)),
            JobState::Expired => return Err(End::Job("JOB_EXPIRED", job.expired_by)),
            JobState::Failed => {
                return Err(End::Job("JOB_FAILED", job.failure.map(|failure| failure.message).unwrap_or_default()));
            }
            state => return Err(End::Wrong(format!("its events ended, but it is {}", state.as_str_name()))),
        }
        let part = if kind == Kind::RvdJob { "cells" } else { "mesh" };
        let Some(result) = job.results.iter().find(|result| result.name == part) else {
            return Err(End::Wrong(format!("the job succeeded, but has no {part}")));
        };
        let begin = Instant::now();
        self.read(&result.digest, asked, pace).await?;
        asked.stages.download = Some(begin.elapsed());
        Ok(())
    }

    fn spec(&self, kind: Kind, digest: String) -> JobSpec {
        let file = MeshFile { digest, format: MeshFormat::Ply.into(), attributes: None };
        let work = match kind {
            Kind::RvdJob => job_spec::Work::Rvd(self.diagram_options()),
            _ => job_spec::Work::Remesh(self.remesh_options()),
        };
        JobSpec {
            mesh: Some(JobMesh { source: Some(job_mesh::Source::File(file)) }),
            work: Some(work),
            backend: self.backend(),
            labels: HashMap::from([(LABEL.to_owned(), self.caller.run.clone())]),
            ..JobSpec::default()
        }
    }

    /// Cancels the job and waits for its end. One that had ended before is as good as any other.
    async fn give_up(&self, id: &str, why: Why) -> Result<(), End> {
        let (tally, ends) = (&self.caller.tally, within(CANCEL));
        let call = tally.begin("tessera.v1.JobService/CancelJob");
        let told = unary(call, &ends, jobs(self.door.clone()).cancel_job(CancelJobRequest { id: id.to_owned() })).await;
        match (told, why) {
            // The result of a job that ended before is taken as if nothing had been said.
            (Err(End::Status(status)), Why::Cancel) if status.code() == Code::FailedPrecondition => return Ok(()),
            // The caller gave up, whatever becomes of the job.
            (_, Why::TooLong | Why::Stop) | (Err(_), Why::Cancel) => {}
            (Ok(_), Why::Cancel) => watch_job(tally, self.door, &ends, id).await?,
        }
        Err(End::Here(why))
    }

    async fn read(&self, digest: &str, asked: &mut Asked, pace: &mut Pace) -> Result<(), End> {
        let wrong = |what: &dyn std::fmt::Display| End::Wrong(what.to_string());
        let request = ReadRequest { digest: digest.to_owned(), ..ReadRequest::default() };
        let (call, mut client) = (self.caller.tally.begin("tessera.v1.BlobService/Read"), blobs(self.door.clone()));
        let ends = Ends { cancel: None, limit: self.ends.limit, stop: self.ends.stop.clone() };
        let mut pieces = Answers::of(call, &ends, client.read(request)).await?;
        let mut blob = Incoming::new(digest);
        while let Some(piece) = pieces.next(&ends).await? {
            blob.take(&piece).map_err(|error| wrong(&error))?;
            asked.came_bytes += piece.data.len() as u64;
            pace.read(piece.data.len()).await;
        }
        blob.finish().map_err(|error| wrong(&error)).map(|_| ())
    }
}

/// Ends of what is done after a call: by time alone.
fn within(limit: Duration) -> Ends {
    let (_, stop) = watch::channel(false);
    Ends { cancel: None, limit: Instant::now() + limit, stop }
}

async fn watch_job(tally: &Tally, door: &Door, ends: &Ends, id: &str) -> Result<(), End> {
    let (call, mut client) = (tally.begin("tessera.v1.JobService/WatchJob"), jobs(door.clone()));
    let request = WatchJobRequest { id: id.to_owned(), after: 0 };
    let mut events = Answers::of(call, ends, client.watch_job(request)).await?;
    let mut last = JobState::Unspecified;
    while let Some(message) = events.next(ends).await? {
        if let Some(job_event::What::State(change)) = message.event.and_then(|event| event.what) {
            last = change.state();
        }
    }
    let open = matches!(last, JobState::Unspecified | JobState::Queued | JobState::Running);
    if open { Err(End::Wrong("its events ended before the job did".to_owned())) } else { Ok(()) }
}

/// How long a job waited and worked, by the server's clock.
fn stages(job: &Job) -> (Option<Duration>, Option<Duration>) {
    let time = |stamp: &prost_types::Timestamp| {
        let since = Duration::from_secs(u64::try_from(stamp.seconds).ok()?);
        since.checked_add(Duration::from_nanos(u64::try_from(stamp.nanos).ok()?))
    };
    let [created, started, changed] = [&job.created, &job.started, &job.changed].map(|at| at.as_ref().and_then(time));
    let between = |from: Option<Duration>, to: Option<Duration>| to?.checked_sub(from?);
    (between(created, started), between(started, changed))
}

async fn write(tally: &Tally, door: &Door, ends: &Ends, digest: &str, bytes: Bytes) -> Result<(), End> {
    let (size_bytes, digest) = (bytes.len() as u64, digest.to_owned());
    let count = bytes.len().div_ceil(PIECE_BYTES).max(1);
    let messages = (0..count).map(move |k| {
        let (from, to) = (k * PIECE_BYTES, ((k + 1) * PIECE_BYTES).min(bytes.len()));
        let mut message = WriteRequest { finish: k + 1 == count, ..piece(from as u64, bytes[from..to].to_vec()) };
        if k == 0 {
            (message.digest, message.size_bytes) = (digest.clone(), size_bytes);
        }
        message
    });
    let call = tally.begin("tessera.v1.BlobService/Write");
    let stored = unary(call, ends, blobs(door.clone()).write(tokio_stream::iter(messages))).await?;
    let wrong = || End::Wrong(format!("all {size_bytes} bytes were sent, but the blob is not complete"));
    stored.complete.then_some(()).ok_or_else(wrong)
}

/// Uploads a file that many jobs use, unless it is there. Whether it was not.
pub(in crate::load) async fn put(tally: &Tally, door: &Door, file: &Surface, limit: Duration) -> Result<bool, Status> {
    let ends = within(limit);
    let request = FindMissingRequest { digests: vec![file.digest.clone()] };
    let call = tally.begin("tessera.v1.BlobService/FindMissing");
    let missing = unary(call, &ends, blobs(door.clone()).find_missing(request)).await.map_err(status)?;
    if missing.digests.is_empty() {
        return Ok(false);
    }
    write(tally, door, &ends, &file.digest, file.file.clone()).await.map_err(status)?;
    Ok(true)
}

fn status(end: End) -> Status {
    match end {
        End::Status(status) => status,
        End::Wrong(said) | End::Job(_, said) => Status::internal(said),
        End::Here(_) => Status::deadline_exceeded("it did not answer in time"),
    }
}

/// Removes a blob. Whether it is gone, or belongs to another job.
pub(in crate::load) async fn delete_blob(tally: &Tally, door: &Door, digest: &str) -> bool {
    let call = tally.begin("tessera.v1.BlobService/Delete");
    let answer = counted(call, blobs(door.clone()).delete(DeleteRequest { digest: digest.to_owned() })).await;
    !answer.is_err_and(|status| !matches!(status.code(), Code::NotFound | Code::FailedPrecondition))
}

/// Ends and forgets a job. Whether it is gone.
async fn delete_job(tally: &Tally, door: &Door, id: &str, ended: bool) -> bool {
    if !ended {
        let call = tally.begin("tessera.v1.JobService/CancelJob");
        let _ = counted(call, jobs(door.clone()).cancel_job(CancelJobRequest { id: id.to_owned() })).await;
        // A job at work may take a moment to hear of it.
        let _ = watch_job(tally, door, &within(CANCEL), id).await;
    }
    let call = tally.begin("tessera.v1.JobService/DeleteJob");
    let answer = counted(call, jobs(door.clone()).delete_job(DeleteJobRequest { id: id.to_owned() })).await;
    !answer.is_err_and(|status| status.code() != Code::NotFound)
}

impl Rubbish {
    /// Removes it; `ended` says whether its job had come to its end. Returns whether the job is gone, and how many blobs are
    /// not.
    pub(in crate::load) async fn remove(&self, tally: &Tally, door: &Door, ended: bool) -> (bool, u64) {
        let job = match &self.job {
            Some(id) => delete_job(tally, door, id, ended).await,
            None => true,
        };
        let mut left = 0;
        for digest in &self.blobs {
            left += u64::from(!delete_blob(tally, door, digest).await);
        }
        (job, left)
    }
}

/// Ends and forgets all jobs that a run left; how many things could not be removed.
pub(in crate::load) async fn sweep(tally: &Tally, door: &Door, run: &str) -> u64 {
    let labels = HashMap::from([(LABEL.to_owned(), run.to_owned())]);
    let (mut left, mut page_token) = (0, String::new());
    loop {
        let request = ListJobsRequest { labels: labels.clone(), page_token, ..ListJobsRequest::default() };
        let call = tally.begin("tessera.v1.JobService/ListJobs");
        let Ok(page) = counted(call, jobs(door.clone()).list_jobs(request)).await else { return left + 1 };
        for job in page.jobs {
            let rubbish = Rubbish {
                blobs: job.results.iter().map(|result| result.digest.clone()).collect(),
                job: Some(job.id.clone()),
            };
            let (is_gone, blobs) = rubbish.remove(tally, door, has_ended(&job)).await;
            left += u64::from(!is_gone) + blobs;
        }
        page_token = page.next_page_token;
        if page_token.is_empty() {
            return left;
        }
    }
}
