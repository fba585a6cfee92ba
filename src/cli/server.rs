//! Which server is asked, and as whom.
//!
//! Purpose: the options that every command has which cannot do without a server. Invariant: a [`Tenant`] can be sent as it
//! is. Must not know: connections, what is asked.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use serde_json::Value;

use super::endpoint::ServerUrl;
use super::exit::{NoInput, Usage};
use super::say;
use super::trust::{Trust, TrustArgs};
use server::keys::Secret;

/// A server, and the credentials for it.
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
        match (1..=128).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_graphic()) {
            true => Ok(Self(text.to_owned())),
            false => Err("a tenant has 1 to 128 printable ASCII characters without spaces".to_owned()),
        }
    }
}

/// Options of a command whose work a server may do.
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

/// The server, and the credentials for it.
#[derive(Args, Debug)]
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

/// The options of a command that asks a server.
#[derive(Args, Debug)]
#[command(next_help_heading = "Server")]
pub(crate) struct ServerArgs {
    #[command(flatten)]
    at: CallArgs,
    /// Seconds to try again after a lost connection, from the last that came; 0 not to. For uploads, downloads, submit with a
    /// request id, watch and wait.
    #[arg(long, value_name = "S", global = true, default_value_t = 60.0, env = "TESSERA_RETRY_S", value_parser = pause)]
    retry_s: f64,
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
    let text = std::fs::read(path).map_err(|cause| NoInput { path: path.to_owned(), cause })?;
    let secret = std::str::from_utf8(&text).ok().and_then(|text| Secret::parse(text.trim()));
    let Some(secret) = secret else {
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

pub(crate) fn pause(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if (0.0..=86_400.0).contains(&seconds) => Ok(seconds),
        _ => Err("a number of seconds from 0 to 86400 is needed".to_owned()),
    }
}

impl CallArgs {
    /// Where the server is.
    ///
    /// # Errors
    /// [`Usage`] if none is named.
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
    pub(crate) fn server(&self) -> Result<Server> {
        self.at.server()
    }

    pub(crate) fn url(&self) -> Result<&ServerUrl, Usage> {
        self.at.url()
    }

    /// Prints an answer: with --json as an object, else as lines.
    pub(crate) fn tell(&self, json: impl FnOnce() -> Value, lines: impl FnOnce() -> Vec<String>) -> Result<()> {
        match self.json {
            true => say::json(&json())?,
            false => lines().iter().try_for_each(|line| outln!("{line}"))?,
        }
        Ok(())
    }

    pub(crate) fn retry(&self) -> Duration {
        Duration::from_secs_f64(self.retry_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
