//! Lines on the standard output and the standard error stream, and text from elsewhere, made fit to be shown.
//!
//! Purpose: a server's words cannot move the cursor, change colours, turn the writing round or hide what follows ([`plain`]).
//! Invariant: a closed pipe is no error, so that work which writes files still ends and writes them; any other failure of the
//! standard output is one, since the output was the result. Nothing else in the program prints. Must not know: what is printed.

use std::io::{ErrorKind, Write};
use std::{fmt, io};

use clap::Args;
use serde_json::Value;

use super::exit::NotWritten;

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

/// The most characters of a message that are shown.
const MOST: usize = 2000;

/// `text` on one line, its control characters replaced, and no longer than is of use.
pub(crate) fn plain(text: &str) -> String {
    let mut line: String = text.trim().chars().take(MOST).map(shown).collect();
    if text.trim().chars().nth(MOST).is_some() {
        line.push('…');
    }
    line
}

/// `text` as it is, line by line, its control characters replaced.
pub(crate) fn plain_lines(text: &str) -> String {
    text.chars().map(|c| if c == '\n' { c } else { shown(c) }).collect()
}

/// A report whose strings can be shown. Numbers, and the order of its keys, stay as they are.
pub(crate) fn plain_json(value: Value) -> Value {
    let clean = |text: String| if text.chars().any(hidden) { text.chars().map(shown).collect() } else { text };
    match value {
        Value::String(text) => Value::String(clean(text)),
        Value::Array(all) => Value::Array(all.into_iter().map(plain_json).collect()),
        Value::Object(all) => Value::Object(all.into_iter().map(|(k, v)| (clean(k), plain_json(v))).collect()),
        other => other,
    }
}

fn shown(c: char) -> char {
    match c {
        '\n' | '\r' | '\t' => ' ',
        c if hidden(c) => char::REPLACEMENT_CHARACTER,
        c => c,
    }
}

/// Characters that act on their surroundings or cannot be seen: control characters, directions of writing, joiners,
/// line separators, tags.
fn hidden(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}')
        || matches!(c, '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_pipe_is_no_error() {
        assert!(heard(Err(ErrorKind::BrokenPipe.into())).is_ok());
        assert!(heard(Err(ErrorKind::StorageFull.into())).is_err());
    }

    #[test]
    fn nothing_acts_on_a_terminal() {
        assert_eq!(
            plain("\u{1b}[31mbad\u{7}\nline\t\u{202e}x\u{9b}"),
            "\u{fffd}[31mbad\u{fffd} line \u{fffd}x\u{fffd}"
        );
        assert_eq!(plain(" Größe 3 µm, χ 2 \n"), "Größe 3 µm, χ 2");
        let long = plain(&"x".repeat(5000));
        assert!(long.chars().count() == MOST + 1 && long.ends_with('…'));
    }

    #[test]
    fn lines_stay_lines() {
        assert_eq!(plain_lines("a\n\tb\u{1b}[2J\rc\n"), "a\n b\u{fffd}[2J c\n");
    }

    #[test]
    fn a_report_keeps_all_but_such_characters() {
        let usual = serde_json::json!({"b": 1, "a": ["x", {"c": null}], "d": 0.5});
        assert_eq!(plain_json(usual.clone()).to_string(), usual.to_string());
        let odd = serde_json::json!({"\u{1b}k": ["\u{202e}v"]});
        assert_eq!(plain_json(odd), serde_json::json!({"\u{fffd}k": ["\u{fffd}v"]}));
    }
}
