//! What a server's admin port counts.
//!
//! Purpose: reads `/metrics` over HTTP and keeps what a load is compared with. Invariant: an answer is read within a time and
//! a size. Must not know: what this side counted.

use std::collections::BTreeMap;
use std::time::Duration;

use anyhow::Result;
use hyper::{StatusCode, Uri};

use crate::exit::Unavailable;
use crate::http_get::get;

/// Reads `--metrics`: `http://HOST:PORT/PATH`; the port is 80 and the path `/metrics` if not given.
pub(super) fn metrics_url(text: &str) -> Result<Uri, String> {
    let wrong = |what: &str| format!("the address of metrics {what}; an example is http://127.0.0.1:9090/metrics");
    if !text.starts_with("http://") {
        return Err(wrong("begins with http://"));
    }
    let uri: Uri = text.parse().map_err(|_| wrong("needs a host"))?;
    match uri.authority() {
        Some(place) if !place.as_str().contains('@') => Ok(uri),
        _ => Err(wrong("needs a host")),
    }
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
    let path = match url.path_and_query().map(|path| path.as_str()) {
        None | Some("/") => "/metrics",
        Some(path) => path,
    };
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
