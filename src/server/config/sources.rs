//! The source of each value.
//!
//! Purpose: [`Sources`] serves messages and the printed configuration.
//! Invariant: it decides nothing.
//! Must not know: values and their parsing.

use std::collections::BTreeMap;
use std::fmt;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// The program.
    Default,
    File {
        file: String,
        /// From 1 on.
        line: usize,
    },
    Environment(String),
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
pub struct Sources(pub(super) BTreeMap<String, Source>);

impl Sources {
    /// The source of an option's value (`--name`), if it is not the command line.
    pub(super) fn of(&self, option: &str) -> Option<&Source> {
        let key = option.trim_start_matches("--").replace('-', "_");
        self.0.get(&key).filter(|source| matches!(source, Source::File { .. } | Source::Environment(_)))
    }
}
