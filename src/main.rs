//! The program: parse, start logging, call one subcommand.

use std::process::ExitCode;

/// A server's memory is to be what its jobs need now, not what they needed once: what is free goes back to the system after ten
/// seconds, also where the threads that used it are idle.
#[cfg(target_os = "linux")]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> ExitCode {
    cli::main()
}
