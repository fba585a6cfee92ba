//! How far a run is: a bar on a terminal, a line every few seconds elsewhere.
//!
//! Invariant: one measure over all stages, which never goes back. On the standard error stream only. Must not know:
//! what a stage does, where it is done.

use std::path::Path;
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Mutex, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use geometry::cvt::Iteration;
use geometry::remesh::Observer;
use jobs::lock;

const PARTS: u64 = 1000;
const TICK: Duration = Duration::from_millis(200);
/// Time between two lines where there is no terminal, unless `TESSERA_PROGRESS_S` says otherwise.
const LINE: Duration = Duration::from_secs(5);

pub(crate) struct Progress {
    shared: Arc<Mutex<State>>,
    ticker: Option<(mpsc::Sender<()>, JoinHandle<()>)>,
}

struct State {
    name: String,
    start: Instant,
    track: Track,
    /// The part of the whole that this file is.
    span: (f64, f64),
    bar: Option<ProgressBar>,
    stage: String,
    /// Energy, or place in the queue.
    detail: String,
}

impl Progress {
    /// Of the work on the file `of`, which begins now with reading it.
    pub(crate) fn begin(of: &Path, quiet: bool) -> Self {
        let bar = bar(PARTS, "{spinner} {wide_bar} {percent:>3} % {msg}", quiet);
        let between = if bar.is_some() { TICK } else { line_every() };
        let name = of.file_name().map_or_else(|| of.display().to_string(), |name| name.to_string_lossy().into_owned());
        let (track, stage) = (Track::new(Instant::now()), "read".to_owned());
        let shared = State { name, start: Instant::now(), track, span: (0.0, 1.0), bar, stage, detail: String::new() };
        let shared = Arc::new(Mutex::new(shared));
        let ticker = if quiet { None } else { ticker(Arc::clone(&shared), between) };
        Self { shared, ticker }
    }

    /// Of the next of several files, whose part of the whole is `span`; it begins with reading it.
    pub(crate) fn next(&self, name: &str, span: (f64, f64)) {
        let mut state = lock(&self.shared);
        (state.track, state.span) = (Track::new(Instant::now()), span);
        name.clone_into(&mut state.name);
        "read".clone_into(&mut state.stage);
        state.detail.clear();
        state.draw();
    }

    pub(crate) fn plan(&self, plan: Plan) {
        lock(&self.shared).track.plan(plan, Instant::now());
    }

    /// A stage, or how far it is: `done` of `total`, which is 0 if not known.
    pub(crate) fn stage(&self, name: &str, done: u64, total: u64) {
        lock(&self.shared).stage(name, done, total);
    }

    pub(crate) fn counter(&self, name: &'static str, total: u64) -> impl FnMut() + Send + 'static {
        let shared = Arc::clone(&self.shared);
        let mut done = 0;
        move || {
            done += 1;
            lock(&shared).stage(name, done, total);
        }
    }

    pub(crate) fn iteration(&self, index: u64, total: u64, energy_ratio: f64) {
        let mut state = lock(&self.shared);
        let done = index.saturating_add(1);
        let total = total.max(done);
        state.track.enter("iterations", done, total, Instant::now());
        state.stage = format!("iterations {done} of {total}");
        state.detail = if energy_ratio.is_finite() { format!(", E/E_hex {energy_ratio:.5}") } else { String::new() };
        state.draw();
    }

    pub(crate) fn detail(&self, text: &str) {
        let mut state = lock(&self.shared);
        text.clone_into(&mut state.detail);
        state.draw();
    }

    pub(crate) fn note(&self, text: &str) {
        self.aside(|| errln!("{text}"));
    }

    pub(crate) fn aside<R>(&self, write: impl FnOnce() -> R) -> R {
        match &lock(&self.shared).bar {
            Some(bar) => bar.suspend(write),
            None => write(),
        }
    }
}

/// A bar on the standard error stream, if that is a terminal and may have one.
pub(crate) fn bar(length: u64, template: &str, quiet: bool) -> Option<ProgressBar> {
    let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template(template).ok()?;
    (!quiet && !bar.is_hidden()).then(|| bar.with_style(style))
}

impl State {
    fn stage(&mut self, name: &str, done: u64, total: u64) {
        self.track.enter(name, done, total, Instant::now());
        self.stage = if total > 1 { format!("{name} {done} of {total}") } else { name.to_owned() };
        self.detail.clear();
        self.draw();
    }

    fn draw(&mut self) {
        let fraction = self.fraction(Instant::now());
        let Some(bar) = &self.bar else { return };
        bar.set_position((fraction * PARTS as f64) as u64);
        bar.set_message(format!("{}: {}{}", self.name, self.stage, self.detail));
    }

    fn fraction(&mut self, now: Instant) -> f64 {
        let (begin, end) = self.span;
        begin + (end - begin) * self.track.fraction(now)
    }

    fn line(&mut self) {
        let now = Instant::now();
        // Rounded down: what is said to be all is done.
        let percent = (100.0 * self.fraction(now)).floor();
        let seconds = now.duration_since(self.start).as_secs_f64();
        errln!("tessera: {}: {percent:.0} %, {}{}, {seconds:.0} s", self.name, self.stage, self.detail);
    }
}

impl Observer for Progress {
    fn stage(&mut self, name: &'static str) {
        Progress::stage(self, name, 0, 0);
    }

    fn iteration(&mut self, iteration: &Iteration, total: usize) {
        Progress::iteration(self, iteration.index as u64, total as u64, iteration.energy_ratio);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some((stop, thread)) = self.ticker.take() {
            drop(stop);
            let _ = thread.join();
        }
        if let Some(bar) = lock(&self.shared).bar.take() {
            bar.finish_and_clear();
        }
    }
}

/// Draws again every so often until its sender goes. Without a thread there is a bar that moves with the stages alone.
fn ticker(shared: Arc<Mutex<State>>, between: Duration) -> Option<(mpsc::Sender<()>, JoinHandle<()>)> {
    let (stop, stopped) = mpsc::channel();
    let tick = move || {
        while stopped.recv_timeout(between) == Err(RecvTimeoutError::Timeout) {
            let mut state = lock(&shared);
            match &state.bar {
                Some(bar) => {
                    bar.tick();
                    state.draw();
                }
                None => state.line(),
            }
        }
    };
    let thread = std::thread::Builder::new().name("progress".to_owned()).spawn(tick).ok()?;
    Some((stop, thread))
}

fn line_every() -> Duration {
    let seconds = std::env::var("TESSERA_PROGRESS_S").ok().and_then(|text| text.parse::<f64>().ok());
    let seconds = seconds.filter(|s| (0.01..=86_400.0).contains(s));
    seconds.map_or(LINE, Duration::from_secs_f64)
}

/// A stage's name and its predicted time, seconds.
type Stage = (&'static str, f64);

/// The predicted times, seconds. They are those of `tessera remesh --report`, two cores of an AMD EPYC (Zen 5), release build,
/// `--backend parallel`, November 2026: `genus3` with 20,000 and 200,000 facets, `torus` with 100,000 and `hills` with 60,000,
/// each with 2,000, 10,000 and 40,000 points. They are rounded; only their ratios matter, since a run finds out its own speed.
#[derive(Clone, Debug)]
pub(crate) struct Plan(Vec<Stage>);

impl Plan {
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

/// Makes one fraction of the stages of a [`Plan`]. It never falls and is below 1 until the run ends. A stage that comes again (thin
/// parts, points that are added) begins where the fraction is, and what follows shares the rest.
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
