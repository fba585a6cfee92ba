//! `tessera cluster` and `tessera store`.
//!
//! Purpose: what an operator asks of the database that servers share. Invariant: it needs no server. Must not know: SQL.

use std::future::Future;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use serde_json::json;

use super::exit::{BadInput, Unavailable, Usage};
use super::say::{self, plain};
use jobs::postgres::{Checked, Operator, PostgresOptions};
use jobs::record::{Job, JobId, Outcome};
use jobs::store::StoreError;
use jobs::store::shared::{Member, Overview};

#[derive(Args, Clone, Debug)]
pub(crate) struct DatabaseArgs {
    /// The database, as `tessera serve` has it: postgres://USER@HOST/DATABASE.
    #[arg(long, value_name = "URL", global = true, env = "TESSERA_STORE", hide_env_values = true)]
    store: Option<String>,
    /// File that holds the password of the database.
    #[arg(long, value_name = "FILE", global = true, env = "TESSERA_STORE_PASSWORD_FILE")]
    store_password_file: Option<PathBuf>,
}

#[derive(Args, Debug)]
pub(crate) struct ClusterArgs {
    #[command(subcommand)]
    command: ClusterCommand,
    #[command(flatten)]
    at: DatabaseArgs,
    /// Print the answer as JSON.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum ClusterCommand {
    /// List servers, work by tenant, and leases.
    Status,
    /// Let a server take no more work: what is at work ends, calls are answered, and readiness is withdrawn.
    Drain {
        /// Its name, as `status` shows it.
        node: String,
        /// Let it take work again.
        #[arg(long)]
        undo: bool,
    },
    /// Jobs that failed since servers went down with them.
    Dead {
        #[command(subcommand)]
        command: DeadCommand,
    },
}

#[derive(Debug, Subcommand)]
enum DeadCommand {
    /// List them, the newest first.
    List,
    /// Make new jobs of what they were asked to do.
    Requeue {
        /// Which ones.
        #[arg(required_unless_present = "all")]
        ids: Vec<JobId>,
        /// All of them.
        #[arg(long, conflicts_with = "ids")]
        all: bool,
    },
}

#[derive(Args, Debug)]
pub(crate) struct StoreArgs {
    #[command(subcommand)]
    command: StoreCommand,
    #[command(flatten)]
    at: DatabaseArgs,
    /// Print the answer as JSON.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum StoreCommand {
    /// Bring the schema up to date. Servers do so at their start, too.
    Migrate,
    /// Say whether the schema is up to date and what is kept agrees. Exit code 65 if not.
    Check,
}

impl DatabaseArgs {
    pub(crate) fn is_given(&self) -> bool {
        self.store.is_some()
    }

    pub(crate) fn options(&self) -> Result<PostgresOptions> {
        const NONE: &str = "which database? Give --store postgres://USER@HOST/DATABASE or set TESSERA_STORE";
        let url = self.store.as_ref().ok_or_else(|| Usage(NONE.to_owned()))?;
        let password_file = self.store_password_file.clone();
        // Whether jobs may be lost is for servers to say.
        Ok(PostgresOptions { password_file, connections: 1, may_lose: true, ..PostgresOptions::new(url, "operator") })
    }
}

fn block_on<T>(work: impl Future<Output = Result<T, StoreError>>) -> Result<T> {
    run(work)?.map_err(told)
}

/// Runs what asks the database.
pub(crate) fn run<T>(work: impl Future<Output = T>) -> Result<T> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    Ok(runtime.context("cannot start the runtime")?.block_on(work))
}

/// With the exit code of its kind.
fn told(error: StoreError) -> anyhow::Error {
    let text = error.to_string();
    match error {
        StoreError::Unavailable { .. } | StoreError::Unusable { .. } | StoreError::UnknownVersion { .. } => {
            Unavailable(text).into()
        }
        _ => BadInput(text).into(),
    }
}

pub(crate) fn cluster(args: &ClusterArgs) -> Result<()> {
    let (options, json) = (args.at.options()?, args.json);
    match &args.command {
        ClusterCommand::Status => {
            let overview = block_on(async { Operator::connect(&options).await?.overview().await })?;
            tell(json, || status_json(&overview), || status_lines(&overview))
        }
        ClusterCommand::Drain { node, undo } => {
            let servers = block_on(async { Operator::connect(&options).await?.drain(node, !undo).await })?;
            if servers == 0 {
                let text = format!("no server that is alive is called {node:?}; `tessera cluster status` lists them");
                return Err(BadInput(text).into());
            }
            let does = if *undo { "takes work again" } else { "takes no more work" };
            tell(json, || json!({ "servers": servers, "drains": !undo }), || vec![format!("{} {does}", plain(node))])
        }
        ClusterCommand::Dead { command: DeadCommand::List } => {
            let dead = block_on(async { Operator::connect(&options).await?.dead().await })?;
            tell(json, || dead.iter().map(dead_json).collect(), || dead.iter().map(dead_line).collect())
        }
        ClusterCommand::Dead { command: DeadCommand::Requeue { ids, all } } => {
            let made = block_on(async {
                let operator = Operator::connect(&options).await?;
                let dead = if *all { operator.dead().await?.iter().map(|job| job.id).collect() } else { ids.clone() };
                let mut made = Vec::new();
                for id in dead {
                    made.push((id, operator.requeue(id).await?.id));
                }
                Ok(made)
            })?;
            let of = |(old, new): &(JobId, JobId)| json!({ "job": old.to_string(), "new": new.to_string() });
            let line = |(old, new): &(JobId, JobId)| format!("{old} is tried again as {new}");
            tell(json, || made.iter().map(of).collect(), || made.iter().map(line).collect())
        }
    }
}

pub(crate) fn store(args: &StoreArgs) -> Result<()> {
    let (options, json) = (args.at.options()?, args.json);
    match args.command {
        StoreCommand::Migrate => {
            let (before, now) = block_on(Operator::migrate(&options))?;
            let line = format!("schema    {now} steps, {} of them new", now - before);
            tell(json, || json!({ "steps_before": before, "steps": now }), || vec![line])
        }
        StoreCommand::Check => {
            let checked = block_on(async { Operator::connect(&options).await?.check().await })?;
            let Checked { schema: (done, known), jobs, faults } = &checked;
            let all = || json!({ "steps": done, "known_steps": known, "jobs": jobs, "faults": faults });
            let lines = || {
                let schema = format!("schema    {done} steps; this program knows {known}");
                let jobs = jobs.iter().filter(|(_, jobs)| **jobs > 0).map(|(state, jobs)| format!("{state:9} {jobs}"));
                let faults = faults.iter().map(|fault| format!("fault     {fault}"));
                std::iter::once(schema).chain(jobs).chain(faults).collect()
            };
            tell(json, all, lines)?;
            match faults.is_empty() {
                true => Ok(()),
                false => Err(BadInput("what is kept does not agree".to_owned()).into()),
            }
        }
    }
}

fn tell(json: bool, value: impl FnOnce() -> serde_json::Value, lines: impl FnOnce() -> Vec<String>) -> Result<()> {
    match json {
        true => say::json(&value())?,
        false => lines().iter().try_for_each(|line| outln!("{line}"))?,
    }
    Ok(())
}

/// Bytes of a device whose memory has no limit, as the database has them.
const NOT_LIMITED: u64 = i64::MAX as u64;

fn status_json(overview: &Overview) -> serde_json::Value {
    let (nodes, capacity) = overview.capacity();
    let mut all = json!(overview);
    for member in all["members"].as_array_mut().into_iter().flatten() {
        let device = &mut member["node"]["memory"]["device"];
        if device.as_u64().is_some_and(|bytes| bytes >= NOT_LIMITED) {
            *device = serde_json::Value::Null;
        }
    }
    all["total"] = json!({ "queued": overview.queued(), "running": overview.running(), "nodes": nodes,
        "capacity": capacity, "oldest_ms": overview.oldest_ms() });
    say::plain_json(all)
}

fn status_lines(overview: &Overview) -> Vec<String> {
    let mut lines =
        vec![format!("{:24}  {:8}  {:8}  {:>7}  {:>12}  ADDRESS", "NODE", "ROLE", "STATE", "AT WORK", "MEMORY")];
    lines.extend(overview.members.iter().map(|member| {
        // A lease says more than what the server said of itself a moment ago.
        let leases = overview.leases.iter().filter(|lease| lease.holder == member.holder).count();
        member_line(member, leases)
    }));
    let (_, capacity) = overview.capacity();
    lines.push(String::new());
    lines.push(format!(
        "{} queued, {} running, {capacity} at once; the oldest queued job waits for {} s",
        overview.queued(),
        overview.running(),
        overview.oldest_ms() / 1000
    ));
    lines.extend(overview.lines.iter().map(|line| {
        let tenant = if line.tenant.is_empty() { "-".to_owned() } else { plain(&line.tenant) };
        format!("  {tenant:22}  {} queued, {} running", line.queued, line.running)
    }));
    let over: Vec<_> = overview.leases.iter().filter(|lease| lease.left_ms < 0).collect();
    lines.extend(over.iter().map(|lease| {
        let ago = lease.left_ms.unsigned_abs() / 1000;
        format!("the lease of job {} at {} ended {ago} s ago", lease.job, plain(&lease.holder))
    }));
    lines
}

fn member_line(member: &Member, at_work: usize) -> String {
    let node = &member.node;
    let state = match (member.is_alive, member.drains) {
        (false, _) => "away",
        (true, true) => "draining",
        (true, false) => "alive",
    };
    let memory = format!("{} MiB", node.memory.host >> 20);
    let work = format!("{at_work}/{}", node.places);
    let gpu = if node.has_gpu { " GPU" } else { "" };
    let line = format!(
        "{:24}  {:8}  {state:8}  {work:>7}  {memory:>12}  {}{gpu}",
        plain(&node.name),
        node.role.to_string(),
        plain(&node.address)
    );
    line.trim_end().to_owned()
}

/// Why it failed.
fn cause(job: &Job) -> &str {
    match &job.status.outcome {
        Some(Outcome::Failed(failure)) => &failure.message,
        _ => "",
    }
}

fn dead_json(job: &Job) -> serde_json::Value {
    let all = json!({ "job": job.id.to_string(), "tenant": job.spec.tenant, "crashes": job.status.crashes, "message": cause(job) });
    say::plain_json(all)
}

fn dead_line(job: &Job) -> String {
    format!("{}  {}  {}", job.id, plain(&job.spec.tenant), plain(cause(job)))
}
