//! The two texts that Prometheus reads.
//!
//! Purpose: OpenMetrics for clients that ask for it, else the older text; the two differ in how counters are declared.
//! Invariant: the samples are the same. Must not know: what is counted.

use std::fmt::Write as _;

use prometheus_client::encoding::text;
use prometheus_client::registry::Registry;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// OpenMetrics 1.0.
    OpenMetrics,
    /// The text format 0.0.4.
    Text,
}

impl Format {
    /// What a client that sends this header `Accept` reads.
    pub fn of(accept: Option<&str>) -> Self {
        match accept {
            Some(accept) if accept.contains("application/openmetrics-text") => Self::OpenMetrics,
            _ => Self::Text,
        }
    }

    pub fn content_type(self) -> &'static str {
        match self {
            Self::OpenMetrics => "application/openmetrics-text; version=1.0.0; charset=utf-8",
            Self::Text => "text/plain; version=0.0.4; charset=utf-8",
        }
    }

    pub(super) fn write(self, registry: &Registry) -> String {
        let mut open = String::new();
        // Writing to a string does not fail.
        let _ = text::encode(&mut open, registry);
        match self {
            Self::OpenMetrics => open,
            Self::Text => older(&open),
        }
    }
}

/// OpenMetrics as the older text: there the name of a counter has its suffix everywhere, and there is neither unit nor end.
fn older(open: &str) -> String {
    let mut out = String::with_capacity(open.len());
    let mut help = None;
    for line in open.lines() {
        let mut words = line.splitn(4, ' ');
        match (words.next(), words.next(), words.next(), words.next()) {
            (Some("#"), Some("HELP"), Some(name), Some(text)) => help = Some((name, text)),
            (Some("#"), Some("TYPE"), Some(name), Some(kind)) => {
                let (suffix, kind) = match kind {
                    "counter" => ("_total", "counter"),
                    "info" => ("_info", "gauge"),
                    other => ("", other),
                };
                if let Some((_, text)) = help.take().filter(|(of, _)| *of == name) {
                    let _ = writeln!(out, "# HELP {name}{suffix} {text}");
                }
                let _ = writeln!(out, "# TYPE {name}{suffix} {kind}");
            }
            (Some("#"), ..) => {}
            _ => {
                out.push_str(line);
                out.push('\n');
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use prometheus_client::metrics::counter::Counter;
    use prometheus_client::metrics::info::Info;
    use prometheus_client::registry::Unit;

    use super::*;

    #[test]
    fn both_texts_have_the_same_samples() {
        let mut registry = Registry::default();
        let counter = Counter::<u64>::default();
        counter.inc();
        registry.register_with_unit("work", "What was done", Unit::Seconds, counter);
        registry.register("build", "The build", Info::new(vec![("version", "1 # TYPE x counter")]));
        let open = Format::OpenMetrics.write(&registry);
        assert!(
            open.contains("# TYPE work_seconds counter\n# UNIT work_seconds seconds\n") && open.ends_with("# EOF\n")
        );
        let expected = "# HELP work_seconds_total What was done.\n# TYPE work_seconds_total counter\n\
                        work_seconds_total 1\n# HELP build_info The build.\n# TYPE build_info gauge\n\
                        build_info{version=\"1 # TYPE x counter\"} 1\n";
        assert_eq!(Format::Text.write(&registry), expected);
    }

    #[test]
    fn a_client_gets_what_it_reads() {
        let prometheus = "application/openmetrics-text;version=1.0.0;q=0.5,text/plain;version=0.0.4;q=0.2,*/*;q=0.1";
        assert_eq!(Format::of(Some(prometheus)), Format::OpenMetrics);
        assert_eq!((Format::of(Some("text/plain")), Format::of(None)), (Format::Text, Format::Text));
    }
}
