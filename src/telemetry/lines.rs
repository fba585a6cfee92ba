//! A line of the log.
//!
//! Purpose: [`Names`] remembers which spans name a job or a trace, [`Lines`] writes events with the names of their spans, as
//! text or as JSON. Invariant: a name stands once in a line, at the same place in every line. Must not know: what is logged.

use std::fmt;

use serde_json::{Map, Value};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::{FormatTime, SystemTime};
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

use super::LogFormat;

/// What a span names.
#[derive(Clone, Debug, Default)]
struct Named {
    trace_id: Option<String>,
    job: Option<String>,
}

impl Visit for Named {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        match field.name() {
            "trace_id" => self.trace_id = Some(format!("{value:?}")),
            "job" => self.job = Some(format!("{value:?}")),
            _ => {}
        }
    }
}

/// Remembers the names of spans.
pub(super) struct Names;

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Names {
    fn on_new_span(&self, attributes: &Attributes<'_>, id: &Id, context: Context<'_, S>) {
        let mut named = Named::default();
        attributes.record(&mut named);
        if let Some(span) = context.span(id) {
            span.extensions_mut().insert(named);
        }
    }

    fn on_record(&self, id: &Id, values: &Record<'_>, context: Context<'_, S>) {
        if let Some(span) = context.span(id)
            && let Some(named) = span.extensions_mut().get_mut::<Named>()
        {
            values.record(named);
        }
    }
}

/// Writes events.
pub(super) struct Lines {
    pub(super) format: LogFormat,
}

impl<S, N> FormatEvent<S, N> for Lines
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(&self, context: &FmtContext<'_, S, N>, writer: Writer<'_>, event: &Event<'_>) -> fmt::Result {
        let mut names = Named::default();
        for span in context.event_scope().into_iter().flatten() {
            if let Some(named) = span.extensions().get::<Named>() {
                // The innermost comes first.
                names.trace_id = names.trace_id.or_else(|| named.trace_id.clone());
                names.job = names.job.or_else(|| named.job.clone());
            }
        }
        match self.format {
            LogFormat::Text => text(context, writer, event, &names),
            LogFormat::Json => json(writer, event, names),
        }
    }
}

fn text<S, N>(context: &FmtContext<'_, S, N>, mut writer: Writer<'_>, event: &Event<'_>, names: &Named) -> fmt::Result
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    SystemTime.format_time(&mut writer)?;
    let level = *event.metadata().level();
    match writer.has_ansi_escapes() {
        true => write!(writer, " \x1b[{}m{level:>5}\x1b[0m ", colour(level))?,
        false => write!(writer, " {level:>5} ")?,
    }
    write!(writer, "{}: ", event.metadata().target())?;
    context.format_fields(writer.by_ref(), event)?;
    if let Some(job) = &names.job {
        write!(writer, " job={job}")?;
    }
    if let Some(trace) = &names.trace_id {
        write!(writer, " trace_id={trace}")?;
    }
    writeln!(writer)
}

/// As terminals number colours.
fn colour(level: Level) -> u8 {
    match level {
        Level::ERROR => 31,
        Level::WARN => 33,
        Level::INFO => 32,
        Level::DEBUG => 34,
        Level::TRACE => 35,
    }
}

fn json(mut writer: Writer<'_>, event: &Event<'_>, names: Named) -> fmt::Result {
    let mut time = String::new();
    SystemTime.format_time(&mut Writer::new(&mut time))?;
    let mut all = Fields(Map::new());
    let metadata = event.metadata();
    all.0.insert("timestamp".to_owned(), time.into());
    all.0.insert("level".to_owned(), metadata.level().as_str().into());
    event.record(&mut all);
    all.0.insert("target".to_owned(), metadata.target().into());
    all.0.extend(names.job.map(|job| ("job".to_owned(), job.into())));
    all.0.extend(names.trace_id.map(|trace| ("trace_id".to_owned(), trace.into())));
    writeln!(writer, "{}", Value::Object(all.0))
}

/// The fields of an event.
struct Fields(Map<String, Value>);

impl Fields {
    fn add(&mut self, field: &Field, value: impl Into<Value>) {
        self.0.insert(field.name().to_owned(), value.into());
    }
}

impl Visit for Fields {
    fn record_f64(&mut self, field: &Field, value: f64) {
        self.add(field, value);
    }

    fn record_i64(&mut self, field: &Field, value: i64) {
        self.add(field, value);
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        self.add(field, value);
    }

    fn record_bool(&mut self, field: &Field, value: bool) {
        self.add(field, value);
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        self.add(field, value);
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        self.add(field, format!("{value:?}"));
    }
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::sync::{Arc, Mutex};

    use tracing::{field, info_span};
    use tracing_subscriber::layer::SubscriberExt as _;

    use super::*;

    #[derive(Clone, Default)]
    struct Page(Arc<Mutex<Vec<u8>>>);

    impl io::Write for Page {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// The line that is written within a call's and a job's span.
    fn line(format: LogFormat) -> String {
        let page = Page::default();
        let writer = page.clone();
        let layer = tracing_subscriber::fmt::layer().with_ansi(false).event_format(Lines { format });
        let layer = Names.and_then(layer.with_writer(move || writer.clone()));
        tracing::subscriber::with_default(tracing_subscriber::registry().with(layer), || {
            let call = info_span!("call", trace_id = field::Empty).entered();
            call.record("trace_id", field::display("abc"));
            let _job = info_span!("job", job = %7, kind = "remesh").entered();
            let _stage = info_span!("stage", stage = "dual").entered();
            tracing::info!(ms = 2.5, facets = 8, by = ?"me", "done \"so far\"");
        });
        let bytes = page.0.lock().unwrap().clone();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_line_of_json_has_its_job_and_its_trace() {
        let value: Value = serde_json::from_str(&line(LogFormat::Json)).unwrap();
        assert_eq!((&value["job"], &value["trace_id"]), (&"7".into(), &"abc".into()));
        assert_eq!((&value["message"], &value["level"]), (&"done \"so far\"".into(), &"INFO".into()));
        assert_eq!((&value["ms"], &value["facets"], &value["by"]), (&2.5.into(), &8.into(), &"\"me\"".into()));
        assert!(value["timestamp"].as_str().unwrap().ends_with('Z') && value["target"].is_string());
    }

    #[test]
    fn a_line_of_text_has_them_at_its_end() {
        let line = line(LogFormat::Text);
        assert!(line.ends_with(" job=7 trace_id=abc\n") && line.contains(" INFO tessera"), "{line}");
        assert!(line.contains("done \"so far\" ms=2.5 facets=8"), "{line}");
    }
}
