//! The server's counts beside this side's.
//!
//! Purpose: [`Tally`] counts the calls of this side, [`Comparison`] compares them with what the server counted.
//! Invariant: every call that is begun is counted once: with the status that the server sent, or as unheard if none came. Equal
//! means equal: for each method and status as many calls, and what the server counted more is no more than what was unheard.
//! Must not know: what is asked, how the server's counts are had.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::Result;
use hyper::{StatusCode, Uri};
use serde::Serialize;
use serde_json::{Value, json};
use tonic::{Code, Status};

use crate::exit::Unavailable;
use crate::health::get;
use crate::remote::is_lost;
use jobs::lock;
use transport::status_name;

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

/// Reads `--metrics`: `http://HOST:PORT/PATH`; the port is 80 and the path `/metrics` if not given.
pub(super) fn metrics_url(text: &str) -> Result<Uri, String> {
    let wrong = |what: &str| format!("the address of metrics {what}; an example is http://127.0.0.1:9090/metrics");
    if !text.starts_with("http://") {
        return Err(wrong("begins with http://"));
    }
    let uri: Uri = text.parse().map_err(|_| wrong("needs a host"))?;
    let named = uri.authority().is_some_and(|place| !place.as_str().contains('@'));
    if named { Ok(uri) } else { Err(wrong("needs a host")) }
}

pub(super) type Key = (String, String);

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Samples {
    pub(super) calls: BTreeMap<Key, u64>,
    pub(super) seconds: BTreeMap<Key, f64>,
    pub(super) refusals: BTreeMap<String, u64>,
    pub(super) facets: u64,
    pub(super) seeds: u64,
}

impl Samples {
    fn of(text: &str) -> Self {
        let mut all = Self::default();
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            let Some((name, labels, value)) = sample(line) else { continue };
            let label = |wanted: &str| labels.iter().find(|(name, _)| *name == wanted).map(|(_, value)| value.clone());
            let key = || Some((label("rpc_method")?, label("rpc_response_status_code")?));
            match name {
                "rpc_server_call_duration_seconds_count" => {
                    all.calls.extend(key().map(|key| (key, value as u64)));
                }
                "rpc_server_call_duration_seconds_sum" => all.seconds.extend(key().map(|key| (key, value))),
                "tessera_refusals_total" => all.refusals.extend(label("reason").map(|reason| (reason, value as u64))),
                "tessera_facets_total" => all.facets = value as u64,
                "tessera_seeds_total" => all.seeds = value as u64,
                _ => {}
            }
        }
        all
    }
}

type Labels<'a> = Vec<(&'a str, String)>;

fn sample(line: &str) -> Option<(&str, Labels<'_>, f64)> {
    let name_end = line.find(['{', ' '])?;
    let (name, mut rest) = line.split_at(name_end);
    let mut labels = Vec::new();
    if let Some(inside) = rest.strip_prefix('{') {
        rest = inside;
        loop {
            rest = rest.trim_start_matches([',', ' ']);
            if let Some(after) = rest.strip_prefix('}') {
                rest = after;
                break;
            }
            let (label, after) = rest.split_once("=\"")?;
            let (value, after) = quoted(after)?;
            labels.push((label, value));
            rest = after;
        }
    }
    let value = rest.split_whitespace().next()?.parse().ok()?;
    Some((name, labels, value))
}

/// Text up to its closing quotation mark, and what follows.
fn quoted(text: &str) -> Option<(String, &str)> {
    let mut value = String::new();
    let mut chars = text.char_indices();
    loop {
        match chars.next()? {
            (at, '"') => return Some((value, &text[at + 1..])),
            (_, '\\') => match chars.next()?.1 {
                'n' => value.push('\n'),
                other => value.push(other),
            },
            (_, c) => value.push(c),
        }
    }
}

pub(super) async fn read(url: &Uri) -> Result<Samples> {
    const LIMIT: Duration = Duration::from_secs(10);
    const MOST_BYTES: usize = 16 << 20;
    let place = format!("{}:{}", url.host().unwrap_or_default(), url.port_u16().unwrap_or(80));
    let path = url.path_and_query().map(|path| path.as_str()).filter(|path| *path != "/").unwrap_or("/metrics");
    let why = match get(&place, path, LIMIT, MOST_BYTES).await {
        Ok((StatusCode::OK, body)) => return Ok(Samples::of(&String::from_utf8_lossy(&body))),
        Ok((status, _)) => format!("it answers with status {}", status.as_u16()),
        Err(why) => why,
    };
    Err(Unavailable(format!("--metrics: {url} cannot be read: {why}")).into())
}

/// Reads the metrics until nothing that ended before is still being counted.
pub(super) async fn settled(url: &Uri) -> Result<Samples> {
    let mut last = read(url).await?;
    for _ in 0..20 {
        tokio::time::sleep(Duration::from_millis(50)).await;
        let next = read(url).await?;
        if next.calls == last.calls {
            return Ok(next);
        }
        last = next;
    }
    Ok(last)
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

    #[test]
    fn samples_are_read_whatever_their_labels_hold() {
        let text = "# HELP x y\n\
            rpc_server_call_duration_seconds_sum{rpc_method=\"a/B\",rpc_response_status_code=\"OK\"} 1.5\n\
            rpc_server_call_duration_seconds_count{rpc_response_status_code=\"OK\", rpc_method=\"a/B\"} 3\n\
            rpc_server_call_duration_seconds_bucket{le=\"+Inf\",rpc_method=\"a/B\"} 3\n\
            tessera_refusals_total{reason=\"a \\\"}{\\\\ b\"} 2 1700000000\n\
            tessera_facets_total 1e3\n\
            broken{a=\"b\n";
        let samples = Samples::of(text);
        let key = ("a/B".to_owned(), "OK".to_owned());
        assert_eq!((samples.calls[&key], samples.seconds[&key], samples.facets), (3, 1.5, 1000));
        assert_eq!(samples.refusals, BTreeMap::from([("a \"}{\\ b".to_owned(), 2)]));
    }

    #[test]
    fn an_address_of_metrics_has_a_place() {
        for good in ["http://127.0.0.1:9090/metrics", "http://a:1", "http://a/x", "http://[::1]:7/"] {
            assert!(metrics_url(good).is_ok(), "{good:?}");
        }
        for bad in ["", "127.0.0.1:9090", "https://a:1/metrics", "http://", "http:///x", "http://u@a:1", "http://a b"] {
            assert!(metrics_url(bad).is_err(), "{bad:?}");
        }
    }
}
