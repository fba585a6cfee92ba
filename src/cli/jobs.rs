//! `tessera jobs`.
//!
//! Purpose: jobs of a server, created, watched and ended from a shell. Invariant: the standard output has what was asked for
//! and nothing else: an id, a table, a line an event, or JSON. Must not know: how calls are made (`remote`).

mod fetch;
mod show;
mod spec;

use std::path::Path;
use std::time::Duration;

use anyhow::Result;
use clap::{Args, Subcommand};
use serde_json::json;

use super::exit::{self, NoResult, Usage};
use super::given::{Words, words};
use super::progress::{Plan, Progress};
use super::remote::{is_id, session};
use super::say;
use super::server::{ServerArgs, number};
use super::{files, interrupt};
use fetch::FetchArgs;
use geometry::remesh::RemeshOptions;
pub(crate) use server::config::count;
use spec::{Asked, RemeshWork, RvdWork};
use wire::proto::{CreateJobRequest, EstimateJobRequest, Job, JobState, ListJobsRequest, ReusePolicy, job_spec};

pub(crate) use spec::digest;

#[derive(Args, Debug)]
pub(crate) struct JobsArgs {
    #[command(subcommand)]
    command: JobsCommand,
    #[command(flatten)]
    server: ServerArgs,
}

#[derive(Debug, Subcommand)]
enum JobsCommand {
    /// Upload what a job needs, create it, and print its id.
    Submit {
        #[command(subcommand)]
        work: SubmitWork,
    },
    /// List jobs, the newest first.
    List(ListArgs),
    /// Show a job.
    Get(IdArgs),
    /// Print what happens to a job, a line each, until it has ended.
    Watch(WatchArgs),
    /// Wait until a job has ended, and print its warnings: exit code 0 if it succeeded, 70 if not.
    Wait(IdArgs),
    /// Cancel a job.
    Cancel(IdArgs),
    /// Forget a job that has ended, and its result.
    Delete(IdArgs),
    /// Fetch the result of a job that succeeded.
    Fetch(FetchArgs),
    /// Ask what a job would need, without creating it.
    Estimate {
        #[command(subcommand)]
        work: EstimateWork,
    },
}

#[derive(Debug, Subcommand)]
enum SubmitWork {
    /// Remesh a surface; options as of `tessera remesh`.
    Remesh {
        #[command(flatten)]
        work: Box<RemeshWork>,
        #[command(flatten)]
        how: HowArgs,
    },
    /// Compute a restricted Voronoi diagram; options as of `tessera rvd`.
    Rvd {
        #[command(flatten)]
        work: RvdWork,
        #[command(flatten)]
        how: HowArgs,
    },
}

#[derive(Debug, Subcommand)]
enum EstimateWork {
    /// Of a remesh.
    Remesh(Box<RemeshWork>),
    /// Of a restricted Voronoi diagram.
    Rvd(RvdWork),
}

#[derive(Args, Debug)]
#[command(next_help_heading = "The job")]
struct HowArgs {
    /// The same id with the same job gives the same job again, so that a submit can be repeated safely.
    #[arg(long, value_name = "ID", value_parser = request_id)]
    request_id: Option<String>,
    /// Whether an earlier job of the same tenant with the same result may be the answer.
    #[arg(long, default_value = "never", value_parser = words(REUSES))]
    reuse: ReusePolicy,
    /// Jobs with a higher priority go first: -100 to 100 [default: 0].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(i32).range(-100..=100))]
    priority: Option<i32>,
    /// Seconds that the job may be at work before it expires.
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = deadline)]
    deadline_s: Option<Duration>,
    /// Seconds that the job may wait before it expires.
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = deadline)]
    queue_deadline_s: Option<Duration>,
    /// A label, to find the job again; may be given several times.
    #[arg(long = "label", value_name = "K=V", value_parser = label)]
    labels: Vec<(String, String)>,
}

#[derive(Args, Debug)]
struct IdArgs {
    /// The job.
    #[arg(value_parser = id)]
    id: String,
}

#[derive(Args, Debug)]
struct WatchArgs {
    /// The job.
    #[arg(value_parser = id)]
    id: String,
    /// Only what came after this number.
    #[arg(long, value_name = "N", default_value_t = 0)]
    after: u64,
}

#[derive(Args, Debug)]
struct ListArgs {
    /// Only jobs in this state; may be given several times.
    #[arg(long = "state", value_parser = words(STATES), value_name = "STATE")]
    states: Vec<JobState>,
    /// Only jobs with this label; may be given several times.
    #[arg(long = "label", value_name = "K=V", value_parser = label)]
    labels: Vec<(String, String)>,
    /// The most jobs to list.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = count, allow_negative_numbers = true)]
    limit: u32,
}

const STATES: Words<JobState> = &[
    ("queued", "It waits for its turn", JobState::Queued),
    ("running", "It is being done", JobState::Running),
    ("succeeded", "It is done", JobState::Succeeded),
    ("failed", "It has no result", JobState::Failed),
    ("cancelled", "Its caller ended it", JobState::Cancelled),
    ("expired", "A deadline passed, or its result is no longer kept", JobState::Expired),
];

const REUSES: Words<ReusePolicy> = &[
    ("never", "Each submit makes a job", ReusePolicy::Never),
    ("same-bits", "If its result is kept and has the same bits", ReusePolicy::SameBits),
];

fn id(text: &str) -> Result<String, String> {
    let text = text.to_ascii_lowercase();
    if is_id(&text) { Ok(text) } else { Err("a job's id has 32 hexadecimal digits".to_owned()) }
}

fn request_id(text: &str) -> Result<String, String> {
    let named = (1..=128).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_graphic());
    named.then(|| text.to_owned()).ok_or("1 to 128 printable ASCII characters without spaces are needed".to_owned())
}

fn deadline(text: &str) -> Result<Duration, String> {
    number(text, 0.001..=1e9, "a number of seconds from 0.001 on is needed").map(Duration::from_secs_f64)
}

fn label(text: &str) -> Result<(String, String), String> {
    let (key, value) = text.split_once('=').ok_or("a label is KEY=VALUE")?;
    if !(1..=63).contains(&key.len()) || !key.bytes().all(|b| b.is_ascii_alphanumeric() || b"._-/".contains(&b)) {
        return Err("a label's key has 1 to 63 ASCII letters, digits and ._-/".to_owned());
    }
    if value.len() > 255 || value.chars().any(char::is_control) {
        return Err("a label's value has at most 255 bytes without control characters".to_owned());
    }
    Ok((key.to_owned(), value.to_owned()))
}

fn labels(all: &[(String, String)]) -> Result<std::collections::HashMap<String, String>> {
    let mut labels = std::collections::HashMap::new();
    for (key, value) in all {
        if labels.insert(key.clone(), value.clone()).is_some() {
            return Err(Usage(format!("--label {key} is given twice; a key has one value")).into());
        }
    }
    if labels.len() > 64 { Err(Usage("a job has at most 64 labels".to_owned()).into()) } else { Ok(labels) }
}

pub(crate) fn run(args: &JobsArgs) -> Result<()> {
    let server = &args.server;
    // Before a file is read.
    server.at.url()?;
    match &args.command {
        JobsCommand::Submit { work: SubmitWork::Remesh { work, how } } => submit(|| work.asked(), how, server),
        JobsCommand::Submit { work: SubmitWork::Rvd { work, how } } => submit(|| work.asked(), how, server),
        JobsCommand::Estimate { work: EstimateWork::Remesh(work) } => estimate(&work.asked()?, server),
        JobsCommand::Estimate { work: EstimateWork::Rvd(work) } => estimate(&work.asked()?, server),
        JobsCommand::List(list) => self::list(list, server),
        JobsCommand::Get(IdArgs { id }) => {
            let job = session(server, async |session| session.job(id).await)?;
            server.tell(|| show::json_of(&job), || show::lines(&job))
        }
        JobsCommand::Cancel(IdArgs { id }) => {
            let job = session(server, async |session| session.cancel(id).await)?;
            server.tell(|| show::json_of(&job), || vec![format!("{id} {}", show::state(job.state))])
        }
        JobsCommand::Delete(IdArgs { id }) => delete(id, server),
        JobsCommand::Watch(WatchArgs { id, after }) => watch(id, *after, server),
        JobsCommand::Wait(IdArgs { id }) => wait(id, server),
        JobsCommand::Fetch(fetch) => fetch::run(fetch, server),
    }
}

fn submit(asked: impl FnOnce() -> Result<Asked>, how: &HowArgs, server: &ServerArgs) -> Result<()> {
    let labels = labels(&how.labels)?;
    let Asked { mut spec, sources, input } = asked()?;
    let message = |span: Option<Duration>| span.and_then(|span| prost_types::Duration::try_from(span).ok());
    (spec.labels, spec.priority) = (labels, how.priority);
    (spec.queue_deadline, spec.run_deadline) = (message(how.queue_deadline_s), message(how.deadline_s));
    let request = CreateJobRequest {
        spec: Some(spec),
        request_id: how.request_id.clone().unwrap_or_default(),
        reuse: how.reuse.into(),
    };
    let progress = transfer(input.as_ref().map(|(path, _)| path.as_path()), server, "upload");
    let created = session(server, async |session| {
        session.upload(&sources, &progress).await?;
        session.create(&request).await
    });
    drop(progress);
    let created = created?;
    let job = created.job.unwrap_or_default();
    let json = || {
        let mut told = show::json_of(&job);
        told["existed"] = created.existed.into();
        told["reused"] = created.reused.into();
        told
    };
    server.tell(json, || vec![job.id.clone()])
}

fn estimate(asked: &Asked, server: &ServerArgs) -> Result<()> {
    let mut request = EstimateJobRequest { spec: Some(asked.spec.clone()), ..EstimateJobRequest::default() };
    if let Some((path, format)) = &asked.input {
        // So that nothing has to be uploaded.
        let mesh = files::Surface::new(path, Some(*format)).read_mesh()?;
        (request.vertices, request.facets) = (Some(mesh.positions().len() as u64), Some(mesh.facets().len() as u64));
    }
    let estimate = session(server, async |session| session.estimate(request).await)?;
    server.tell(|| show::json_of_estimate(&estimate), || show::lines_of_estimate(&estimate))
}

fn list(args: &ListArgs, server: &ServerArgs) -> Result<()> {
    let states = args.states.iter().map(|&state| state.into()).collect();
    let query = ListJobsRequest { states, labels: labels(&args.labels)?, ..ListJobsRequest::default() };
    let (jobs, more) = session(server, async |session| session.jobs(&query, args.limit).await)?;
    let json = || json!({ "jobs": jobs.iter().map(show::json_of).collect::<Vec<_>>(), "more": more });
    server.tell(json, || show::table(&jobs))?;
    if more && !server.quiet && !server.json {
        errln!("there are more jobs; --limit shows them");
    }
    Ok(())
}

fn delete(id: &str, server: &ServerArgs) -> Result<()> {
    let deleted = session(server, async |session| session.delete(id).await);
    deleted.map_err(|error| match error.downcast::<NoResult>() {
        Ok(NoResult(said)) => NoResult(format!("{said}; cancel it first: tessera jobs cancel {id}")).into(),
        Err(error) => error,
    })?;
    server.tell(|| json!({ "id": id, "deleted": true }), Vec::new)
}

fn watch(id: &str, after: u64, server: &ServerArgs) -> Result<()> {
    let mut print = |event: &_| {
        let line = if server.json { show::json_of_event(event).to_string() } else { show::line_of_event(event) };
        // A reader that is gone needs no more events.
        Ok(say::try_line(format_args!("{line}"))?)
    };
    session(server, async |session| session.watch(id, after, &mut print).await)
}

fn wait(id: &str, server: &ServerArgs) -> Result<()> {
    let mut progress = None;
    let waited = session(server, async |session| {
        let mut job = session.job(id).await?;
        let progress = progress.insert(Progress::begin(Path::new(&format!("job {}", &id[..8])), server.quiet));
        if !super::remote::has_ended(&job) {
            progress.plan(plan(&job));
            job = session.wait(id, progress).await?;
        }
        let figures = fetch::figures(session, &job, progress).await?;
        Ok((job, figures))
    });
    drop(progress);
    let (job, figures) = waited.map_err(|error| match exit::code(&error) {
        interrupt::CODE => error.context(format!("job {id} goes on; `tessera jobs cancel` ends it")),
        _ => error,
    })?;
    let mut told = show::json_of(&job);
    fetch::warn(id, &figures, &mut told);
    server.tell(|| told, Vec::new)?;
    show::why(&job).map_or(Ok(()), |why| Err(NoResult(format!("job {id} {why}")).into()))
}

/// About what a job takes. The size of its surface is not known here.
fn plan(job: &Job) -> Plan {
    let given =
        job.spec.as_ref().and_then(|spec| spec.arrays.as_ref()?.seeds.as_ref()).map(|seeds| seeds.count as usize);
    let points = |drawn: Option<u32>| given.or(drawn.map(|points| points as usize)).unwrap_or(10_000);
    let usual = RemeshOptions::usual();
    match job.spec.as_ref().and_then(|spec| spec.work.as_ref()) {
        Some(job_spec::Work::Rvd(work)) => {
            let points = points(work.points);
            Plan::rvd(points.saturating_mul(2), points, true)
        }
        Some(job_spec::Work::Remesh(work)) => {
            let points = points(work.points);
            let steps = |given: Option<u32>, usual: usize| given.map_or(usual, |steps| steps as usize);
            let steps = steps(work.lloyd, usual.lloyd).saturating_add(steps(work.newton, usual.newton));
            Plan::remesh(points.saturating_mul(2), points, steps, true)
        }
        _ => Plan::remesh(10_000, 10_000, usual.lloyd + usual.newton, true),
    }
}

/// The progress of bytes on their way.
pub(super) fn transfer(of: Option<&Path>, server: &ServerArgs, stage: &'static str) -> Progress {
    let progress = Progress::begin(of.unwrap_or(Path::new("job")), server.quiet);
    progress.plan(Plan::transfer(stage));
    progress
}
