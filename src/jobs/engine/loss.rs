//! What becomes of a device that was lost.
//!
//! Purpose: [`LossPolicy`] says what an engine does if its device does not come back, [`Outage`] for how long it has been
//! away. Invariant: work that was promised to a device goes to the CPU only by that policy. Must not know: threads, what a
//! device is.

use std::time::{Duration, Instant};

use crate::Backends;
use geometry::rvd::{BackendChoice, BackendKind};

/// What an engine does whose device does not come back in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LossPolicy {
    /// Tries again, for ever. Work that needs the device is refused after the time.
    #[default]
    Wait,
    /// Ends, so that its process can be started anew.
    End,
    /// Lets the CPU do the work from then on.
    Cpu,
}

/// Since when there is no device.
#[derive(Debug, Default)]
pub(super) struct Outage(Option<Instant>);

impl Outage {
    /// It could not be had.
    pub(super) fn begin(&mut self) {
        self.0.get_or_insert_with(Instant::now);
    }

    /// It is there.
    pub(super) fn end(&mut self) {
        self.0 = None;
    }

    /// Whether it was away for as long as this.
    pub(super) fn has_lasted(&self, time: Duration) -> bool {
        self.0.is_some_and(|since| since.elapsed() >= time)
    }
}

impl Backends {
    /// The same without the GPU: [`BackendChoice::Auto`] means the CPU.
    pub(super) fn without_gpu(&self) -> Self {
        let reason =
            "the device was lost and did not come back; the CPU does its work until the server is started anew";
        let default = match self.default {
            BackendChoice::Only(BackendKind::Gpu) => BackendChoice::Auto,
            other => other,
        };
        Self { gpu: Err(reason.to_owned()), default, ..self.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outage_is_counted_from_its_first_moment() {
        let mut outage = Outage::default();
        assert!(!outage.has_lasted(Duration::ZERO));
        outage.begin();
        outage.begin();
        assert!(outage.has_lasted(Duration::ZERO) && !outage.has_lasted(Duration::from_secs(3600)));
        outage.end();
        assert!(!outage.has_lasted(Duration::ZERO));
    }
}
