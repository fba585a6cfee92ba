//! What a load came to, for people, as JSON and as a picture; and how it is while it runs: a line on a terminal.
//!
//! Invariant: every figure has its unit; the view is on the standard error stream only. Must not know: how anything is measured,
//! written or drawn.

use std::collections::BTreeMap;
use std::time::Duration;

use indicatif::ProgressBar;
use serde_json::{Value, json};

use super::Done;
use super::amounts::Kind;
use super::calls::Stages;
use super::compare::Comparison;
use super::measure::{Counts, Latencies};
use crate::load::measure::{Measure, Second};
use crate::progress::bar;
use picture::chart::{Axis, Figure, Panel, Series};

/// Quantiles of latencies, and their names.
pub(super) const QUANTILES: [(&str, f64); 4] = [("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("p999", 0.999)];

impl Done {
    fn kinds(&self) -> impl Iterator<Item = (&'static str, &Latencies)> {
        Kind::ALL.iter().map(|kind| kind.name()).zip(&self.measure.kinds).filter(|(_, all)| all.count() > 0)
    }

    fn stages(&self) -> impl Iterator<Item = (&'static str, &Latencies)> {
        Stages::NAMES.into_iter().zip(&self.measure.stages).filter(|(_, all)| all.count() > 0)
    }

    /// As lines. `crossed` are the thresholds that were crossed, in words.
    pub(super) fn lines(&self, crossed: &[String]) -> Vec<String> {
        let measure = &self.measure;
        let mut lines = Vec::new();
        if self.stopped {
            lines.push(format!("stopped    after {:.1} s of measuring", measure.seconds_measured()));
        }
        lines.extend([String::new(), head("latency, ms"), row("all", &measure.latencies)]);
        if self.kinds().count() > 1 {
            lines.extend(self.kinds().map(|(name, all)| row(&format!("  {name}"), all)));
        }
        lines.extend(self.stages().map(|(name, all)| row(&format!("  {name}"), all)));
        if measure.slow_latencies.count() > 0 {
            lines.push(row("slow readers", &measure.slow_latencies));
        }
        lines.push(String::new());
        lines.extend(self.rates());
        lines.extend(outcomes(&measure.counts));
        if measure.slow.intended > 0 {
            let (done, failed) = (measure.slow.done, measure.slow.errors());
            lines.push(format!("slow       {} calls, {done} done, {failed} failed", measure.slow.intended));
        }
        lines.extend(self.compared());
        if self.left > 0 {
            lines.push(format!("left       {} jobs or blobs could not be removed", self.left));
        }
        lines.extend(crossed.iter().map(|words| format!("crossed    {words}")));
        lines
    }

    fn rates(&self) -> Vec<String> {
        let (measure, amounts) = (&self.measure, &self.measure.amounts);
        let mib = |bytes: u64| measure.rate(bytes) / f64::from(1 << 20);
        let [facets, seeds] = [amounts.facets, amounts.seeds].map(|count| thousands(measure.rate(count)));
        let calls = measure.rate(amounts.done);
        let rates = format!("rate       {calls:.2} calls a second; {facets} facets and {seeds} seeds a second");
        let mut lines = vec![rates];
        if amounts.sent_bytes + amounts.came_bytes > 0 {
            let (sent, came) = (mib(amounts.sent_bytes), mib(amounts.came_bytes));
            lines.push(format!("transfer   {sent:.2} MiB a second sent, {came:.2} MiB received"));
        }
        lines
    }

    fn compared(&self) -> Vec<String> {
        let Some(comparison) = &self.comparison else { return Vec::new() };
        let (calls, methods, unheard) = (comparison.calls(), comparison.methods.len(), comparison.unheard());
        let unheard = if unheard > 0 { format!(", of which {unheard} were given up") } else { String::new() };
        let mut lines = Vec::new();
        match comparison.mismatches() {
            0 => lines.push(format!("counts     equal to the server's: {calls} RPCs of {methods} methods{unheard}")),
            count => {
                lines.push(format!("counts     {count} of the server's are other than here{unheard}:"));
                let other = comparison.methods.iter().flat_map(|m| m.rows.iter().map(move |row| (&m.name, row)));
                let other = other.filter(|(_, row)| row.here as i64 != row.there);
                lines.extend(other.map(|(name, row)| {
                    format!("           {name} {}: {} here, {} there", row.status, row.here, row.there)
                }));
            }
        }
        let short = |name: &str| name.rsplit('/').next().unwrap_or(name).to_owned();
        lines.push(format!("{:<24}{:>10}{:>12}{:>12}", "mean of RPCs, ms", "calls", "here", "server"));
        for method in &comparison.methods {
            let ms = |mean: Option<f64>| mean.map_or("-".to_owned(), |mean| format!("{:.2}", 1e3 * mean));
            let calls = method.rows.iter().map(|row| row.here).sum::<u64>() + method.unheard;
            let (here, there) = (ms(method.mean_s.here), ms(method.mean_s.there));
            lines.push(format!("  {:<22}{calls:>10}{here:>12}{there:>12}", short(&method.name)));
        }
        lines
    }

    pub(super) fn json(&self, crossed: &[String]) -> Value {
        let (measure, amounts) = (&self.measure, &self.measure.amounts);
        let kinds: BTreeMap<_, _> = self.kinds().map(|(name, all)| (name, latencies(all))).collect();
        let stages: BTreeMap<_, _> = self.stages().map(|(name, all)| (name, latencies(all))).collect();
        let slow = (measure.slow.intended > 0).then(|| {
            let mut slow = counts(&measure.slow);
            slow["latency_s"] = latencies(&measure.slow_latencies);
            slow
        });
        json!({
            "measured_s": measure.seconds_measured(),
            "stopped": self.stopped,
            "calls": counts(&measure.counts),
            "latency_s": latencies(&measure.latencies),
            "kinds_s": kinds,
            "stages_s": stages,
            "rates": {
                "calls_a_second": measure.rate(amounts.done), "facets_a_second": measure.rate(amounts.facets),
                "seeds_a_second": measure.rate(amounts.seeds), "sent_bytes_a_second": measure.rate(amounts.sent_bytes),
                "received_bytes_a_second": measure.rate(amounts.came_bytes),
            },
            "slow_readers": slow,
            "timeline": measure.seconds,
            "comparison": self.comparison.as_ref().map(Comparison::json),
            "left": self.left,
            "thresholds_crossed": crossed,
        })
    }
}

fn outcomes(counts: &Counts) -> Vec<String> {
    let part = |count: u64| format!("{count} ({:.1} %)", 100.0 * count as f64 / counts.intended.max(1) as f64);
    let mut lines = vec![format!("done       {} of {} calls", counts.done, counts.intended)];
    let mut line = |name: &str, count: u64| {
        if count > 0 {
            lines.push(format!("{name:<11}{}", part(count)));
        }
    };
    line("cancelled", counts.cancelled);
    line("dropped", counts.dropped);
    line("late", counts.late);
    line("stopped", counts.stopped);
    let (refused, errors) = (counts.refusals(), counts.errors());
    lines.push(format!("refused    {}", if refused > 0 { part(refused) } else { "0".to_owned() }));
    lines.extend(counts.refused.iter().map(|(reason, count)| format!("           {count} {reason}")));
    lines.push(format!("errors     {}", if errors > 0 { part(errors) } else { "0".to_owned() }));
    lines.extend(
        counts.failed.iter().map(|(code, times)| format!("           {} {code}: {}", times.count, times.example)),
    );
    lines
}

fn head(name: &str) -> String {
    let names = ["calls", "p50", "p90", "p99", "p99.9", "max", "mean"];
    names.iter().fold(format!("{name:<16}"), |line, name| format!("{line}{name:>10}"))
}

fn row(name: &str, all: &Latencies) -> String {
    let quantiles = QUANTILES.map(|(_, part)| all.quantile(part));
    let rest = [all.max(), all.mean()];
    let number = |value: &Option<f64>| value.map_or("-".to_owned(), |seconds| format!("{:.1}", 1e3 * seconds));
    let values = quantiles.iter().chain(&rest).map(|value| format!("{:>10}", number(value)));
    format!("{name:<16}{:>10}{}", all.count(), values.collect::<String>())
}

fn thousands(value: f64) -> String {
    match value {
        value if value >= 1e6 => format!("{:.2} M", value / 1e6),
        value if value >= 1e4 => format!("{:.1} k", value / 1e3),
        value => format!("{value:.0}"),
    }
}

fn latencies(all: &Latencies) -> Value {
    let mut object = json!({ "count": all.count() });
    for (name, part) in QUANTILES {
        object[name] = all.quantile(part).into();
    }
    object["max"] = all.max().into();
    object["mean"] = all.mean().into();
    object
}

fn counts(counts: &Counts) -> Value {
    let mut object = json!(counts);
    (object["refused"], object["errors"]) = (counts.refusals().into(), counts.errors().into());
    object
}

pub(super) fn figure(title: String, measure: &Measure) -> Figure {
    let seconds = &measure.seconds;
    let series = |name: &str, of: &dyn Fn(&Second) -> Option<f64>| Series {
        name: name.to_owned(),
        points: seconds.iter().filter_map(|second| Some((second.at as f64, of(second)?))).collect(),
    };
    let ms = |seconds: Option<f64>| seconds.map(|seconds| 1e3 * seconds);
    let latency = vec![
        series("p50", &|second| ms(second.p50)),
        series("p99", &|second| ms(second.p99)),
        series("max", &|second| ms(second.max)),
    ];
    let count = |name: &str, of: fn(&Second) -> u64| {
        // A line of nothing says nothing, but for what is done.
        let any = name == "done" || seconds.iter().any(|second| of(second) > 0);
        any.then(|| series(name, &|second| Some(of(second) as f64)))
    };
    let outcomes = [
        count("done", |second| second.done),
        count("refused", |second| second.refused),
        count("failed", |second| second.failed),
        count("dropped", |second| second.dropped),
    ];
    let panel = |title: &str, y: Axis, series: Vec<Series>| Panel {
        title: title.to_owned(),
        x: Axis::linear("seconds since the begin"),
        y,
        series,
        ..Panel::default()
    };
    Figure {
        title,
        panels: vec![
            panel("Latency from the intended start", Axis::log("ms"), latency),
            panel("Calls that ended", Axis::linear("a second"), outcomes.into_iter().flatten().collect()),
        ],
    }
}

pub(super) struct View(Option<ProgressBar>);

impl View {
    pub(super) const EVERY: Duration = Duration::from_millis(250);

    /// Of a run that lasts so long.
    pub(super) fn new(length: Duration, quiet: bool) -> Self {
        Self(bar(length.as_millis() as u64, "{spinner} {bar:20} {msg}", quiet))
    }

    pub(super) fn draw(&self, measure: &Measure, elapsed: Duration, open: u64) {
        let Some(bar) = &self.0 else { return };
        bar.set_position(elapsed.as_millis() as u64);
        bar.set_message(line(measure, elapsed, open));
    }
}

impl Drop for View {
    fn drop(&mut self) {
        if let Some(bar) = self.0.take() {
            bar.finish_and_clear();
        }
    }
}

fn line(measure: &Measure, elapsed: Duration, open: u64) -> String {
    let length = measure.window.end.as_secs();
    let phase = match elapsed {
        at if at < measure.window.start => "warming up, ",
        at if at >= measure.window.end => "waiting for open calls, ",
        _ => "",
    };
    let last = measure.seconds.last().copied().unwrap_or_default();
    let ms = |seconds: Option<f64>| seconds.map_or("-".to_owned(), |seconds| format!("{:.0}", 1e3 * seconds));
    let counts = &measure.counts;
    format!(
        "{phase}{} of {length} s | {} a second, {open} open | ms p50 {} p99 {} | refused {} errors {} dropped {} late {}",
        elapsed.as_secs(),
        last.done,
        ms(last.p50),
        ms(last.p99),
        counts.refusals(),
        counts.errors(),
        counts.dropped,
        counts.late,
    )
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use picture::Size;

    #[test]
    fn a_run_without_calls_has_a_picture_too() {
        let mut measure = Measure::new(Duration::ZERO..Duration::from_secs(5));
        for seconds in [0, 1, 5] {
            measure.turn(Duration::from_secs(seconds));
            let figure = figure("load".to_owned(), &measure);
            assert_eq!(figure.panels[1].series.len(), 1);
            assert!(figure.draw(Size::new(800, 300).unwrap()).is_ok());
        }
    }

    #[test]
    fn a_line_says_where_the_run_is() {
        let s = Duration::from_secs(1);
        let mut measure = Measure::new(2 * s..10 * s);
        measure.dropped(3 * s);
        measure.turn(5 * s);
        assert!(line(&measure, s, 3).starts_with("warming up, 1 of 10 s | 0 a second, 3 open | ms p50 - p99 - |"));
        assert!(line(&measure, 5 * s, 3).starts_with("5 of 10 s") && line(&measure, 5 * s, 3).contains("dropped 1"));
        assert!(line(&measure, 11 * s, 3).starts_with("waiting for open calls"));
    }
}
