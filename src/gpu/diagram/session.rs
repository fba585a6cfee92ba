//! One surface on a device, and the order of the work on it.
//!
//! Purpose: the rooms own what a session knows: `memory` where things lie, `neighbours` the seeds, `clip` the pairs and sums,
//! `optimizer` the seeds that move. The session calls them in turn: a pass is search, first cells, clip, totals, in as few
//! submissions as the pairs allow. Pieces that do not cover the surface are not an answer: with seeds a rounding apart, facets in
//! the bisector of two seeds, or slivers, single precision gives one point to two cells or to none. The pass is then done in f64.
//! So it is where a seed that is close to another has no cell: floats lose cells that small without a gap that shows.
//! Invariant: buffers are there before a room is called. A pass that returns has every pair of its facets done, on the device or
//! in f64, and covers the surface within the tolerance of `Clip::covers`, or is exact.
//! Must not know: what a stage does.

mod pass;
mod resident;
mod search;
mod shares;

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use super::clip::{Clip, by_cell, fixed};
use super::layout::{LONGER, MOST_REQUEUED, NONE, Params, STRIDE};
use super::memory::{Memory, Windows, records};
use super::neighbours::{Neighbours, Place, grid};
use super::optimizer::Optimizer;
use super::pipelines::SLOTS;
use super::plan::{self, Counts};
use super::space::DeviceSpace;
use super::{Context, Result};
use super::{Gpu, phases};
use crate::Traffic;
use geometry::rvd::parallel::Parallel;
use geometry::rvd::{
    Capacities, CellSums, DeviceWork, PassStats, PhasesMs, PieceBatch, Resident, RvdError, Session, SessionOptions,
    Surface, check_seeds, elapsed_ms,
};
use geometry::token::Token;

pub(super) use shares::SharedSession;

pub(super) struct GpuSession<P: DeviceSpace> {
    cx: Arc<Context<P>>,
    memory: Memory<P>,
    neighbours: Neighbours<P>,
    pub(super) clip: Clip<P>,
    optimizer: Optimizer,
    /// Sessions on other devices, which do the facets that this one does not.
    others: Vec<Self>,
    /// What the device had done before the session was opened.
    opened: Traffic,
    options: SessionOptions,
}

/// The rooms below the optimizer, while that is borrowed.
macro_rules! rooms {
    ($session:expr) => {
        crate::diagram::optimizer::Rooms {
            cx: &$session.cx,
            memory: &$session.memory,
            neighbours: &$session.neighbours,
            clip: &$session.clip,
        }
    };
}
use rooms;

impl<P: DeviceSpace> GpuSession<P> {
    /// A session for at most `options.max_seeds` seeds on `surface`. It is planned for as many, or, if the surface is lifted, for
    /// those that are set: a seed may have many sides there, and most have one.
    pub(super) fn new(gpu: &Gpu, surface: Arc<Surface<P>>, options: SessionOptions) -> Result<Self> {
        let cx = Arc::new(Context {
            device: Arc::clone(&gpu.device),
            pool: Arc::clone(&gpu.pool),
            pipelines: P::pipelines(gpu)?,
            mass: fixed::total_mass(&surface),
            longest_lift: P::longest_lift(&surface),
            surface,
            max_seeds: options.max_seeds,
            capacities: options.capacities,
        });
        let seeds = if P::IS_PLACE { options.max_seeds } else { 0 };
        Ok(Self::planned(cx, options, seeds))
    }

    /// With room for `seeds` seeds.
    fn planned(cx: Arc<Context<P>>, options: SessionOptions, seeds: usize) -> Self {
        let SessionOptions { capacities, tuning, .. } = options;
        let (surface, limits) = (&cx.surface, cx.limits());
        let expected = records::expected_cells(surface, seeds);
        let slots_log2 = records::first_slots(&expected, capacities.cells, Capacities::default().cells);
        let mut facets = records::facets(surface, &slots_log2);
        // In R³ alone cells look for facets.
        let found = if P::IS_PLACE { by_cell::choose(&expected, tuning.strategy) } else { Vec::new() };
        for &f in &found {
            by_cell::mark(&mut facets[f as usize], true);
        }
        let near = by_cell::Grid::new(surface, &found, seeds);
        let k = capacities.neighbours.clamp(1, seeds.max(1)) as u64;
        // Rows by the device or by the host, and a quarter for longer ones where there is room for it; of these as many
        // as the device makes in a pass.
        let rows = seeds as u64 * k.max(u64::from(STRIDE));
        let most = limits.seen_bytes() / 4;
        let side = grid::grid_side_for(surface, seeds);
        let counts = Counts {
            lifted: !P::IS_PLACE,
            facets: facets.len() as u64,
            seeds: seeds as u64,
            table: (rows + seeds as u64 * k / 4 + u64::from(MOST_REQUEUED * LONGER)).min(most.max(rows)),
            polygon: SLOTS as u64,
            near: near.near.len() as u64,
            cells: plan::grid_cells(side),
            // Lists note places alone.
            listed: if P::IS_PLACE { plan::listed(seeds as u64, limits) } else { 0 },
            ..Counts::default()
        };
        // Half as many again for pairs that turn out empty and for pairs done again.
        let windows = Windows::new(&expected, 1.5 * capacities.pairs_percent as f64 / 100.0);
        let live = (0..facets.len()).filter(|&f| !surface.skips(f));
        let roots = live.map(|f| [f as u32, NONE]).collect();
        Self {
            memory: Memory {
                cx: Arc::clone(&cx),
                counts,
                windows,
                slots_log2,
                facets,
                on_device: None,
                resident: Default::default(),
            },
            neighbours: Neighbours::new(Arc::clone(&cx), side, roots),
            clip: Clip::new(Arc::clone(&cx), near, tuning.accumulate),
            optimizer: Optimizer::new(tuning.together),
            others: Vec::new(),
            opened: cx.device.traffic(),
            options,
            cx,
        }
    }

    /// Plans anew if there is no room for `seeds` seeds, with some to spare.
    fn make_room(&mut self, seeds: usize) -> Result<()> {
        if seeds as u64 <= self.memory.counts.seeds || seeds > self.cx.max_seeds {
            return Ok(());
        }
        self.release()?;
        let room = (seeds + seeds / 8).min(self.cx.max_seeds);
        let larger = Self::planned(Arc::clone(&self.cx), self.options, room);
        let before = std::mem::replace(self, larger);
        self.opened = before.opened;
        self.clip.work = before.clip.work;
        self.neighbours.host_searches = before.neighbours.host_searches;
        Ok(())
    }

    fn on_pool<R: Send>(&mut self, work: impl FnOnce(&mut Self) -> R + Send) -> R {
        let pool = Arc::clone(&self.cx.pool);
        pool.install(|| work(self))
    }

    /// Allocates the buffers, and fills them with all that the host knows, if they are not there.
    pub(super) fn ensure_memory(&mut self) -> Result<()> {
        if self.memory.on_device.is_some() {
            return Ok(());
        }
        let in_parts =
            self.memory.cut() || self.memory.windows.share != self.facets() || self.cx.device.memory_bytes().is_some();
        if in_parts && self.clip.near.side > 0 {
            // A seed would look for facets of all windows.
            self.clip.leave_all_to_propagation(&mut self.memory);
        }
        self.memory.lay_out_within(self.clip.near.side > 0)?;
        self.memory.allocate()?;
        self.clip.upload_near(&self.memory)?;
        self.neighbours.memory_changed(&self.memory)?;
        self.memory.upload_facets()?;
        self.neighbours.upload_roots(&self.memory)
    }

    /// Frees the buffers; [`Self::ensure_memory`] makes larger ones. What the device found is found again.
    fn release(&mut self) -> Result<()> {
        self.memory.on_device = None;
        self.neighbours.memory_lost();
        self.optimizer.memory_lost();
        if !self.neighbours.rows.are_of_host() {
            self.seeds_changed();
        }
        // Memory comes back once the device has seen that nothing uses it.
        Ok(self.cx.device.run(self.cx.device.encoder())?)
    }

    /// The seeds are others than those of the last pass.
    fn seeds_changed(&mut self) {
        self.neighbours.seeds_changed();
        self.clip.seeds_changed();
    }

    fn params(&self) -> Params {
        self.clip.params(&self.memory, &self.neighbours)
    }

    fn facets(&self) -> Range<u32> {
        0..self.memory.facets.len() as u32
    }

    /// Statistics of a pass that begins: rows and first cells, in submissions of their own, so that they can be timed.
    pub(super) fn begin_pass(&mut self, token: &Token) -> Result<PassStats> {
        let mut stats = PassStats::default();
        if self.neighbours.count == 0 {
            return Err(RvdError::NoSeeds);
        }
        if let Place::Trial(_) = self.neighbours.place {
            self.neighbours.place = Place::Point;
            self.seeds_changed();
        }
        self.optimizer.sums_lost();
        token.check()?;
        let begin = Instant::now();
        self.search_now(token)?;
        stats.neighbours_ms = elapsed_ms(begin);
        let begin = Instant::now();
        self.start_now(token)?;
        stats.start_ms = elapsed_ms(begin);
        stats.duplicate_seeds = self.neighbours.duplicates;
        Ok(stats)
    }

    /// What was done since the session was opened.
    fn work(&self) -> DeviceWork {
        let now = self.cx.device.traffic();
        DeviceWork {
            host_searches: self.neighbours.host_searches,
            device_submissions: now.submissions - self.opened.submissions,
            device_allocations: now.allocations - self.opened.allocations,
            uploaded_bytes: now.uploaded_bytes - self.opened.uploaded_bytes,
            read_back_bytes: now.read_bytes - self.opened.read_bytes,
            ..self.clip.work
        }
    }

    fn compute_sums(&mut self, out: &mut CellSums<P>, token: &Token) -> Result<PassStats> {
        let before = self.work();
        let mut stats = self.begin_pass(token)?;
        let begin = Instant::now();
        self.run_sums(token, &mut stats)?;
        stats.clip_ms = elapsed_ms(begin);
        let begin = Instant::now();
        self.download_sums(out)?;
        stats.update_ms += elapsed_ms(begin);
        let area = out.area.iter().sum();
        let lost = self.loses_cells(&out.area)?;
        self.neighbours.loses_cells = Some(lost);
        if self.neighbours.merged || lost || !self.clip.covers(area, self.facets()) {
            stats = finished(stats, self.in_f64()?.sums(out, token)?);
        }
        stats.device += self.work().since(&before);
        Ok(stats)
    }

    /// Whether a cell without an area is of a seed so near to another that floats may have lost the cell.
    fn loses_cells(&mut self, area: &[f64]) -> Result<bool> {
        let empty: Vec<u32> = (0..).zip(area).filter(|(_, area)| **area == 0.0).map(|(i, _)| i).collect();
        if empty.is_empty() {
            return Ok(false);
        }
        self.view()?;
        Ok(self.neighbours.any_clumped(&empty))
    }

    /// Whether a diagram of the present seeds loses cells. Sums tell, and are asked only where seeds are that near.
    fn may_lose_cells(&mut self, token: &Token) -> Result<bool> {
        if self.neighbours.loses_cells.is_none() {
            self.begin_pass(token)?;
            self.view()?;
            let all: Vec<u32> = (0..self.neighbours.count as u32).collect();
            if self.neighbours.any_clumped(&all) {
                self.compute_sums(&mut CellSums::default(), token)?;
            } else {
                self.neighbours.loses_cells = Some(false);
            }
        }
        Ok(self.neighbours.loses_cells == Some(true))
    }

    /// The sums of the last pass, with what the host finished.
    fn download_sums(&mut self, out: &mut CellSums<P>) -> Result<()> {
        self.ensure_memory()?;
        let words = self.clip.sum_words(&self.memory, self.neighbours.count)?;
        out.reset(self.neighbours.count);
        fixed::decode(&words, self.cx.surface.is_uniform(), &self.clip.scales, out);
        Ok(())
    }

    /// A pass finds the pairs of a range of facets; then their pieces are written. They come out by facet, then seed.
    fn compute_pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats> {
        out.clear();
        let end = facets.end.min(self.memory.facets.len() as u32);
        let facets = facets.start.min(end)..end;
        let before = self.work();
        let lost = self.may_lose_cells(token)?;
        let mut stats = self.begin_pass(token)?;
        let mut next = facets.start;
        while next < facets.end {
            let begin = Instant::now();
            next = self.run_pairs(next..facets.end, token, &mut stats)?;
            stats.clip_ms += elapsed_ms(begin);
            let begin = Instant::now();
            self.clip.emit_all(&self.memory, &mut self.neighbours, out, token)?;
            stats.update_ms += elapsed_ms(begin);
        }
        let begin = Instant::now();
        out.sort();
        stats.pairs = out.len() as u64;
        stats.update_ms += elapsed_ms(begin);
        let area = (0..out.len()).map(|i| out.area(i)).sum();
        if self.neighbours.merged || lost || !self.clip.covers_places(area, facets.clone()) {
            stats = finished(stats, self.in_f64()?.pieces(facets, out, token)?);
        }
        stats.device += self.work().since(&before);
        Ok(stats)
    }

    /// A session for the pass again, in f64.
    fn in_f64(&mut self) -> Result<Box<dyn Session<P>>> {
        // With capacities of its own: these may show in the last bits.
        let options = SessionOptions::new(self.cx.max_seeds);
        let parallel = Parallel::on(Arc::clone(&self.cx.pool));
        let mut session = P::session(&parallel, Arc::clone(&self.cx.surface), options)?;
        if self.neighbours.place == Place::Set {
            session.set_seeds(&self.neighbours.seeds)?;
        } else {
            self.view()?;
            session.set_seeds(&self.neighbours.host.seen)?;
        }
        Ok(session)
    }
}

impl<P: DeviceSpace> Session<P> for GpuSession<P> {
    fn set_seeds(&mut self, seeds: &[P]) -> Result<()> {
        // Before room is made: seeds that are refused leave the session as it was.
        check_seeds(seeds, self.cx.max_seeds)?;
        self.on_pool(|session| session.make_room(seeds.len()))?;
        self.neighbours.set_seeds(seeds)?;
        self.seeds_changed();
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums<P>, token: &Token) -> Result<PassStats> {
        self.on_pool(|session| session.compute_sums(out, token))
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats> {
        self.on_pool(|session| session.compute_pieces(facets, out, token))
    }

    fn device_bytes(&self) -> u64 {
        self.memory.device_bytes() + self.optimizer.device_bytes()
    }

    fn device_work(&self) -> DeviceWork {
        self.work()
    }

    fn device_phases(&self) -> Option<PhasesMs> {
        self.cx.device.stage_ms().map(phases)
    }

    fn resident(&mut self) -> Option<&mut dyn Resident<P>> {
        (self.neighbours.count > 0).then_some(self)
    }
}

/// The figures of the device's pass and of the one that was `done` after it; every pair was finished in f64.
fn finished(lost: PassStats, done: PassStats) -> PassStats {
    let mut stats = lost;
    stats.add(&done);
    PassStats { pairs: done.pairs, f64_finished: done.pairs, duplicate_seeds: lost.duplicate_seeds, ..stats }
}
