//! The options of a server as data: names, types of values, and the configuration as a file.
//!
//! Purpose: rules for all options (keys of the file, printing, tests) use this, so that an option is described once, in
//! `args`. [`print`] writes a configuration that can be read back and gives the same; an option without a value is a comment.
//! Invariant: nothing here names an option. No secret is printed: secrets are given by file, or are the password of a URL.
//! Must not know: the use of values.

use std::any::TypeId;
use std::fmt::Write;

use clap::builder::{BoolishValueParser, Resettable};
use clap::{Arg, ArgAction, ArgMatches, Args, Command};
use toml::Value;

use super::args::ServeArgs;
use super::values::without_password;
use crate::config::args::Sources;

/// The option that names the file; no key of it.
pub(super) const CONFIG: &str = "config";

/// The type of an option's value in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// `true` or `false`.
    Switch,
    /// A number, whole or not.
    Number,
    /// Anything else, in quotes.
    Text,
}

pub(super) fn options() -> Command {
    with_switches(ServeArgs::augment_args(Command::new("serve")))
}

/// The command without the environment, for reading the defaults.
pub(super) fn untouched() -> Command {
    options().mut_args(|arg| arg.env(Resettable::Reset))
}

/// The defaults of all options. Errors: a fault of the program: an option without a default that is needed.
pub fn defaults() -> Result<ArgMatches, clap::Error> {
    untouched().try_get_matches_from(["serve"])
}

/// Lets a switch be taken back that the file or the environment has turned on: `--ephemeral=false`.
pub fn with_switches(command: Command) -> Command {
    command.mut_args(|arg| match (arg.get_action(), arg.get_env()) {
        (ArgAction::SetTrue, Some(_)) => arg
            .action(ArgAction::Set)
            .num_args(0..=1)
            .require_equals(true)
            .default_value("false")
            .default_missing_value("true")
            .value_name("BOOL")
            .value_parser(BoolishValueParser::new())
            .hide_possible_values(true)
            .hide_default_value(true),
        _ => arg,
    })
}

/// Whether an option can be a key of the file.
pub(super) fn is_key(arg: &Arg) -> bool {
    arg.get_long().is_some() && arg.get_id() != CONFIG
}

/// Whether it may be given more than once.
pub(super) fn is_list(arg: &Arg) -> bool {
    matches!(arg.get_action(), ArgAction::Append) || arg.get_value_delimiter().is_some()
}

pub(super) fn kind(arg: &Arg) -> Kind {
    let of = arg.get_value_parser().type_id();
    let numbers = [
        TypeId::of::<u8>(),
        TypeId::of::<u16>(),
        TypeId::of::<u32>(),
        TypeId::of::<u64>(),
        TypeId::of::<usize>(),
        TypeId::of::<f64>(),
    ];
    match () {
        () if of == TypeId::of::<bool>() => Kind::Switch,
        () if numbers.iter().any(|number| of == *number) => Kind::Number,
        () => Kind::Text,
    }
}

/// Whether the option takes `value`; else clap's sentence.
pub(super) fn takes(arg: &Arg, value: &str) -> Result<(), String> {
    let Some(long) = arg.get_long() else { return Ok(()) };
    let alone = arg.clone().required(false).env(Resettable::Reset);
    let line = ["tessera".to_owned(), format!("--{long}={value}")];
    match Command::new("tessera").arg(alone).try_get_matches_from(line) {
        Ok(_) => Ok(()),
        Err(error) => Err(sentence(&error)),
    }
}

/// Clap's message without its hints for the command line.
fn sentence(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let first = text.split("\n\n").next().unwrap_or_default();
    let words: Vec<&str> = first.trim_start_matches("error: ").split_whitespace().collect();
    words.join(" ")
}

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
            Kind::Text => quoted(&without_password(&raw)),
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
