//! Derives the sources of values from clap's result.
//!
//! Invariant: an option without a value has no source. Must not know: options by name.

use clap::ArgMatches;
use clap::parser::ValueSource;

use super::file::ConfigFile;
use super::options::{is_key, options};
use super::sources::{Source, Sources};

/// The sources of clap's values, with the keys of `file` as defaults.
pub fn sources(found: &ArgMatches, file: Option<&ConfigFile>) -> Sources {
    let of = |arg: &clap::Arg| {
        let (id, long) = (arg.get_id().as_str(), arg.get_long()?);
        Some(match found.try_contains_id(id).ok().and_then(|_| found.value_source(id))? {
            ValueSource::EnvVariable => Source::Environment(arg.get_env()?.to_string_lossy().into_owned()),
            ValueSource::CommandLine => Source::Line(format!("--{long}")),
            _ => file.and_then(|file| file.source(id)).unwrap_or(Source::Default),
        })
    };
    let command = options();
    let keys = command.get_arguments().filter(|arg| is_key(arg));
    Sources(keys.filter_map(|arg| Some((arg.get_id().to_string(), of(arg)?))).collect())
}
