//! The backends, made as the options say.

use std::sync::Arc;

use anyhow::Context;

use geometry::rvd::parallel::Parallel;
use geometry::rvd::serial::Serial;
use geometry::rvd::{Backend, BackendChoice};
use gpu::diagram::Gpu;
use gpu::{BackendOptions, NoGpu};
use jobs::{Backends, JobError};
pub(crate) use server::config::{BackendArg, BackendArgs};

/// All backends of a server.
///
/// # Errors
/// `BackendUnavailable` if the default one is the GPU and there is none.
pub(crate) fn all(args: &BackendArgs) -> Result<Backends, JobError> {
    let backends = Backends {
        gpu: gpu(args).inspect_err(|reason| tracing::info!(%reason, "no GPU backend")),
        parallel: Arc::new(Parallel::new(args.threads)?),
        serial: Arc::new(Serial),
        default: args.backend.into(),
        pools: Some(|threads| Ok(Arc::new(Parallel::new(Some(threads))?))),
    };
    backends.choose(BackendChoice::Auto)?;
    Ok(backends)
}

/// The one backend that a subcommand in this process works with.
///
/// # Errors
/// `BackendUnavailable`.
pub(crate) fn one(args: &BackendArgs) -> Result<Arc<dyn Backend>, JobError> {
    match args.backend {
        BackendArg::Serial => Ok(Arc::new(Serial)),
        BackendArg::Parallel => Ok(Arc::new(Parallel::new(args.threads)?)),
        BackendArg::Gpu | BackendArg::Auto => all(args)?.choose(BackendChoice::Auto).cloned(),
    }
}

/// Does a subcommand's work on as many threads as `--threads` says: what no backend does too, as reading and drawing.
///
/// # Errors
/// There are no threads to be had, or what the work says.
pub(crate) fn on_threads<R: Send>(
    args: &BackendArgs,
    work: impl FnOnce() -> anyhow::Result<R> + Send,
) -> anyhow::Result<R> {
    let threads = if args.backend == BackendArg::Serial { Some(1) } else { args.threads };
    let name = |i| format!("tessera-{i}");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).thread_name(name).build();
    pool.context("cannot start threads; ask for fewer with --threads")?.install(work)
}

/// The GPU backend, or why there is none and what to do.
///
/// # Errors
/// A sentence for the caller.
pub(crate) fn gpu(args: &BackendArgs) -> Result<Arc<dyn Backend>, String> {
    Ok(open_gpu(args)?)
}

/// As [`gpu`], for who needs more of it than a backend.
///
/// # Errors
/// A sentence for the caller.
pub(crate) fn open_gpu(args: &BackendArgs) -> Result<Arc<Gpu>, String> {
    let options = BackendOptions {
        threads: args.threads,
        software_gpu: args.gpu_software,
        gpu_timeout: args.gpu_timeout,
        ..BackendOptions::new()
    };
    options.open_gpu().map_err(|why| match &why {
        // An adapter that opens and then fails is a fault that should be seen, not passed over.
        NoGpu::Broken(error) => {
            tracing::warn!(%error, "the GPU was found but does not work");
            format!("{why}; --backend parallel works without it")
        }
        _ if args.gpu_software => format!("{why}; --backend parallel works without a GPU"),
        _ => format!("{why}; --gpu-software takes a software adapter, --backend parallel works without a GPU"),
    })
}
