//! How a run is, while it runs: a line on a terminal, nothing elsewhere.
//!
//! Invariant: on the standard error stream only. Must not know: how figures are measured.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::measure::Measure;

pub(super) struct View(Option<ProgressBar>);

impl View {
    pub(super) const EVERY: Duration = Duration::from_millis(250);

    /// Of a run that lasts so long.
    pub(super) fn new(length: Duration, quiet: bool) -> Self {
        let bar = ProgressBar::with_draw_target(Some(length.as_millis() as u64), ProgressDrawTarget::stderr());
        let bar = Some(bar).filter(|bar| !quiet && !bar.is_hidden());
        if let Some((bar, style)) = bar.as_ref().zip(ProgressStyle::with_template("{spinner} {bar:20} {msg}").ok()) {
            bar.set_style(style);
        }
        Self(bar)
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
    use super::*;

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
