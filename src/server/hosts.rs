//! The hosts and sites whose requests a server without keys answers.
//!
//! Purpose: [`Hosts::check`] looks at `Host`, `:authority`, `Origin` and `Sec-Fetch-Site`. Browsers run pages of any site, and
//! such a page reaches a server on the browser's network in two ways: across sites, with its own `Origin`, or by a name of its
//! site that resolves to the server's address (DNS rebinding), which is then the host of the request. Invariant: a request
//! without these headers is no browser's and passes. Must not know: keys, listeners, how a refusal is worded.

use std::net::IpAddr;

use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, Request, Uri, header};
use tokio::net::TcpListener;

/// Names of this server, and sites whose pages may use it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hosts {
    /// Without port.
    pub names: Vec<String>,
    /// As `Origin` has them, in lower case.
    pub origins: Vec<HeaderValue>,
}

/// The hosts that a listener answers besides the names of the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// This machine.
    Here,
    /// Addresses, and names that no public zone can have: no site can make them resolve to an address of its choice.
    Near,
    /// Any: a browser can only come with a name that the certificate has, or not at all.
    Anywhere,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Foreign {
    Host,
    /// `Host` is there more than once.
    Hosts,
    Origin,
    /// A page sends what browsers send without asking first.
    MediaType,
}

/// Top-level names that no public zone has (RFC 6761, RFC 6762, RFC 8375, ICANN's reserved `internal`), and that of Kubernetes.
const PRIVATE: [&str; 6] = [".localhost", ".local", ".internal", ".svc", ".home.arpa", ".test"];

impl Hosts {
    /// Refuses requests to other hosts, and those of other sites' pages.
    pub fn check<B>(&self, request: &Request<B>, reach: Reach) -> Result<(), Foreign> {
        let headers = request.headers();
        check_once(headers)?;
        let named = headers.get(header::HOST).map(|value| Authority::try_from(value.as_bytes()));
        let hosts = request.uri().authority().map(|authority| Some(authority.clone()));
        let mut hosts = hosts.into_iter().chain(named.map(Result::ok));
        if !hosts.all(|host| host.is_some_and(|host| self.is_ours(host.host(), reach))) {
            return Err(Foreign::Host);
        }
        let mut origins = all(headers, &header::ORIGIN).peekable();
        let is_page = origins.peek().is_some();
        if !origins.all(|origin| self.is_site(origin, request)) || (!is_page && is_across(request)) {
            return Err(Foreign::Origin);
        }
        if is_page && is_simple(request) { Err(Foreign::MediaType) } else { Ok(()) }
    }

    fn is_ours(&self, host: &str, reach: Reach) -> bool {
        let bare = bare(host);
        let is_near = match (bare.parse::<IpAddr>(), reach) {
            (Ok(address), Reach::Here) => address.to_canonical().is_loopback(),
            // Browsers resolve all names under localhost to this machine (RFC 6761).
            (Err(_), Reach::Here) => bare == "localhost" || bare.ends_with(".localhost"),
            (Ok(_), Reach::Near) => true,
            (Err(_), Reach::Near) => {
                !bare.is_empty() && (!bare.contains('.') || PRIVATE.iter().any(|end| bare.ends_with(end)))
            }
            (_, Reach::Anywhere) => true,
        };
        is_near || self.has(&bare)
    }

    fn has(&self, bare: &str) -> bool {
        self.names.iter().any(|name| name.eq_ignore_ascii_case(bare))
    }

    /// Whether a page of this origin may send this request: one of the server, of a named host, or of an allowed site.
    fn is_site<B>(&self, origin: &HeaderValue, request: &Request<B>) -> bool {
        // `Origin: null`, of files and sandboxed frames, has no host.
        let Some(site) = authority(origin) else { return false };
        let named = request.headers().get(header::HOST).and_then(|value| Authority::try_from(value.as_bytes()).ok());
        let own = request.uri().authority().cloned().or(named);
        // `Authority` compares without regard to case.
        own.is_some_and(|own| own == site)
            || self.has(&bare(site.host()))
            || self.origins.iter().any(|allowed| allowed.as_bytes().eq_ignore_ascii_case(origin.as_bytes()))
    }
}

/// The hosts of a listener: this machine if it listens on loopback, else `wide`.
pub fn reach(listener: &TcpListener, wide: Reach) -> Reach {
    match listener.local_addr() {
        Ok(address) if !address.ip().to_canonical().is_loopback() => wide,
        _ => Reach::Here,
    }
}

/// A request has one `Host`: programs that take another of two than a proxy before them are misled (RFC 9112, section 3.2).
pub fn check_once(headers: &HeaderMap) -> Result<(), Foreign> {
    if all(headers, &header::HOST).count() > 1 { Err(Foreign::Hosts) } else { Ok(()) }
}

/// Whether a browser says that a page of another site causes the request. To follow a link is no such request.
fn is_across<B>(request: &Request<B>) -> bool {
    let text = |name: &str| request.headers().get(name).and_then(|value| value.to_str().ok());
    let is_visit = text("sec-fetch-mode") == Some("navigate") && request.method() == Method::GET;
    matches!(text("sec-fetch-site"), Some("cross-site" | "same-site")) && !is_visit
}

/// Whether a browser would send it for any page without asking first.
fn is_simple<B>(request: &Request<B>) -> bool {
    let media = request.headers().get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok());
    let media = media.map(|media| media.split(';').next().unwrap_or_default().trim().to_ascii_lowercase());
    matches!(media.as_deref(), Some("text/plain" | "application/x-www-form-urlencoded"))
}

/// The host and port of an origin.
fn authority(origin: &HeaderValue) -> Option<Authority> {
    let parts = Uri::try_from(origin.as_bytes()).ok()?.into_parts();
    parts.scheme.and(parts.authority)
}

fn all<'a>(headers: &'a HeaderMap, name: &HeaderName) -> impl Iterator<Item = &'a HeaderValue> {
    headers.get_all(name).into_iter()
}

fn bare(host: &str) -> String {
    let host = host.strip_suffix('.').unwrap_or(host);
    host.trim_start_matches('[').trim_end_matches(']').to_ascii_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(reach: Reach, uri: &str, headers: &[(&str, &str)]) -> Option<Foreign> {
        let request =
            headers.iter().fold(Request::builder().uri(uri), |request, &(name, value)| request.header(name, value));
        let names = vec!["Tessera.example".to_owned()];
        let hosts = Hosts { names, origins: vec![HeaderValue::from_static("https://app.example.com")] };
        hosts.check(&request.body(()).unwrap(), reach).err()
    }

    fn refused(uri: &str, headers: &[(&str, &str)]) -> Option<Foreign> {
        at(Reach::Here, uri, headers)
    }

    #[test]
    fn this_machine_and_named_hosts_pass() {
        assert_eq!(refused("/", &[]), None);
        for host in
            ["localhost", "localhost:1", "LOCALHOST.:80", "a.localhost", "127.0.0.1:8080", "127.9.9.9", "[::1]:1"]
        {
            assert_eq!(refused("/", &[("host", host)]), None, "{host}");
            assert_eq!(refused(&format!("http://{host}/"), &[]), None, "{host}");
            let origin = format!("http://{host}");
            assert_eq!(refused("/", &[("host", host), ("origin", &origin)]), None, "{origin}");
            let other = format!("http://{}", host.replace(":1", ":2"));
            let foreign = refused("/", &[("host", "localhost:7"), ("origin", &other)]);
            assert_eq!(foreign, Some(Foreign::Origin), "{other}: another port is another site");
        }
        let named = [("host", "tessera.example"), ("origin", "https://tessera.example:444")];
        assert_eq!(refused("/", &named), None);
        assert_eq!(refused("/", &[("host", "localhost"), ("origin", "https://App.example.com")]), None);
    }

    #[test]
    fn other_hosts_and_sites_do_not() {
        for host in [
            "evil.example",
            "127.0.0.1.evil.example",
            "localhost.evil.example",
            "evillocalhost",
            "0.0.0.0:1",
            "10.0.0.1",
            "",
        ] {
            assert_eq!(refused("/", &[("host", host)]), Some(Foreign::Host), "{host}");
        }
        assert_eq!(refused("http://evil.example/", &[("host", "localhost")]), Some(Foreign::Host));
        assert_eq!(refused("/", &[("host", "localhost"), ("host", "localhost")]), Some(Foreign::Hosts));
        let origins = [
            "http://evil.example",
            "http://localhost.evil.example:80",
            "null",
            "localhost",
            "file://",
            "",
            "http://app.example.com",
        ];
        for origin in origins {
            assert_eq!(refused("/", &[("host", "localhost"), ("origin", origin)]), Some(Foreign::Origin), "{origin}");
        }
    }

    #[test]
    fn other_machines_reach_it_by_addresses_and_by_names_that_no_site_can_have() {
        let near = |host: &str| at(Reach::Near, "/", &[("host", host)]);
        for host in [
            "10.0.0.1:8080",
            "[2001:db8::1]:1",
            "localhost:1",
            "tessera:9090",
            "tessera-0.tessera.default.svc",
            "tessera.default.svc.cluster.local.",
            "box.local",
            "host.docker.internal",
        ] {
            assert_eq!(near(host), None, "{host}");
        }
        for host in ["evil.com", "svc.evil.com", "10.0.0.1.evil.com", "tessera.default", ""] {
            assert_eq!(near(host), Some(Foreign::Host), "{host}");
            assert_eq!(at(Reach::Anywhere, "/", &[("host", "evil.com")]), None);
        }
        let page = [("host", "evil.com"), ("origin", "http://other.com")];
        assert_eq!(at(Reach::Anywhere, "/", &page), Some(Foreign::Origin));
    }

    #[test]
    fn browsers_say_whose_page_it_is() {
        let of = |site: &str, mode: &str| {
            refused("/", &[("host", "localhost"), ("sec-fetch-site", site), ("sec-fetch-mode", mode)])
        };
        for (site, mode) in [("same-origin", "cors"), ("none", "navigate"), ("cross-site", "navigate")] {
            assert_eq!(of(site, mode), None, "{site} {mode}");
        }
        for (site, mode) in [("cross-site", "no-cors"), ("same-site", "no-cors"), ("cross-site", "cors")] {
            assert_eq!(of(site, mode), Some(Foreign::Origin), "{site} {mode}");
        }
        for (media, refusal) in [
            ("text/plain; charset=utf-8", Some(Foreign::MediaType)),
            ("application/x-www-form-urlencoded", Some(Foreign::MediaType)),
            ("application/json", None),
            ("model/obj", None),
        ] {
            let page = [("host", "localhost"), ("origin", "http://localhost"), ("content-type", media)];
            assert_eq!(refused("/", &page), refusal, "{media}");
            assert_eq!(refused("/", &[("host", "localhost"), ("content-type", media)]), None, "no page");
        }
    }
}
