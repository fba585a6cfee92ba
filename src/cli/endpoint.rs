//! The address of a server, as `--endpoint` takes it.
//!
//! Invariant: a [`ServerUrl`] is `http://HOST:PORT` or `https://HOST:PORT` and nothing else. What is refused is refused
//! before any work, with what to write instead. Must not know: connections.

use std::fmt;
use std::str::FromStr;

use tonic::transport::Uri;

/// Where a server is: `http://HOST:PORT`, or with TLS `https://HOST:PORT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ServerUrl(String);

impl ServerUrl {
    pub(crate) fn as_str(&self) -> &str {
        &self.0
    }

    pub(crate) fn has_tls(&self) -> bool {
        self.0.starts_with(TLS)
    }

    pub(crate) fn with_tls(&self) -> String {
        self.0.replacen(CLEAR, TLS, 1)
    }
}

impl fmt::Display for ServerUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

const CLEAR: &str = "http://";
const TLS: &str = "https://";

const EXAMPLE: &str = "http://127.0.0.1:50051";

impl FromStr for ServerUrl {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some((scheme, rest)) = text.split_once("://") else {
            return Err(format!(
                "the address begins with http://, or with https:// for TLS; write it as http://{text}, for example {EXAMPLE}"
            ));
        };
        let scheme = match scheme.to_ascii_lowercase().as_str() {
            "http" => CLEAR,
            "https" => TLS,
            "grpcs" => return Err(format!("the address begins with http:// or https://; write {TLS}{rest}")),
            _ => {
                return Err(format!(
                    "{scheme}:// is not known; the address begins with http:// or https://, for example {EXAMPLE}"
                ));
            }
        };
        let (place, path) = rest.split_at(rest.find(['/', '?', '#']).unwrap_or(rest.len()));
        if !matches!(path, "" | "/") {
            return Err(format!("the address ends with the port; write {scheme}{place} without {path}"));
        }
        if place.contains('@') {
            return Err("names and passwords are not sent; leave out what stands before @".to_owned());
        }
        if place.is_empty() || place.starts_with(':') && !place[1..].contains(':') {
            return Err(format!("the host is missing; an example is {EXAMPLE}"));
        }
        if place.matches(':').count() > 1 && !place.starts_with('[') {
            return Err(format!(
                "an address of IPv6 stands in brackets, as http://[::1]:50051; {EXAMPLE} is one of IPv4"
            ));
        }
        let uri: Uri = format!("{scheme}{place}").parse().map_err(|e| format!("{e}; an example is {EXAMPLE}"))?;
        match (uri.host(), uri.port_u16()) {
            (None | Some(""), _) | (Some(_), None | Some(0)) => {
                Err(format!("the port is missing or no number from 1 to 65535; an example is {EXAMPLE}"))
            }
            (Some(_), Some(_)) => Ok(Self(format!("{scheme}{place}"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_and_a_port_are_taken() {
        for text in [
            "http://127.0.0.1:50051",
            "HTTP://localhost:1",
            "http://[::1]:50051/",
            "https://a.example:65535",
            "HTTPS://[::1]:1",
        ] {
            let url: ServerUrl = text.parse().unwrap();
            assert_eq!(url.has_tls(), text.to_lowercase().starts_with("https"));
            assert!(url.with_tls().starts_with("https://") && !url.with_tls()[8..].contains("//"));
            assert!(tonic::transport::Endpoint::from_shared(url.to_string()).is_ok(), "{url}");
        }
    }

    #[test]
    fn what_is_refused_says_what_to_write() {
        for (text, words) in [
            ("HTTPS://host:1/x", "write https://host:1 without /x"),
            ("https://host", "port is missing"),
            ("grpcs://host:1", "write https://host:1"),
            ("grpc://host:1", "begins with http:// or https://"),
            ("unix:///run/socket", "begins with http://"),
            ("127.0.0.1:50051", "http://127.0.0.1:50051"),
            ("localhost:50051", "http://localhost:50051"),
            ("[::1]:50051", "http://[::1]:50051"),
            ("", "http://127.0.0.1:50051"),
            ("http://", "host is missing"),
            ("http://:50051", "http://127.0.0.1:50051"),
            ("http://host", "port is missing"),
            ("http://host:", "port is missing"),
            ("http://host:0", "port is missing"),
            ("http://host:65536", "http://127.0.0.1:50051"),
            ("http://host:http", "http://127.0.0.1:50051"),
            ("http://host:1/v1/remesh", "without /v1/remesh"),
            ("http://host:1?a=b", "without ?a=b"),
            ("http://host:1#top", "without #top"),
            ("http://user:pass@host:1", "before @"),
            ("http://user@host:1", "before @"),
            ("http://ho st:1", "http://127.0.0.1:50051"),
            ("http://::1:50051", "http://127.0.0.1:50051"),
        ] {
            let refused = ServerUrl::from_str(text).unwrap_err();
            assert!(refused.contains(words), "{text:?}: {refused}");
        }
    }
}
