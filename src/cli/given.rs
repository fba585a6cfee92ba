//! Options, and which of them are set.
//!
//! Purpose: a message leaves open what the user left open, so that defaults apply where the work is done. [`message`] makes
//! the message of a remesh of the options that are set, by their names. Invariant: an option's id is its name in the schema.
//! Must not know: what an option means.

use std::collections::BTreeMap;
use std::ops::Deref;

use anyhow::Result;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::parser::ValueSource;
use clap::{ArgMatches, Args, Command, FromArgMatches, Id};

use crate::exit::Usage;
use wire::fields::{BETWEEN, Fields};
use wire::proto;

pub(crate) type Texts = BTreeMap<String, String>;

#[derive(Debug)]
pub(crate) struct Given<A> {
    options: A,
    /// Those that are set.
    pub(crate) set: Texts,
}

/// The options of a remesh that are set. Files of lists are no options of the message. Errors: `Usage` for a value that the
/// schema does not have.
pub(crate) fn message(given: &[&Texts]) -> Result<proto::RemeshOptions> {
    let mut fields = Fields::default();
    for (name, text) in given.iter().copied().flatten() {
        let wrong = |must| Usage(format!("--{} is {text}; it must be {must}", name.replace('_', "-")));
        fields.set(name, text).map_err(wrong)?;
    }
    Ok(fields.finish())
}

/// Words that an option takes, each with its help and what it stands for.
pub(crate) type Words<T> = &'static [(&'static str, &'static str, T)];

/// Reads one of these words.
pub(crate) fn words<T: Clone + Send + Sync + 'static>(all: Words<T>) -> impl TypedValueParser<Value = T> {
    // Messages and HTTP have underscores.
    let value = |word: &'static str, help| PossibleValue::new(word).alias(word.replace('-', "_")).help(help);
    PossibleValuesParser::new(all.iter().map(|(word, help, _)| value(word, *help))).try_map(|word| {
        let known = all.iter().find(|(known, ..)| *known == word.replace('_', "-"));
        known.map(|(.., value)| value.clone()).ok_or("is no such word")
    })
}

impl<A> Deref for Given<A> {
    type Target = A;

    fn deref(&self) -> &A {
        &self.options
    }
}

fn set(matches: &ArgMatches) -> Texts {
    let is_set = |id: &&Id| {
        matches!(matches.value_source(id.as_str()), Some(ValueSource::CommandLine | ValueSource::EnvVariable))
    };
    let text = |id: &Id| {
        let raw = matches.try_get_raw(id.as_str()).ok().flatten().into_iter().flatten();
        let all: Vec<_> = raw.map(|raw| raw.to_string_lossy()).collect();
        (id.as_str().to_owned(), all.join(&BETWEEN.to_string()))
    };
    matches.ids().filter(is_set).map(text).collect()
}

impl<A: FromArgMatches> FromArgMatches for Given<A> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        Ok(Self { set: set(matches), options: A::from_arg_matches(matches)? })
    }

    fn from_arg_matches_mut(matches: &mut ArgMatches) -> Result<Self, clap::Error> {
        // Taking the options takes them out.
        Ok(Self { set: set(matches), options: A::from_arg_matches_mut(matches)? })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.set.extend(set(matches));
        self.options.update_from_arg_matches(matches)
    }
}

impl<A: Args> Args for Given<A> {
    fn group_id() -> Option<Id> {
        A::group_id()
    }

    fn augment_args(command: Command) -> Command {
        A::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        A::augment_args_for_update(command)
    }
}
