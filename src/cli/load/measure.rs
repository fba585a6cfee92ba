//! What a load came to: latencies, counts, and both by the second.
//!
//! Invariant: a latency runs from the time when its call was to begin, not from when it did: a stall counts for all calls
//! that were to begin meanwhile. Calls that were to begin in the measured time are counted; rates are of calls that ended in
//! it. Must not know: how calls are made, how figures are shown.

use std::collections::BTreeMap;
use std::ops::Range;
use std::time::Duration;

use hdrhistogram::Histogram;
use serde::Serialize;

use super::amounts::Kind;
use super::calls::{Asked, Outcome, Stages};

/// A call that began later than this after it was to begin is late.
pub(super) const LATE: Duration = Duration::from_millis(10);
/// The most reasons and codes with an entry of their own.
const NAMES: usize = 50;
const OTHER: &str = "other";

/// Latencies, kept to three digits.
#[derive(Clone, Debug)]
pub(super) struct Latencies(Option<Histogram<u64>>);

impl Default for Latencies {
    fn default() -> Self {
        /// A day, in microseconds.
        const MOST: u64 = 86_400_000_000;
        Self(Histogram::new_with_bounds(1, MOST, 3).ok())
    }
}

impl Latencies {
    fn add(&mut self, time: Duration) {
        if let Some(all) = &mut self.0 {
            all.saturating_record(u64::try_from(time.as_micros()).unwrap_or(u64::MAX));
        }
    }

    pub(super) fn count(&self) -> u64 {
        self.0.as_ref().map_or(0, Histogram::len)
    }

    fn seconds(&self, of: impl FnOnce(&Histogram<u64>) -> f64) -> Option<f64> {
        self.0.as_ref().filter(|all| !all.is_empty()).map(|all| of(all) / 1e6)
    }

    /// Seconds that the part `part` of all did not exceed.
    pub(super) fn quantile(&self, part: f64) -> Option<f64> {
        self.seconds(|all| all.value_at_quantile(part) as f64)
    }

    pub(super) fn mean(&self) -> Option<f64> {
        self.seconds(Histogram::mean)
    }

    pub(super) fn max(&self) -> Option<f64> {
        self.seconds(|all| all.max() as f64)
    }
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Times {
    pub(super) count: u64,
    /// The message of the first.
    pub(super) example: String,
}

/// Outcomes of calls of a sort, such as those of slow readers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Counts {
    /// Calls that were to begin.
    pub(super) intended: u64,
    pub(super) done: u64,
    /// Cancelled, as the plan said.
    pub(super) cancelled: u64,
    /// Not sent, since too many were open.
    pub(super) dropped: u64,
    pub(super) late: u64,
    /// Open when the run was stopped.
    pub(super) stopped: u64,
    #[serde(rename = "refusals")]
    pub(super) refused: BTreeMap<String, u64>,
    #[serde(rename = "failures")]
    pub(super) failed: BTreeMap<String, Times>,
}

impl Counts {
    pub(super) fn refusals(&self) -> u64 {
        self.refused.values().sum()
    }

    pub(super) fn errors(&self) -> u64 {
        self.failed.values().map(|times| times.count).sum()
    }

    fn add(&mut self, outcome: &Outcome) {
        match outcome {
            Outcome::Done => self.done += 1,
            Outcome::Cancelled => self.cancelled += 1,
            Outcome::Stopped => self.stopped += 1,
            Outcome::Refused { reason, .. } => *named(&mut self.refused, reason) += 1,
            Outcome::Failed { code, said } => {
                let times = named(&mut self.failed, code);
                times.count += 1;
                if times.example.is_empty() {
                    said.clone_into(&mut times.example);
                }
            }
        }
    }
}

/// The entry of a name, or of all that find no place.
fn named<'a, V: Default>(all: &'a mut BTreeMap<String, V>, name: &str) -> &'a mut V {
    let name = if all.contains_key(name) || all.len() < NAMES { name } else { OTHER };
    all.entry(name.to_owned()).or_default()
}

/// Calls that ended in a second, and their latencies in seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Second {
    /// Seconds since the run began.
    #[serde(rename = "at_s")]
    pub(super) at: u64,
    pub(super) done: u64,
    pub(super) refused: u64,
    pub(super) failed: u64,
    pub(super) dropped: u64,
    #[serde(rename = "p50_s")]
    pub(super) p50: Option<f64>,
    #[serde(rename = "p99_s")]
    pub(super) p99: Option<f64>,
    #[serde(rename = "max_s")]
    pub(super) max: Option<f64>,
}

/// Calls with a result in the measured time, and what they carried.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Amounts {
    pub(super) done: u64,
    pub(super) facets: u64,
    pub(super) seeds: u64,
    pub(super) sent_bytes: u64,
    pub(super) came_bytes: u64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct When {
    pub(super) kind: Kind,
    pub(super) slow: bool,
    /// Since the run began: when it was to begin, when it did, when it ended.
    pub(super) intended: Duration,
    pub(super) sent: Duration,
    pub(super) ended: Duration,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Measure {
    /// The measured time, since the run began.
    pub(super) window: Range<Duration>,
    /// Of all calls but those of slow readers.
    pub(super) counts: Counts,
    pub(super) latencies: Latencies,
    /// By kind, in the order of [`Kind::ALL`].
    pub(super) kinds: [Latencies; Kind::ALL.len()],
    /// By stage, in the order of [`Stages::NAMES`].
    pub(super) stages: [Latencies; Stages::NAMES.len()],
    pub(super) slow: Counts,
    pub(super) slow_latencies: Latencies,
    pub(super) amounts: Amounts,
    /// Second by second, from the beginning.
    pub(super) seconds: Vec<Second>,
    now: Second,
    now_latencies: Latencies,
}

impl Measure {
    pub(super) fn new(window: Range<Duration>) -> Self {
        Self { window, ..Self::default() }
    }

    /// A call that was to begin then was not sent.
    pub(super) fn dropped(&mut self, intended: Duration) {
        self.turn(intended);
        self.now.dropped += 1;
        if self.window.contains(&intended) {
            self.counts.intended += 1;
            self.counts.dropped += 1;
        }
    }

    pub(super) fn over(&mut self, when: &When, asked: &Asked) {
        let latency = when.ended.saturating_sub(when.intended);
        let is_done = asked.outcome == Outcome::Done;
        if !when.slow {
            self.turn(when.ended);
            match &asked.outcome {
                Outcome::Done => {
                    self.now.done += 1;
                    self.now_latencies.add(latency);
                }
                Outcome::Refused { .. } => self.now.refused += 1,
                Outcome::Failed { .. } => self.now.failed += 1,
                Outcome::Cancelled | Outcome::Stopped => {}
            }
        }
        if is_done && !when.slow && self.window.contains(&when.ended) {
            self.amounts.done += 1;
            self.amounts.facets += asked.facets;
            self.amounts.seeds += asked.seeds;
            self.amounts.sent_bytes += asked.sent_bytes;
            self.amounts.came_bytes += asked.came_bytes;
        }
        if !self.window.contains(&when.intended) {
            return;
        }
        let counts = if when.slow { &mut self.slow } else { &mut self.counts };
        counts.intended += 1;
        counts.late += u64::from(when.sent.saturating_sub(when.intended) > LATE);
        counts.add(&asked.outcome);
        if !is_done {
            return;
        }
        if when.slow {
            self.slow_latencies.add(latency);
            return;
        }
        self.latencies.add(latency);
        if let Some(kind) = self.kinds.get_mut(when.kind as usize) {
            kind.add(latency);
        }
        for (stage, time) in self.stages.iter_mut().zip(asked.stages.all()) {
            time.into_iter().for_each(|time| stage.add(time));
        }
    }

    /// The run was ended early: what would have come does not count.
    pub(super) fn cut(&mut self, at: Duration) {
        self.window.end = self.window.end.min(at).max(self.window.start);
    }

    /// The seconds up to `at` are over. What comes a little out of order is counted where it comes.
    pub(super) fn turn(&mut self, at: Duration) {
        while self.now.at < at.as_secs() {
            let next = Second { at: self.now.at + 1, ..Second::default() };
            let mut second = std::mem::replace(&mut self.now, next);
            second.p50 = self.now_latencies.quantile(0.5);
            second.p99 = self.now_latencies.quantile(0.99);
            second.max = self.now_latencies.max();
            self.now_latencies.0.iter_mut().for_each(Histogram::reset);
            self.seconds.push(second);
        }
    }

    pub(super) fn seconds_measured(&self) -> f64 {
        self.window.end.saturating_sub(self.window.start).as_secs_f64()
    }

    /// `count` a second of the measured time.
    pub(super) fn rate(&self, count: u64) -> f64 {
        let seconds = self.seconds_measured();
        if seconds > 0.0 { count as f64 / seconds } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: Duration = Duration::from_secs(1);

    fn asked(outcome: Outcome) -> Asked {
        let stages = Stages { queue: Some(S), ..Stages::default() };
        Asked { outcome, stages, facets: 100, seeds: 10, sent_bytes: 5, came_bytes: 7, rubbish: None }
    }

    fn when(intended: f64, sent: f64, ended: f64) -> When {
        let [intended, sent, ended] = [intended, sent, ended].map(Duration::from_secs_f64);
        When { kind: Kind::Rvd, slow: false, intended, sent, ended }
    }

    #[test]
    fn a_latency_runs_from_when_it_was_to_begin() {
        let mut measure = Measure::new(2 * S..10 * S);
        // Of the warm-up; ends in the measured time.
        measure.over(&when(1.0, 1.0, 2.5), &asked(Outcome::Done));
        assert_eq!((measure.counts.intended, measure.amounts.done), (0, 1));
        // A stall of 3 s before it was sent.
        measure.over(&when(4.0, 7.0, 7.5), &asked(Outcome::Done));
        let [max, p50] = [measure.latencies.max(), measure.latencies.quantile(0.5)].map(Option::unwrap);
        assert!((max - 3.5).abs() < 0.01 && (p50 - 3.5).abs() < 0.01, "{max} {p50}");
        assert_eq!((measure.counts.late, measure.counts.done, measure.kinds[Kind::Rvd as usize].count()), (1, 1, 1));
        assert_eq!(measure.stages[1].count(), 1);
        // Ends after the measured time: counted, but of no rate.
        measure.over(&when(9.0, 9.0, 12.0), &asked(Outcome::Done));
        assert_eq!((measure.counts.done, measure.amounts.done, measure.amounts.facets), (2, 2, 200));
        assert!((measure.rate(measure.amounts.done) - 0.25).abs() < 1e-12);
        measure.dropped(5 * S);
        measure.dropped(11 * S);
        assert_eq!((measure.counts.dropped, measure.counts.intended), (1, 3));
    }

    #[test]
    fn seconds_have_what_ended_in_them() {
        let mut measure = Measure::new(Duration::ZERO..10 * S);
        measure.over(&when(0.1, 0.1, 0.2), &asked(Outcome::Done));
        let refused = Outcome::Refused { reason: "full".to_owned(), after: S };
        measure.over(&when(0.3, 0.3, 2.2), &asked(refused));
        measure.over(&when(0.3, 0.3, 2.3), &asked(Outcome::Failed { code: "X".to_owned(), said: "why".to_owned() }));
        measure.turn(4 * S);
        let all: Vec<_> = measure.seconds.iter().map(|s| (s.at, s.done, s.refused, s.failed)).collect();
        assert_eq!(all, [(0, 1, 0, 0), (1, 0, 0, 0), (2, 0, 1, 1), (3, 0, 0, 0)]);
        assert!(
            measure.seconds[0].p99.is_some_and(|p99| (p99 - 0.1).abs() < 0.001) && measure.seconds[1].p50.is_none()
        );
        assert_eq!((measure.counts.refusals(), measure.counts.errors()), (1, 1));
        assert_eq!(measure.counts.failed["X"].example, "why");
    }

    #[test]
    fn names_of_strangers_do_not_grow_without_end() {
        let mut counts = Counts::default();
        for k in 0..500 {
            counts.add(&Outcome::Refused { reason: format!("{k}"), after: S });
        }
        assert_eq!((counts.refused.len(), counts.refusals()), (NAMES + 1, 500));
        assert_eq!(counts.refused[OTHER], 450);
    }
}
