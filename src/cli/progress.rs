//! How far a run is: a bar on a terminal, a line every few seconds elsewhere.
//!
//! Invariant: one measure over all stages, which never goes back. On the standard error stream only. Must not know:
//! what a stage does, where it is done.

mod track;

use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

pub(crate) use track::Plan;
use track::Track;

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
        let bar = ProgressBar::with_draw_target(Some(PARTS), ProgressDrawTarget::stderr());
        let bar = Some(bar).filter(|bar| !quiet && !bar.is_hidden());
        let between = if bar.is_some() { TICK } else { line_every() };
        if let Some((bar, style)) =
            bar.as_ref().zip(ProgressStyle::with_template("{spinner} {wide_bar} {percent:>3} % {msg}").ok())
        {
            bar.set_style(style);
        }
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

    /// A counter of the `total` steps of a stage.
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
        match &lock(&self.shared).bar {
            Some(bar) => bar.suspend(|| errln!("{text}")),
            None => errln!("{text}"),
        }
    }

    pub(crate) fn aside<R>(&self, write: impl FnOnce() -> R) -> R {
        match &lock(&self.shared).bar {
            Some(bar) => bar.suspend(write),
            None => write(),
        }
    }
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
