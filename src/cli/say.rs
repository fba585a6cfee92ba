//! Lines on the standard output and the standard error stream.
//!
//! Invariant: a closed pipe is no error, so that work which writes files still ends and writes them; any other failure of
//! the standard output is one, since the output was the result. Nothing else in the program prints. Must not know: what is
//! printed.

use std::fmt;
use std::io::{self, ErrorKind, Write};

use clap::Args;

use super::exit::NotWritten;

/// How much is said.
#[derive(Args, Clone, Copy, Debug, Default)]
pub(crate) struct SayArgs {
    /// Say nothing but warnings and errors: no progress and no summary.
    #[arg(long, short)]
    pub(crate) quiet: bool,
    /// Print the report on the standard output, as JSON, and nothing else there.
    #[arg(long)]
    pub(crate) json: bool,
}

impl SayArgs {
    pub(crate) fn summary(&self) -> bool {
        !self.quiet && !self.json
    }
}

/// A line on the standard output. See [`line`].
macro_rules! outln {
    ($($text:tt)*) => { $crate::say::line(format_args!($($text)*)) };
}

/// A line on the standard error stream. See [`note`].
macro_rules! errln {
    ($($text:tt)*) => { $crate::say::note(format_args!($($text)*)) };
}

/// Writes a line to the standard output.
pub(crate) fn line(text: fmt::Arguments<'_>) -> Result<(), NotWritten> {
    try_line(text).map(|_| ())
}

/// Writes a line to the standard output; false if the pipe is closed.
pub(crate) fn try_line(text: fmt::Arguments<'_>) -> Result<bool, NotWritten> {
    let mut out = io::stdout().lock();
    let written = out.write_fmt(text).and_then(|()| out.write_all(b"\n")).and_then(|()| out.flush());
    let closed = written.as_ref().is_err_and(|error| error.kind() == ErrorKind::BrokenPipe);
    heard(written).map(|()| !closed)
}

/// Writes a line to the standard error stream. A failure of that has no other place to go.
pub(crate) fn note(text: fmt::Arguments<'_>) {
    // As one piece, so that lines of several writers do not mix.
    let _ = io::stderr().write_all(format!("{text}\n").as_bytes());
}

/// Writes a report to the standard output, as one line.
pub(crate) fn json_line(report: &serde_json::Value) -> Result<(), NotWritten> {
    line(format_args!("{report}"))
}

pub(crate) fn bytes(bytes: &[u8]) -> Result<(), NotWritten> {
    let mut out = io::stdout().lock();
    heard(out.write_all(bytes).and_then(|()| out.flush()))
}

fn heard(written: io::Result<()>) -> Result<(), NotWritten> {
    match written {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(NotWritten(format!("cannot write to the standard output: {error}")))
        }
        _ => Ok(()),
    }
}

pub(crate) fn json(report: &serde_json::Value) -> Result<(), NotWritten> {
    line(format_args!("{report:#}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_pipe_is_no_error() {
        assert!(heard(Err(ErrorKind::BrokenPipe.into())).is_ok());
        assert!(heard(Err(ErrorKind::StorageFull.into())).is_err());
    }
}
