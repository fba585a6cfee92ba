//! `tessera remesh`.

pub(super) mod args;
mod batch;
mod summary;
mod tasks;

use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use serde_json::Value;

use super::endpoint::ServerUrl;
use super::files::Loaded;
use super::progress::{Plan, Progress};
use super::remote::RemeshDone;
use super::server::Server;
use super::{backends, files, interrupt, remote, say};
pub(crate) use args::{DensityArg, RemeshArgs};
use geometry::cvt::density::{DensityOptions, DensitySource};
use geometry::mesh::TriMesh;
use geometry::remesh::report::to_json;
use geometry::remesh::{RemeshOptions, Seeds, remesh};
use geometry::rvd::Backend;
use geometry::token::Token;
use jobs::memory;
use summary::Told;
use tasks::Task;
use wire::proto;

pub(crate) fn run(args: &RemeshArgs) -> Result<()> {
    let tasks = tasks::of(args)?;
    let worker = Worker::new(args)?;
    backends::on_threads(&args.backend, || match tasks.as_slice() {
        [task] => alone(args, task, worker),
        tasks => batch::run(args, tasks, worker),
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
        (message, options): &(proto::RemeshOptions, RemeshOptions),
        progress: &mut Progress,
    ) -> Result<RemeshDone> {
        if let Some(server) = &self.server {
            let job = remote::RemeshJob { mesh, message, options, backend: args.backend.backend };
            return remote::remesh(server, &job, progress);
        }
        let backend = match &self.backend {
            Some(backend) => Arc::clone(backend),
            None => Arc::clone(self.backend.insert(backends::one(&args.backend)?)),
        };
        let done = remesh(mesh, options, backend.as_ref(), progress, &self.token)?;
        let report = to_json(&done.report)?;
        Ok(RemeshDone { mesh: done.mesh, curve_edges: done.curve_edges, report, attributes: done.attributes })
    }
}

struct Remeshed {
    report: Value,
    /// What the format of the output cannot hold.
    left_out: Option<String>,
    total_ms: f64,
}

fn alone(args: &RemeshArgs, task: &Task, mut worker: Worker) -> Result<()> {
    let mut progress = Progress::begin(task.input.path(), args.say.quiet);
    let done = one(args, task, &mut worker, &mut progress, true)?;
    drop(progress);
    done.left_out.iter().for_each(|note| errln!("{note}"));
    if args.say.json {
        say::json(&done.report)?;
    }
    if args.say.summary() && !task.output.is_standard() {
        let told = Told {
            report: &done.report,
            input: task.input.path(),
            output: task.output.path(),
            endpoint: args.at.endpoint.as_ref().map(ServerUrl::as_str),
            bounded: args.size.max_deviation.is_some(),
            total_ms: done.total_ms,
        };
        told.print()?;
    }
    Ok(())
}

/// Reads, remeshes and writes a file. Ctrl-C ends the process until the work begins, if `listen` says that no handler is there yet.
fn one(args: &RemeshArgs, task: &Task, worker: &mut Worker, progress: &mut Progress, listen: bool) -> Result<Remeshed> {
    let start = Instant::now();
    let Loaded { mesh, attributes, notes } = match args.files.no_attributes {
        true => Loaded { mesh: task.input.read_mesh()?, attributes: None, notes: Vec::new() },
        false => task.input.read_loaded()?,
    };
    notes.iter().for_each(|note| progress.note(note));
    let asked = args.options(&mesh, attributes)?;
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
    let left_out = task.output.write(&mesh, attributes.as_ref())?;
    drop(attributes);
    args.picture.draw(&mesh, &curve_edges)?;
    // A server's report stays as it is.
    if worker.server.is_none() {
        let timings = &mut report["timings_ms"];
        (timings["read"], timings["write"], timings["total"]) = (read_ms.into(), ms(writing).into(), ms(start).into());
        report["memory"]["host_peak_bytes"] = memory::peak_memory_bytes().into();
    }
    if let Some(path) = &args.files.report {
        files::write_json(path, &report)?;
    }
    Ok(Remeshed { report, left_out, total_ms: ms(start) })
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
    }
}

fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}
