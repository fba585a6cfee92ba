//! `tessera config`.

use anyhow::{Context, Result};
use clap::{ArgMatches, Args, Subcommand};

use super::serve;
pub(crate) use server::config::{self, ServeArgs};

/// `tessera config`'s options.
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
    /// The server's options.
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
