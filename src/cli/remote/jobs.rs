//! Jobs: the calls of `JobService`.
//!
//! Invariant: a job that an answer holds is the one that was asked for. Events come in order, and after a lost connection go
//! on after the last that came. A call that would make a second job is not repeated. Must not know: what is printed.

use std::future::Future;

use anyhow::Result;
use tonic::Response;

use super::faults::{self, Fault, wrong};
use super::link::{Answered, Door, Link};
use super::session::{Session, one};
use crate::progress::Progress;
use wire::proto::job_service_client::JobServiceClient;
use wire::proto::{
    CancelJobRequest, CreateJobRequest, CreateJobResponse, DeleteJobRequest, EstimateJobRequest, EstimateJobResponse,
    GetJobRequest, Job, JobEvent, JobState, ListJobsRequest, ListJobsResponse, WatchJobRequest, job_event,
};

/// Takes an event. False if no more are wanted.
type Events<'a> = &'a mut dyn FnMut(&JobEvent) -> Result<bool>;

const PAGE: u32 = 100;
/// Pages in a row in which nothing is: a server may look for long, but not for ever.
const EMPTY_PAGES: u32 = 1000;

pub(crate) fn jobs(door: Door) -> JobServiceClient<Door> {
    JobServiceClient::new(door).max_decoding_message_size(16 << 20)
}

/// Whether a job in this state stays in it, but for being forgotten.
fn is_end(state: JobState) -> bool {
    use JobState as S;
    matches!(state, S::Succeeded | S::Failed | S::Cancelled | S::Expired)
}

pub(crate) fn has_ended(job: &Job) -> bool {
    JobState::try_from(job.state).is_ok_and(is_end)
}

/// Whether this is how jobs are named: 32 lower-case hexadecimal digits.
pub(crate) fn is_id(text: &str) -> bool {
    text.len() == 32 && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

fn checked(job: Option<Job>, id: Option<&str>) -> Result<Job> {
    let job = job.ok_or_else(|| wrong("there is no job in it"))?;
    if !is_id(&job.id) || id.is_some_and(|id| id != job.id) {
        return Err(wrong("it is about another job"));
    }
    known(job.state)?;
    Ok(job)
}

fn known(state: i32) -> Result<JobState> {
    let known = JobState::try_from(state).ok().filter(|known| *known != JobState::Unspecified);
    known.ok_or_else(|| wrong(format!("there is no state {state}")))
}

impl Session<'_> {
    /// Creates a job. Without a number of the caller's, a call whose answer is lost is not repeated.
    pub(crate) async fn create(&mut self, request: &CreateJobRequest) -> Result<CreateJobResponse> {
        let ask = async |link: &Link<'_>| one(link, jobs(link.channel()).create_job(request.clone())).await;
        let mut answer = match request.request_id.is_empty() {
            false => self.repeat(ask).await?,
            true => self.once(ask).await.map_err(|fault| match fault {
                Fault::Lost(error) => {
                    error.context("whether the job was created is not known; see `tessera jobs list`")
                }
                Fault::Final(error) => error,
            })?,
        };
        answer.job = Some(checked(answer.job.take(), None)?);
        Ok(answer)
    }

    pub(crate) async fn job(&mut self, id: &str) -> Result<Job> {
        let request = GetJobRequest { id: id.to_owned() };
        Ok(self.once(async |link| get(link, request, id).await).await?)
    }

    /// The newest jobs that `query` is about, at most `limit`; and whether there are more.
    pub(crate) async fn jobs(&mut self, query: &ListJobsRequest, limit: u32) -> Result<(Vec<Job>, bool)> {
        let (mut found, mut token, mut empty) = (Vec::new(), String::new(), 0);
        loop {
            let page_size = (limit - found.len() as u32).min(PAGE);
            let request = ListJobsRequest { page_size, page_token: token.clone(), ..query.clone() };
            let answer = self.once(async |link| one(link, jobs(link.channel()).list_jobs(request)).await).await?;
            let ListJobsResponse { jobs: page, next_page_token } = answer;
            if page.len() > page_size as usize {
                return Err(wrong(format!("{page_size} jobs were asked for, and {} came", page.len())));
            }
            empty = if page.is_empty() { empty + 1 } else { 0 };
            if empty > EMPTY_PAGES || (!token.is_empty() && token == next_page_token) {
                return Err(wrong("its pages do not end"));
            }
            for job in page {
                found.push(checked(Some(job), None)?);
            }
            let more = !next_page_token.is_empty();
            if !more || found.len() as u32 >= limit {
                return Ok((found, more));
            }
            token = next_page_token;
        }
    }

    pub(crate) async fn cancel(&mut self, id: &str) -> Result<Job> {
        let request = CancelJobRequest { id: id.to_owned() };
        checked(
            self.once(async |link| in_state(link, jobs(link.channel()).cancel_job(request)).await).await?.job,
            Some(id),
        )
    }

    pub(crate) async fn delete(&mut self, id: &str) -> Result<()> {
        let request = DeleteJobRequest { id: id.to_owned() };
        self.once(async |link| in_state(link, jobs(link.channel()).delete_job(request)).await).await?;
        Ok(())
    }

    pub(crate) async fn estimate(&mut self, request: EstimateJobRequest) -> Result<EstimateJobResponse> {
        Ok(self.once(async |link| one(link, jobs(link.channel()).estimate_job(request)).await).await?)
    }

    /// Gives each event of a job after number `after` to `sink`, until the job has ended or `sink` wants no more.
    pub(crate) async fn watch(&mut self, id: &str, mut after: u64, sink: Events<'_>) -> Result<()> {
        loop {
            let before = after;
            let tried = self.once(async |link| watch_on(link, id, &mut after, sink).await).await;
            if after > before {
                self.again.came();
            }
            match tried {
                Ok(true) => return Ok(()),
                // As after the last event of a job that has ended.
                Ok(false) => {
                    let request = GetJobRequest { id: id.to_owned() };
                    match self.once(async |link| get(link, request, id).await).await {
                        Ok(job) if has_ended(&job) => return Ok(()),
                        Ok(_) => self.lost(Fault::Lost(wrong("its events ended before the job did"))).await?,
                        Err(fault) => self.lost(fault).await?,
                    }
                }
                Err(fault) => self.lost(fault).await?,
            }
        }
    }

    pub(crate) async fn wait(&mut self, id: &str, progress: &Progress) -> Result<Job> {
        let mut show = |event: &JobEvent| {
            tell(event, progress);
            Ok(true)
        };
        self.watch(id, 0, &mut show).await?;
        let ask = async |link: &Link<'_>| get(link, GetJobRequest { id: id.to_owned() }, id).await;
        let job = self.repeat(ask).await?;
        if has_ended(&job) { Ok(job) } else { Err(wrong("its events say that the job has ended, but it has not")) }
    }
}

/// Waits for the answer of a call that only a job in the right state allows.
async fn in_state<T>(link: &Link<'_>, call: impl Future<Output = Answered<T>>) -> Result<T, Fault> {
    let answer = link.first(call).await?;
    answer.map(Response::into_inner).map_err(|status| faults::of_state(link.url, &status))
}

async fn get(link: &Link<'_>, request: GetJobRequest, id: &str) -> Result<Job, Fault> {
    Ok(checked(one(link, jobs(link.channel()).get_job(request)).await?.job, Some(id))?)
}

/// Goes on with the events after number `after`. False if they ended, and the job did not.
async fn watch_on(link: &Link<'_>, id: &str, after: &mut u64, sink: Events<'_>) -> Result<bool, Fault> {
    let mut events =
        one(link, jobs(link.channel()).watch_job(WatchJobRequest { id: id.to_owned(), after: *after })).await?;
    loop {
        // That it was created is an event, so that there is one at once. Later ones take as long as the work does.
        let message = if *after == 0 { link.first(events.message()).await? } else { events.message().await };
        let event = match message {
            Ok(Some(message)) => message.event.ok_or_else(|| wrong("there is no event in it"))?,
            Ok(None) => return Ok(false),
            Err(status) => return Err(faults::of_call(link.url, &status)),
        };
        if event.number <= *after {
            return Err(wrong(format!("event {} comes after event {after}", event.number)).into());
        }
        let mut ended = false;
        if let Some(job_event::What::State(change)) = &event.what {
            ended = is_end(known(change.state)?);
        }
        *after = event.number;
        if !sink(&event)? || ended {
            return Ok(true);
        }
    }
}

fn tell(event: &JobEvent, progress: &Progress) {
    match &event.what {
        Some(job_event::What::State(change)) if change.state == i32::from(JobState::Queued) => {
            progress.stage("queued", 0, 0);
        }
        Some(job_event::What::Stage(stage)) => progress.stage(&super::stage(&stage.name), stage.done, stage.total),
        // The ratio that is shown elsewhere is in the report.
        Some(job_event::What::Iteration(step)) => progress.iteration(step.index, step.total, f64::NAN),
        _ => {}
    }
}
