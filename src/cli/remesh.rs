//! `tessera remesh`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;

use super::exit::Usage;
use super::progress::Progress;
use super::{backends, files, interrupt, remote};
use crate::config::BackendArgs;
use crate::cvt::Projection;
use crate::mesh::TriMesh;
use crate::mesh::attributes::Attributes;
use crate::remesh::{RemeshOptions, Report, Seeds, remesh};
use crate::rvd::CancelFlag;
use crate::telemetry;

/// `tessera remesh`'s options.
#[derive(Args, Debug)]
pub(crate) struct RemeshArgs {
    /// The surface: .obj, .ply, .stl or .off.
    input: PathBuf,
    /// Where the remesh goes; the extension is the format.
    #[arg(short, long, value_name = "OUTPUT")]
    output: PathBuf,
    /// Number of seeds, about the number of vertices of the result.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    points: u32,
    /// Lloyd steps.
    #[arg(long, value_name = "N", default_value_t = 5)]
    lloyd: u32,
    /// Quasi-Newton steps after them. Not available yet: only 0, which is the default for now.
    #[arg(long, value_name = "N", default_value_t = 0)]
    newton: u32,
    /// Random seed of the first points.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Who works.
    #[command(flatten)]
    backend: BackendArgs,
    /// Let a server do the work, e.g. http://127.0.0.1:50051.
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// Write the report there, as JSON.
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
    /// Leave aside normals, texture coordinates, colours and scalars of the input.
    #[arg(long)]
    no_attributes: bool,
}

/// Runs it.
pub(crate) fn run(args: &RemeshArgs) -> Result<()> {
    if args.newton > 0 {
        let text = format!("--newton {}: quasi-Newton steps are not available yet; use --newton 0", args.newton);
        return Err(Usage(text).into());
    }
    args.backend.check()?;
    files::check_output(&args.output, &["obj", "ply", "stl", "off"])?;
    args.report.iter().try_for_each(|path| files::check_output(path, &[]))?;
    let start = Instant::now();
    let (mesh, attributes) = match args.no_attributes {
        true => (files::read_mesh(&args.input)?, None),
        false => files::read_loaded(&args.input)?,
    };
    let read_ms = ms(start);
    match &args.endpoint {
        None => here(args, &mesh, attributes, start, read_ms),
        Some(endpoint) => there(args, &mesh, attributes.as_ref(), endpoint),
    }
}

fn here(args: &RemeshArgs, mesh: &TriMesh, attributes: Option<Attributes>, start: Instant, read_ms: f64) -> Result<()> {
    let cancel = CancelFlag::default();
    interrupt::cancel_on_signal(&cancel).context("cannot listen for signals")?;
    let backend = backends::one(&args.backend)?;
    let options = RemeshOptions {
        seeds: Seeds::Sample { points: args.points as usize, seed: args.seed },
        lloyd: args.lloyd as usize,
        weights: None,
        projection: Projection::Free,
        measure: true,
        attributes,
    };
    let mut progress = Progress::new();
    let done = remesh(mesh, &options, backend.as_ref(), &mut progress, &cancel);
    drop(progress);
    let mut done = done?;
    let writing = Instant::now();
    files::write_loaded(&args.output, &done.mesh, done.attributes.as_ref())?;
    let timings = &mut done.report.timings_ms;
    (timings.read, timings.write, timings.total) = (read_ms, ms(writing), ms(start));
    done.report.memory.host_peak_bytes = telemetry::peak_memory_bytes();
    if let Some(path) = &args.report {
        files::write_json(path, &done.report)?;
    }
    print(&done.report);
    Ok(())
}

fn there(args: &RemeshArgs, mesh: &TriMesh, attributes: Option<&Attributes>, endpoint: &str) -> Result<()> {
    let job = remote::RemeshJob {
        mesh,
        points: args.points.into(),
        random_seed: args.seed,
        lloyd: args.lloyd,
        backend: args.backend.backend,
        attributes,
    };
    let done = remote::remesh(endpoint, &job)?;
    files::write_loaded(&args.output, &done.mesh, done.attributes.as_ref())?;
    if let Some(path) = &args.report {
        files::write_json(path, &done.report)?;
    }
    let result = &done.report["result"];
    println!(
        "{} vertices, {} facets, by {} at {endpoint}",
        result["vertices"], result["facets"], done.report["backend"]
    );
    Ok(())
}

/// What a person wants to know at the end.
fn print(report: &Report) {
    let (input, result, rvd) = (&report.input, &report.result, &report.rvd);
    let by = report.adapter.as_deref().unwrap_or("CPU");
    println!("backend     {} ({by}), {} threads", report.backend, report.threads);
    println!("input       {} vertices, {} facets, χ {}", input.vertices, input.facets, input.topology.euler);
    println!("result      {} vertices, {} facets, χ {}", result.vertices, result.facets, result.topology.euler);
    if let Some(last) = report.iterations.last() {
        println!("iterations  {}, E/E_hex before the last {:.5}", report.iterations.len(), last.energy_ratio);
    }
    println!("pairs       {}, launched again {}, empty cells {}", rvd.pairs, rvd.relaunched_pairs, rvd.empty_cells);
    if let Some(q) = &result.quality {
        println!(
            "quality     Q min {:.4}, mean {:.4}; angle min {:.2}°, mean {:.2}°",
            q.q_min, q.q_avg, q.theta_min_deg, q.theta_avg_deg
        );
        println!("            under 30° {:.2} %; valence 5-7 {:.2} %", q.under_30_percent, q.v567_percent);
        println!("distance    Hausdorff {:.4} %, RMS {:.4} % of the diagonal", q.hausdorff_percent, q.rms_percent);
    }
    println!(
        "topology    {} boundary edges, {} non-manifold edges, {} non-manifold vertices",
        result.topology.boundary_edges, result.topology.non_manifold_edges, result.topology.non_manifold_vertices
    );
    if !report.topology_changes.is_empty() {
        println!("changed     {}; more points keep more", report.topology_changes.join(", "));
    }
    if let Some(bytes) = report.memory.host_peak_bytes {
        let mib = |bytes: u64| bytes >> 20;
        println!("memory      {} MiB, {} MiB on the device", mib(bytes), mib(report.memory.device_bytes));
    }
    println!("time        {:.0} ms", report.timings_ms.total);
}

fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}
