//! From the command line to the options, through the configuration's file; and `tessera config`.
//!
//! Purpose: [`parse`] reads the line twice where a file is named: once to find the file, once with the file's values as
//! defaults. Invariant: precedence is clap's: default, file, environment, line. Must not know: what is done with options.

use std::ffi::{OsStr, OsString};
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::builder::Resettable;
use clap::{ArgMatches, Args, CommandFactory, FromArgMatches, Subcommand};

use super::serve;
use crate::{Cli, Command};
pub(crate) use server::config::{self, ServeArgs};
use server::config::{ConfigFile, sources, with_switches};

#[derive(Args, Debug)]
pub(crate) struct ConfigArgs {
    #[command(subcommand)]
    command: ConfigCommand,
}

#[derive(Debug, Subcommand)]
enum ConfigCommand {
    /// Say whether `tessera serve` would take the configuration; exit code 2 if not. Takes every option of `serve`.
    Check(Box<ServeArgs>),
    /// Print the configuration that holds, as a file that can be read back, each value with where it came from. Takes every
    /// option of `serve`.
    Print(PrintArgs),
}

#[derive(Args, Debug)]
struct PrintArgs {
    /// Print what holds if nothing is said.
    #[arg(long)]
    defaults: bool,
    #[command(flatten)]
    options: Box<ServeArgs>,
}

impl ConfigArgs {
    pub(crate) fn options(&mut self) -> &mut ServeArgs {
        match &mut self.command {
            ConfigCommand::Check(options) => options,
            ConfigCommand::Print(args) => &mut args.options,
        }
    }
}

pub(crate) fn run(args: &ConfigArgs, found: Option<&ArgMatches>) -> Result<()> {
    match &args.command {
        ConfigCommand::Check(options) => {
            serve::check(options)?;
            outln!("good")?;
        }
        ConfigCommand::Print(args) if args.defaults => {
            let found = config::defaults().context("reading the defaults")?;
            outln!("{}", config::print(&found, &config::sources(&found, None)).trim_end())?;
        }
        ConfigCommand::Print(args) => {
            let found = found.context("reading the options")?;
            outln!("{}", config::print(found, &args.options.sources).trim_end())?;
            // What is printed is what was said; whether it is good is said too.
            serve::check(&args.options)?;
        }
    }
    Ok(())
}

/// Subcommands that take a server's options.
const SERVER: &[&[&str]] = &[&["serve"], &["config", "check"], &["config", "print"]];

/// The options of `config` that are its own, and the one that says which file is meant.
const SHOWN: &[&str] = &["config", "defaults"];

pub(super) struct Given {
    pub(super) cli: Cli,
    /// What clap found of a server's options, if the subcommand has them.
    pub(super) options: Option<ArgMatches>,
}

pub(super) fn command() -> clap::Command {
    without_empty(with_server(Cli::command(), &|options| options))
}

/// A variable that is set to nothing says nothing, as it does where a file of Compose passes on what is not set.
fn without_empty(command: clap::Command) -> clap::Command {
    let is_empty = |name: &OsStr| std::env::var_os(name).is_some_and(|value| value.is_empty());
    let reset = |arg: clap::Arg| if arg.get_env().is_some_and(is_empty) { arg.env(Resettable::Reset) } else { arg };
    let command = command.mut_args(reset);
    command.mut_subcommands(without_empty)
}

/// Changes the options of a server wherever they are.
fn with_server(command: clap::Command, change: &dyn Fn(clap::Command) -> clap::Command) -> clap::Command {
    let hidden = |command: clap::Command| {
        command.mut_args(|arg| {
            let shown = SHOWN.contains(&arg.get_id().as_str());
            arg.hide(!shown)
        })
    };
    command.mut_subcommand("serve", |serve| change(with_switches(serve))).mut_subcommand("config", |config| {
        config
            .mut_subcommand("check", |check| hidden(change(with_switches(check))))
            .mut_subcommand("print", |print| hidden(change(with_switches(print))))
    })
}

/// Reads the command line, and the file that it names. What clap refuses ends the process, as does `--help`.
pub(super) fn parse(line: &[OsString]) -> Result<Given> {
    let mut found = command().get_matches_from(line);
    let path = options(&found).and_then(|options| options.get_one::<PathBuf>("config"));
    let file = path.map(|path| ConfigFile::read(path)).transpose()?;
    if let Some(file) = &file {
        let command = with_server(Cli::command(), &|options| file.apply(options));
        found = without_empty(command).get_matches_from(line);
    }
    let mut cli = Cli::from_arg_matches(&found).unwrap_or_else(|error| error.format(&mut command()).exit());
    let options = options(&found).cloned();
    if let (Some(args), Some(options)) = (server(&mut cli.command), &options) {
        args.sources = sources(options, file.as_ref());
    }
    Ok(Given { cli, options })
}

fn options(found: &ArgMatches) -> Option<&ArgMatches> {
    SERVER.iter().find_map(|path| {
        path.iter().try_fold(found, |found, name| Some(found.subcommand().filter(|(given, _)| given == name)?.1))
    })
}

fn server(command: &mut Command) -> Option<&mut ServeArgs> {
    match command {
        Command::Serve(args) => Some(args),
        Command::Config(args) => Some(args.options()),
        _ => None,
    }
}
