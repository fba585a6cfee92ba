//! Where each value came from.
//!
//! Purpose: [`Sources`], for messages and for what is printed. Invariant: it is read from what clap found and from the file,
//! and never decides anything. Must not know: values.

use std::collections::BTreeMap;
use std::fmt;

use clap::ArgMatches;
use clap::parser::ValueSource;

use super::file::ConfigFile;
use super::options::{is_key, options};

/// Where a value came from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    /// The program.
    Default,
    /// A line of the file.
    File {
        /// As it was named.
        file: String,
        /// From 1 on.
        line: usize,
    },
    /// A variable.
    Environment(String),
    /// The command line.
    Line(String),
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            Self::File { file, line } => write!(f, "{file}:{line}"),
            Self::Environment(name) => write!(f, "the variable {name}"),
            Self::Line(option) => write!(f, "{option} on the command line"),
        }
    }
}

/// The sources of all options that have a value, by name.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sources(BTreeMap<String, Source>);

impl Sources {
    /// Reads them from what clap found, with the keys of `file` as defaults.
    pub(crate) fn new(found: &ArgMatches, file: Option<&ConfigFile>) -> Self {
        let of = |arg: &clap::Arg| {
            let (id, long) = (arg.get_id().as_str(), arg.get_long()?);
            Some(match found.try_contains_id(id).ok().and_then(|_| found.value_source(id))? {
                ValueSource::EnvVariable => Source::Environment(arg.get_env()?.to_string_lossy().into_owned()),
                ValueSource::CommandLine => Source::Line(format!("--{long}")),
                _ => match file.and_then(|file| Some((file, file.line(id)?))) {
                    Some((file, line)) => Source::File { file: file.name(), line },
                    None => Source::Default,
                },
            })
        };
        let command = options();
        let keys = command.get_arguments().filter(|arg| is_key(arg));
        Self(keys.filter_map(|arg| Some((arg.get_id().to_string(), of(arg)?))).collect())
    }

    /// Where the value of an option came from, `--so`, if that is somewhere else than the command line.
    pub(super) fn of(&self, option: &str) -> Option<&Source> {
        let key = option.trim_start_matches("--").replace('-', "_");
        self.get(&key).filter(|source| matches!(source, Source::File { .. } | Source::Environment(_)))
    }

    /// The same by its key, the program's too.
    pub(super) fn get(&self, key: &str) -> Option<&Source> {
        self.0.get(key)
    }
}
