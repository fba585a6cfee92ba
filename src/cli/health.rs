//! `tessera health`: whether a server takes calls, for people and for the probes of containers.
//!
//! Asked over gRPC, or at the admin port, which needs neither a certificate nor a key.
//!
//! Invariant: the exit code is 0 for SERVING and 69 for everything else. No backend is made. Must not know: connections.

use std::error::Error;
use std::fmt;
use std::time::Duration;

use anyhow::{Context, Result};
use bytes::Bytes;
use clap::Args;
use http_body_util::{BodyExt, Empty, Limited};
use hyper::client::conn::http1;
use hyper::{Request, StatusCode};
use hyper_util::rt::TokioIo;
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tonic_health::pb::health_check_response::ServingStatus;

use super::exit::Unavailable;
use super::remote::{health, watch_health};
use super::say;
use super::server::ServerArgs;

#[derive(Args, Debug)]
pub(crate) struct HealthArgs {
    /// Service to ask for, e.g. tessera.v1.JobService; all of the server if not given.
    #[arg(long, value_name = "NAME", default_value = "", hide_default_value = true)]
    service: String,
    /// Print every change until the server ends.
    #[arg(long)]
    watch: bool,
    /// Ask the admin port for readiness instead, e.g. 127.0.0.1:9090: without TLS and without a key.
    #[arg(long, value_name = "ADDRESS:PORT", conflicts_with_all = ["service", "watch"], env = "TESSERA_ADMIN")]
    admin: Option<String>,
    /// Seconds for the server to answer.
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = super::server::pause)]
    timeout_s: f64,
    #[command(flatten)]
    server: ServerArgs,
}

pub(crate) fn run(args: &HealthArgs) -> Result<()> {
    let limit = Duration::from_secs_f64(args.timeout_s);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("no runtime")?;
    if let Some(address) = &args.admin {
        let told = runtime.block_on(ask(address, limit))?;
        say::try_line(format_args!("{}", if args.server.json { told.json() } else { told.to_string() }))?;
        let wrong = || Unavailable(format!("the server of {address} is {told}")).into();
        return told.is_ready().then_some(()).ok_or_else(wrong);
    }
    let server = args.server.at.server()?;
    let last = runtime.block_on(async {
        if !args.watch {
            let state = health(&server, &args.service, limit).await?;
            args.print(state)?;
            return Ok(state);
        }
        let told = watch_health(&server, &args.service, limit, |state| args.print(state));
        told.await.map(|()| ServingStatus::NotServing)
    });
    match last? {
        ServingStatus::Serving => Ok(()),
        ServingStatus::ServiceUnknown => Err(Unavailable(format!("{} serves no {}", server.url, args.service)).into()),
        _ => Err(Unavailable(format!("{} does not serve now", server.url)).into()),
    }
}

impl HealthArgs {
    /// Prints a state; false if the output was closed.
    fn print(&self, state: ServingStatus) -> Result<bool> {
        let name = state.as_str_name();
        let text = match self.server.json {
            true => json!({ "service": self.service, "status": name }).to_string(),
            false => name.to_owned(),
        };
        Ok(say::try_line(format_args!("{text}"))?)
    }
}

#[derive(Debug, PartialEq)]
struct Readiness(Value);

impl Readiness {
    fn read(bytes: &[u8]) -> Option<Self> {
        let value: Value = serde_json::from_slice(bytes).ok()?;
        (value["ready"].is_boolean() && value["reasons"].is_array()).then_some(Self(value))
    }

    fn is_ready(&self) -> bool {
        self.0["ready"] == true
    }

    fn json(&self) -> String {
        self.0.to_string()
    }

    fn names(&self, key: &str) -> String {
        let names = self.0[key].as_array().into_iter().flatten().filter_map(Value::as_str);
        let names: Vec<String> = names.map(|name| name.replace(char::is_control, " ")).collect();
        names.join(", ")
    }
}

impl fmt::Display for Readiness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (reasons, degraded) = (self.names("reasons"), self.names("degraded"));
        if self.is_ready() { f.write_str("ready") } else { write!(f, "not ready: {reasons}") }?;
        if degraded.is_empty() { Ok(()) } else { write!(f, "; degraded: {degraded}") }
    }
}

async fn ask(address: &str, limit: Duration) -> Result<Readiness, Unavailable> {
    /// The admin port sends no longer answer.
    const MOST_BYTES: usize = 64 << 10;
    let known = [StatusCode::OK, StatusCode::SERVICE_UNAVAILABLE];
    let told = get(address, "/readyz", limit, MOST_BYTES).await.and_then(|(status, body)| {
        Readiness::read(&body).filter(|_| known.contains(&status)).ok_or_else(|| format!("it answers {status}"))
    });
    told.map_err(|why| {
        Unavailable(format!("cannot ask {address} for readiness: {why}; is it the --admin-listen of a server?"))
    })
}

/// Asks `place`, HOST:PORT, for `path`. An answer has at most `most` bytes. Errors: a clause that says why there is no answer.
pub(crate) async fn get(place: &str, path: &str, limit: Duration, most: usize) -> Result<(StatusCode, Bytes), String> {
    match tokio::time::timeout(limit, answer(place, path, most)).await {
        Ok(answer) => answer.map_err(|error| match error.downcast_ref::<hyper::Error>() {
            Some(error) if error.is_parse() => "it does not speak HTTP".to_owned(),
            _ => error.to_string(),
        }),
        Err(_) => Err(format!("it did not answer within {} s", limit.as_secs_f64())),
    }
}

async fn answer(place: &str, path: &str, most: usize) -> Result<(StatusCode, Bytes), Box<dyn Error + Send + Sync>> {
    let (mut sender, connection) = http1::handshake(TokioIo::new(TcpStream::connect(place).await?)).await?;
    // It ends when the sender is dropped.
    tokio::spawn(connection);
    let answer = sender.send_request(Request::get(path).header("host", place).body(Empty::<Bytes>::new())?).await?;
    let status = answer.status();
    Ok((status, Limited::new(answer.into_body(), most).collect().await?.to_bytes()))
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    use super::*;

    #[test]
    fn an_answer_is_told_in_words() {
        let told = |text: &str| Readiness::read(text.as_bytes()).map(|told| (told.is_ready(), told.to_string()));
        assert_eq!(told(r#"{"ready":true,"reasons":[],"degraded":[]}"#), Some((true, "ready".to_owned())));
        let lost = r#"{"ready":false,"reasons":["device_lost","a\nb"],"degraded":["on_cpu"]}"#;
        assert_eq!(told(lost), Some((false, "not ready: device_lost, a b; degraded: on_cpu".to_owned())));
        for wrong in ["", "ok", "[]", "{}", r#"{"ready":1,"reasons":[]}"#] {
            assert_eq!(told(wrong), None, "{wrong}");
        }
    }

    #[tokio::test]
    async fn answers_are_read_within_their_bounds() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let place = listener.local_addr().unwrap().to_string();
        for (sent, expected) in [
            ("HTTP/1.1 404 Not Found\r\nContent-Length: 2\r\n\r\nno", Ok((404, "no"))),
            ("HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n2\r\nab\r\n1\r\nc\r\n0\r\n\r\n", Ok((200, "abc"))),
            ("HTTP/1.1 200 OK\r\n\r\nup to the end", Ok((200, "up to the end"))),
            ("HTTP/1.1 200 OK\r\nContent-Length: 20\r\n\r\n01234567890123456789", Err("limit exceeded")),
            ("HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\ncut", Err("reading a body")),
            ("hello\r\n\r\n", Err("does not speak HTTP")),
        ] {
            let serve = async {
                let (mut stream, _) = listener.accept().await.unwrap();
                let mut request = [0; 256];
                assert!(stream.read(&mut request).await.unwrap() > 0);
                stream.write_all(sent.as_bytes()).await.unwrap();
            };
            let (read, ()) = tokio::join!(get(&place, "/x", Duration::from_secs(10), 16), serve);
            match (read, expected) {
                (Ok((status, body)), Ok(want)) => {
                    assert_eq!((status.as_u16(), body.as_ref()), (want.0, want.1.as_bytes()))
                }
                (Err(said), Err(words)) => assert!(said.contains(words), "{said}"),
                (read, _) => panic!("{sent:?}: {read:?}"),
            }
        }
        let silent = get(&place, "/x", Duration::from_millis(50), 16).await.unwrap_err();
        assert_eq!(silent, "it did not answer within 0.05 s");
    }
}
