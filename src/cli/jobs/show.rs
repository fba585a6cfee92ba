//! Jobs and events, as people and scripts read them.
//!
//! Invariant: text of a server goes through `plain`. Keys of the JSON stay as they are; more may be added. Must not know:
//! calls.

use prost_types::Timestamp;
use serde_json::{Map, Value, json};

use crate::info::seconds;
use crate::say::{plain, plain_json};
use geometry::mesh::io::Format;
use wire::proto::{
    BackendChoice, EstimateJobResponse, Job, JobEvent, JobFailureKind, JobMesh, JobState, job_event, job_mesh,
    job_spec, result_format,
};

/// Name of a value of an enum, which the protocol writes behind a prefix.
fn word(name: Option<&str>, prefix: &str) -> String {
    match name.and_then(|name| name.strip_prefix(prefix)) {
        None | Some("UNSPECIFIED") => "unknown".to_owned(),
        Some(word) => word.to_ascii_lowercase(),
    }
}

/// A state's name, as `--state` takes it.
pub(super) fn state(value: i32) -> String {
    word(JobState::try_from(value).ok().map(|state| state.as_str_name()), "JOB_STATE_")
}

pub(super) fn kind(job: &Job) -> &'static str {
    match job.spec.as_ref().and_then(|spec| spec.work.as_ref()) {
        Some(job_spec::Work::Remesh(_)) => "remesh",
        Some(job_spec::Work::Rvd(_)) => "rvd",
        Some(job_spec::Work::Cvt(_)) => "cvt",
        None => "unknown",
    }
}

/// The format of a remesh's file, if the result is one.
pub(super) fn format(job: &Job) -> Option<&'static str> {
    let form = job.spec.as_ref().and_then(|spec| spec.result.as_ref()).and_then(|result| result.form.as_ref());
    match form {
        None => Some("ply"),
        Some(result_format::Form::File(format)) => match file_format(*format) {
            "unknown" => Some("ply"),
            name => Some(name),
        },
        Some(result_format::Form::Arrays(_)) => None,
    }
}

fn file_format(value: i32) -> &'static str {
    Format::of_number(value).map_or("unknown", Format::extension)
}

/// A moment, if it is one that has a year of four digits.
pub(super) fn moment(at: Option<&Timestamp>) -> Option<String> {
    let at = at.filter(|at| (-62_135_596_800..253_402_300_800).contains(&at.seconds))?;
    let nanos = at.nanos.clamp(0, 999_999_999);
    // Milliseconds say enough.
    Some(Timestamp { seconds: at.seconds, nanos: nanos - nanos % 1_000_000 }.to_string())
}

fn failure(value: i32) -> String {
    word(JobFailureKind::try_from(value).ok().map(|kind| kind.as_str_name()), "JOB_FAILURE_KIND_")
}

fn backend(value: i32) -> String {
    match word(BackendChoice::try_from(value).ok().map(|choice| choice.as_str_name()), "BACKEND_CHOICE_") {
        unknown if unknown == "unknown" => "auto".to_owned(),
        name => name,
    }
}

/// Labels in the order of their keys.
fn labels(job: &Job) -> Vec<(&str, &str)> {
    let mut all: Vec<(&str, &str)> =
        job.spec.iter().flat_map(|spec| &spec.labels).map(|(key, value)| (key.as_str(), value.as_str())).collect();
    all.sort_unstable();
    all
}

pub(super) fn json_of(job: &Job) -> Value {
    let spec = job.spec.as_ref();
    let labels: Map<String, Value> = labels(job).into_iter().map(|(k, v)| (k.to_owned(), v.into())).collect();
    let results: Map<String, Value> =
        job.results.iter().map(|blob| (blob.name.clone(), blob.digest.clone().into())).collect();
    let input = match spec.and_then(|spec| spec.mesh.as_ref()) {
        Some(JobMesh { source: Some(job_mesh::Source::File(file)) }) => {
            json!({ "digest": file.digest, "format": file_format(file.format) })
        }
        _ => Value::Null,
    };
    plain_json(json!({
        "id": job.id,
        "state": state(job.state),
        "kind": kind(job),
        "created": moment(job.created.as_ref()),
        "started": moment(job.started.as_ref()),
        "changed": moment(job.changed.as_ref()),
        "attempts": job.attempts,
        "crashes": job.crashes,
        "failure": job.failure.as_ref().map(|why| json!({ "kind": failure(why.kind), "message": why.message })),
        "expired_by": Some(&job.expired_by).filter(|by| !by.is_empty()),
        "results": results,
        "unschedulable": Some(&job.unschedulable).filter(|why| !why.is_empty()),
        "server": Some(&job.server).filter(|name| !name.is_empty()),
        "request_id": Some(&job.request_id).filter(|id| !id.is_empty()),
        "labels": labels,
        "input": input,
        "format": format(job),
        "backend": backend(spec.map_or(0, |spec| spec.backend)),
        "priority": spec.and_then(|spec| spec.priority).unwrap_or_default(),
        "queue_deadline_s": seconds(spec.and_then(|spec| spec.queue_deadline)),
        "run_deadline_s": seconds(spec.and_then(|spec| spec.run_deadline)),
    }))
}

/// Why a job has no result, or nothing if it has not ended so.
pub(super) fn why(job: &Job) -> Option<String> {
    match JobState::try_from(job.state) {
        Ok(JobState::Failed) => {
            let why = job.failure.as_ref();
            let said = plain(why.map_or("", |why| &why.message));
            let kind = failure(why.map_or(0, |why| why.kind)).replace('_', " ");
            Some(if said.is_empty() { format!("failed ({kind})") } else { format!("failed ({kind}): {said}") })
        }
        Ok(JobState::Cancelled) => Some("was cancelled".to_owned()),
        Ok(JobState::Expired) => Some(match job.expired_by.as_str() {
            "queue_deadline" => "expired: it waited longer than its queue deadline".to_owned(),
            "run_deadline" => "expired: it was at work longer than its deadline".to_owned(),
            "kept" => "expired: its result was kept as long as results are".to_owned(),
            _ => "expired".to_owned(),
        }),
        _ => None,
    }
}

pub(super) fn lines(job: &Job) -> Vec<String> {
    let mut lines = vec![format!("id        {}", job.id), format!("kind      {}", kind(job))];
    lines.push(format!("state     {}", why(job).unwrap_or_else(|| state(job.state))));
    if !job.unschedulable.is_empty() {
        lines.push(format!("waits     {}", plain(&job.unschedulable)));
    }
    if !job.server.is_empty() {
        lines.push(format!("server    {}", plain(&job.server)));
    }
    for (name, at) in [("created", &job.created), ("started", &job.started), ("changed", &job.changed)] {
        lines.extend(moment(at.as_ref()).map(|at| format!("{name:9} {at}")));
    }
    if job.attempts > 0 {
        let crashes =
            if job.crashes > 0 { format!(", the server went down in {}", job.crashes) } else { String::new() };
        lines.push(format!("attempts  {}{crashes}", job.attempts));
    }
    if !job.request_id.is_empty() {
        lines.push(format!("request   {}", plain(&job.request_id)));
    }
    lines.extend(labels(job).into_iter().map(|(key, value)| format!("label     {}={}", plain(key), plain(value))));
    lines.extend(job.results.iter().map(|blob| format!("result    {} {}", plain(&blob.name), plain(&blob.digest))));
    lines
}

pub(super) fn table(jobs: &[Job]) -> Vec<String> {
    let head = format!("{:32}  {:9}  {:6}  {:24}  LABELS", "ID", "STATE", "KIND", "CREATED");
    let rows = jobs.iter().map(|job| {
        let labels: Vec<String> = labels(job).into_iter().map(|(k, v)| format!("{}={}", plain(k), plain(v))).collect();
        let created = moment(job.created.as_ref()).unwrap_or_else(|| "-".to_owned());
        let row = format!("{:32}  {:9}  {:6}  {created:24}  {}", job.id, state(job.state), kind(job), labels.join(" "));
        row.trim_end().to_owned()
    });
    std::iter::once(head).chain(rows).collect()
}

pub(super) fn json_of_event(event: &JobEvent) -> Value {
    let mut value = json!({ "number": event.number, "at": moment(event.at.as_ref()) });
    let (key, what) = match &event.what {
        Some(job_event::What::State(change)) => {
            value["attempt"] = change.attempt.into();
            ("state", state(change.state).into())
        }
        Some(job_event::What::Stage(stage)) => {
            ("stage", json!({ "name": stage.name, "done": stage.done, "total": stage.total }))
        }
        Some(job_event::What::Iteration(step)) => {
            let (energy, ratio, norm) = (step.energy, step.energy_ratio, step.gradient_norm);
            let (index, total, kind) = (step.index, step.total, &step.kind);
            let figures = json!({ "index": index, "total": total, "kind": kind, "energy": energy,
                "energy_ratio": ratio, "gradient_norm": norm, "ms": step.ms });
            ("iteration", figures)
        }
        // Of a newer server.
        None => ("other", Value::Null),
    };
    value[key] = what;
    plain_json(value)
}

pub(super) fn line_of_event(event: &JobEvent) -> String {
    let what = match &event.what {
        Some(job_event::What::State(change)) if change.attempt > 1 => {
            format!("{} (attempt {})", state(change.state), change.attempt)
        }
        Some(job_event::What::State(change)) => state(change.state),
        Some(job_event::What::Stage(stage)) if stage.total > 1 => {
            format!("stage {} {} of {}", plain(&stage.name), stage.done, stage.total)
        }
        Some(job_event::What::Stage(stage)) => format!("stage {}", plain(&stage.name)),
        Some(job_event::What::Iteration(step)) => {
            let of = if step.total > 0 { format!(" of {}", step.total) } else { String::new() };
            let done = step.index.saturating_add(1);
            format!("step {done}{of} {}, energy {:e}, {:.1} ms", plain(&step.kind), step.energy, step.ms)
        }
        None => "an event that this version does not know".to_owned(),
    };
    let at = moment(event.at.as_ref()).unwrap_or_else(|| "-".to_owned());
    format!("{at:24}  {:>6}  {what}", event.number)
}

pub(super) fn json_of_estimate(estimate: &EstimateJobResponse) -> Value {
    json!({
        "fits": estimate.fits,
        "unschedulable": Some(&estimate.unschedulable).filter(|why| !why.is_empty()),
        "seconds": estimate.seconds,
        "host_bytes": estimate.host_bytes,
        "host_limit_bytes": estimate.host_limit_bytes,
        "device_bytes": estimate.device_bytes,
        "device_limit_bytes": estimate.device_limit_bytes,
    })
}

pub(super) fn lines_of_estimate(estimate: &EstimateJobResponse) -> Vec<String> {
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    let of = |limit: u64| if limit > 0 { format!(" of {} MiB", mib(limit)) } else { String::new() };
    let fits = match (estimate.fits, estimate.unschedulable.as_str()) {
        (true, _) => "yes".to_owned(),
        (false, "") => "no: the server would refuse it".to_owned(),
        (false, why) => format!("no: {}", plain(why)),
    };
    let mut lines = vec![
        format!("fits      {fits}"),
        format!("time      {:.1} s, if nothing else is at work", estimate.seconds),
        format!("memory    {} MiB{}", mib(estimate.host_bytes), of(estimate.host_limit_bytes)),
    ];
    if estimate.device_bytes > 0 {
        lines.push(format!("GPU       {} MiB{}", mib(estimate.device_bytes), of(estimate.device_limit_bytes)));
    }
    lines
}
