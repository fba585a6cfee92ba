//! Readiness of the server, and the reasons against it.
//!
//! Purpose: [`Readiness`] is the one source of health, `/readyz` and `GetServerInfo`. Code that finds a fault sets its
//! [`Reason`], and clears it once the fault is over.
//! Invariant: the server is ready if no reason is set, but for those that only [degrade](Reason::only_degrades) it. Watchers
//! see every change at once. Must not know: how faults are found, how health is served.

use std::fmt;
use std::sync::Arc;

use strum::{IntoStaticStr, VariantArray};
use tokio::sync::watch;

/// Why a server is not ready, or slower than it should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, IntoStaticStr, VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum Reason {
    /// The first probe has not passed yet.
    Starting,
    Draining,
    /// An operator wants it to take no more work.
    Drained,
    /// The device was lost and is not back.
    DeviceLost,
    /// A diagram whose answer is known came out wrong, or not at all.
    ProbeFailed,
    /// Work goes on although it was asked to stop.
    WorkStuck,
    JournalBroken,
    /// There is no room for blobs or for the journal.
    DiskFull,
    StoreAway,
    /// The GPU did not come back after a loss, and the CPU does its work.
    OnCpu,
}

impl Reason {
    pub const ALL: &[Self] = Self::VARIANTS;

    /// Its name in answers and labels.
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Whether the server does all that it is asked, though not as well as it should.
    pub fn only_degrades(self) -> bool {
        self == Self::OnCpu
    }

    /// Whether it is a fault of what keeps jobs and blobs. Streams, which keep nothing, work all the same.
    pub fn is_of_storage(self) -> bool {
        matches!(self, Self::JournalBroken | Self::DiskFull | Self::StoreAway)
    }

    fn bit(self) -> u16 {
        1 << self as u16
    }
}

/// The reasons that are set at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Condition(u16);

impl Condition {
    /// Whether no reason is set that keeps the server from its work.
    pub fn is_ready(self) -> bool {
        self.reasons().next().is_none()
    }

    pub fn has(self, reason: Reason) -> bool {
        self.0 & reason.bit() != 0
    }

    pub fn reasons(self) -> impl Iterator<Item = Reason> {
        self.all().filter(|reason| !reason.only_degrades())
    }

    /// Why it is not as good as it should be, ready or not.
    pub fn degraded(self) -> impl Iterator<Item = Reason> {
        self.all().filter(|reason| reason.only_degrades())
    }

    /// As `/readyz` answers.
    pub fn describe(self) -> serde_json::Value {
        let reasons: Vec<&str> = self.reasons().map(Reason::name).collect();
        let degraded: Vec<&str> = self.degraded().map(Reason::name).collect();
        serde_json::json!({ "ready": self.is_ready(), "reasons": reasons, "degraded": degraded })
    }

    fn all(self) -> impl Iterator<Item = Reason> {
        Reason::ALL.iter().copied().filter(move |reason| self.has(*reason))
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = |reasons: Vec<Reason>| reasons.into_iter().map(Reason::name).collect::<Vec<_>>().join(", ");
        let (reasons, degraded) = (names(self.reasons().collect()), names(self.degraded().collect()));
        match reasons.as_str() {
            "" => f.write_str("ready")?,
            reasons => write!(f, "not ready: {reasons}")?,
        }
        match degraded.as_str() {
            "" => Ok(()),
            degraded => write!(f, "; degraded: {degraded}"),
        }
    }
}

/// See the module's head. Clones share one value.
#[derive(Clone, Debug, Default)]
pub struct Readiness(Arc<watch::Sender<Condition>>);

impl Readiness {
    pub fn new() -> Self {
        Self::default()
    }

    pub fn set(&self, reason: Reason, is_set: bool) {
        self.0.send_if_modified(|condition| {
            let next = if is_set { condition.0 | reason.bit() } else { condition.0 & !reason.bit() };
            std::mem::replace(&mut condition.0, next) != next
        });
    }

    pub fn condition(&self) -> Condition {
        *self.0.borrow()
    }

    pub fn watch(&self) -> watch::Receiver<Condition> {
        self.0.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_come_and_go_by_themselves() {
        let readiness = Readiness::new();
        assert!(readiness.condition().is_ready());
        readiness.set(Reason::DeviceLost, true);
        readiness.clone().set(Reason::DiskFull, true);
        assert_eq!(readiness.condition().to_string(), "not ready: device_lost, disk_full");
        readiness.set(Reason::DeviceLost, false);
        let left: Vec<_> = readiness.condition().reasons().collect();
        assert_eq!(left, [Reason::DiskFull]);
        readiness.set(Reason::DiskFull, false);
        assert_eq!(readiness.condition().to_string(), "ready");
    }

    #[test]
    fn what_only_degrades_leaves_the_server_ready() {
        let readiness = Readiness::new();
        readiness.set(Reason::OnCpu, true);
        let condition = readiness.condition();
        assert!(condition.is_ready() && condition.reasons().next().is_none());
        assert_eq!(condition.degraded().collect::<Vec<_>>(), [Reason::OnCpu]);
        assert_eq!(condition.to_string(), "ready; degraded: on_cpu");
        readiness.set(Reason::Draining, true);
        assert_eq!(readiness.condition().to_string(), "not ready: draining; degraded: on_cpu");
    }

    #[test]
    fn who_watches_hears_of_changes_alone() {
        let readiness = Readiness::new();
        let mut watch = readiness.watch();
        readiness.set(Reason::Draining, false);
        assert!(!watch.has_changed().unwrap(), "it was so before");
        readiness.set(Reason::Draining, true);
        assert!(watch.has_changed().unwrap() && watch.borrow_and_update().has(Reason::Draining));
        readiness.set(Reason::Draining, true);
        assert!(!watch.has_changed().unwrap());
    }

    #[test]
    fn every_reason_has_a_bit_and_a_name_of_its_own() {
        let names: std::collections::BTreeSet<_> = Reason::ALL.iter().map(|reason| reason.name()).collect();
        let bits = Reason::ALL.iter().fold(0, |all, reason| all | reason.bit());
        assert_eq!((names.len(), bits.count_ones()), (Reason::ALL.len(), Reason::ALL.len() as u32));
    }
}
