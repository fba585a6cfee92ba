//! What the admin port says of a server's readiness.
//!
//! Invariant: an answer is read to a limit, in length and in time; what it says is shown without control characters. Must not
//! know: gRPC, options.

use std::fmt;
use std::future::poll_fn;
use std::pin::Pin;
use std::time::Duration;

use hyper::body::{Body, Incoming};
use hyper::client::conn::http1;
use hyper::{Request, StatusCode};
use hyper_util::rt::TokioIo;
use serde_json::Value;
use tokio::net::TcpStream;

use crate::exit::Unavailable;

/// Longer answers are none of the admin port.
const MOST_BYTES: usize = 64 << 10;

/// Whether a server is ready, and why not.
#[derive(Debug, PartialEq)]
pub(super) struct Readiness(Value);

impl Readiness {
    /// Reads the answer's body.
    fn read(bytes: &[u8]) -> Option<Self> {
        let value: Value = serde_json::from_slice(bytes).ok()?;
        (value["ready"].is_boolean() && value["reasons"].is_array()).then_some(Self(value))
    }

    pub(super) fn is_ready(&self) -> bool {
        self.0["ready"] == true
    }

    pub(super) fn json(&self) -> String {
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
        match self.is_ready() {
            true => f.write_str("ready")?,
            false => write!(f, "not ready: {}", self.names("reasons"))?,
        }
        match self.names("degraded").as_str() {
            "" => Ok(()),
            names => write!(f, "; degraded: {names}"),
        }
    }
}

/// Asks the admin port at an address.
///
/// # Errors
/// [`Unavailable`]: nobody answers in time, or it is no admin port.
pub(super) async fn ask(address: &str, limit: Duration) -> Result<Readiness, Unavailable> {
    match tokio::time::timeout(limit, answer(address)).await {
        Ok(Ok(told)) => Ok(told),
        Ok(Err(why)) => Err(Unavailable(format!(
            "cannot ask {address} for readiness: {why}; is it the --admin-listen of a server?"
        ))),
        Err(_) => Err(Unavailable(format!("{address} does not answer within {} s", limit.as_secs_f64()))),
    }
}

async fn answer(address: &str) -> Result<Readiness, Box<dyn std::error::Error>> {
    let stream = TcpStream::connect(address).await?;
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await?;
    let request = Request::get("/readyz").header("host", address).body(String::new())?;
    // The connection goes on while the answer is awaited, and ends with it.
    let asked = async {
        let response = sender.send_request(request).await?;
        let status = response.status();
        let bytes = whole(response.into_body()).await?;
        let known = [StatusCode::OK, StatusCode::SERVICE_UNAVAILABLE].contains(&status);
        Readiness::read(&bytes).filter(|_| known).ok_or_else(|| format!("it answers {status}").into())
    };
    tokio::pin!(asked);
    tokio::pin!(connection);
    tokio::select! {
        told = &mut asked => told,
        ended = &mut connection => match ended {
            Ok(()) => asked.await,
            Err(error) => Err(error.into()),
        },
    }
}

async fn whole(mut body: Incoming) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let mut all = Vec::new();
    while let Some(frame) = poll_fn(|context| Pin::new(&mut body).poll_frame(context)).await {
        if let Ok(data) = frame?.into_data() {
            all.extend_from_slice(&data);
        }
        if all.len() > MOST_BYTES {
            return Err("its answer is too long".into());
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
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
}
