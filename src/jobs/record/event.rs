//! What happened to a job, numbered.
//!
//! Purpose: [`Event`], and `Log`, the events of one job that are kept. Invariant: numbers of a job begin at 1, rise and are
//! never used twice, a restart of the process included. State changes are always kept. Of stages and iterations at most
//! [`KEPT_PROGRESS`] are: the oldest iterations go first. A number that is not there was one of those, or was never given.
//! Must not know: stores, watchers.

use serde::{Deserialize, Serialize};

use crate::record::Time;
use crate::record::state::State;

/// The most stages and iterations that are kept of a job.
pub const KEPT_PROGRESS: usize = 64;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Event {
    /// From 1, rising.
    pub number: u64,
    pub at: Time,
    pub what: What,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum What {
    State {
        state: State,
        /// Times that it had been begun by then.
        attempt: u32,
    },
    Progress(Progress),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Progress {
    Stage {
        /// Its name, as in the stream's `Progress`.
        name: String,
        done: u64,
        /// Steps planned; 0 if not known.
        total: u64,
    },
    Iteration {
        /// From 0.
        index: u64,
        /// Steps planned; 0 if not known.
        total: u64,
        /// "lloyd" or "lbfgs".
        kind: String,
        /// Energy of the seeds before the step.
        energy: f64,
        /// Over that of regular hexagons; 0 if not known, as in records of earlier releases.
        #[serde(default)]
        energy_ratio: f64,
        gradient_norm: f64,
        /// Wall-clock milliseconds.
        ms: f64,
    },
}

impl Progress {
    /// With numbers that a record can hold: one that is not finite becomes 0.
    pub fn finite(mut self) -> Self {
        if let Self::Iteration { energy, energy_ratio, gradient_norm, ms, .. } = &mut self {
            for number in [energy, energy_ratio, gradient_norm, ms] {
                *number = if number.is_finite() { *number } else { 0.0 };
            }
        }
        self
    }
}

/// The events of one job that are kept, by number.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Log(Vec<Event>);

impl Log {
    /// The last number that is kept, or 0.
    pub fn last(&self) -> u64 {
        self.0.last().map_or(0, |event| event.number)
    }

    /// Adds what came later, and lets go of what is too much.
    pub fn push(&mut self, event: Event) {
        self.0.push(event);
        let is_progress = |event: &Event| matches!(event.what, What::Progress(_));
        let is_iteration = |event: &Event| matches!(event.what, What::Progress(Progress::Iteration { .. }));
        if self.0.iter().filter(|event| is_progress(event)).count() > KEPT_PROGRESS {
            let oldest = self.0.iter().position(is_iteration).or_else(|| self.0.iter().position(is_progress));
            oldest.map(|index| self.0.remove(index));
        }
    }

    /// The last stage that was begun since the job was.
    pub fn last_stage(&self) -> Option<&str> {
        self.0.iter().rev().take_while(|event| !matches!(event.what, What::State { .. })).find_map(|event| match &event
            .what
        {
            What::Progress(Progress::Stage { name, .. }) => Some(name.as_str()),
            _ => None,
        })
    }

    /// With what `later` has beyond this.
    pub fn extended(mut self, later: &Self) -> Self {
        let last = self.last();
        later.0.iter().filter(|event| event.number > last).for_each(|event| self.push(event.clone()));
        self
    }

    pub fn after(&self, after: u64, most: usize) -> Events {
        let events: Vec<Event> = self.0.iter().filter(|event| event.number > after).take(most).cloned().collect();
        let last = events.last().map_or(after, |event| event.number);
        Events { missing: last - after - events.len() as u64, events }
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Events {
    pub events: Vec<Event>,
    /// How many numbers between the one asked for and the last of these have no event: iterations that were thinned out,
    /// or were lost with the process.
    pub missing: u64,
}
