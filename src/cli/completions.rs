//! `tessera completions` and `tessera man`: what shells and readers of manuals need to know of the command line.
//!
//! Purpose: both are made of the options themselves, so that they cannot tell anything else. Invariant: nothing is written but to
//! the standard output or to the folder that was named. Must not know: what any option does.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use clap_complete::Shell;

use super::exit::{NoFolder, NotWritten};
use super::say;

#[derive(Args, Debug)]
pub(crate) struct CompletionsArgs {
    /// The shell. Bash: `source <(tessera completions bash)`.
    #[arg(value_enum)]
    shell: Shell,
}

#[derive(Args, Debug)]
pub(crate) struct ManArgs {
    /// Write the pages of all commands there, as tessera.1, tessera-remesh.1 and so on, instead of the first one to the standard
    /// output.
    #[arg(long, value_name = "DIR")]
    out_dir: Option<PathBuf>,
}

pub(crate) fn completions(args: &CompletionsArgs, mut command: clap::Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "tessera", &mut script);
    Ok(say::line(format_args!("{}", String::from_utf8_lossy(&script).trim_end()))?)
}

pub(crate) fn man(args: &ManArgs, command: clap::Command) -> Result<()> {
    let Some(folder) = &args.out_dir else {
        let mut page = Vec::new();
        clap_mangen::Man::new(command).render(&mut page)?;
        return Ok(say::line(format_args!("{}", String::from_utf8_lossy(&page).trim_end()))?);
    };
    if !folder.is_dir() {
        return Err(NoFolder { path: folder.join("tessera.1"), folder: folder.clone() }.into());
    }
    clap_mangen::generate_to(command, folder)
        .map_err(|error| NotWritten(format!("cannot write pages to {}: {error}", folder.display())).into())
}
