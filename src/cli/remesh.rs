//! `tessera remesh`.

pub(super) mod args;
mod summary;

use std::time::Instant;

use anyhow::{Context, Result};
use serde_json::Value;

use super::endpoint::ServerUrl;
use super::exit::Usage;
use super::files::Loaded;
use super::progress::{Plan, Progress};
use super::server::Server;
use super::{backends, files, interrupt, remote, say, server, sizes};
use crate::cvt::density::{DensityOptions, DensitySource};
use crate::memory;
use crate::mesh::TriMesh;
use crate::mesh::attributes::Attributes;
use crate::remesh::report::to_json;
use crate::remesh::{RemeshOptions, Seeds, remesh};
use crate::token::Token;
use args::FileArgs;
pub(crate) use args::{DensityArg, RemeshArgs};
use summary::Told;

/// Runs it.
pub(crate) fn run(args: &RemeshArgs) -> Result<()> {
    check(args)?;
    backends::on_threads(&args.backend, || work(args))
}

fn work(args: &RemeshArgs) -> Result<()> {
    let start = Instant::now();
    let trust = args.endpoint.as_ref().map(|url| args.trust.read(url)).transpose()?.unwrap_or_default();
    let mut progress = Progress::begin(&args.input, &args.say);
    let Loaded { mesh, attributes, notes } = match args.files.no_attributes {
        true => Loaded { mesh: files::read_mesh(&args.input)?, attributes: None, notes: Vec::new() },
        false => files::read_loaded(&args.input)?,
    };
    notes.iter().for_each(|note| progress.note(note));
    let options = args.options(&mesh, attributes)?;
    let read_ms = ms(start);
    let steps = options.lloyd + options.newton;
    progress.plan(Plan::remesh(mesh.facets().len(), points(&mesh, &options), steps, args.endpoint.is_some()));
    let (mut done, report) = match &args.endpoint {
        None => here(args, &mesh, &options, &mut progress)?,
        Some(url) => {
            let job = remote::RemeshJob { mesh: &mesh, options: &options, backend: args.backend.backend };
            let key = server::key(args.key_file.as_deref())?;
            let server = Server { url: url.clone(), tenant: args.tenant.clone(), trust, key };
            let done = remote::remesh(&server, &job, &progress)?;
            (Done { mesh: done.mesh, curve_edges: done.curve_edges, attributes: done.attributes }, done.report)
        }
    };
    let (mut report, writing) = (report, Instant::now());
    progress.stage("write", 0, 0);
    let written = files::write_loaded(&args.files.output, &done.mesh, done.attributes.take().as_ref())?;
    args.picture.draw(&done.mesh, &done.curve_edges)?;
    // What a server says of itself stays as it is.
    if args.endpoint.is_none() {
        let timings = &mut report["timings_ms"];
        (timings["read"], timings["write"], timings["total"]) = (read_ms.into(), ms(writing).into(), ms(start).into());
        report["memory"]["host_peak_bytes"] = memory::peak_memory_bytes().into();
    }
    if let Some(path) = &args.files.report {
        files::write_json(path, &report)?;
    }
    drop(progress);
    written.iter().for_each(|note| errln!("{note}"));
    if args.say.json {
        say::json(&report)?;
    }
    if args.say.summary() {
        let told = Told {
            report: &report,
            input: &args.input,
            output: &args.files.output,
            endpoint: args.endpoint.as_ref().map(ServerUrl::as_str),
            bounded: args.size.max_deviation.is_some(),
            total_ms: ms(start),
        };
        told.print()?;
    }
    Ok(())
}

/// Refuses what cannot be, before any work.
fn check(args: &RemeshArgs) -> Result<()> {
    let RemeshArgs { input, files: FileArgs { output, report, overwrite, .. }, size, shape, .. } = args;
    args.backend.check()?;
    files::check_surface_output(output)?;
    report.iter().try_for_each(|path| files::check_output(path, &[]))?;
    if files::same(input, output) && !overwrite {
        let name = output.display();
        return Err(Usage(format!(
            "{name} is the input, and the remesh would replace it; give --output another name, or add --overwrite"
        ))
        .into());
    }
    let others = [shape.creases.as_deref(), size.sizes.as_deref()];
    let others = || others.into_iter().flatten();
    files::check_apart(others(), [output.as_path()].into_iter())?;
    let kept = [input.as_path(), output.as_path()].into_iter().chain(others());
    files::check_apart(kept, [report.as_deref(), args.picture.path()].into_iter().flatten())?;
    if size.sizes.is_some() {
        sizes::check_format(input, "--sizes")?;
    }
    if shape.creases.is_some() {
        sizes::check_format(input, "--creases")?;
    }
    args.picture.check()?;
    size.check(shape.placement)
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

/// What is to be written.
struct Done {
    mesh: TriMesh,
    curve_edges: Vec<[u32; 2]>,
    attributes: Option<Attributes>,
}

fn here(args: &RemeshArgs, mesh: &TriMesh, options: &RemeshOptions, progress: &mut Progress) -> Result<(Done, Value)> {
    let token = Token::default();
    interrupt::cancel_on_signal(&token).context("cannot listen for signals")?;
    let backend = backends::one(&args.backend)?;
    let done = remesh(mesh, options, backend.as_ref(), progress, &token)?;
    let report = to_json(&done.report)?;
    Ok((Done { mesh: done.mesh, curve_edges: done.curve_edges, attributes: done.attributes }, report))
}

fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}
