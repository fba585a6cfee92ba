//! Windows whose records are on the device.
//!
//! Purpose: where the memory that the device may take does not hold the records of all facets, some windows stay there, and the others
//! take turns with one more buffer: the host sends their records whenever a pass comes to them. First cells of all facets stay.
//! Invariant: the window at work is on the device. Windows change no bit. What has to fit is the plan's total.
//! Must not know: what is computed on the records.

use super::{Memory, places};
use crate::buffers::write;
use crate::diagram::plan::{Counts, Moved, OptimizerPlan, Plan, window_bytes};
use crate::diagram::{DeviceSpace, Result};
use crate::dispatch::PART;
use geometry::rvd::RvdError;

/// The fewest facets of a window that is made shorter to fit.
const FEWEST: u64 = PART / 32;

/// Which windows have records on the device.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::diagram) struct Resident {
    /// Buffers for records: one a window, or fewer.
    buffers: usize,
    windows: usize,
    /// The window whose records are in the last buffer, where windows take turns with it.
    last: Option<usize>,
}

impl Resident {
    pub(super) fn all(windows: usize) -> Self {
        Self { buffers: windows, windows, last: None }
    }

    pub(super) fn buffers(&self) -> usize {
        self.buffers
    }

    /// Windows from the first on that stay; all, or all but those that take turns.
    pub(super) fn staying(&self) -> usize {
        if self.buffers < self.windows { self.buffers - 1 } else { self.windows }
    }

    pub(super) fn forget(&mut self) {
        self.last = None;
    }

    /// The buffer of a window's records.
    pub(super) fn buffer_of(buffers: usize, window: usize) -> usize {
        window.min(buffers - 1)
    }
}

impl<P: DeviceSpace> Memory<P> {
    /// Makes this window the one at work, and has its records on the device.
    pub(in crate::diagram) fn turn_to(&mut self, window: usize) -> Result<()> {
        self.windows.present = window;
        if window < self.resident.staying() || self.resident.last == Some(window) || self.on_device.is_none() {
            return Ok(());
        }
        let facets = places(&self.windows.facets());
        write(&self.cx.device, &self.window()?.facets, 0, &self.facets[facets])?;
        self.resident.last = Some(window);
        Ok(())
    }

    /// Lays the buffers out as [`Self::lay_out`], in what memory the device may take: with shorter windows, and with the records of
    /// some of them alone. Errors: `OutOfMemory` where that is not enough.
    pub(in crate::diagram) fn lay_out_within(&mut self, flags: bool) -> Result<()> {
        self.lay_out(flags);
        let Some(limit) = self.cx.device.memory_bytes() else { return Ok(()) };
        let mut needed = self.total_bytes();
        if needed <= limit {
            return Ok(());
        }
        let before = self.windows.most;
        let mut most = self.counts.facets.next_power_of_two() / 2;
        let mut least = needed;
        // The windows of which the fewest facets take turns: facets, windows' length, buffers.
        let mut best: Option<(u64, u64, usize)> = None;
        while most >= FEWEST && best.is_none_or(|best| best.0 > 0) {
            let buffers = self.hold_in(most, limit, flags);
            needed = self.total_bytes();
            least = least.min(needed);
            if needed <= limit {
                let turns = self.facets_in_turn();
                if best.is_none_or(|best| turns < best.0) {
                    best = Some((turns, most, buffers));
                }
            }
            most /= 2;
        }
        let Some((_, most, buffers)) = best else {
            self.windows.most = before;
            return Err(RvdError::OutOfMemory { needed_bytes: least, limit_bytes: limit });
        };
        self.hold_in(most, limit, flags);
        self.hold(buffers);
        Ok(())
    }

    /// Cuts windows of at most `most` facets, with as many buffers for records as fit, at least one. Returns their number.
    fn hold_in(&mut self, most: u64, limit: u64, flags: bool) -> usize {
        self.windows.most = most;
        self.cut();
        self.lay_out(flags);
        self.hold(1);
        let (window, _) = window_bytes(self.counts.lifted, self.counts.window);
        let more = limit.saturating_sub(self.total_bytes()) / window.max(1);
        self.hold(1 + usize::try_from(more).unwrap_or(usize::MAX - 1));
        self.resident.buffers
    }

    /// Facets whose records are not on the device all the time.
    fn facets_in_turn(&self) -> u64 {
        let turns = self.windows.all.get(self.resident.staying()..).unwrap_or_default();
        turns.iter().map(|window| window.facets.len() as u64).sum()
    }

    /// Has so many buffers for records, or one for each window.
    fn hold(&mut self, buffers: usize) {
        let windows = self.windows.all.len();
        self.resident = Resident { buffers: buffers.clamp(1, windows), windows, last: None };
        self.counts.held = self.counts.facets.min(self.resident.buffers as u64 * self.counts.window);
    }

    /// With what moves the seeds, which a session makes when it does.
    fn total_bytes(&self) -> u64 {
        let Counts { lifted, seeds, .. } = self.counts;
        let moving = OptimizerPlan::of(Moved { lifted, seeds }).total_bytes();
        Plan::of(self.counts).total_bytes().saturating_add(moving)
    }
}
