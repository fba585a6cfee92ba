//! The program: parse, start logging, call one subcommand.

use std::process::ExitCode;

/// A server's memory is to be what its jobs need now, not what they needed once.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    tessera::internals::cli::main()
}
