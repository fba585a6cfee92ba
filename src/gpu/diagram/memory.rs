//! What lies on the device.
//!
//! Purpose: sizes of all buffers, the buffers themselves, where facets and their sets of cells lie. Where the buffers of all facets
//! would be larger than what a shader can see of one, facets go by [`Windows`] of neighbouring ones: each has its records and first
//! cells, and all take turns with the sets of cells and the list of pairs. The seeds' buffers and their sums are shared. Where the
//! device's memory does not hold the records of all windows ([`resident`]), the host sends those of each when its turn comes.
//! Invariant: capacities grow, and stay for the life of the session. While buffers are missing nothing is uploaded. Facets have
//! their own numbers everywhere; only where a record or a first cell lies is counted from the window's beginning. Sums are
//! integers, so windows change no bit. With more than one window no facet is found by cell.
//! Must not know: seeds, and what is computed on the buffers.

mod buffers;
pub(super) mod records;
mod resident;

use std::ops::Range;
use std::sync::Arc;

use bytemuck::Pod;

use super::layout::{Params, State};
use super::pipelines::SLOTS;
use super::plan::{self, Counts, Need, Plan, Window};
use super::space::DeviceSpace;
use super::{Context, Result};
use crate::buffers::write;
use crate::dispatch::{self, Limits, Stage};
pub(super) use buffers::{Bindings, Buffers, OptimizerBindings, OptimizerBuffers, WindowBuffers};
use geometry::rvd::RvdError;
use geometry::token::Token;

pub(super) struct OnDevice {
    pub buffers: Buffers,
    pub bindings: Bindings,
}

pub(super) struct Memory<P: DeviceSpace> {
    pub cx: Arc<Context<P>>,
    pub counts: Counts,
    pub windows: Windows,
    /// Log2 of the slots of each facet's set of cells.
    pub slots_log2: Vec<u8>,
    /// The records as they are to be on the device.
    pub facets: Vec<P::Facet>,
    /// `None` before the first use and while capacities grow.
    pub on_device: Option<OnDevice>,
    /// Windows whose records are on the device.
    pub resident: resident::Resident,
}

fn places(facets: &Range<u32>) -> Range<usize> {
    facets.start as usize..facets.end as usize
}

impl<P: DeviceSpace> Memory<P> {
    pub(super) fn there(&self) -> Result<&OnDevice> {
        self.on_device.as_ref().ok_or_else(|| RvdError::Internal("no buffers".to_owned()))
    }

    pub(super) fn encode(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        lane: usize,
        stages: &[Stage<'_>],
        token: &Token,
    ) -> Result<()> {
        dispatch::encode(&self.cx.device, encoder, lane, stages, self.there()?.buffers.origins(), token)
    }

    /// Reads entries `range` of a buffer of `T`.
    pub(super) fn read<T: Pod>(&self, of: fn(&Buffers) -> &wgpu::Buffer, range: Range<usize>) -> Result<Vec<T>> {
        let buffers = &self.there()?.buffers;
        Ok(buffers.staging.read(&self.cx.device, of(buffers), range)?)
    }

    /// Cuts the facets into windows, for the present capacities. Whether they are more than one.
    pub(super) fn cut(&mut self) -> bool {
        self.windows.cut(self.counts.lifted, &self.slots_log2, self.cx.limits());
        self.windows.all.len() > 1
    }

    /// Gives each facet's set of cells its place among its window's, and sizes all buffers. `flags`: a slot more for each
    /// facet of a window.
    pub(super) fn lay_out(&mut self, flags: bool) {
        let windows = &self.windows.all;
        self.resident = resident::Resident::all(windows.len());
        for window in windows {
            let places = places(&window.facets);
            records::assign_slots(&mut self.facets[places.clone()], &self.slots_log2[places]);
        }
        let most = |what: fn(&Window) -> u64| windows.iter().map(what).max().unwrap_or(0);
        let (window, slots) = (most(|w| w.facets.len() as u64), most(|w| w.slots));
        let pairs = most(|w| w.pairs) + self.windows.spare();
        let flags = if flags { window } else { 0 };
        let polygons = self.cx.limits().seen_bytes() / 16 / SLOTS as u64;
        let (windows, emitted) = (windows.len() as u64, pairs.min(1 << 16).min(polygons.max(1)));
        let held = self.counts.facets;
        self.counts = Counts { window, windows, held, slots: slots + flags, pairs, emitted, ..self.counts };
    }

    pub(super) fn allocate(&mut self) -> Result<()> {
        let plan = Plan::new(self.counts, self.cx.limits())?;
        let facets: Vec<u64> = self.windows.all.iter().map(|w| w.facets.len() as u64).collect();
        let buffers = Buffers::new(&self.cx.device, self.counts.lifted, plan, &facets, self.resident.buffers())?;
        let bindings = Bindings::new(&self.cx.device, &self.cx.pipelines, &buffers)?;
        self.on_device = Some(OnDevice { buffers, bindings });
        Ok(())
    }

    pub(super) fn device_bytes(&self) -> u64 {
        self.on_device.as_ref().map_or(0, |there| there.buffers.plan.total_bytes())
    }

    pub(super) fn by_window(&self) -> impl Iterator<Item = (&Window, &WindowBuffers)> {
        let buffers = self.on_device.iter().flat_map(|there| &there.buffers.windows);
        self.windows.all.iter().zip(buffers)
    }

    /// The buffers of the window at work.
    pub(super) fn window(&self) -> Result<&WindowBuffers> {
        let window = self.there()?.buffers.windows.get(self.windows.present);
        window.ok_or_else(|| RvdError::Internal("no window".to_owned()))
    }

    /// Sends the records of the windows that stay on the device.
    pub(super) fn upload_facets(&mut self) -> Result<()> {
        for (window, to) in self.by_window().take(self.resident.staying()) {
            write(&self.cx.device, &to.facets, 0, &self.facets[places(&window.facets)])?;
        }
        self.resident.forget();
        Ok(())
    }

    pub(super) fn write_state(&self, state: State) -> Result<()> {
        Ok(write(&self.cx.device, &self.there()?.buffers.state, 0, &[state])?)
    }

    pub(super) fn write_params(&self, params: Params) -> Result<()> {
        Ok(write(&self.cx.device, &self.there()?.buffers.params, 0, &[params])?)
    }

    /// Room for `pairs` pairs and half as many again, when buffers are allocated next.
    pub(super) fn grow_list(&mut self, pairs: u64) {
        self.windows.grow(1.5 * pairs as f64 / self.counts.pairs.max(1) as f64);
    }

    /// Whether the neighbour table has room for `entries` entries. If not, there is room for half as many again when buffers
    /// are allocated next.
    pub(super) fn has_room(&mut self, entries: u64) -> bool {
        let fits = entries <= self.counts.table;
        if !fits {
            self.counts.table = (entries * 3 / 2).min(self.most_entries()).max(entries);
        }
        fits
    }

    /// Entries of the neighbour table at most.
    pub(super) fn most_entries(&self) -> u64 {
        self.cx.limits().seen_bytes() / 4
    }
}

/// Pairs that the list has room for beside those that are expected.
const SPARE_PAIRS: f64 = 1024.0;

/// What decides how facets lie on the device. Capacities grow, and stay for the life of the session.
pub(crate) struct Windows {
    /// Cells that each facet is expected to meet.
    expected: Vec<f32>,
    /// Pairs that there is room for, for each that is expected.
    pairs_per_cell: f64,
    /// What that has grown by.
    grown: f64,
    /// By facet; never empty.
    pub all: Vec<Window>,
    /// The window at work.
    pub present: usize,
    /// The facets that are cut: all, or those that this device does.
    pub share: Range<u32>,
    /// The most facets of a window.
    pub most: u64,
}

impl Windows {
    /// For facets that are expected to meet these numbers of cells, with room for `pairs_per_cell` pairs for each.
    pub(crate) fn new(expected: &[f64], pairs_per_cell: f64) -> Self {
        let all = Window { facets: 0..expected.len() as u32, slots: 0, pairs: 0 };
        Self {
            expected: expected.iter().map(|&e| e as f32).collect(),
            pairs_per_cell,
            grown: 1.0,
            share: all.facets.clone(),
            all: vec![all],
            present: 0,
            most: u64::MAX,
        }
    }

    /// Cuts these facets alone. Before they are cut.
    pub(crate) fn take_share(&mut self, share: Range<u32>) {
        self.all = vec![Window { facets: share.clone(), slots: 0, pairs: 0 }];
        self.share = share;
    }

    pub(crate) fn facets(&self) -> Range<u32> {
        self.all.get(self.present).map_or(0..0, |w| w.facets.clone())
    }

    pub(crate) fn is_last(&self) -> bool {
        self.present + 1 >= self.all.len()
    }

    pub(crate) fn window_of(&self, facet: u32) -> usize {
        self.all.partition_point(|w| w.facets.end <= facet).min(self.all.len() - 1)
    }

    /// Cuts the facets anew, for sets of cells of these sizes.
    pub(crate) fn cut(&mut self, lifted: bool, slots_log2: &[u8], limits: Limits) {
        let (expected, per_cell) = (&self.expected, self.pairs_per_cell * self.grown);
        let need = |(&e, &log2): (&f32, &u8)| Need { slots: 1 << log2, pairs: per_cell * f64::from(e) };
        let share = places(&self.share);
        let needs = expected[share.clone()].iter().zip(&slots_log2[share]).map(need);
        self.all = plan::windows(lifted, needs, self.spare(), self.most, limits);
        let first = self.share.start;
        self.all.iter_mut().for_each(|w| w.facets = w.facets.start + first..w.facets.end + first);
        self.present = 0;
    }

    pub(crate) fn spare(&self) -> u64 {
        (SPARE_PAIRS * self.grown) as u64
    }

    /// Makes room for `needed` times as many pairs, and twice as many at least.
    pub(crate) fn grow(&mut self, needed: f64) {
        self.grown *= needed.max(2.0);
    }
}
