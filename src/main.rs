//! The program: parse, start logging, call one subcommand.

use std::process::ExitCode;

fn main() -> ExitCode {
    tessera::internals::cli::main()
}
