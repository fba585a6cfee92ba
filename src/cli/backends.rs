//! The backends, made as the options say; and `tessera doctor`: what this machine has and what would be used.

use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;

use crate::backends;
use geometry::rvd::parallel::Parallel;
use geometry::rvd::serial::Serial;
use geometry::rvd::{Backend, BackendChoice};
use gpu::device::adapters;
use gpu::diagram::Gpu;
use gpu::{BackendOptions, NoGpu};
use jobs::{Backends, JobError};
pub(crate) use server::config::{BackendArg, BackendArgs};

/// All backends of a server. Errors: `BackendUnavailable` if the default one is the GPU and there is none.
pub(crate) fn all(args: &BackendArgs) -> Result<Backends, JobError> {
    let backends = Backends {
        gpu: gpus(args).inspect_err(|reason| tracing::info!(%reason, "no GPU backend")),
        parallel: Arc::new(Parallel::new(args.threads)?),
        serial: Arc::new(Serial),
        default: args.backend.into(),
        pools: Some(|threads| Ok(Arc::new(Parallel::new(Some(threads))?))),
    };
    backends.choose(BackendChoice::Auto)?;
    Ok(backends)
}

/// The one backend that a subcommand in this process works with. Errors: `BackendUnavailable`.
pub(crate) fn one(args: &BackendArgs) -> Result<Arc<dyn Backend>, JobError> {
    match args.backend {
        BackendArg::Serial => Ok(Arc::new(Serial)),
        BackendArg::Parallel => Ok(Arc::new(Parallel::new(args.threads)?)),
        BackendArg::Gpu | BackendArg::Auto => all(args)?.choose(BackendChoice::Auto).cloned(),
    }
}

/// Does a subcommand's work on as many threads as `--threads` says: what no backend does too, as reading and drawing.
pub(crate) fn on_threads<R: Send>(args: &BackendArgs, work: impl FnOnce() -> Result<R> + Send) -> Result<R> {
    let threads = if args.backend == BackendArg::Serial { Some(1) } else { args.threads };
    let name = |i| format!("tessera-{i}");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).thread_name(name).build();
    pool.context("cannot start threads; ask for fewer with --threads")?.install(work)
}

/// The GPU backend. Errors: a sentence that says why there is none, and what to do.
pub(crate) fn gpu(args: &BackendArgs) -> Result<Arc<Gpu>, String> {
    options(args).open_gpu().map_err(|why| told(args, &why))
}

/// The same on as many adapters as are asked for.
fn gpus(args: &BackendArgs) -> Result<Arc<dyn Backend>, String> {
    options(args).open_gpus().map_err(|why| told(args, &why))
}

fn options(args: &BackendArgs) -> BackendOptions {
    BackendOptions {
        threads: args.threads,
        software_gpu: args.gpu_software,
        gpu_timeout: args.gpu_timeout,
        gpu_adapters: args.gpu_adapters.0,
        // Its range is checked.
        gpu_memory_bytes: args.gpu_memory_bytes().ok().flatten(),
        ..BackendOptions::new()
    }
}

fn told(args: &BackendArgs, why: &NoGpu) -> String {
    match why {
        // An adapter that opens and then fails is a fault that should be seen, not passed over.
        NoGpu::Broken(error) => {
            tracing::warn!(%error, "the GPU was found but does not work");
            format!("{why}; --backend parallel works without it")
        }
        NoGpu::TooFew { .. } => format!("{why}; ask for fewer with --gpu-adapters"),
        _ if args.gpu_software => format!("{why}; --backend parallel works without a GPU"),
        _ => format!("{why}; --gpu-software takes a software adapter, --backend parallel works without a GPU"),
    }
}

/// `tessera doctor`'s options: the same as where work is done, to see their effect.
#[derive(Args, Debug)]
pub(crate) struct DoctorArgs {
    #[command(flatten)]
    backend: BackendArgs,
}

pub(crate) fn run(args: &DoctorArgs) -> Result<()> {
    args.backend.check()?;
    outln!("tessera     {}", env!("CARGO_PKG_VERSION"))?;
    outln!("cores       {}", std::thread::available_parallelism().map_or(1, usize::from))?;
    for adapter in adapters() {
        outln!("adapter     {} ({}, {}, {})", adapter.name, adapter.kind, adapter.backend, adapter.driver)?;
        let (buffer, binding) = (adapter.max_buffer_bytes >> 20, adapter.max_binding_bytes >> 20);
        let (seen, groups) = (adapter.max_storage_buffers, adapter.max_workgroups);
        outln!(
            "            buffers to {buffer} MiB, bindings to {binding} MiB, {seen} storage buffers a stage, {groups} workgroups a dimension"
        )?;
        if let Some(reason) = &adapter.unusable {
            outln!("            cannot be used: {reason}")?;
        } else if adapter.software {
            outln!("            used with --gpu-software only")?;
        }
    }
    let begin = Instant::now();
    match backends::gpus(&args.backend) {
        Ok(gpu) => {
            outln!("gpu         {}, ready in {} ms", gpu.adapter().unwrap_or_default(), begin.elapsed().as_millis())?;
        }
        Err(reason) => outln!("gpu         none: {reason}")?,
    }
    let backends = backends::all(&args.backend)?;
    outln!("parallel    {} threads", backends.parallel.threads())?;
    let chosen = backends.choose(BackendChoice::Auto)?;
    let adapter = chosen.adapter().map(|name| format!(" ({name})")).unwrap_or_default();
    outln!("would use   {}{adapter}, {} threads", chosen.kind().name(), chosen.threads())?;
    Ok(())
}
