//! `tessera journal`.
//!
//! Purpose: says what a server's journal holds, and mends one that is damaged. Invariant: no server uses it meanwhile; a
//! journal that is replaced is kept. Must not know: how a journal is laid out.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use serde_json::json;

use super::exit::{BadInput, NotWritten, Unavailable};
use super::say;
use jobs::store::{Findings, StoreError, check, repair};
pub(crate) use server::config::data_dir;

#[derive(Args, Debug)]
pub(crate) struct JournalArgs {
    #[command(subcommand)]
    command: JournalCommand,
    /// The server's folder, as `tessera serve` has it: the user's state directory if not given.
    #[arg(long, value_name = "DIR", global = true, env = "TESSERA_DATA_DIR")]
    data_dir: Option<PathBuf>,
    /// Print the answer as JSON.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum JournalCommand {
    /// Say whether the journal is whole, and how many jobs can be read. Exit code 65 if it is damaged.
    Check,
    /// Put a new journal with all jobs that can be read in the place of a damaged one, which is kept beside it. Exit code 65 if
    /// there are none.
    Repair,
}

pub(crate) fn run(args: &JournalArgs) -> Result<()> {
    let folder = data_dir(args.data_dir.as_ref())?;
    // The database's code may panic on a page of noise. It is caught and reported as a fault, without its trace.
    std::panic::set_hook(Box::new(|_| {}));
    let found = match args.command {
        JournalCommand::Check => check(&folder),
        JournalCommand::Repair => {
            let runtime = tokio::runtime::Builder::new_current_thread().build().context("cannot start the runtime")?;
            runtime.block_on(repair(&folder))
        }
    };
    let Findings { faults, jobs, lost, damaged } = found.map_err(told)?;
    if args.json {
        let lost: Vec<String> = lost.iter().map(ToString::to_string).collect();
        let damaged = damaged.as_ref().map(|path| path.display().to_string());
        say::json(&json!({ "faults": faults, "jobs": jobs, "lost": lost, "damaged_journal": damaged }))?;
    } else {
        for fault in &faults {
            outln!("fault   {fault}")?;
        }
        for id in &lost {
            outln!("lost    {id}")?;
        }
        outln!("jobs    {jobs} can be read")?;
        if let Some(path) = &damaged {
            outln!("kept    the damaged journal is {}", path.display())?;
        }
    }
    let is_whole = faults.is_empty() && lost.is_empty();
    match args.command {
        JournalCommand::Check if !is_whole => {
            Err(BadInput("the journal is damaged; `tessera journal repair` saves what can be read".to_owned()).into())
        }
        JournalCommand::Repair if jobs == 0 && damaged.is_some() => {
            let text = "no job could be saved: the new journal is empty; the damaged one is kept beside it";
            Err(BadInput(text.to_owned()).into())
        }
        _ => Ok(()),
    }
}

/// With the exit code of its kind.
fn told(error: StoreError) -> anyhow::Error {
    let text = error.to_string();
    match error {
        StoreError::InUse { .. } => Unavailable(text).into(),
        StoreError::Io { .. } => NotWritten(text).into(),
        _ => BadInput(text).into(),
    }
}
