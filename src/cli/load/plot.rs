//! A run as a picture: latencies and outcomes over time.
//!
//! Must not know: how pictures are drawn, how figures are measured.

use super::measure::{Measure, Second};
use picture::chart::{Axis, Figure, Panel, Series};

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
}
