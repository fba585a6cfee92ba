//! Options of metrics, health and traces.
//!
//! Invariant: the admin port is open to this machine alone, unless an option opens it.
//! Must not know: metrics, traces.

use std::net::SocketAddr;

use clap::Args;
use telemetry::Traces;

use super::values::{ConfigError, addresses};

/// See the module's head.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Metrics, health and traces")]
pub struct WatchingArgs {
    /// Seconds between two probes of an idle backend: a tiny diagram with a known answer. While a probe fails, health says
    /// NOT_SERVING.
    #[arg(long, value_name = "S", default_value_t = 60.0, env = "TESSERA_PROBE_S")]
    pub probe_s: f64,
    /// Address and port for operators: metrics, health and readiness over HTTP. None if not given; anything but loopback needs
    /// --admin-public.
    #[arg(long, value_name = "ADDRESS:PORT", env = "TESSERA_ADMIN_LISTEN")]
    pub admin_listen: Option<String>,
    /// Let other machines reach the admin port, which asks for no key. --insecure does so too.
    #[arg(long, env = "TESSERA_ADMIN_PUBLIC")]
    pub admin_public: bool,
    /// Collector of OpenTelemetry traces (OTLP over gRPC), e.g. http://127.0.0.1:4317. None if not given.
    #[arg(long, value_name = "URL", env = "TESSERA_OTLP_ENDPOINT")]
    pub otlp_endpoint: Option<String>,
    /// Share of the traces to export, 0 to 1; traces sampled by a caller are always exported.
    #[arg(long, value_name = "R", default_value_t = 1.0, env = "TESSERA_OTLP_RATIO")]
    pub otlp_ratio: f64,
}

impl WatchingArgs {
    /// Addresses of the admin port; empty if it is off.
    pub(super) fn admin(&self, insecure: bool) -> Result<Vec<SocketAddr>, ConfigError> {
        let Some(listen) = &self.admin_listen else { return Ok(Vec::new()) };
        let found = addresses("--admin-listen", listen)?;
        if !insecure && !self.admin_public && found.iter().any(|address| !address.ip().to_canonical().is_loopback()) {
            let must = "a loopback address, as 127.0.0.1:9090, since it asks for no key; or give --admin-public";
            return Err(ConfigError::new("--admin-listen", format!("{listen:?}"), must));
        }
        Ok(found)
    }

    /// The collector of traces, and the part that is exported.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn traces(&self) -> Result<Option<Traces>, ConfigError> {
        // The variable that programs with OpenTelemetry share.
        let shared = || std::env::var("OTEL_EXPORTER_OTLP_ENDPOINT").ok().filter(|url| !url.is_empty());
        let wrong = |option, value: String, must: &'static str| Err(ConfigError::new(option, value, must));
        if !(0.0..=1.0).contains(&self.otlp_ratio) {
            return wrong("--otlp-ratio", self.otlp_ratio.to_string(), "a number from 0 to 1");
        }
        let Some(endpoint) = self.otlp_endpoint.clone().or_else(shared) else { return Ok(None) };
        if !cfg!(feature = "otlp") {
            return wrong("--otlp-endpoint", endpoint, "left out: this program was built without the feature otlp");
        }
        if endpoint.contains('@') {
            let must = "a URL without a name and a password, which logs would show";
            return wrong("--otlp-endpoint", "a URL with an @".to_owned(), must);
        }
        match endpoint.strip_prefix("http://").is_some_and(|host| !host.is_empty()) {
            true => Ok(Some(Traces { endpoint, ratio: self.otlp_ratio })),
            false => wrong(
                "--otlp-endpoint",
                endpoint,
                "a URL as http://127.0.0.1:4317; https is not supported, use a collector on this host",
            ),
        }
    }
}
