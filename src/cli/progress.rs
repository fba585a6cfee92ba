//! A progress bar, on a terminal only.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::cvt::Iteration;
use crate::remesh::Observer;

/// See the module's head.
pub(crate) struct Progress(ProgressBar);

impl Progress {
    /// A bar that shows once something happens. indicatif hides it where there is no terminal.
    pub(crate) fn new() -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
        if let Ok(style) = ProgressStyle::with_template("{spinner} {prefix:10} {wide_bar} {pos}/{len} {msg}") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        Self(bar)
    }

    /// A stage of so many steps; 0 if not known.
    pub(crate) fn stage(&self, name: &str, done: u64, total: u64) {
        self.0.set_prefix(name.to_owned());
        self.0.set_length(total.max(1));
        self.0.set_position(done);
    }

    /// An iteration.
    pub(crate) fn iteration(&self, index: u64, total: u64, energy_ratio: f64) {
        self.stage("iterations", index + 1, total.max(index + 1));
        self.0.set_message(format!("E/E_hex {energy_ratio:.5}"));
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
        self.0.finish_and_clear();
    }
}
