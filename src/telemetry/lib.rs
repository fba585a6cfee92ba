//! Logs on the standard error stream, and traces to a collector.
//!
//! Purpose: one call at start; what it gives is kept until the end. Invariant: nothing but this module sets a subscriber, and
//! nothing writes logs to the standard output. Every line that belongs to a call or a job has its `trace_id`, and its `job`.
//! Nobody waits for a collector. Must not know: what is logged.

#![warn(unreachable_pub)]

mod lines;
pub mod trace;
#[cfg(feature = "otlp")]
mod traces;

use std::io::IsTerminal;

use tracing::level_filters::LevelFilter;
use tracing::{Level, Metadata};
use tracing_subscriber::filter::{FilterExt as _, ParseError, filter_fn};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer as _};

/// Where traces go.
#[derive(Clone, Debug, PartialEq)]
pub struct Traces {
    /// A collector of OTLP over gRPC.
    pub endpoint: String,
    /// The part that is exported, 0 to 1.
    pub ratio: f64,
}

/// How a log line looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line.
    Json,
}

/// Why there are no logs.
#[derive(Debug, thiserror::Error)]
pub enum TelemetryError {
    /// The filter is not one.
    #[error("TESSERA_LOG is not a log filter: {0}; an example is `info,tessera=debug`")]
    Filter(#[from] ParseError),
    /// A subscriber is there already.
    #[error("logging was set up twice")]
    Twice,
    /// Traces cannot be exported.
    #[cfg(feature = "otlp")]
    #[error("--otlp-endpoint: {0}; an example is http://127.0.0.1:4317")]
    Traces(String),
}

/// To be kept until the program ends: then traces that wait are sent, and lines that wait are written.
#[derive(Debug)]
pub struct Telemetry {
    #[cfg(feature = "otlp")]
    _traces: Option<traces::Exporting>,
    _writing: tracing_appender::non_blocking::WorkerGuard,
}

/// Starts logging, and exports traces if somebody takes them. What is logged: the variable `TESSERA_LOG`, or `default` (e.g.
/// "info").
///
/// # Errors
/// [`TelemetryError`].
pub fn start(format: LogFormat, default: &str, traces: Option<&Traces>) -> Result<Telemetry, TelemetryError> {
    let filter = match std::env::var("TESSERA_LOG") {
        Ok(filter) if !filter.trim().is_empty() => EnvFilter::try_new(filter)?,
        _ => EnvFilter::try_new(default)?,
    };
    // A thread of its own writes: nobody at work waits for who reads the log. What it is too slow for is left out.
    let (writer, writing) = tracing_appender::non_blocking(std::io::stderr());
    // Whatever is logged: a line has the names that its spans have.
    let spans = filter_fn(names_work).with_max_level_hint(LevelFilter::INFO);
    let lines = tracing_subscriber::fmt::layer()
        .event_format(lines::Lines { format })
        .with_writer(writer)
        // It would say so on the same stream, and panic there.
        .log_internal_errors(false)
        .with_ansi(format == LogFormat::Text && std::io::stderr().is_terminal());
    let logs = lines::Names.and_then(lines).with_filter(filter.or(spans));
    let registry = tracing_subscriber::registry().with(logs);
    #[cfg(feature = "otlp")]
    {
        let traces = traces.map(traces::Exporting::start).transpose()?;
        let layer = traces.as_ref().map(traces::Exporting::layer);
        registry.with(layer).try_init().map_err(|_| TelemetryError::Twice)?;
        Ok(Telemetry { _traces: traces, _writing: writing })
    }
    #[cfg(not(feature = "otlp"))]
    {
        // Refused where options are checked.
        let _ = traces;
        registry.try_init().map_err(|_| TelemetryError::Twice)?;
        Ok(Telemetry { _writing: writing })
    }
}

/// Whether something is a span of ours that names a call or a job.
fn names_work(metadata: &Metadata<'_>) -> bool {
    metadata.is_span() && *metadata.level() <= Level::INFO && metadata.target().starts_with("tessera")
}
