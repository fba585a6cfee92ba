//! `tessera doctor`: what this machine has and what would be used.

use anyhow::Result;
use clap::Args;

use super::backends;
use geometry::rvd::{Backend, BackendChoice};
use gpu::device::adapters;
use server::config::BackendArgs;

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
        outln!(
            "            buffers to {} MiB, bindings to {} MiB, {} storage buffers a stage, {} workgroups a dimension",
            adapter.max_buffer_bytes >> 20,
            adapter.max_binding_bytes >> 20,
            adapter.max_storage_buffers,
            adapter.max_workgroups
        )?;
        if let Some(reason) = &adapter.unusable {
            outln!("            cannot be used: {reason}")?;
        } else if adapter.software {
            outln!("            used with --gpu-software only")?;
        }
    }
    match backends::gpu(&args.backend) {
        Ok(gpu) => outln!("gpu         {}", gpu.adapter().unwrap_or_default())?,
        Err(reason) => outln!("gpu         none: {reason}")?,
    }
    let backends = backends::all(&args.backend)?;
    outln!("parallel    {} threads", backends.parallel.threads())?;
    let chosen = backends.choose(BackendChoice::Auto)?;
    let adapter = chosen.adapter().map(|name| format!(" ({name})")).unwrap_or_default();
    outln!("would use   {}{adapter}, {} threads", chosen.kind().name(), chosen.threads())?;
    Ok(())
}
