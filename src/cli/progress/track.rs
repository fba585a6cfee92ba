//! How far a run is, from the stages that it has gone through.
//!
//! Purpose: [`Plan`] predicts what each stage takes, [`Track`] makes one fraction of that. Invariant: the fraction never
//! falls and is below 1 until the run ends. A stage that comes again (thin parts, points that are added) begins where the
//! fraction is, and what follows shares the rest. Must not know: how it is shown.
//!
//! The times are those of `tessera remesh --report`, two cores of an AMD EPYC (Zen 5), release build, `--backend parallel`,
//! November 2026: `genus3` with 20,000 and 200,000 facets, `torus` with 100,000 and `hills` with 60,000, each with
//! 2,000, 10,000 and 40,000 points. They are rounded; only their ratios matter, since a run finds out its own speed.

use std::time::{Duration, Instant};

/// A stage's name and its predicted time, seconds.
type Stage = (&'static str, f64);

#[derive(Clone, Debug)]
pub(crate) struct Plan(Vec<Stage>);

impl Plan {
    /// Of a remesh, here or on a server.
    pub(crate) fn remesh(facets: usize, points: usize, steps: usize, remote: bool) -> Self {
        let (f, n) = (facets as f64 * 1e-6, points as f64 * 1e-6);
        let mut stages = vec![("read", 0.3 * f)];
        if remote {
            stages.extend([("upload", 0.1 * f), ("queued", 0.01)]);
        }
        stages.extend([
            ("prepare", 0.01 + 0.9 * f),
            ("sample", 0.3 * f + 0.8 * n),
            ("iterations", steps as f64 * (0.1 * f + 0.6 * n)),
            ("dual", 0.01 + 0.7 * f + 5.5 * n),
            ("repair", 0.02 + 0.8 * f + 8.0 * n),
            ("attributes", 0.02 * f + 0.05 * n),
            ("measure", 0.05 + f + 2.0 * n),
        ]);
        if remote {
            stages.push(("download", 0.3 * n));
        }
        stages.push(("write", 0.1 * n));
        Self(stages)
    }

    /// Of bytes that are sent or fetched.
    pub(crate) fn transfer(stage: &'static str) -> Self {
        Self(vec![("read", 0.01), (stage, 1.0)])
    }

    /// Of a diagram.
    pub(crate) fn rvd(facets: usize, points: usize, remote: bool) -> Self {
        let (f, n) = (facets as f64 * 1e-6, points as f64 * 1e-6);
        let mut stages = vec![("read", 0.3 * f)];
        if remote {
            stages.extend([("upload", 0.1 * f), ("queued", 0.01)]);
        }
        stages.extend([("prepare", 0.3 * f), ("diagram", 0.01 + 2.0 * f + 6.0 * n), ("write", 0.5 * f + n)]);
        Self(stages)
    }
}

#[derive(Debug)]
pub(crate) struct Track {
    start: Instant,
    stages: Vec<Stage>,
    /// The stage at work; none before the first.
    at: Option<usize>,
    began: Instant,
    /// The fractions where the stage began and where it ends.
    span: (f64, f64),
    /// How far the stage says it is, 0 to 1, if it does.
    counted: Option<f64>,
    /// Predicted and true time of the stages that have ended.
    predicted: f64,
    taken: Duration,
    /// The largest fraction that was ever told.
    told: f64,
}

/// A stage whose time is up stays here, and so does a whole that is nearly done.
const NEARLY: f64 = 0.97;

impl Track {
    /// A run that begins at `now`, of which nothing is known.
    pub(crate) fn new(now: Instant) -> Self {
        Self {
            start: now,
            stages: Vec::new(),
            at: None,
            began: now,
            span: (0.0, 0.0),
            counted: None,
            predicted: 0.0,
            taken: Duration::ZERO,
            told: 0.0,
        }
    }

    /// Takes the plan. Its first stage has ended.
    pub(crate) fn plan(&mut self, plan: Plan, now: Instant) {
        let all: f64 = plan.0.iter().map(|(_, time)| time).sum();
        let first = plan.0.first().map_or(0.0, |(_, time)| time / all);
        (self.stages, self.at) = (plan.0, Some(0));
        (self.predicted, self.taken) = (0.0, Duration::ZERO);
        (self.began, self.span, self.counted) = (self.start, (0.0, first), Some(1.0));
        self.fraction(now);
    }

    /// The stage `name` is at work and has done so much of so much; a `total` of 0 or 1 says nothing.
    pub(crate) fn enter(&mut self, name: &str, done: u64, total: u64, now: Instant) {
        let Some(next) = self.stages.iter().position(|(stage, _)| *stage == name) else { return };
        let counted = (total > 1).then(|| (done as f64 / total as f64).min(1.0));
        if self.at == Some(next) && (counted.is_some() || self.counted.is_none()) {
            self.counted = counted;
            return;
        }
        let from = if self.at.is_some_and(|at| at < next) { self.span.1 } else { self.fraction(now) };
        if let Some(at) = self.at {
            self.predicted += self.stages[at].1;
            self.taken += now.saturating_duration_since(self.began);
        }
        let from = from.max(self.told);
        let rest: f64 = self.stages[next..].iter().map(|(_, time)| time).sum();
        let share = if rest > 0.0 { self.stages[next].1 / rest } else { 0.0 };
        (self.at, self.began, self.counted) = (Some(next), now, counted);
        self.span = (from, from + (1.0 - from) * share);
    }

    /// How far the run is, 0 to less than 1.
    pub(crate) fn fraction(&mut self, now: Instant) -> f64 {
        let within = self.counted.unwrap_or_else(|| self.by_time(now));
        let (from, to) = self.span;
        self.told = self.told.max((from + (to - from) * within).min(0.999));
        self.told
    }

    /// How far a stage is that does not say so: its time against what the stages before took.
    fn by_time(&self, now: Instant) -> f64 {
        let Some(at) = self.at else { return 0.0 };
        // A little of the prediction, so that a first stage of no length says nothing.
        let speed = (self.taken.as_secs_f64() + 0.05) / (self.predicted + 0.05);
        let expected = self.stages[at].1 * speed;
        if expected <= 0.0 {
            return NEARLY;
        }
        (now.saturating_duration_since(self.began).as_secs_f64() / expected).min(NEARLY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goes through stages, each with a number of steps to tell, and says the fraction after each second.
    fn run(plan: Plan, stages: &[(&str, u64)]) -> Vec<f64> {
        let start = Instant::now();
        let mut track = Track::new(start);
        let mut told = vec![track.fraction(start)];
        track.plan(plan, start);
        let mut now = start;
        for &(name, total) in stages {
            track.enter(name, 0, total, now);
            for done in 1..=total.max(3) {
                now += Duration::from_secs(1);
                if total > 0 {
                    track.enter(name, done, total, now);
                }
                told.push(track.fraction(now));
            }
        }
        told
    }

    fn check(told: &[f64]) {
        assert!(told.windows(2).all(|w| w[0] <= w[1]), "{told:?}");
        assert!(told.iter().all(|f| (0.0..1.0).contains(f)), "{told:?}");
    }

    #[test]
    fn the_bar_never_empties() {
        let plan = || Plan::remesh(69_000, 10_000, 35, false);
        let usual = ["prepare", "sample"].map(|s| (s, 0)).into_iter().chain([("iterations", 35)]);
        let usual: Vec<_> = usual.chain(["dual", "repair", "attributes", "measure", "write"].map(|s| (s, 0))).collect();
        let told = run(plan(), &usual);
        check(&told);
        assert!(told[told.len() - 1] > 0.95, "{told:?}");
        // Thin parts and added points: stages come again, others are left out, and some are not known.
        let again = [("prepare", 0), ("iterations", 9), ("dual", 0), ("prepare", 0), ("iterations", 9), ("dual", 0)];
        let again: Vec<_> =
            again.into_iter().chain([("repair", 0), ("what?", 0), ("dual", 0), ("measure", 0)]).collect();
        check(&run(plan(), &again));
        check(&run(Plan::rvd(1000, 10, true), &[("upload", 7), ("queued", 0), ("diagram", 30), ("write", 0)]));
        check(&run(Plan::remesh(0, 0, 0, true), &[("upload", 0), ("measure", 0)]));
        check(&run(Plan(Vec::new()), &[("prepare", 0)]));
    }

    #[test]
    fn stages_are_weighted_by_their_time() {
        let share = |facets, points, steps| {
            let Plan(stages) = Plan::remesh(facets, points, steps, false);
            let all: f64 = stages.iter().map(|(_, t)| t).sum();
            stages.iter().find(|(name, _)| *name == "iterations").unwrap().1 / all
        };
        // Of 1.1 and 2.3 s, 0.50 and 0.94 went to the steps.
        assert!((0.3..0.65).contains(&share(20_000, 10_000, 35)));
        assert!((0.3..0.65).contains(&share(200_000, 2_000, 35)));
        assert!(share(20_000, 10_000, 1000) > 0.9 && share(20_000, 10_000, 0) == 0.0);
    }

    #[test]
    fn a_stage_without_steps_moves_with_time() {
        let start = Instant::now();
        let mut track = Track::new(start);
        track.plan(Plan::remesh(100_000, 10_000, 35, false), start + Duration::from_millis(30));
        track.enter("prepare", 0, 0, start + Duration::from_millis(30));
        let at = |track: &mut Track, ms| track.fraction(start + Duration::from_millis(ms));
        let (a, b, c) = (at(&mut track, 31), at(&mut track, 60), at(&mut track, 100_000));
        assert!(a < b && b < c && c < track.span.1, "{a} {b} {c}");
    }
}
