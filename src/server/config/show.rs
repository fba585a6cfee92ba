//! The configuration as a file.
//!
//! Purpose: [`print`] writes a configuration that can be read back.
//! Invariant: reading it gives the same configuration; an option without a value is a comment. No secret is printed, since
//! secrets are given by file.
//! Must not know: options by name.

use std::fmt::Write;

use clap::{Arg, ArgMatches};
use toml::Value;

use super::options::{Kind, is_key, is_list, kind, options};
use super::sources::Sources;

pub fn print(found: &ArgMatches, sources: &Sources) -> String {
    let mut out = format!("# What `tessera serve` {} would use. Name it with --config.\n", env!("CARGO_PKG_VERSION"));
    let mut heading = None;
    let command = options();
    for arg in command.get_arguments().filter(|arg| is_key(arg)) {
        if arg.get_help_heading() != heading {
            heading = arg.get_help_heading();
            let _ = writeln!(out, "\n# {}", heading.unwrap_or("Others"));
        }
        let key = arg.get_id();
        let _ = match (value(arg, found), sources.0.get(key.as_str())) {
            (Some(value), Some(source)) => writeln!(out, "{key} = {value}  # {source}"),
            (Some(value), None) => writeln!(out, "{key} = {value}"),
            (None, _) => writeln!(out, "# {key} is not set"),
        };
    }
    out
}

/// The value of an option, as the file has it.
fn value(arg: &Arg, found: &ArgMatches) -> Option<String> {
    let all: Vec<String> = found
        .try_get_raw(arg.get_id().as_str())
        .ok()??
        .map(|raw| raw.to_string_lossy())
        .map(|raw| match kind(arg) {
            Kind::Switch => switch(arg, found).unwrap_or(false).to_string(),
            Kind::Number => number(&raw).unwrap_or_else(|| quoted(&raw)),
            Kind::Text => quoted(&raw),
        })
        .collect();
    match is_list(arg) {
        true => Some(format!("[{}]", all.join(", "))),
        false => all.into_iter().next_back(),
    }
}

fn switch(arg: &Arg, found: &ArgMatches) -> Option<bool> {
    found.try_get_one::<bool>(arg.get_id().as_str()).ok()?.copied()
}

/// A number as TOML has it: the command line takes more, as `.5` and `007`.
fn number(raw: &str) -> Option<String> {
    let whole = raw.parse::<u64>().ok().map(|number| number.to_string());
    whole.or_else(|| raw.parse::<f64>().ok().map(|number| Value::Float(number).to_string()))
}

/// A text in quotes, on one line.
fn quoted(raw: &str) -> String {
    let mut out = String::from('"');
    for letter in raw.chars() {
        match letter {
            '"' | '\\' => out.extend(['\\', letter]),
            control if control.is_control() => {
                let _ = write!(out, "\\u{:04X}", u32::from(control));
            }
            other => out.push(other),
        }
    }
    out.push('"');
    out
}
