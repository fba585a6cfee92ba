//! `tessera info`: what a server says of itself.
//!
//! Invariant: with `--json` every field of the answer is printed under its name in the interface. Must not know: connections.

use std::time::Duration;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::{Value, json};

use super::remote::info;
use super::say;
use super::server::ServerArgs;
use wire::proto::{BackendState, GetServerInfoResponse, RequestLimits};

#[derive(Args, Debug)]
pub(crate) struct InfoArgs {
    /// Seconds for the server to answer.
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = super::server::pause)]
    timeout_s: f64,
    #[command(flatten)]
    server: ServerArgs,
}

pub(crate) fn run(args: &InfoArgs) -> Result<()> {
    let (server, limit) = (args.server.at.server()?, Duration::from_secs_f64(args.timeout_s));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("no runtime")?;
    let told = runtime.block_on(info(&server, limit))?;
    match args.server.json {
        true => say::json(&as_json(&told))?,
        false => print(&told)?,
    }
    Ok(())
}

fn print(told: &GetServerInfoResponse) -> Result<()> {
    let revision = if told.revision.is_empty() { "unknown" } else { &told.revision };
    outln!("version     {} (revision {revision}; {})", told.version, told.features.join(", "))?;
    outln!("uptime      {:.0} s", seconds(told.uptime).unwrap_or(0.0))?;
    if let Some(readiness) = &told.readiness {
        let ready = if readiness.ready { "yes".to_owned() } else { format!("no: {}", readiness.reasons.join(", ")) };
        outln!("ready       {ready}")?;
        if !readiness.degraded.is_empty() {
            outln!("degraded    {}", readiness.degraded.join(", "))?;
        }
    }
    for BackendState { name, is_default, adapter, threads, unavailable } in &told.backends {
        let usual = if *is_default { ", the default" } else { "" };
        let adapter = if adapter.is_empty() { String::new() } else { format!("{adapter}, ") };
        let usable = format!("{adapter}{threads} threads{usual}");
        outln!("{name:<12}{}", if unavailable.is_empty() { usable } else { format!("none: {unavailable}") })?;
    }
    if let Some(device) = &told.device {
        let (most, binding) = (device.max_buffer_bytes >> 20, device.max_binding_bytes >> 20);
        outln!("device      {} ({}, {})", device.adapter, device.api, device.driver)?;
        outln!("            buffers to {most} MiB, bindings to {binding} MiB")?;
        if let Some(bytes) = device.allocated_bytes {
            outln!("            {} MiB allocated", bytes >> 20)?;
        }
    }
    if let Some(memory) = &told.memory {
        let mib = |bytes: Option<u64>| bytes.map_or("unknown".to_owned(), |bytes| format!("{} MiB", bytes >> 20));
        let (resident, machine) = (mib(memory.resident_bytes), mib(memory.machine_bytes));
        outln!("memory      {resident} held, of {machine}; {} for a job", mib(memory.job_limit_bytes))?;
    }
    if let Some(limits) = &told.limits {
        let RequestLimits { max_vertices, max_facets, max_seeds, max_iterations, .. } = limits;
        outln!(
            "limits      {max_vertices} vertices, {max_facets} facets, {max_seeds} seeds, {max_iterations} iterations"
        )?;
        outln!("            {} jobs at once, {} streams", limits.jobs_at_once, limits.max_streams)?;
    }
    Ok(())
}

pub(crate) fn seconds(time: Option<prost_types::Duration>) -> Option<f64> {
    time.map(|time| time.seconds as f64 + f64::from(time.nanos) * 1e-9)
}

pub(crate) fn as_json(told: &GetServerInfoResponse) -> Value {
    let backend = |state: &BackendState| {
        json!({
            "name": state.name, "is_default": state.is_default, "adapter": state.adapter, "threads": state.threads,
            "unavailable": state.unavailable,
        })
    };
    json!({
        "version": told.version,
        "revision": told.revision,
        "features": told.features,
        "uptime_s": seconds(told.uptime),
        "readiness": told.readiness.as_ref().map(|r| json!({ "ready": r.ready, "reasons": r.reasons, "degraded": r.degraded })),
        "backends": told.backends.iter().map(backend).collect::<Vec<_>>(),
        "device": told.device.as_ref().map(|d| json!({
            "adapter": d.adapter, "api": d.api, "driver": d.driver, "is_software": d.is_software,
            "max_buffer_bytes": d.max_buffer_bytes, "max_binding_bytes": d.max_binding_bytes,
            "max_workgroups": d.max_workgroups, "allocated_bytes": d.allocated_bytes,
        })),
        "memory": told.memory.as_ref().map(|m| json!({
            "machine_bytes": m.machine_bytes, "resident_bytes": m.resident_bytes,
            "job_limit_bytes": m.job_limit_bytes, "stream_limit_bytes": m.stream_limit_bytes,
        })),
        "limits": told.limits.as_ref().map(|l| json!({
            "max_vertices": l.max_vertices, "max_facets": l.max_facets, "max_seeds": l.max_seeds,
            "max_iterations": l.max_iterations, "max_message_bytes": l.max_message_bytes,
            "max_streams": l.max_streams, "max_sessions": l.max_sessions, "job_time_s": seconds(l.job_time),
            "jobs_at_once": l.jobs_at_once,
        })),
    })
}
