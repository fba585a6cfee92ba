//! Logs on the standard error stream.
//!
//! Purpose: one call at start. Invariant: nothing but this module sets a subscriber, and nothing
//! writes logs to the standard output. Must not know: what is logged.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::ParseError;

/// How a log line looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line.
    Json,
}

/// Why there are no logs.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TelemetryError {
    /// The filter is not one.
    #[error("TESSERA_LOG is not a log filter: {0}; an example is `info,tessera=debug`")]
    Filter(#[from] ParseError),
    /// A subscriber is there already.
    #[error("logging was set up twice")]
    Twice,
}

/// Starts logging. What is logged: the variable `TESSERA_LOG`, or `default` (e.g. "info").
///
/// # Errors
/// [`TelemetryError`].
pub(crate) fn start(format: LogFormat, default: &str) -> Result<(), TelemetryError> {
    let filter = match std::env::var("TESSERA_LOG") {
        Ok(filter) if !filter.trim().is_empty() => EnvFilter::try_new(filter)?,
        _ => EnvFilter::try_new(default)?,
    };
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // It would say so on the same stream, and panic there.
        .log_internal_errors(false)
        .with_ansi(std::io::stderr().is_terminal());
    let done = match format {
        LogFormat::Text => builder.try_init(),
        LogFormat::Json => builder.json().flatten_event(true).try_init(),
    };
    done.map_err(|_| TelemetryError::Twice)
}
