//! Logs on the standard error stream, and traces to a collector.
//!
//! Purpose: one call at start; what it gives is kept until the end. Invariant: nothing but this module sets a subscriber, and
//! nothing writes logs to the standard output. Every line that belongs to a call or a job has its span, with `trace_id` and `job`.
//! Work never waits for a collector. Must not know: what is logged.

pub mod trace;
#[cfg(feature = "otlp")]
mod traces;

use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use tracing::level_filters::LevelFilter;
use tracing::{Level, Metadata};
use tracing_subscriber::filter::{FilterExt as _, ParseError, filter_fn};
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer as _, Registry};

/// Where traces go.
#[derive(Clone, Debug, PartialEq)]
pub struct Traces {
    /// A collector of OTLP over gRPC.
    pub endpoint: String,
    /// The part that is exported, 0 to 1.
    pub ratio: f64,
}

/// How a log line looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
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

/// Starts logging, and the export of traces if there is a collector. The filter of the log is the variable `TESSERA_LOG`, or
/// `default` (e.g. "info").
///
/// # Errors
/// [`TelemetryError`].
pub fn start(format: LogFormat, default: &str, traces: Option<&Traces>) -> Result<Telemetry, TelemetryError> {
    let filter = match std::env::var("TESSERA_LOG") {
        Ok(filter) if !filter.trim().is_empty() => EnvFilter::try_new(filter)?,
        _ => EnvFilter::try_new(default)?,
    };
    // Written in a thread of its own: work never waits for a slow reader of the log, which loses lines instead.
    let (writer, writing) = tracing_appender::non_blocking(std::io::stderr());
    // Whatever is logged: a line has the names that its spans have.
    let spans = filter_fn(names_work).with_max_level_hint(LevelFilter::INFO);
    let logs = lines(format, std::io::stderr().is_terminal(), writer).with_filter(filter.or(spans));
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

/// Writes events, each with the spans that it lies in. Text has colours if a terminal shows it.
fn lines(format: LogFormat, colours: bool, writer: impl for<'a> MakeWriter<'a> + Send + Sync + 'static) -> BoxedLayer {
    // An error of the writer would be logged to the same stream, and panic there.
    let lines = tracing_subscriber::fmt::layer().with_writer(writer).log_internal_errors(false);
    match format {
        LogFormat::Text => lines.with_ansi(colours).boxed(),
        LogFormat::Json => lines.json().flatten_event(true).with_current_span(false).boxed(),
    }
}

type BoxedLayer = Box<dyn tracing_subscriber::Layer<Registry> + Send + Sync>;

/// Whether something is a span of ours that names a call or a job.
fn names_work(metadata: &Metadata<'_>) -> bool {
    metadata.is_span() && *metadata.level() <= Level::INFO && metadata.target().starts_with("tessera")
}

/// Rate limit for log lines that others can cause: counts events and decides when to log them.
#[derive(Debug)]
pub struct Seldom {
    pause: Duration,
    /// Time of the last line, and events since then.
    state: Mutex<(Option<Instant>, u64)>,
}

/// A line in five seconds: for what remote peers can cause.
impl Default for Seldom {
    fn default() -> Self {
        Self::every(Duration::from_secs(5))
    }
}

impl Seldom {
    /// At most one line in `pause`.
    pub fn every(pause: Duration) -> Self {
        Self { pause, state: Mutex::default() }
    }

    /// Counts an event. If a line is due, returns the number of events since the last line.
    pub fn count(&self) -> Option<u64> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.1 += 1;
        if state.0.is_some_and(|last| last.elapsed() < self.pause) {
            return None;
        }
        state.0 = Some(Instant::now());
        Some(std::mem::take(&mut state.1))
    }
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::sync::Arc;

    use tracing::{field, info_span};

    use super::*;

    #[derive(Clone, Default)]
    struct Page(Arc<Mutex<Vec<u8>>>);

    impl io::Write for Page {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// The line of an event within the spans of a call and of its job, and the id of the call's trace.
    fn line(format: LogFormat) -> (String, String) {
        let page = Page::default();
        let writer = page.clone();
        let layer = lines(format, false, move || writer.clone());
        let trace = tracing::subscriber::with_default(tracing_subscriber::registry().with(layer), || {
            let call = info_span!("call", trace_id = field::Empty).entered();
            let trace = trace::join(&call, None);
            let _job = info_span!("job", job = %7, kind = "remesh").entered();
            tracing::info!(ms = 2.5, by = ?"me", "done \"so far\"");
            trace.id()
        });
        let bytes = page.0.lock().unwrap().clone();
        (String::from_utf8(bytes).unwrap(), trace)
    }

    #[test]
    fn a_line_of_json_has_its_job_and_its_trace() {
        let (line, trace) = line(LogFormat::Json);
        let value: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!((&value["spans"][0]["trace_id"], &value["spans"][1]["job"]), (&trace.into(), &"7".into()));
        assert_eq!((&value["message"], &value["level"]), (&"done \"so far\"".into(), &"INFO".into()));
        assert_eq!((&value["ms"], &value["by"]), (&2.5.into(), &"\"me\"".into()));
        assert!(value["timestamp"].as_str().unwrap().ends_with('Z') && value["target"].is_string());
    }

    #[test]
    fn a_line_of_text_has_them_too() {
        let (line, trace) = line(LogFormat::Text);
        let spans = format!(" INFO call{{trace_id={trace}}}:job{{job=7 kind=\"remesh\"}}: tessera");
        assert!(line.contains(&spans), "{line}");
        assert!(line.ends_with("done \"so far\" ms=2.5 by=\"me\"\n"), "{line}");
    }

    #[test]
    fn the_first_is_told_at_once_and_the_next_are_counted() {
        let seldom = Seldom::default();
        assert_eq!(seldom.count(), Some(1));
        assert_eq!(seldom.count(), None);
        seldom.state.lock().unwrap().0 = Instant::now().checked_sub(seldom.pause);
        assert_eq!(seldom.count(), Some(2));
    }
}
