//! `tessera remesh`: of one file, or of many in one run.
//!
//! Invariant: of many files, one that fails stops no other. Each has one line, on the standard output if it was remeshed, else on
//! the standard error stream; the exit code is that of the first failure. Must not know: how a remesh is made.

pub(super) mod args;
mod summary;
mod tasks;

use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use args::flag;
pub(crate) use args::{DENSITIES, RemeshArgs};
use serde_json::{Value, json};
use summary::Told;
use tasks::Task;

use super::exit::{self, NotWritten};
use super::files::Loaded;
use super::progress::{Plan, Progress};
use super::remote::RemeshDone;
use super::server::{Server, ServerUrl};
use super::{backends, files, interrupt, remote, say};
use geometry::cvt::density::{DensityOptions, DensitySource};
use geometry::mesh::TriMesh;
use geometry::mesh::attributes::Attributes;
use geometry::mesh::io::RegionChoice;
use geometry::remesh::report::to_json;
use geometry::remesh::{RemeshOptions, Seeds, Warning, remesh};
use geometry::rvd::Backend;
use geometry::token::Token;
use jobs::memory;

pub(crate) fn run(args: &RemeshArgs) -> Result<()> {
    let tasks = tasks::of(args)?;
    let worker = Worker::new(args)?;
    backends::on_threads(&args.backend, || match tasks.as_slice() {
        [task] => alone(args, task, worker),
        tasks => all(args, tasks, worker),
    })
}

struct Worker {
    server: Option<Server>,
    token: Token,
    /// Opened once it is needed, and kept for the files that follow.
    backend: Option<Arc<dyn Backend>>,
}

impl Worker {
    fn new(args: &RemeshArgs) -> Result<Self> {
        Ok(Self { server: args.at.server()?, token: Token::default(), backend: None })
    }

    /// From now on Ctrl-C cancels the work instead of ending the process.
    fn listen(&self) -> Result<()> {
        interrupt::cancel_on_signal(&self.token).context("cannot listen for signals")
    }

    fn remesh(
        &mut self,
        args: &RemeshArgs,
        mesh: &TriMesh,
        task: &remote::Task,
        progress: &mut Progress,
    ) -> Result<RemeshDone> {
        if let Some(server) = &self.server {
            return remote::remesh(server, mesh, task, args.backend.backend, progress);
        }
        let backend = match &self.backend {
            Some(backend) => Arc::clone(backend),
            None => Arc::clone(self.backend.insert(backends::one(&args.backend)?)),
        };
        let done = remesh(mesh, &task.1, backend.as_ref(), progress, &self.token)?;
        let report = to_json(&done.report)?;
        Ok(RemeshDone { mesh: done.mesh, curve_edges: done.curve_edges, report, attributes: done.attributes })
    }
}

struct Remeshed {
    report: Value,
    total_ms: f64,
}

fn alone(args: &RemeshArgs, task: &Task, mut worker: Worker) -> Result<()> {
    let mut progress = Progress::begin(task.input.path(), args.say.quiet);
    let done = one(args, task, &mut worker, &mut progress, true)?;
    drop(progress);
    warnings(task, &done.report).for_each(|line| errln!("{line}"));
    if args.say.json {
        say::json(&done.report)?;
    }
    if args.say.summary() && !task.output.is_standard() {
        let told = Told {
            report: &done.report,
            input: task.input.path(),
            output: task.output.path(),
            endpoint: args.at.endpoint.as_ref().map(ServerUrl::as_str),
            total_ms: done.total_ms,
        };
        told.print()?;
    }
    Ok(())
}

/// Reads, remeshes and writes a file. Ctrl-C ends the process until the work begins, if `listen` says that no handler is there yet.
fn one(args: &RemeshArgs, task: &Task, worker: &mut Worker, progress: &mut Progress, listen: bool) -> Result<Remeshed> {
    let start = Instant::now();
    let Loaded { mesh, attributes, creases, vertices, mut warnings } = match args.files.no_attributes {
        true => {
            let (creases, vertices, warnings) = Default::default();
            Loaded { mesh: task.input.read_mesh()?, attributes: None, creases, vertices, warnings }
        }
        false => task.input.read_loaded(args.files.regions.as_ref().unwrap_or(&RegionChoice::Named))?,
    };
    let mut asked = args.options(&mesh, attributes, creases)?;
    warnings.extend(asked.1.keep_vertices(&vertices).iter().map(Warning::left_aside));
    asked.0.keep = asked.1.keep.iter().map(ToString::to_string).collect();
    let options = &asked.1;
    let read_ms = ms(start);
    if worker.server.is_none() && listen {
        worker.listen()?;
    }
    let steps = options.lloyd + options.newton;
    progress.plan(Plan::remesh(mesh.facets().len(), points(&mesh, options), steps, worker.server.is_some()));
    let RemeshDone { mesh, curve_edges, mut report, attributes } = worker.remesh(args, &mesh, &asked, progress)?;
    let writing = Instant::now();
    progress.stage("write", 0, 0);
    let unheld = task.output.write(&mesh, attributes.as_ref())?;
    args.picture.draw(&mesh, attributes.as_ref().and_then(Attributes::regions), &curve_edges)?;
    drop(attributes);
    // A server's report stays as it is.
    if worker.server.is_none() {
        let timings = &mut report["timings_ms"];
        (timings["read"], timings["write"], timings["total"]) = (read_ms.into(), ms(writing).into(), ms(start).into());
        report["memory"]["host_peak_bytes"] = memory::peak_memory_bytes().into();
    }
    let of_work = report["warnings"].take();
    let of_files = |warnings: Vec<Warning>| warnings.into_iter().map(|warning| json!(warning));
    let all = of_files(warnings).chain(of_work.as_array().cloned().unwrap_or_default());
    report["warnings"] = all.chain(of_files(unheld.into_iter().collect())).collect();
    if let Some(path) = &args.files.report {
        files::write_json(path, &report)?;
    }
    Ok(Remeshed { report, total_ms: ms(start) })
}

/// The warnings of a report, a line each, with options as the command names them.
fn warnings<'a>(task: &'a Task, report: &'a Value) -> impl Iterator<Item = String> + 'a {
    told_of(report).map(move |(warning, text)| {
        let file = if warning["code"] == "not_held" { &task.output } else { &task.input };
        format!("tessera: warning: {file}: {text}")
    })
}

/// Each warning of a report with its sentence.
pub(crate) fn told_of(report: &Value) -> impl Iterator<Item = (&Value, String)> {
    let all = report["warnings"].as_array().map(Vec::as_slice).unwrap_or_default();
    all.iter().map(|warning| {
        let text = say::plain(warning["message"].as_str().unwrap_or_default());
        let text = text.split('`').enumerate().map(|(k, part)| if k % 2 == 1 { flag(part) } else { part.to_owned() });
        (warning, text.collect())
    })
}

/// About how many points there will be.
fn points(mesh: &TriMesh, options: &RemeshOptions) -> usize {
    let of_length = |length: f64| (2.0 / 3f64.sqrt() * mesh.area() / length / length) as usize;
    match (&options.seeds, &options.density) {
        (Seeds::Sample { points, .. }, _) => *points,
        (Seeds::Given(seeds), _) => seeds.len(),
        (Seeds::Implied { .. }, DensityOptions { source: DensitySource::Sizes(sizes), .. }) => {
            of_length(sizes.iter().sum::<f64>() / sizes.len().max(1) as f64)
        }
        (Seeds::Implied { .. }, density) => density.edge_length.map_or(0, of_length),
        (Seeds::Share { of, .. }, _) => of.points(mesh),
    }
}

pub(super) fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// Remeshes them, one after the other: each has all threads. Errors: the first failure, after all were tried; a signal or
/// an output that cannot be written, at once.
fn all(args: &RemeshArgs, tasks: &[Task], mut worker: Worker) -> Result<()> {
    worker.listen()?;
    let sizes: Vec<u64> = tasks.iter().map(size).collect();
    let total = sizes.iter().sum::<u64>() as f64;
    let mut progress = Progress::begin(std::path::Path::new("batch"), args.say.quiet);
    let (mut failed, mut first, mut before) = (0, None, 0);
    for (k, (task, bytes)) in tasks.iter().zip(sizes).enumerate() {
        let span = (before as f64 / total, (before + bytes) as f64 / total);
        progress.next(&format!("{} of {}, {}", k + 1, tasks.len(), task.input), span);
        before += bytes;
        worker.token.check()?;
        match one(args, task, &mut worker, &mut progress, false) {
            Ok(done) => told(args, task, &done, &progress)?,
            Err(error) => {
                let code = exit::code(&error);
                if code == interrupt::CODE {
                    return Err(error);
                }
                failed += 1;
                let (file, text) = (task.input.to_string(), say::plain_lines(&format!("{error:#}")));
                // Errors of a file begin with its name.
                match text.starts_with(&file) {
                    true => progress.note(&format!("tessera: {text}")),
                    false => progress.note(&format!("tessera: {file}: {text}")),
                }
                if args.say.json {
                    let line =
                        json!({ "input": task.input.to_string(), "error": format!("{error:#}"), "exit_code": code });
                    progress.aside(|| say::json_line(&line))?;
                }
                first.get_or_insert(error);
            }
        }
    }
    drop(progress);
    let count = tasks.len();
    if args.say.summary() {
        outln!("{} of {count} files remeshed", count - failed)?;
    }
    first.map_or(Ok(()), |error| Err(error.context(format!("{failed} of {count} files failed, the first"))))
}

/// Bytes of an input, for the bar; a file that is not there has few.
fn size(task: &Task) -> u64 {
    std::fs::metadata(task.input.path()).map_or(1, |meta| meta.len().max(1))
}

fn told(args: &RemeshArgs, task: &Task, done: &Remeshed, progress: &Progress) -> Result<(), NotWritten> {
    warnings(task, &done.report).for_each(|line| progress.note(&line));
    if args.say.json {
        let mut line = json!({ "input": task.input.to_string(), "output": task.output.to_string() });
        line["report"] = done.report.clone();
        progress.aside(|| say::json_line(&line))?;
    }
    if args.say.summary() {
        progress.aside(|| outln!("{}", summary(task, done)))?;
    }
    Ok(())
}

fn summary(task: &Task, done: &Remeshed) -> String {
    let at = |pointer: &str| done.report.pointer(pointer).unwrap_or(&Value::Null);
    let count = |pointer: &str| at(pointer).as_u64().unwrap_or(0);
    let [vertices, facets] = ["/result/vertices", "/result/facets"].map(count);
    let mut line = format!("{} -> {}: {vertices} vertices, {facets} facets", task.input, task.output);
    if let Some(angle) = at("/result/theta_min_deg").as_f64() {
        line += &format!(", angle min {angle:.2}°");
    }
    if let Some(distance) = at("/result/hausdorff_percent").as_f64() {
        line += &format!(", Hausdorff {distance:.4} %");
    }
    line + &format!(", {:.0} ms", done.total_ms)
}
