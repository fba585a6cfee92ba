//! The command line: one file per subcommand.
//!
//! Purpose: options to calls, errors to exit codes (`exit::HELP`). Invariant: results go to files and the standard output,
//! everything else to the standard error stream; both through `say`. Must not know: how anything is computed.

#![warn(unreachable_pub)]

#[macro_use]
mod say;

pub(crate) mod backends;
mod bench;
mod blobs;
#[cfg(feature = "postgres")]
mod cluster;
mod completions;
mod config;
mod exit;
mod files;
mod given;
mod health;
mod info;
mod interrupt;
mod jobs;
mod journal;
mod keys;
mod load;
mod measure;
mod picture;
mod progress;
mod remesh;
mod remote;
mod rvd;
mod serve;
mod server;
pub(crate) mod shape;
mod source;
mod surroundings;
#[cfg(test)]
mod tests;

use std::io::IsTerminal as _;
use std::process::ExitCode;

use clap::{ArgAction, Parser, Subcommand};

use self::config::Given;
pub use ::server::config::ServeArgs;
use ::telemetry::{self, LogFormat};

/// Exact restricted Voronoi diagrams and remeshing of triangle surfaces.
#[derive(Debug, Parser)]
#[command(name = "tessera", version, about, max_term_width = 100, after_help = exit::HELP)]
#[command(disable_help_flag = true, disable_version_flag = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// How log lines look. What is logged: the variable TESSERA_LOG, e.g. `debug`.
    #[arg(long, global = true, value_enum, default_value_t, env = "TESSERA_LOG_FORMAT", help_heading = GENERAL)]
    log_format: LogFormat,
    /// Print help; `--help` says more than `-h`.
    #[arg(long, short, global = true, action = ArgAction::Help, help_heading = GENERAL)]
    help: Option<bool>,
    /// Print the version.
    #[arg(long, short = 'V', action = ArgAction::Version, help_heading = GENERAL)]
    version: Option<bool>,
}

/// What every subcommand has; it comes last.
const GENERAL: &str = "General";

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve over gRPC until SIGTERM or Ctrl-C.
    Serve(ServeArgs),
    /// Check and print the configuration of `serve`.
    Config(config::ConfigArgs),
    /// Remesh a surface: sample, iterate, triangulate, repair, measure.
    Remesh(remesh::RemeshArgs),
    /// Compute the restricted Voronoi diagram of seeds on a surface.
    Rvd(rvd::RvdArgs),
    /// Create, watch and end jobs of a server, and fetch their results.
    Jobs(jobs::JobsArgs),
    /// Store files at a server and fetch them.
    Blobs(blobs::BlobsArgs),
    /// Say what a server's journal of jobs holds, and mend a damaged one; the server does not run meanwhile.
    Journal(journal::JournalArgs),
    /// List and drain the servers that share a database, and try again jobs that failed for crashes.
    #[cfg(feature = "postgres")]
    Cluster(cluster::ClusterArgs),
    /// Bring the schema of the database that servers share up to date, and check what is kept.
    #[cfg(feature = "postgres")]
    Store(cluster::StoreArgs),
    /// Make, list and revoke the keys of a server, in its folder.
    Keys(keys::KeysArgs),
    /// Say whether a server takes calls; exit code 69 if it does not.
    Health(health::HealthArgs),
    /// Say what a server is and what it takes.
    Info(info::InfoArgs),
    /// Put a server under load, and measure how it answers.
    Load(Box<load::LoadArgs>),
    /// Measure speed.
    Bench(bench::BenchArgs),
    /// Measure a mesh, and how far it is from the one it was made from.
    Measure(measure::MeasureArgs),
    /// Write a procedural surface.
    Shape(shape::ShapeArgs),
    /// Say what this machine has and what would be used.
    Doctor(backends::DoctorArgs),
    /// Print a script that completes words of this program in a shell.
    Completions(completions::CompletionsArgs),
    /// Print the page of the manual, or write those of all commands.
    Man(completions::ManArgs),
}

/// Runs the program on its own command line.
pub fn main() -> ExitCode {
    surroundings::within(run)
}

fn run() -> u8 {
    execute().map_or_else(
        |error| {
            errln!("tessera: {}", say::plain_lines(&format!("{error:#}")));
            exit::code(&error)
        },
        |()| 0,
    )
}

fn execute() -> anyhow::Result<()> {
    let line: Vec<_> = std::env::args_os().collect();
    let Given { cli, options } = config::parse(&line)?;
    let traces = |args: &ServeArgs| args.check().and_then(|_| args.watching.traces());
    let is_text = cli.log_format == LogFormat::Text;
    let (filter, traces) = match &cli.command {
        // A person at a terminal sees the addresses, and what goes wrong.
        Command::Serve(args) if is_text && std::io::stderr().is_terminal() => ("warn", traces(args)?),
        Command::Serve(args) => ("info", traces(args)?),
        _ => ("warn", None),
    };
    let _telemetry = telemetry::start(cli.log_format, filter, traces.as_ref())?;
    match &cli.command {
        Command::Serve(args) => serve::run(args),
        Command::Config(args) => config::run(args, options.as_ref()),
        Command::Remesh(args) => remesh::run(args),
        Command::Rvd(args) => rvd::run(args),
        Command::Jobs(args) => jobs::run(args),
        Command::Blobs(args) => blobs::run(args),
        Command::Journal(args) => journal::run(args),
        #[cfg(feature = "postgres")]
        Command::Cluster(args) => cluster::cluster(args),
        #[cfg(feature = "postgres")]
        Command::Store(args) => cluster::store(args),
        Command::Keys(args) => keys::run(args),
        Command::Health(args) => health::run(args),
        Command::Info(args) => info::run(args),
        Command::Load(args) => load::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Measure(args) => measure::run(args),
        Command::Shape(args) => shape::run(args),
        Command::Doctor(args) => backends::run(args),
        Command::Completions(args) => completions::completions(args, config::command()),
        Command::Man(args) => completions::man(args, config::command()),
    }
}
