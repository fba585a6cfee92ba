//! What the admin port says of a server's readiness.
//!
//! Invariant: an answer is read to a limit, in length and in time; what it says is shown without control characters. Must not
//! know: gRPC, options.

use std::fmt;
use std::time::Duration;

use hyper::StatusCode;
use serde_json::Value;

use crate::exit::Unavailable;
use crate::http_get::get;

/// Whether a server is ready, and why not.
#[derive(Debug, PartialEq)]
pub(super) struct Readiness(Value);

impl Readiness {
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

pub(super) async fn ask(address: &str, limit: Duration) -> Result<Readiness, Unavailable> {
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
