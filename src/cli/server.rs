//! Which server is asked, and as whom.
//!
//! Purpose: the options that every command has which cannot do without a server: its address, the tenant, the key, and trust and
//! identity over TLS. Invariant: a [`ServerUrl`] is `http://HOST:PORT` or `https://HOST:PORT` and nothing else, a [`Tenant`] can be sent
//! as it is, files are read before any work, and a key is never shown. Must not know: connections, what is asked.

use std::fmt;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Result;
use clap::Args;
use serde_json::Value;
use tonic::transport::Uri;

use super::exit::{NoInput, Usage};
use super::say;
use server::keys::Secret;

#[derive(Clone, Debug)]
pub(crate) struct Server {
    pub(crate) url: ServerUrl,
    /// Tenant of the jobs; without it, the tenant of the key or of this host.
    pub(crate) tenant: Option<Tenant>,
    /// Whom a client trusts over TLS, and what it shows.
    pub(crate) trust: Trust,
    pub(crate) key: Option<Secret>,
}

/// Whose jobs are meant: 1 to 128 printable ASCII characters without spaces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Tenant(String);

impl Tenant {
    pub(crate) fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for Tenant {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let named = (1..=128).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_graphic());
        let wrong = "a tenant has 1 to 128 printable ASCII characters without spaces";
        if named { Ok(Self(text.to_owned())) } else { Err(wrong.to_owned()) }
    }
}

#[derive(Args, Debug)]
pub(crate) struct EndpointArgs {
    /// Let a server do the work, e.g. http://127.0.0.1:50051.
    #[arg(long, value_name = "URL")]
    pub(crate) endpoint: Option<ServerUrl>,
    /// Whose work the server takes it for, where several share one.
    #[arg(long, value_name = "T", env = "TESSERA_TENANT")]
    tenant: Option<Tenant>,
    /// File with the key that the server wants.
    #[arg(long, value_name = "FILE", env = "TESSERA_KEY_FILE")]
    key_file: Option<PathBuf>,
    #[command(flatten)]
    trust: TrustArgs,
}

impl EndpointArgs {
    pub(crate) fn server(&self) -> Result<Option<Server>> {
        let Some(url) = &self.endpoint else { return Ok(None) };
        let (trust, key) = (self.trust.read(url)?, key(self.key_file.as_deref())?);
        Ok(Some(Server { url: url.clone(), tenant: self.tenant.clone(), trust, key }))
    }
}

#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Server")]
pub(crate) struct CallArgs {
    /// The server, e.g. http://127.0.0.1:50051.
    // Needed, but clap does not let an option be both needed and allowed anywhere on the line.
    #[arg(long, value_name = "URL", global = true, env = "TESSERA_ENDPOINT")]
    endpoint: Option<ServerUrl>,
    /// Whose jobs are meant, where several share a server.
    #[arg(long, value_name = "T", global = true, env = "TESSERA_TENANT")]
    tenant: Option<Tenant>,
    #[command(flatten)]
    trust: TrustArgs,
    /// File with the key that the server wants. What is in it is sent with each call.
    #[arg(long, value_name = "FILE", global = true, env = "TESSERA_KEY_FILE")]
    key_file: Option<PathBuf>,
}

#[derive(Args, Debug)]
#[command(next_help_heading = "Server")]
pub(crate) struct ServerArgs {
    #[command(flatten)]
    pub(crate) at: CallArgs,
    /// Seconds to try again after a lost connection, from the last that came; 0 not to. For uploads, downloads, submit with a
    /// request id, watch and wait.
    #[arg(long, value_name = "S", global = true, default_value_t = 60.0, env = "TESSERA_RETRY_S", value_parser = pause)]
    pub(crate) retry_s: f64,
    /// Print the answer on the standard output as JSON, and nothing else there.
    #[arg(long, global = true, help_heading = "Messages")]
    pub(crate) json: bool,
    /// Say nothing but answers, warnings and errors: no progress.
    #[arg(long, short, global = true, help_heading = "Messages")]
    pub(crate) quiet: bool,
}

/// Reads a key. What a file holds that is none is not repeated.
pub(crate) fn key(file: Option<&Path>) -> Result<Option<Secret>> {
    let Some(path) = file else { return Ok(None) };
    let text = bytes(path)?;
    let Some(secret) = std::str::from_utf8(&text).ok().and_then(|text| Secret::parse(text.trim())) else {
        let text = format!("{} holds no key; a key is one line, as `tessera keys add` prints it", path.display());
        return Err(Usage(text).into());
    };
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        const OTHERS: u32 = 0o077;
        if std::fs::metadata(path).is_ok_and(|found| found.is_file() && found.permissions().mode() & OTHERS != 0) {
            errln!("tessera: warning: others can read the key in {}; chmod 600 keeps them out", path.display());
        }
    }
    Ok(Some(secret))
}

/// Reads a number of this range; else says what is needed.
pub(crate) fn number(text: &str, range: RangeInclusive<f64>, needed: &str) -> Result<f64, String> {
    text.parse::<f64>().ok().filter(|number| range.contains(number)).ok_or_else(|| needed.to_owned())
}

pub(crate) fn pause(text: &str) -> Result<f64, String> {
    number(text, 0.0..=86_400.0, "a number of seconds from 0 to 86400 is needed")
}

impl CallArgs {
    /// Where the server is. Errors: [`Usage`] if none is named.
    pub(crate) fn url(&self) -> Result<&ServerUrl, Usage> {
        const NONE: &str =
            "which server? Give --endpoint URL or set TESSERA_ENDPOINT, for example to http://127.0.0.1:50051";
        self.endpoint.as_ref().ok_or_else(|| Usage(NONE.to_owned()))
    }

    pub(crate) fn server(&self) -> Result<Server> {
        let url = self.url()?;
        let (trust, key) = (self.trust.read(url)?, key(self.key_file.as_deref())?);
        Ok(Server { url: url.clone(), tenant: self.tenant.clone(), trust, key })
    }
}

impl ServerArgs {
    /// Prints an answer: with --json as an object, else as lines.
    pub(crate) fn tell(&self, json: impl FnOnce() -> Value, lines: impl FnOnce() -> Vec<String>) -> Result<()> {
        match self.json {
            true => say::json(&json())?,
            false => lines().iter().try_for_each(|line| outln!("{line}"))?,
        }
        Ok(())
    }
}

#[derive(Args, Clone, Debug, Default)]
pub(crate) struct TrustArgs {
    /// File with the authorities that vouch for the server, in PEM; those of the system if not given. For https:// alone.
    #[arg(long, value_name = "FILE", global = true, env = "TESSERA_CA")]
    pub(crate) ca: Option<PathBuf>,
    /// File with the client's certificate, in PEM.
    #[arg(long, value_name = "FILE", global = true, env = "TESSERA_CLIENT_CERT")]
    pub(crate) client_cert: Option<PathBuf>,
    /// File with that certificate's private key, in PEM.
    #[arg(long, value_name = "FILE", global = true, env = "TESSERA_CLIENT_KEY")]
    pub(crate) client_key: Option<PathBuf>,
}

/// What the files hold; nothing if the system's authorities are to be trusted and nothing is shown.
#[derive(Clone, Default)]
pub(crate) struct Trust {
    pub(crate) authorities: Option<Vec<u8>>,
    pub(crate) identity: Option<(Vec<u8>, Vec<u8>)>,
}

impl fmt::Debug for Trust {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Trust").finish_non_exhaustive()
    }
}

impl TrustArgs {
    pub(crate) fn read(&self, url: &ServerUrl) -> Result<Trust> {
        let given = [("--ca", &self.ca), ("--client-cert", &self.client_cert), ("--client-key", &self.client_key)];
        if let Some((option, _)) = given.iter().find(|(_, file)| file.is_some())
            && !url.has_tls()
        {
            let text = format!("{option} is for https, and {url} is not; write {}", url.with_tls());
            return Err(Usage(text).into());
        }
        let identity = match (&self.client_cert, &self.client_key) {
            (Some(cert), Some(key)) => Some((bytes(cert)?, bytes(key)?)),
            (None, None) => None,
            (Some(_), None) => return Err(Usage("--client-cert needs --client-key, its private key".into()).into()),
            (None, Some(_)) => return Err(Usage("--client-key needs --client-cert, its certificate".into()).into()),
        };
        Ok(Trust { authorities: self.ca.as_deref().map(bytes).transpose()?, identity })
    }
}

fn bytes(path: &Path) -> Result<Vec<u8>, NoInput> {
    std::fs::read(path).map_err(|cause| NoInput { path: path.to_owned(), cause })
}

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
        let whole = uri.host().is_some_and(|host| !host.is_empty()) && uri.port_u16().is_some_and(|port| port > 0);
        let wrong = || format!("the port is missing or no number from 1 to 65535; an example is {EXAMPLE}");
        whole.then(|| Self(format!("{scheme}{place}"))).ok_or_else(wrong)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exit::code;

    #[test]
    fn a_key_is_read_and_never_repeated() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let secret = Secret::random().unwrap();
        std::fs::write(file.path(), format!("  {}\n", secret.reveal())).unwrap();
        assert_eq!(key(Some(file.path())).unwrap(), Some(secret));
        std::fs::write(file.path(), "hunter2").unwrap();
        let refused = key(Some(file.path())).unwrap_err().to_string();
        assert!(refused.contains("holds no key") && !refused.contains("hunter2"), "{refused}");
        assert!(key(Some(Path::new("/no/such/file"))).is_err() && key(None).unwrap().is_none());
    }

    #[test]
    fn a_tenant_can_be_sent() {
        assert!("team-7/a".parse::<Tenant>().is_ok());
        for bad in ["", "two words", "ü", "a\n", &"x".repeat(129)] {
            assert!(bad.parse::<Tenant>().is_err(), "{bad:?}");
        }
    }

    #[test]
    fn what_does_not_go_together_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pem");
        std::fs::write(&file, "x").unwrap();
        let (file, none) = (Some(file), Some(folder.path().join("none")));
        let [https, http] = ["https://a:1", "http://a:1"].map(|url| url.parse::<ServerUrl>().unwrap());
        let all = TrustArgs { ca: file.clone(), client_cert: file.clone(), client_key: file.clone() };
        assert!(all.read(&https).unwrap().identity.is_some());
        assert!(!format!("{:?}", all.read(&https).unwrap()).contains("120"), "no bytes are shown");
        for (args, url, exit, words) in [
            (TrustArgs { ca: file.clone(), ..TrustArgs::default() }, &http, 2, "write https://a:1"),
            (TrustArgs { client_cert: file.clone(), ..TrustArgs::default() }, &https, 2, "needs --client-key"),
            (TrustArgs { client_key: file.clone(), ..TrustArgs::default() }, &https, 2, "needs --client-cert"),
            (TrustArgs { ca: none, ..TrustArgs::default() }, &https, 66, "cannot read"),
        ] {
            let error = args.read(url).unwrap_err();
            assert!(code(&error) == exit && error.to_string().contains(words), "{error}");
        }
        assert!(TrustArgs::default().read(&http).is_ok());
    }

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
