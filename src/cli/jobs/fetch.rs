//! `tessera jobs fetch`.
//!
//! Invariant: a file gets its name once its bytes are all there and have their digest.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};

use super::{id, show};
use crate::exit::{Absent, NoResult, Unavailable, Usage};
use crate::files;
use crate::progress::Progress;
use crate::remesh::told_of;
use crate::remote::{Session, has_ended, session};
use crate::say::{plain, plain_json};
use crate::server::ServerArgs;
use geometry::mesh::io::Format;
use wire::proto::{Job, job_spec};

/// Its name among the blobs of a result.
const REPORT: &str = "report";

/// The longest report: some hundred bytes an iteration.
const REPORT_BYTES: usize = 256 << 20;

#[derive(Args, Debug)]
pub(super) struct FetchArgs {
    /// The job.
    #[arg(value_parser = id)]
    id: String,
    /// Where the result goes. A file that is there is replaced once the new one is whole.
    #[arg(long, short, value_name = "FILE", required_unless_present = "report")]
    output: Option<PathBuf>,
    /// Which blob of the result [default: mesh; cells for a diagram, seeds for a session].
    #[arg(long, value_name = "NAME", requires = "output")]
    name: Option<String>,
    /// Write the report there, as JSON.
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
}

pub(super) fn run(args: &FetchArgs, server: &ServerArgs) -> Result<()> {
    let FetchArgs { id, output, name, report } = args;
    output.iter().chain(report).try_for_each(|path| files::check_output(path, &[]))?;
    let outputs = [output.as_deref(), report.as_deref()];
    files::check_apart(std::iter::empty(), outputs.into_iter().flatten())?;
    let progress = super::transfer(output.as_deref().or(report.as_deref()), server, "download");
    let fetched = session(server, async |session| {
        let job = session.job(id).await?;
        check(&job)?;
        let mut told = json!({ "id": id });
        // Warnings are of the whole result, whichever part is fetched.
        let figures = match report {
            Some(_) => read_report(session, digest(&job, REPORT)?, &progress).await?,
            None => figures(session, &job, &progress).await?,
        };
        if let Some(path) = output {
            let name = name.as_deref().unwrap_or(usual(&job));
            let digest = digest(&job, name)?;
            check_extension(&job, name, path)?;
            let mut file = files::Output::begin(path)?;
            let size = session.download(digest, &mut |bytes| file.add(bytes), &progress).await?;
            file.finish()?;
            (told["name"], told["digest"]) = (name.into(), digest.into());
            (told["size_bytes"], told["file"]) = (size.into(), path.to_string_lossy().into());
        }
        if let Some(path) = report {
            files::write_json(path, &figures)?;
            told["report"] = path.to_string_lossy().into();
        }
        Ok((told, figures))
    });
    drop(progress);
    let (mut told, figures) = fetched?;
    warn(id, &figures, &mut told);
    server.tell(|| told, Vec::new)
}

/// Prints the warnings of a report and enters them in what is told of the job.
pub(super) fn warn(id: &str, figures: &Value, told: &mut Value) {
    told_of(figures).for_each(|(_, text)| errln!("tessera: warning: job {id}: {text}"));
    if let Some(warnings) = figures.get("warnings") {
        told["warnings"] = warnings.clone();
    }
}

/// The report of a result. Null if it is not kept: the rest of the result is of use without it.
pub(super) async fn figures(session: &mut Session<'_>, job: &Job, progress: &Progress) -> Result<Value> {
    if !job.results.iter().any(|blob| blob.name == REPORT) {
        return Ok(Value::Null);
    }
    match read_report(session, digest(job, REPORT)?, progress).await {
        Err(error) if error.is::<Absent>() => Ok(Value::Null),
        read => read,
    }
}

fn check(job: &Job) -> Result<()> {
    let id = &job.id;
    if let Some(why) = show::why(job) {
        return Err(NoResult(format!("job {id} {why}")).into());
    }
    let state = show::state(job.state);
    let wrong = || NoResult(format!("job {id} is {state}; wait for it with: tessera jobs wait {id}")).into();
    has_ended(job).then_some(()).ok_or_else(wrong)
}

/// What people mean by the result.
fn usual(job: &Job) -> &'static str {
    match job.spec.as_ref().and_then(|spec| spec.work.as_ref()) {
        Some(job_spec::Work::Rvd(_)) => "cells",
        Some(job_spec::Work::Cvt(_)) => "seeds",
        Some(job_spec::Work::Remesh(_)) | None => "mesh",
    }
}

fn digest<'a>(job: &'a Job, name: &str) -> Result<&'a str> {
    match job.results.iter().find(|blob| blob.name == name) {
        Some(blob) => match super::spec::digest(&blob.digest) {
            Ok(_) => Ok(&blob.digest),
            Err(why) => Err(Unavailable(format!("the server's answer is wrong: {why}")).into()),
        },
        None if job.results.is_empty() => Err(Absent(format!("the result of job {} is no longer kept", job.id)).into()),
        None => {
            let all: Vec<String> = job.results.iter().map(|blob| plain(&blob.name)).collect();
            let text = format!("the result of job {} has no {name}; --name takes one of: {}", job.id, all.join(", "));
            Err(Absent(text).into())
        }
    }
}

/// Refuses a name that says another format than the surface has.
fn check_extension(job: &Job, name: &str, path: &Path) -> Result<()> {
    let (Some(has), Ok(named)) = (show::format(job), Format::of_path(path)) else { return Ok(()) };
    if name == "mesh" && named.extension() != has {
        let text =
            format!("{}: the result of this job is .{has}; submit sets another format with --format", path.display());
        return Err(Usage(text).into());
    }
    if name == "mesh" && path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gz")) {
        let text = format!("{}: the result of this job is not packed; leave out .gz", path.display());
        return Err(Usage(text).into());
    }
    Ok(())
}

async fn read_report(session: &mut Session<'_>, digest: &str, progress: &Progress) -> Result<Value> {
    let wrong = |text: &str| Unavailable(format!("the server's answer is wrong: {text}"));
    let mut bytes = Vec::new();
    let mut keep = |piece: &[u8]| {
        bytes.extend_from_slice(piece);
        if bytes.len() > REPORT_BYTES { Err(wrong("its report does not end").into()) } else { Ok(()) }
    };
    session.download(digest, &mut keep, progress).await?;
    let report = serde_json::from_slice(&bytes).ok().filter(Value::is_object);
    Ok(plain_json(report.ok_or_else(|| wrong("its report is no report"))?))
}
