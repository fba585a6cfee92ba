//! Which server is asked, and as whom.
//!
//! Purpose: the options that every command has which cannot do without a server. Invariant: a [`Tenant`] can be sent as it
//! is. Must not know: connections, what is asked.

use std::str::FromStr;
use std::time::Duration;

use anyhow::Result;
use clap::Args;

use super::endpoint::ServerUrl;
use super::exit::Usage;

/// A server, and what it is told of who asks.
#[derive(Clone, Debug)]
pub(crate) struct Server {
    /// Where it is.
    pub(crate) url: ServerUrl,
    /// Whose jobs are meant; whoever the server takes us for if not given.
    pub(crate) tenant: Option<Tenant>,
}

/// Whose jobs are meant: 1 to 128 printable ASCII characters without spaces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Tenant(String);

impl Tenant {
    /// As it is sent.
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

/// The options of a command that asks a server.
#[derive(Args, Debug)]
#[command(next_help_heading = "Server")]
pub(crate) struct ServerArgs {
    /// The server, e.g. http://127.0.0.1:50051.
    // Needed, but clap does not let an option be both needed and allowed anywhere on the line.
    #[arg(long, value_name = "URL", global = true, env = "TESSERA_ENDPOINT")]
    endpoint: Option<ServerUrl>,
    /// Whose jobs are meant, where several share a server.
    #[arg(long, value_name = "T", global = true, env = "TESSERA_TENANT")]
    tenant: Option<Tenant>,
    /// Seconds to try again after a lost connection, from the last that came; 0 not to. For uploads, downloads, submit with a
    /// request id, watch and wait.
    #[arg(long, value_name = "S", global = true, default_value_t = 60.0, env = "TESSERA_RETRY_S", value_parser = pause)]
    retry_s: f64,
    /// Print the answer on the standard output as JSON, and nothing else there.
    #[arg(long, global = true, help_heading = "What is said")]
    pub(crate) json: bool,
    /// Say nothing but answers, warnings and errors: no progress.
    #[arg(long, short, global = true, help_heading = "What is said")]
    pub(crate) quiet: bool,
}

pub(crate) fn pause(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if (0.0..=86_400.0).contains(&seconds) => Ok(seconds),
        _ => Err("a number of seconds from 0 to 86400 is needed".to_owned()),
    }
}

impl ServerArgs {
    /// The server that is meant.
    ///
    /// # Errors
    /// [`Usage`] if none is named.
    pub(crate) fn server(&self) -> Result<Server> {
        let Some(url) = &self.endpoint else {
            let text =
                "which server? Give --endpoint URL or set TESSERA_ENDPOINT, for example to http://127.0.0.1:50051";
            return Err(Usage(text.to_owned()).into());
        };
        Ok(Server { url: url.clone(), tenant: self.tenant.clone() })
    }

    /// How long to try again after a lost connection.
    pub(crate) fn retry(&self) -> Duration {
        Duration::from_secs_f64(self.retry_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenant_can_be_sent() {
        assert!("team-7/a".parse::<Tenant>().is_ok());
        for bad in ["", "two words", "ü", "a\n", &"x".repeat(129)] {
            assert!(bad.parse::<Tenant>().is_err(), "{bad:?}");
        }
    }
}
