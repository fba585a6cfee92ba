//! Options, and which of them somebody set.
//!
//! Purpose: a job leaves open what its caller left open, so that the server's own defaults apply. Commands that work here
//! share these options, with their defaults. Must not know: what an option means.

use std::collections::BTreeSet;
use std::ops::Deref;

use clap::parser::ValueSource;
use clap::{ArgMatches, Args, Command, FromArgMatches, Id};

#[derive(Debug)]
pub(super) struct Given<A> {
    options: A,
    set: BTreeSet<String>,
}

impl<A> Given<A> {
    /// `value`, if the option `id` was set. Ids are the names of fields.
    pub(super) fn given<T>(&self, id: &str, value: T) -> Option<T> {
        self.set.contains(id).then_some(value)
    }
}

impl<A> Deref for Given<A> {
    type Target = A;

    fn deref(&self) -> &A {
        &self.options
    }
}

fn set(matches: &ArgMatches) -> BTreeSet<String> {
    let is_set = |id: &&Id| {
        matches!(matches.value_source(id.as_str()), Some(ValueSource::CommandLine | ValueSource::EnvVariable))
    };
    matches.ids().filter(is_set).map(|id| id.as_str().to_owned()).collect()
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
