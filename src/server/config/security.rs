//! Options of access to the server.
//!
//! Invariant: a server that other machines can reach has TLS and keys, unless an option waives them. Secrets are given by
//! file, never as a value. Must not know: certificates, keys.

use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;

use clap::Args;
use http::Uri;
use transport::TlsFiles;

use super::values::{ConfigError, seconds};

#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "TLS and keys")]
pub struct SecurityArgs {
    /// File with the server's certificate and its chain, in PEM. With it and --tls-key the port accepts TLS only.
    #[arg(long, value_name = "FILE", env = "TESSERA_TLS_CERT")]
    pub tls_cert: Option<PathBuf>,
    /// File with the certificate's private key, in PEM.
    #[arg(long, value_name = "FILE", env = "TESSERA_TLS_KEY")]
    pub tls_key: Option<PathBuf>,
    /// File with the authorities of clients, in PEM: a client without a certificate of theirs is refused.
    #[arg(long, value_name = "FILE", env = "TESSERA_CLIENT_CA")]
    pub client_ca: Option<PathBuf>,
    /// Seconds between two looks at these files; changed ones hold for new connections. SIGHUP has them looked at once.
    #[arg(long, value_name = "S", default_value_t = 30.0, env = "TESSERA_TLS_RELOAD_S")]
    pub tls_reload_s: f64,
    /// Refuse calls without a key. Keys are made with `tessera keys add`, and lie in the data folder.
    #[arg(long, env = "TESSERA_REQUIRE_KEYS")]
    pub require_keys: bool,
    /// Whether the server describes its interface (gRPC reflection). Where keys are required, this needs one too.
    #[arg(long, value_name = "BOOL", default_value_t = true, action = clap::ArgAction::Set, env = "TESSERA_REFLECTION")]
    pub reflection: bool,
    /// Ask for a key for health too, where keys are required; without, probes need none.
    #[arg(long, env = "TESSERA_HEALTH_NEEDS_KEY")]
    pub health_needs_key: bool,
    /// A name of this server, as a proxy passes it on; may be repeated. Without keys a server answers requests to its own
    /// address alone, so that no web page in a browser can use it.
    #[arg(long, value_name = "NAME", value_delimiter = ',', env = "TESSERA_PUBLIC_HOST")]
    pub public_host: Vec<String>,
    /// A site whose pages may use the HTTP port: a scheme, a host and, if need be, a port. May be repeated.
    #[arg(long, value_name = "ORIGIN", value_delimiter = ',', env = "TESSERA_CORS_ORIGIN")]
    pub cors_origin: Vec<String>,
    /// Let other machines reach the server without TLS or without keys. For a network that you trust.
    #[arg(long, env = "TESSERA_INSECURE")]
    pub insecure: bool,
}

impl SecurityArgs {
    pub(super) fn check(&self) -> Result<Option<TlsFiles>, ConfigError> {
        let reload = seconds("--tls-reload-s", self.tls_reload_s)?;
        let is_name = |host: &str| {
            host.ends_with(|c: char| c.is_ascii_alphanumeric())
                && host.chars().all(|c| c.is_ascii_alphanumeric() || ['-', '_', '.'].contains(&c))
        };
        if let Some(host) = self.public_host.iter().find(|host| !is_name(host) && host.parse::<IpAddr>().is_err()) {
            let must = "a name or an address without scheme and port, as tessera.example";
            return Err(ConfigError::new("--public-host", format!("{host:?}"), must));
        }
        if let Some(site) = self.cors_origin.iter().find(|site| !is_origin(site)) {
            let must = "a scheme, a host and, if need be, a port, as https://app.example.com; * is no site";
            return Err(ConfigError::new("--cors-origin", format!("{site:?}"), must));
        }
        let without = |option, other: &str, must: &'static str| {
            Err(ConfigError::new(option, format!("not given, though {other} is"), must))
        };
        match (&self.tls_cert, &self.tls_key) {
            (Some(cert), Some(key)) => {
                Ok(Some(TlsFiles { cert: cert.clone(), key: key.clone(), client_ca: self.client_ca.clone(), reload }))
            }
            (Some(_), None) => without("--tls-key", "--tls-cert", "given too: the file with its private key"),
            (None, Some(_)) => without("--tls-cert", "--tls-key", "given too: the file with its certificate"),
            (None, None) if self.client_ca.is_some() => {
                let must = "given too, and --tls-key: only over TLS do clients show certificates";
                without("--tls-cert", "--client-ca", must)
            }
            (None, None) => Ok(None),
        }
    }

    /// Checks that a reachable server has TLS and keys, or a waiver.
    pub(super) fn check_reach(
        &self,
        option: &'static str,
        listen: &str,
        addresses: &[SocketAddr],
        has_tls: bool,
    ) -> Result<(), ConfigError> {
        if self.insecure || addresses.iter().all(|address| address.ip().to_canonical().is_loopback()) {
            return Ok(());
        }
        let missing = match (has_tls, self.require_keys) {
            (true, true) => return Ok(()),
            (true, false) => "keys (--require-keys)",
            (false, true) => "TLS (--tls-cert and --tls-key)",
            (false, false) => "TLS (--tls-cert and --tls-key) and without keys (--require-keys)",
        };
        let value = format!("{listen:?}, which other machines may reach, without {missing}");
        let must = "an address of this machine alone, as 127.0.0.1:50051, or have both; on a network that you trust, give \
                    --insecure";
        Err(ConfigError::new(option, value, must))
    }
}

/// Whether browsers send this as `Origin`.
fn is_origin(text: &str) -> bool {
    let Ok(uri) = text.parse::<Uri>() else { return false };
    let is_bare = uri.path() == "/" && !text.ends_with('/') && uri.query().is_none();
    let has_user = uri.authority().is_some_and(|authority| authority.as_str().contains('@'));
    is_bare && !has_user && matches!(uri.scheme_str(), Some("http" | "https"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(given: &[&str]) -> SecurityArgs {
        let file = |name| given.contains(&name).then(|| PathBuf::from(name));
        SecurityArgs {
            tls_cert: file("cert"),
            tls_key: file("key"),
            client_ca: file("ca"),
            tls_reload_s: 30.0,
            require_keys: given.contains(&"keys"),
            reflection: true,
            health_needs_key: false,
            public_host: Vec::new(),
            cors_origin: Vec::new(),
            insecure: given.contains(&"insecure"),
        }
    }

    #[test]
    fn a_certificate_has_its_key() {
        assert_eq!(args(&[]).check(), Ok(None));
        let files = args(&["cert", "key", "ca"]).check().unwrap().unwrap();
        assert_eq!(files.client_ca, Some("ca".into()));
        for (given, missing) in [(&["cert"][..], "--tls-key"), (&["key"], "--tls-cert"), (&["ca"], "--tls-cert")] {
            assert_eq!(args(given).check().unwrap_err().option, missing, "{given:?}");
        }
        assert!(SecurityArgs { tls_reload_s: 0.0, ..args(&[]) }.check().is_err());
    }

    #[test]
    fn a_public_host_has_neither_scheme_nor_port() {
        let with = |host: &str| SecurityArgs { public_host: vec![host.to_owned()], ..args(&[]) }.check();
        for good in ["tessera.example", "tessera", "10.0.0.1", "::1", "a-b.c_d"] {
            assert_eq!(with(good), Ok(None), "{good}");
        }
        for bad in ["", "tessera.example:8080", "http://tessera", "[::1]", "tessera.", "a b"] {
            assert_eq!(with(bad).unwrap_err().option, "--public-host", "{bad}");
        }
    }

    #[test]
    fn a_site_is_what_browsers_send() {
        let with = |site: &str| SecurityArgs { cors_origin: vec![site.to_owned()], ..args(&[]) }.check();
        for good in ["https://app.example.com", "http://localhost:5173", "http://[::1]:1"] {
            assert_eq!(with(good), Ok(None), "{good}");
        }
        for bad in
            ["*", "null", "", "app.example.com", "https://a/", "https://a/b", "https://a?b", "ftp://a", "https://u@a"]
        {
            assert_eq!(with(bad).unwrap_err().option, "--cors-origin", "{bad}");
        }
    }

    #[test]
    fn others_reach_a_server_with_tls_and_keys_alone() {
        let reach = |given: &[&str], address: &str| {
            args(given).check_reach("--listen", address, &[address.parse().unwrap()], given.contains(&"tls"))
        };
        for here in ["127.0.0.1:1", "127.9.9.9:1", "[::1]:1", "[::ffff:127.0.0.1]:1"] {
            assert_eq!(reach(&[], here), Ok(()), "{here}");
        }
        for wide in ["0.0.0.0:1", "10.0.0.1:1", "[::]:1", "[fe80::1]:1"] {
            for (given, words) in [
                (&[][..], "--tls-cert and --tls-key) and without keys"),
                (&["tls"], "keys (--require-keys)"),
                (&["keys"], "TLS (--tls-cert"),
            ] {
                let refused = reach(given, wide).unwrap_err().to_string();
                assert!(refused.contains(words) && refused.contains("--insecure"), "{refused}");
            }
            assert_eq!(reach(&["tls", "keys"], wide), Ok(()));
            assert_eq!(reach(&["insecure"], wide), Ok(()));
        }
    }
}
