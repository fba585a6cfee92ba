//! What a server's admin port counts.
//!
//! Purpose: reads `/metrics` over HTTP and keeps what a load is compared with. Invariant: an answer is read within a time and
//! a size. Must not know: what this side counted.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use anyhow::Result;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::exit::Unavailable;

/// Where metrics are: `http://HOST:PORT/PATH`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct MetricsUrl {
    place: String,
    path: String,
}

impl fmt::Display for MetricsUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "http://{}{}", self.place, self.path)
    }
}

impl FromStr for MetricsUrl {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        const EXAMPLE: &str = "an example is http://127.0.0.1:9090/metrics";
        let Some(rest) = text.strip_prefix("http://") else {
            return Err(format!("the address of metrics begins with http://; {EXAMPLE}"));
        };
        let (place, path) = rest.split_at(rest.find('/').unwrap_or(rest.len()));
        let odd = |c: char| c.is_whitespace() || c.is_control();
        if place.is_empty() || place.contains('@') || text.contains(odd) {
            return Err(format!("the address of metrics needs a host; {EXAMPLE}"));
        }
        let has_port = place.rsplit_once(':').is_some_and(|(_, port)| port.parse::<u16>().is_ok());
        let place = if has_port { place.to_owned() } else { format!("{place}:80") };
        let path = if matches!(path, "" | "/") { "/metrics" } else { path };
        Ok(Self { place, path: path.to_owned() })
    }
}

/// Method and status of calls.
pub(super) type Key = (String, String);

/// What is kept of a scrape.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Samples {
    /// Calls by method and status.
    pub(super) calls: BTreeMap<Key, u64>,
    /// Seconds that they took.
    pub(super) seconds: BTreeMap<Key, f64>,
    /// Refusals by reason.
    pub(super) refusals: BTreeMap<String, u64>,
    /// Facets of jobs that are done.
    pub(super) facets: u64,
    /// Seeds that they asked for.
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

/// Names and values of labels.
type Labels<'a> = Vec<(&'a str, String)>;

/// A line's name, labels and value.
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

/// Reads the metrics.
///
/// # Errors
/// [`Unavailable`] if they are not to be had.
pub(super) async fn read(url: &MetricsUrl) -> Result<Samples> {
    const LIMIT: Duration = Duration::from_secs(10);
    match tokio::time::timeout(LIMIT, get(url)).await {
        Ok(Ok(text)) => Ok(Samples::of(&text)),
        Ok(Err(why)) => Err(Unavailable(format!("--metrics: {url} cannot be read: {why}")).into()),
        Err(_) => Err(Unavailable(format!("--metrics: {url} did not answer within {} s", LIMIT.as_secs())).into()),
    }
}

/// Reads the metrics until nothing that ended before is still being counted.
///
/// # Errors
/// As [`read`].
pub(super) async fn settled(url: &MetricsUrl) -> Result<Samples> {
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

/// The body of an answer. With HTTP/1.0 it comes in one piece and ends with the connection.
async fn get(url: &MetricsUrl) -> Result<String, String> {
    const MOST: u64 = 16 << 20;
    let said = |error: std::io::Error| error.to_string();
    let mut stream = TcpStream::connect(&url.place).await.map_err(said)?;
    let request = format!("GET {} HTTP/1.0\r\nHost: {}\r\nAccept: text/plain\r\n\r\n", url.path, url.place);
    stream.write_all(request.as_bytes()).await.map_err(said)?;
    let mut answer = Vec::new();
    stream.take(MOST).read_to_end(&mut answer).await.map_err(said)?;
    let answer = String::from_utf8_lossy(&answer);
    let (head, body) = answer.split_once("\r\n\r\n").ok_or("it does not speak HTTP")?;
    match head.split(' ').nth(1) {
        Some("200") if !head.to_ascii_lowercase().contains("\r\ntransfer-encoding: chunked") => Ok(body.to_owned()),
        Some("200") => Err("it sends its answer in pieces; name the server itself, not a proxy".to_owned()),
        Some(status) => Err(format!("it answers with status {}", crate::plain::plain(status))),
        None => Err("it does not speak HTTP".to_owned()),
    }
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
        for (text, means) in [
            ("http://127.0.0.1:9090/metrics", "http://127.0.0.1:9090/metrics"),
            ("http://a:1", "http://a:1/metrics"),
            ("http://a/x", "http://a:80/x"),
            ("http://[::1]:7/", "http://[::1]:7/metrics"),
        ] {
            assert_eq!(text.parse::<MetricsUrl>().unwrap().to_string(), means);
        }
        for bad in ["", "127.0.0.1:9090", "https://a:1/metrics", "http://", "http:///x", "http://u@a:1", "http://a b"] {
            assert!(bad.parse::<MetricsUrl>().is_err(), "{bad:?}");
        }
    }

    #[tokio::test]
    async fn what_is_no_answer_is_said() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url: MetricsUrl = format!("http://{}", listener.local_addr().unwrap()).parse().unwrap();
        for (answer, words) in [
            ("HTTP/1.1 404 Not Found\r\n\r\n", "status 404"),
            ("hello", "does not speak HTTP"),
            ("HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n1\r\na", "in pieces"),
        ] {
            let serve = async {
                let (mut stream, _) = listener.accept().await.unwrap();
                let mut request = [0; 256];
                assert!(stream.read(&mut request).await.unwrap() > 0);
                stream.write_all(answer.as_bytes()).await.unwrap();
            };
            let (read, ()) = tokio::join!(read(&url), serve);
            let said = read.unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
        }
    }
}
