//! What a load came to, for people and as JSON.
//!
//! Invariant: every figure has its unit. Must not know: how anything is measured or written.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::amounts::Kind;
use super::calls::Stages;
use super::compare::Comparison;
use super::measure::{Counts, Latencies, Measure, Second, Times};

/// Everything there is to tell.
pub(super) struct Report<'a> {
    /// The load in words.
    pub(super) title: String,
    /// The server in words.
    pub(super) server: String,
    /// The surfaces in words.
    pub(super) surfaces: String,
    pub(super) measure: &'a Measure,
    pub(super) comparison: Option<&'a Comparison>,
    /// What could not be removed.
    pub(super) left: u64,
    pub(super) stopped: bool,
    /// Thresholds that were crossed, in words.
    pub(super) crossed: &'a [String],
}

const QUANTILES: [(&str, f64); 4] = [("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("p999", 0.999)];

impl Report<'_> {
    /// As lines.
    pub(super) fn lines(&self) -> Vec<String> {
        let measure = self.measure;
        let mut lines = vec![self.title.clone(), format!("server     {}", self.server)];
        lines.push(format!("surfaces   {}", self.surfaces));
        if self.stopped {
            lines.push(format!("stopped    after {:.1} s of measuring", measure.seconds_measured()));
        }
        lines.push(String::new());
        lines.push(head("latency, ms"));
        lines.push(row("all", &measure.latencies));
        let kinds: Vec<_> = Kind::ALL.iter().zip(&measure.kinds).filter(|(_, kind)| kind.count() > 0).collect();
        if kinds.len() > 1 {
            lines.extend(kinds.iter().map(|(kind, latencies)| row(&format!("  {}", kind.name()), latencies)));
        }
        let stages = Stages::NAMES.iter().zip(&measure.stages).filter(|(_, stage)| stage.count() > 0);
        lines.extend(stages.map(|(name, latencies)| row(&format!("  {name}"), latencies)));
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
        lines.extend(self.crossed.iter().map(|words| format!("crossed    {words}")));
        lines
    }

    fn rates(&self) -> Vec<String> {
        let (measure, amounts) = (self.measure, &self.measure.amounts);
        let mib = |bytes: u64| measure.rate(bytes) / f64::from(1 << 20);
        let mut lines = vec![format!(
            "rate       {:.2} calls a second; {} facets and {} seeds a second",
            measure.rate(amounts.done),
            thousands(measure.rate(amounts.facets)),
            thousands(measure.rate(amounts.seeds)),
        )];
        if amounts.sent_bytes + amounts.came_bytes > 0 {
            lines.push(format!(
                "transfer   {:.2} MiB a second sent, {:.2} MiB received",
                mib(amounts.sent_bytes),
                mib(amounts.came_bytes)
            ));
        }
        lines
    }

    fn compared(&self) -> Vec<String> {
        let Some(comparison) = self.comparison else { return Vec::new() };
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
            let (here, there) = (ms(method.mean_s.0), ms(method.mean_s.1));
            lines.push(format!("  {:<22}{calls:>10}{here:>12}{there:>12}", short(&method.name)));
        }
        lines
    }

    /// As an object.
    pub(super) fn json(&self) -> Value {
        let (measure, amounts) = (self.measure, &self.measure.amounts);
        let kinds = Kind::ALL.iter().zip(&measure.kinds).filter(|(_, kind)| kind.count() > 0);
        let kinds: serde_json::Map<_, _> = kinds.map(|(kind, all)| (kind.name().to_owned(), latencies(all))).collect();
        let stages = Stages::NAMES.iter().zip(&measure.stages).filter(|(_, stage)| stage.count() > 0);
        let stages: serde_json::Map<_, _> = stages.map(|(name, all)| ((*name).to_owned(), latencies(all))).collect();
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
            "timeline": measure.seconds.iter().map(second).collect::<Vec<_>>(),
            "comparison": self.comparison.map(Comparison::json),
            "left": self.left,
            "thresholds_crossed": self.crossed,
        })
    }
}

/// How many ended how, a line each.
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
    let values = quantiles.iter().chain(&rest).map(|value| match value {
        Some(seconds) => format!("{:>10.1}", 1e3 * seconds),
        None => format!("{:>10}", "-"),
    });
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
    let failed = |all: &BTreeMap<String, Times>| {
        let all =
            all.iter().map(|(code, times)| (code.clone(), json!({ "count": times.count, "example": times.example })));
        Value::Object(all.collect())
    };
    json!({
        "intended": counts.intended, "done": counts.done, "cancelled": counts.cancelled, "dropped": counts.dropped,
        "late": counts.late, "stopped": counts.stopped, "refused": counts.refusals(), "refusals": counts.refused,
        "errors": counts.errors(), "failures": failed(&counts.failed),
    })
}

fn second(second: &Second) -> Value {
    json!({
        "at_s": second.at, "done": second.done, "refused": second.refused, "failed": second.failed,
        "dropped": second.dropped, "p50_s": second.p50, "p99_s": second.p99, "max_s": second.max,
    })
}
