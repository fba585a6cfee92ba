//! The server's counts beside this side's.
//!
//! Purpose: [`Tally`] counts the calls of this side, [`Comparison`] compares them with what the server counted.
//! Invariant: every call that is begun is counted once: with the status that the server sent, or as unheard if none came. Equal
//! means equal: for each method and status as many calls, and what the server counted more is no more than what was unheard.
//! Must not know: what is asked, how the server's counts are had.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Value, json};
use tonic::{Code, Status};

use super::scrape::Samples;
use crate::remote::is_lost;
use jobs::lock;
use server::metrics::status_name;

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Row {
    /// Such as "OK".
    pub(super) status: String,
    pub(super) here: u64,
    #[serde(rename = "server")]
    pub(super) there: i64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Method {
    /// Such as "tessera.v1.JobService/CreateJob".
    #[serde(rename = "method")]
    pub(super) name: String,
    #[serde(rename = "counts")]
    pub(super) rows: Vec<Row>,
    /// Calls whose status did not come.
    pub(super) unheard: u64,
    pub(super) mean_s: Means,
}

/// Mean time of a method as each side measured it, seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Means {
    pub(super) here: Option<f64>,
    #[serde(rename = "server")]
    pub(super) there: Option<f64>,
}

impl Method {
    fn of(name: &str, calls: &Calls, before: &Samples, after: &Samples) -> Self {
        let of = |samples: &BTreeMap<(String, String), u64>, status: &str| {
            samples.get(&(name.to_owned(), status.to_owned())).copied().unwrap_or(0) as i64
        };
        let counted = before.calls.keys().chain(after.calls.keys());
        let theirs = counted.filter(|(method, _)| method == name).map(|(_, status)| status.as_str());
        let all: BTreeSet<&str> = theirs.chain(calls.heard.keys().copied()).collect();
        let rows: Vec<Row> = all
            .into_iter()
            .map(|status| Row {
                status: status.to_owned(),
                here: calls.heard.get(status).copied().unwrap_or(0),
                there: of(&after.calls, status) - of(&before.calls, status),
            })
            .filter(|row| row.here > 0 || row.there != 0)
            .collect();
        let sum = |samples: &Samples| {
            samples.seconds.iter().filter(|((method, _), _)| method == name).map(|(_, seconds)| seconds).sum::<f64>()
        };
        let count: i64 = rows.iter().map(|row| row.there).sum();
        let there = (count > 0).then(|| (sum(after) - sum(before)) / count as f64);
        Self { name: name.to_owned(), rows, unheard: calls.unheard, mean_s: Means { here: calls.mean_s(), there } }
    }

    fn more(&self) -> i64 {
        self.rows.iter().map(|row| row.there - row.here as i64).sum()
    }

    /// Rows that cannot be.
    fn mismatches(&self) -> u64 {
        let less = self.rows.iter().filter(|row| row.there < row.here as i64).count() as u64;
        match less == 0 && self.more() > self.unheard as i64 {
            true => self.rows.iter().filter(|row| row.there > row.here as i64).count() as u64,
            false => less,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Comparison {
    pub(super) methods: Vec<Method>,
    /// Refusals that the server counted, by reason.
    pub(super) refusals: BTreeMap<String, u64>,
    /// Facets and seeds that the server counted.
    pub(super) facets: u64,
    pub(super) seeds: u64,
}

impl Comparison {
    /// Of what was counted between two scrapes.
    pub(super) fn of(methods: &Methods, before: &Samples, after: &Samples) -> Self {
        let refusals = after.refusals.iter().map(|(reason, count)| {
            (reason.clone(), count.saturating_sub(before.refusals.get(reason).copied().unwrap_or(0)))
        });
        Self {
            methods: methods.iter().map(|(name, calls)| Method::of(name, calls, before, after)).collect(),
            refusals: refusals.filter(|(_, count)| *count > 0).collect(),
            facets: after.facets.saturating_sub(before.facets),
            seeds: after.seeds.saturating_sub(before.seeds),
        }
    }

    /// Rows in which the server counted what cannot be.
    pub(super) fn mismatches(&self) -> u64 {
        self.methods.iter().map(Method::mismatches).sum()
    }

    /// Whether the server has counted all that this side began.
    pub(super) fn is_whole(&self) -> bool {
        self.methods.iter().all(|method| method.more() == method.unheard as i64)
    }

    pub(super) fn calls(&self) -> u64 {
        self.methods.iter().map(|m| m.rows.iter().map(|row| row.here).sum::<u64>() + m.unheard).sum()
    }

    /// Calls whose status did not come.
    pub(super) fn unheard(&self) -> u64 {
        self.methods.iter().map(|method| method.unheard).sum()
    }

    pub(super) fn json(&self) -> Value {
        let method = |method: &Method| {
            let mut value = json!(method);
            value["equal"] = (method.mismatches() == 0).into();
            value
        };
        json!({
            "equal": self.mismatches() == 0, "mismatches": self.mismatches(), "calls": self.calls(),
            "unheard": self.unheard(), "methods": self.methods.iter().map(method).collect::<Vec<_>>(),
            "server_refusals": self.refusals, "server_facets": self.facets, "server_seeds": self.seeds,
        })
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Calls {
    /// Calls whose status came, by its name.
    pub(super) heard: BTreeMap<&'static str, u64>,
    pub(super) unheard: u64,
    /// Time of the calls whose status came.
    pub(super) time: Duration,
}

impl Calls {
    pub(super) fn mean_s(&self) -> Option<f64> {
        let heard: u64 = self.heard.values().sum();
        (heard > 0).then(|| self.time.as_secs_f64() / heard as f64)
    }
}

/// Calls by method, as "tessera.v1.JobService/CreateJob".
pub(super) type Methods = BTreeMap<&'static str, Calls>;

/// See the module's head. Clones share one state.
#[derive(Clone, Debug, Default)]
pub(super) struct Tally(Arc<Mutex<Methods>>);

impl Tally {
    pub(super) fn begin(&self, method: &'static str) -> Call {
        Call { tally: self.clone(), method, began: Instant::now(), heard: None }
    }

    pub(super) fn methods(&self) -> Methods {
        lock(&self.0).clone()
    }
}

/// A call under way; over when this is dropped.
#[derive(Debug)]
pub(super) struct Call {
    tally: Tally,
    method: &'static str,
    began: Instant,
    heard: Option<&'static str>,
}

impl Call {
    pub(super) fn over<T>(mut self, answer: &Result<T, Status>) {
        self.heard = match answer {
            Ok(_) => Some(status_name(Code::Ok as usize)),
            Err(status) => (!is_lost(status)).then(|| status_name(status.code() as usize)),
        };
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        let time = self.began.elapsed();
        let mut all = lock(&self.tally.0);
        let calls = all.entry(self.method).or_default();
        match self.heard {
            Some(status) => {
                *calls.heard.entry(status).or_default() += 1;
                calls.time += time;
            }
            None => calls.unheard += 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(counts: &[(&str, u64)]) -> Samples {
        let calls = counts.iter().map(|(status, count)| (("m".to_owned(), (*status).to_owned()), *count)).collect();
        Samples { calls, ..Samples::default() }
    }

    /// Mismatches of what this side counted, how many it did not hear of, and what the server counted.
    fn mismatches(here: &[(&'static str, u64)], unheard: u64, before: &[(&str, u64)], after: &[(&str, u64)]) -> u64 {
        let calls = Calls { heard: here.iter().copied().collect(), unheard, ..Calls::default() };
        Comparison::of(&Methods::from([("m", calls)]), &samples(before), &samples(after)).mismatches()
    }

    #[test]
    fn equal_is_equal() {
        let before = [("OK", 5), ("CANCELLED", 1)];
        assert_eq!(mismatches(&[("OK", 3)], 0, &before, &[("OK", 8), ("CANCELLED", 1)]), 0);
        assert_eq!(mismatches(&[("OK", 3)], 0, &before, &[("OK", 9), ("CANCELLED", 1)]), 1);
        assert_eq!(mismatches(&[("OK", 3)], 0, &before, &[("OK", 7), ("CANCELLED", 1)]), 1);
        assert_eq!(mismatches(&[("OK", 3)], 0, &before, &[("OK", 7), ("CANCELLED", 2)]), 1);
        // The server began anew.
        assert_eq!(mismatches(&[("OK", 3)], 0, &before, &[("OK", 2)]), 2);
    }

    #[test]
    fn a_call_that_was_given_up_may_have_ended_either_way() {
        for after in [[("OK", 3), ("CANCELLED", 2)], [("OK", 5), ("CANCELLED", 0)], [("OK", 3), ("CANCELLED", 1)]] {
            assert_eq!(mismatches(&[("OK", 3)], 2, &[], &after), 0, "{after:?}");
        }
        assert_eq!(mismatches(&[("OK", 3)], 2, &[], &[("OK", 3), ("CANCELLED", 3)]), 1);
        assert_eq!(mismatches(&[("OK", 3)], 2, &[], &[("OK", 2), ("CANCELLED", 2)]), 1);
    }

    #[test]
    fn every_call_is_counted_once() {
        let tally = Tally::default();
        tally.begin("a").over(&Ok(()));
        tally.begin("a").over::<()>(&Err(Status::resource_exhausted("full")));
        tally.begin("a").over::<()>(&Err(Status::from_error(Box::new(std::io::Error::other("broken wire")))));
        drop(tally.begin("a"));
        let all = tally.methods();
        assert_eq!(all["a"].heard, BTreeMap::from([("OK", 1), ("RESOURCE_EXHAUSTED", 1)]));
        assert_eq!(all["a"].unheard, 2);
    }
}
