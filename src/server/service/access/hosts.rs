//! The hosts and sites whose requests a server without keys answers.
//!
//! Purpose: [`check`] looks at `Host`, `:authority` and `Origin`. Browsers run pages of any site, and such a page reaches a
//! server on the browser's machine in two ways: across sites, with its own `Origin`, or by a name of its site that resolves to
//! 127.0.0.1 (DNS rebinding), which is then the host of the request. Invariant: a request without these headers is no
//! browser's and passes. Must not know: keys, addresses of listeners.

use std::net::IpAddr;

use tonic::codegen::http::uri::Authority;
use tonic::codegen::http::{HeaderMap, HeaderName, HeaderValue, Request, Uri, header};

use super::Refusal;

/// Refuses requests to other hosts than this machine or an allowed one, and those of other sites' pages.
pub(super) fn check<B>(request: &Request<B>, allowed: &[String]) -> Result<(), Refusal> {
    let is_ours = |authority: &Authority| is_here(authority.host(), allowed);
    let all = |name: HeaderName, authority: fn(&HeaderValue) -> Option<Authority>| {
        of(request.headers(), &name).all(|value| authority(value).is_some_and(|authority| is_ours(&authority)))
    };
    let host = |value: &HeaderValue| Authority::try_from(value.as_bytes()).ok();
    if !request.uri().authority().is_none_or(is_ours) || !all(header::HOST, host) {
        return Err(Refusal::Host);
    }
    let origin = |value: &HeaderValue| Uri::try_from(value.as_bytes()).ok()?.into_parts().authority;
    // `Origin: null`, of files and sandboxed frames, has no host.
    let is_site = |value: &HeaderValue| value.as_bytes().windows(3).any(|part| part == b"://");
    match all(header::ORIGIN, origin) && of(request.headers(), &header::ORIGIN).all(is_site) {
        true => Ok(()),
        false => Err(Refusal::Origin),
    }
}

fn of<'a>(headers: &'a HeaderMap, name: &HeaderName) -> impl Iterator<Item = &'a HeaderValue> {
    headers.get_all(name).into_iter()
}

fn is_here(host: &str, allowed: &[String]) -> bool {
    let host = host.strip_suffix('.').unwrap_or(host);
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    let is_loopback = match bare.parse::<IpAddr>() {
        Ok(address) => address.to_canonical().is_loopback(),
        // Browsers resolve all names under localhost to this machine (RFC 6761).
        Err(_) => bare.rsplit('.').next().is_some_and(|last| last.eq_ignore_ascii_case("localhost")),
    };
    is_loopback || allowed.iter().any(|name| name.eq_ignore_ascii_case(bare))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(uri: &str, headers: &[(&str, &str)]) -> Option<Refusal> {
        let request =
            headers.iter().fold(Request::builder().uri(uri), |request, &(name, value)| request.header(name, value));
        check(&request.body(()).unwrap(), &["Tessera.example".to_owned()]).err()
    }

    #[test]
    fn this_machine_and_allowed_hosts_pass() {
        assert_eq!(refused("/", &[]), None);
        for host in
            ["localhost", "localhost:1", "LOCALHOST.:80", "a.localhost", "127.0.0.1:8080", "127.9.9.9", "[::1]:1"]
        {
            assert_eq!(refused("/", &[("host", host)]), None, "{host}");
            assert_eq!(refused(&format!("http://{host}/"), &[]), None, "{host}");
            let origin = format!("http://{host}");
            assert_eq!(refused("/", &[("host", "localhost:7"), ("origin", &origin)]), None, "{origin}");
        }
        let named = [("host", "tessera.example"), ("origin", "https://tessera.example:444")];
        assert_eq!(refused("/", &named), None);
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
            assert_eq!(refused("/", &[("host", host)]), Some(Refusal::Host), "{host}");
        }
        assert_eq!(refused("http://evil.example/", &[("host", "localhost")]), Some(Refusal::Host));
        assert_eq!(refused("/", &[("host", "localhost"), ("host", "evil.example")]), Some(Refusal::Host));
        for origin in ["http://evil.example", "http://localhost.evil.example:80", "null", "localhost", "file://", ""] {
            assert_eq!(refused("/", &[("host", "localhost"), ("origin", origin)]), Some(Refusal::Origin), "{origin}");
        }
    }
}
