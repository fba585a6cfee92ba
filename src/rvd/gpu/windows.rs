//! Windows of facets.
//!
//! Purpose: where the buffers of all facets would be larger than what a shader can see of one, facets go by
//! windows of neighbouring ones: each has its records and first cells, and all take turns with the sets of cells
//! and the list of pairs. The seeds' buffers and their sums are shared.
//! Invariant: facets have their own numbers everywhere; only where a record or a first cell lies is counted from
//! the window's beginning. Sums are integers, so windows change no bit. With more than one window no facet is found by cell.
//! Must not know: what a window is clipped by.

use std::ops::Range;
use std::sync::Arc;

use super::buffers::{Buffers, WindowBuffers};
use super::pipelines::Bindings;
use super::plan::{self, Counts, Need, Plan, Window};
use super::search::Rows;
use super::{GpuSession, OnDevice, pack, reach};
use crate::gpu::buffers;
use crate::gpu::limits::Limits;
use crate::rvd::RvdError;

/// Pairs that the list has room for beside those that are expected.
const SPARE_PAIRS: f64 = 1024.0;

/// What decides how facets lie on the device. Capacities grow, and stay for the life of the session.
pub(super) struct Layout {
    /// Cells that each facet is expected to meet.
    expected: Vec<f32>,
    /// Pairs that there is room for, for each that is expected.
    pairs_per_cell: f64,
    /// What that has grown by.
    grown: f64,
    /// Never empty.
    windows: Vec<Window>,
    /// The window at work.
    present: usize,
}

impl Layout {
    /// For facets that meet so many cells each, with room for `pairs_per_cell` pairs for each.
    pub(super) fn new(expected: &[f64], pairs_per_cell: f64) -> Self {
        let all = Window { facets: 0..expected.len() as u32, slots: 0, pairs: 0 };
        Self {
            expected: expected.iter().map(|&e| e as f32).collect(),
            pairs_per_cell,
            grown: 1.0,
            windows: vec![all],
            present: 0,
        }
    }

    /// The windows, by facet.
    pub(super) fn windows(&self) -> &[Window] {
        &self.windows
    }

    /// Facets of the window at work.
    pub(super) fn facets(&self) -> Range<u32> {
        self.windows.get(self.present).map_or(0..0, |w| w.facets.clone())
    }

    /// The window at work is the last one.
    pub(super) fn is_last(&self) -> bool {
        self.present + 1 >= self.windows.len()
    }

    /// Which window is at work.
    pub(super) fn present(&self) -> usize {
        self.present
    }

    /// Turns to window `k`.
    pub(super) fn turn_to(&mut self, k: usize) {
        self.present = k;
    }

    /// The window that `facet` is in.
    pub(super) fn window_of(&self, facet: u32) -> usize {
        self.windows.partition_point(|w| w.facets.end <= facet).min(self.windows.len() - 1)
    }

    fn cut(&mut self, slots_log2: &[u8], limits: Limits) {
        let (expected, per_cell) = (&self.expected, self.pairs_per_cell * self.grown);
        let need = |(&e, &log2): (&f32, &u8)| Need { slots: 1 << log2, pairs: per_cell * f64::from(e) };
        self.windows = plan::windows(expected.iter().zip(slots_log2).map(need), self.spare(), limits);
        self.present = 0;
    }

    fn spare(&self) -> u64 {
        (SPARE_PAIRS * self.grown) as u64
    }
}

fn places(facets: &Range<u32>) -> Range<usize> {
    facets.start as usize..facets.end as usize
}

impl GpuSession {
    /// The buffers; allocated, and filled with all that the host knows, if they are not there.
    pub(super) fn on_device(&mut self) -> Result<&OnDevice, RvdError> {
        if self.on_device.is_none() {
            let limits = Limits::of(&self.device.limits());
            self.lay_out(limits);
            let plan = Plan::new(self.counts, limits)?;
            let facets: Vec<u64> = self.layout.windows().iter().map(|w| w.facets.len() as u64).collect();
            let buffers = Buffers::new(&self.device, plan, &facets)?;
            let bindings = Bindings::new(&self.device, &self.pipelines, &buffers)?;
            buffers::write(&self.device, &buffers.near, 0, &self.grid.near)?;
            if self.rows == Rows::Host {
                buffers::write(&self.device, &buffers.seeds, 0, &self.host.records)?;
                buffers::write(&self.device, &buffers.table, 0, &self.host.packed)?;
            }
            self.on_device = Some(OnDevice { buffers, bindings });
            self.guessed = false;
            self.upload_facets()?;
            self.upload_roots()?;
        }
        self.on_device.as_ref().ok_or_else(|| RvdError::Internal("no buffers".to_owned()))
    }

    /// Frees the buffers; [`Self::on_device`] makes larger ones. What the device found is found again.
    pub(super) fn release(&mut self) -> Result<(), RvdError> {
        self.on_device = None;
        self.listed_for = 0;
        if let Some(moving) = &mut self.moving {
            moving.unbind();
        }
        if self.rows != Rows::Host {
            self.moved();
        }
        // Memory comes back once the device has seen that nothing uses it.
        Ok(self.device.run(self.device.encoder())?)
    }

    /// Windows for the present capacities, and the place of each facet's set of cells among its window's.
    fn lay_out(&mut self, limits: Limits) {
        self.layout.cut(&self.slots_log2, limits);
        let windows = self.layout.windows();
        if windows.len() > 1 && self.grid.side > 0 {
            // A seed would look for facets of all windows.
            reach::unmark(&mut self.facets);
            self.demoted.clear();
            self.grid.side = 0;
        }
        for window in windows {
            let places = places(&window.facets);
            pack::assign_slots(&mut self.facets[places.clone()], &self.slots_log2[places]);
        }
        let most = |what: fn(&Window) -> u64| windows.iter().map(what).max().unwrap_or(0);
        let (window, slots) = (most(|w| w.facets.len() as u64), most(|w| w.slots));
        let pairs = most(|w| w.pairs) + self.layout.spare();
        let flags = if self.grid.side > 0 { window } else { 0 };
        let polygons = limits.seen_bytes() / 16 / self.slots.max(1) as u64;
        let windows = windows.len() as u64;
        self.counts = Counts {
            window,
            windows,
            slots: slots + flags,
            pairs,
            emitted: pairs.min(1 << 16).min(polygons.max(1)),
            table: self.counts.table,
            ..self.counts
        };
    }

    /// Room for `pairs` pairs and half as many again.
    pub(super) fn grow_list(&mut self, pairs: u64) {
        let needed = 1.5 * pairs as f64 / self.counts.pairs.max(1) as f64;
        self.layout.grown *= needed.max(2.0);
    }

    /// What there is of the window at work.
    pub(super) fn window(&self) -> Result<&WindowBuffers, RvdError> {
        let windows = self.on_device.as_ref().map(|there| &there.buffers.windows);
        let window = windows.and_then(|w| w.get(self.layout.present()));
        window.ok_or_else(|| RvdError::Internal("no window".to_owned()))
    }

    /// Where the first cells of `facets` are among all.
    pub(super) fn roots_of(&self, facets: &Range<u32>) -> Range<usize> {
        let at = |facet: u32| self.roots.partition_point(|r| r[0] < facet);
        at(facets.start)..at(facets.end)
    }

    /// The records as the host has them.
    pub(super) fn upload_facets(&self) -> Result<(), RvdError> {
        let Some(there) = &self.on_device else { return Ok(()) };
        for (window, to) in self.layout.windows().iter().zip(&there.buffers.windows) {
            buffers::write(&self.device, &to.facets, 0, &self.facets[places(&window.facets)])?;
        }
        Ok(())
    }

    /// First cells as the host has them.
    pub(super) fn upload_roots(&self) -> Result<(), RvdError> {
        let Some(there) = &self.on_device else { return Ok(()) };
        for (window, to) in self.layout.windows().iter().zip(&there.buffers.windows) {
            buffers::write(&self.device, &to.candidates, 0, &self.roots[self.roots_of(&window.facets)])?;
        }
        Ok(())
    }

    /// First cells as the device has them.
    pub(super) fn download_roots(&mut self) -> Result<(), RvdError> {
        let device = Arc::clone(&self.device);
        self.on_device()?;
        let Some(there) = &self.on_device else { return Ok(()) };
        let mut roots = Vec::with_capacity(self.roots.len());
        for (window, from) in self.layout.windows().iter().zip(&there.buffers.windows) {
            let count = self.roots_of(&window.facets).len();
            roots.append(&mut there.buffers.staging.read(&device, &from.candidates, 0..count)?);
        }
        self.roots = roots;
        Ok(())
    }
}
