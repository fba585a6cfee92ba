//! Facets clipped to cells, and their sums.
//!
//! Purpose: the dispatches of a pass over a window of facets, what pairs that did not end need, and the sums and pieces that
//! come of it. Invariant: nothing is dropped: a pair ends on the device, is launched again with more, or is finished in f64.
//! Which facets `divide` does, and its variant, depend on the surface and the seeds alone, never on capacities. Must not know:
//! where rows and first cells come from, why seeds move.

pub(super) mod by_cell;
pub(super) mod fixed;
mod pieces;
mod retry;

use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

use super::lane;
use super::layout::{self, MEMBERS, NONE, Params, ROOT, ROW, State, accumulate};
use super::memory::{Memory, OnDevice, records};
use super::neighbours::{Neighbours, Rows};
use super::pipelines::SLOTS;
use super::plan::{BATCH, size};
use super::space::{DeviceSpace, FacetRecord};
use super::{Context, Result};
use crate::dispatch::{ARGUMENTS_BYTES, Stage, run_groups, run_indirect};
use geometry::rvd::incident::FacetWalker;
use geometry::rvd::{Accumulate, DeviceWork, PassStats};
use geometry::token::Token;
pub(super) use retry::Pair;

/// What a pass leaves beside the sums on the device.
pub(super) struct PassResult<P: DeviceSpace> {
    /// Pieces that the host clipped: seed and sums.
    pub finished: Vec<(u32, fixed::Units<P>)>,
    /// Facets that the host walked as a whole.
    pub walked: HashSet<u32>,
    /// Parts of the list that repeat earlier pairs.
    pub repeats: Vec<Range<u32>>,
    /// Pairs in the list, repeats included.
    pub length: u32,
    pub pairs: u64,
    /// Polygon vertices allowed at present.
    pub polygon: u32,
    /// Whether facets were done as a whole where that was possible.
    pub divided: bool,
    /// Whether cells entered facets of their own, so that the pieces are to be proved.
    pub by_cell: bool,
    /// What the device gives pairs that lack it, without the host.
    pub device_retries: Shortages,
}

impl<P: DeviceSpace> Default for PassResult<P> {
    fn default() -> Self {
        Self {
            finished: Vec::new(),
            walked: HashSet::new(),
            repeats: Vec::new(),
            length: 0,
            pairs: 0,
            polygon: 0,
            divided: false,
            by_cell: false,
            device_retries: Shortages::default(),
        }
    }
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Shortages {
    /// Longer rows.
    pub neighbours: bool,
    /// More slots for a polygon than there are in registers.
    pub slots: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Wants {
    /// Sums and the list of pairs.
    Sums,
    /// The list of pairs; what the sums hold is of no use.
    Pairs,
}

/// Which variant of the clip stage a launch uses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Variant {
    Registers,
    /// Polygon in many indexed slots.
    Large,
}

/// Clip dispatches per submission: at first, and at most.
pub(super) const STEPS: (u32, u32) = (8, 64);
/// However few the last pass needed.
const FEWEST_STEPS: u32 = 3;
/// Clip dispatches for what comes of pairs with large polygons.
const STEPS_AGAIN: u32 = 4;
/// The variant of `divide` has room for this multiple of the cells that a mean facet is expected to meet. More room
/// costs every facet time, less sends more of them through the list of pairs.
const ROOM: f64 = 1.1;
/// Relative error of the area that single precision may have. Where nothing is lost it is below 10⁻⁷.
const COVER: f64 = 1e-6;

pub(super) fn count_requeued(state: &State, stats: &mut PassStats) {
    stats.relaunched_neighbours += u64::from(state.requeued - state.overflowed);
    stats.relaunched_polygon += u64::from(state.overflowed);
}

/// How a session clips, and what its passes leave.
pub(super) struct Clip<P: DeviceSpace> {
    cx: Arc<Context<P>>,
    /// Polygon vertices that a pass begins with.
    first_polygon: u32,
    /// Mean area and perimeter of a facet.
    lengths: (f64, f64),
    /// Where cells look for facets, and the facets that are left to propagation for these seeds.
    pub near: by_cell::Grid,
    demoted: Vec<u32>,
    /// Whether facets are done as a whole where that is possible.
    pub divides: bool,
    /// Code in [`layout::accumulate`].
    pub accumulate: u32,
    pub scales: fixed::Scales,
    walker: FacetWalker<P>,
    pub pass: PassResult<P>,
    /// What pairs lacked so far.
    pub shortages: Shortages,
    /// Clip dispatches of a pass's first submission: some more than the last pass needed.
    pub steps: u32,
    /// Facets that were divided at once, and that went pair by pair.
    pub work: DeviceWork,
}

impl<P: DeviceSpace> Clip<P> {
    pub(super) fn new(cx: Arc<Context<P>>, near: by_cell::Grid, how: Accumulate) -> Self {
        Self {
            first_polygon: cx.capacities.polygon.clamp(4, SLOTS) as u32,
            lengths: records::mean_facet(&cx.surface),
            near,
            demoted: Vec::new(),
            divides: true,
            accumulate: match how {
                Accumulate::Direct | Accumulate::Auto => accumulate::DIRECT,
                Accumulate::TwoPhase => accumulate::TWO_PHASE,
            },
            scales: fixed::Scales::default(),
            walker: FacetWalker::default(),
            pass: PassResult::default(),
            shortages: Shortages::default(),
            steps: STEPS.0,
            work: DeviceWork::default(),
            cx,
        }
    }

    /// The seeds are others, all near the surface's box.
    pub(super) fn seeds_changed(&mut self) {
        self.set_radius(fixed::covering_radius_of_near(self.cx.longest_lift));
        self.walker.reset(&Token::default());
    }

    /// Every point of the surface's box is within `radius` of a seed.
    pub(super) fn set_radius(&mut self, radius: f64) {
        self.scales = fixed::Scales::new(self.cx.mass, self.cx.surface.area(), radius);
    }

    /// Begins a pass, whose pieces are to be proved if cells look for facets (`by_cell`).
    pub(super) fn begin(&mut self, by_cell: bool) {
        self.pass = PassResult { polygon: self.first_polygon, by_cell, ..PassResult::default() };
    }

    pub(super) fn params(&self, memory: &Memory<P>, neighbours: &Neighbours<P>) -> Params {
        let window = memory.windows.facets();
        Params {
            mass_scale: self.scales.mass as f32,
            moment_scale: self.scales.moment as f32,
            energy_scale: self.scales.energy as f32,
            area_scale: self.scales.area as f32,
            uniform_weights: u32::from(self.cx.surface.is_uniform()),
            list_capacity: memory.counts.pairs.min(u64::from(layout::INDEX)) as u32,
            batch: BATCH,
            polygon: self.pass.polygon,
            accumulate: self.accumulate,
            grid: self.near.side,
            seeds: neighbours.count as u32,
            row: self.cx.capacities.neighbours.clamp(1, ROW as usize) as u32,
            side: neighbours.side,
            roots: neighbours.roots_of(&window).len() as u32,
            divided: NONE,
            facet_first: window.start,
            has_lists: u32::from(memory.counts.listed > 0),
            longest_lift: self.cx.longest_lift as f32 * 1.000_001,
            ..Params::default()
        }
    }

    /// Parameters of a pass over `facets` of the window at work.
    pub(super) fn roots_params(&self, memory: &Memory<P>, neighbours: &Neighbours<P>, facets: &Range<u32>) -> Params {
        let present = neighbours.roots_of(facets);
        let first = present.start - neighbours.roots_of(&memory.windows.facets()).start;
        let by_both = self.pass.divided && self.pass.by_cell;
        Params {
            enqueue_begin: first as u32,
            enqueue_count: present.len() as u32,
            enqueue_root: ROOT,
            emit_count: if self.pass.by_cell { neighbours.count as u32 } else { 0 },
            divided: if by_both { self.first_flag(memory) as u32 } else { NONE },
            ..self.params(memory, neighbours)
        }
    }

    /// The slot where it begins to say which facets are divided.
    fn first_flag(&self, memory: &Memory<P>) -> u64 {
        memory.counts.slots - if self.near.side > 0 { memory.counts.window } else { 0 }
    }

    /// Chooses how a pass goes about it, by what is known of the seeds when it begins.
    pub(super) fn choose(&mut self, wants: Wants, rows: Rows) {
        // The rows of the host are in an order of its own.
        self.pass.divided = self.divides && wants == Wants::Sums && !rows.are_of_host();
        // Rows that are longer already may not be made again, and a list of which pieces are made has no pair twice.
        if wants == Wants::Sums && rows == Rows::Missing {
            self.pass.device_retries = self.shortages;
        }
    }

    /// Clears what a pass over `facets` uses; the sums of `sums` seeds too.
    pub(super) fn encode_clears(
        &self,
        memory: &Memory<P>,
        encoder: &mut wgpu::CommandEncoder,
        facets: &Range<u32>,
        sums: Option<usize>,
    ) -> Result<()> {
        let buffers = &memory.there()?.buffers;
        if let (Some(first), Some(last)) = (facets.clone().next(), facets.clone().next_back()) {
            let slot = |f: u32| u64::from(memory.facets[f as usize].slots().0);
            let begin = slot(first);
            let end = slot(last) + (1 << memory.slots_log2[last as usize]);
            encoder.clear_buffer(&buffers.slots, begin * 4, Some((end - begin) * 4));
        }
        if self.pass.divided && self.pass.by_cell {
            encoder.clear_buffer(&buffers.slots, self.first_flag(memory) * 4, Some(memory.counts.window * 4));
        }
        if let Some(seeds) = sums {
            encoder.clear_buffer(&buffers.sums, 0, Some((seeds * P::SUM_WORDS * 4) as u64));
        }
        Ok(())
    }

    /// Encodes the candidates' arrival, by facet and by cell, then `steps` times indirect arguments and clip.
    pub(super) fn encode_clip(
        &self,
        memory: &Memory<P>,
        seeds: usize,
        encoder: &mut wgpu::CommandEncoder,
        launch: &Launch,
        token: &Token,
    ) -> Result<()> {
        let (device, limits, there) = (&self.cx.device, self.cx.limits(), memory.there()?);
        let entries = self.entries(memory, seeds, launch.candidates.as_ref())?;
        let long = entries.iter().any(Stage::is_long);
        if long {
            memory.encode(encoder, lane::CLIP, &entries, token)?;
        }
        let mut compute = device.pass(encoder, lane::CLIP);
        if !long {
            entries.iter().for_each(|stage| stage.run(&mut compute, limits));
        }
        self.run_steps(memory, there, &mut compute, launch);
        Ok(())
    }

    fn entries<'a>(
        &'a self,
        memory: &'a Memory<P>,
        seeds: usize,
        candidates: Option<&Params>,
    ) -> Result<Vec<Stage<'a>>> {
        let (pipelines, windows) = (&self.cx.pipelines, &memory.there()?.bindings.windows);
        let window = &windows[memory.windows.present];
        let mut entries = Vec::with_capacity(2);
        let mut enter = |pipeline, bindings, items: u32, size| {
            entries.push(Stage { pipeline, bindings, items: items.into(), size, arguments: None });
        };
        if let Some(params) = candidates {
            if params.enqueue_root != 0 && self.pass.divided {
                let (room, weighted) = (self.divide_size(seeds), usize::from(!self.cx.surface.is_uniform()));
                let (divide, bindings) = (&pipelines.divide[room][weighted], &window.divide[room][weighted]);
                let size = if room < 2 && weighted == 0 { size::FACET } else { size::SEARCH };
                enter(divide, bindings, params.enqueue_count, size);
            } else {
                enter(&pipelines.enqueue, &window.enqueue, params.enqueue_count, size::ITEM);
            }
            if params.emit_count > 0 {
                enter(&pipelines.reach, &window.reach, params.emit_count, size::SEARCH);
            }
        }
        Ok(entries)
    }

    fn run_steps(&self, memory: &Memory<P>, there: &OnDevice, compute: &mut wgpu::ComputePass<'_>, launch: &Launch) {
        let (pipelines, window) = (&self.cx.pipelines, &there.bindings.windows[memory.windows.present]);
        let shared = self.accumulate == accumulate::TWO_PHASE;
        let (clip, bindings) = match launch.variant {
            Variant::Registers if shared => (&pipelines.clip_shared, &window.clip_shared),
            Variant::Registers => (&pipelines.clip, &window.clip),
            Variant::Large => (&pipelines.clip_large, &window.clip_large),
        };
        let taken = |compute: &mut wgpu::ComputePass<'_>, taking, with, clip, bindings| {
            run_groups(compute, taking, with, [1, 1]);
            run_indirect(compute, clip, bindings, (&there.buffers.arguments, 0));
        };
        let begins = launch.candidates.is_some_and(|p| p.enqueue_root != 0);
        let device_retries = if begins { self.pass.device_retries } else { Shortages::default() };
        let step = |compute: &mut wgpu::ComputePass<'_>| {
            taken(compute, &pipelines.indirect_arguments, &there.bindings.indirect_arguments, clip, bindings);
            if device_retries.neighbours {
                let arguments = (&there.buffers.arguments, ARGUMENTS_BYTES);
                run_indirect(compute, &pipelines.lengthen, &there.bindings.lengthen, arguments);
            }
        };
        // What failed in one step is seen by the next, and comes again in the one after.
        let steps = launch.steps + u32::from(device_retries.neighbours);
        (0..steps).for_each(|_| step(compute));
        // With fewer slots allowed than there are, the host allows more first.
        if device_retries.slots && self.first_polygon as usize == SLOTS {
            let (large, bindings) = (&pipelines.clip_large, &window.clip_large);
            taken(compute, &pipelines.overflow, &there.bindings.overflow, large, bindings);
            (0..STEPS_AGAIN).for_each(|_| step(compute));
        }
    }

    /// Which variant of `divide` suits the facets. By surface and number of seeds alone: another may round differently.
    fn divide_size(&self, seeds: usize) -> usize {
        let h2 = self.cx.surface.area() / seeds.max(1) as f64;
        let mean = records::mean_cells(self.lengths, h2);
        MEMBERS.iter().position(|&m| ROOM * mean <= f64::from(m)).unwrap_or(MEMBERS.len() - 1)
    }

    /// A pass's first submission took `rounds`: the next one gets some more steps.
    pub(super) fn learn_steps(&mut self, rounds: u32) {
        self.steps = (rounds + 2).clamp(FEWEST_STEPS, STEPS.1);
    }

    /// Counts how the facets of a pass went that entered `roots` of them. Returns that alone.
    pub(super) fn count_facets(&mut self, state: &State, roots: u32) -> DeviceWork {
        let paired_facets = if self.pass.divided { state.paired.min(roots) } else { roots }.into();
        let divided_facets = u64::from(roots) - paired_facets;
        let work = DeviceWork { divided_facets, paired_facets, ..DeviceWork::default() };
        self.work += work;
        work
    }

    /// The sums of the last pass, with what the host finished, in units.
    pub(super) fn sum_words(&self, memory: &Memory<P>, seeds: usize) -> Result<Vec<u32>> {
        let mut words: Vec<u32> = memory.read(|b| &b.sums, 0..seeds * P::SUM_WORDS)?;
        for (seed, units) in &self.pass.finished {
            fixed::add(&mut words[*seed as usize * P::SUM_WORDS..][..P::SUM_WORDS], units);
        }
        Ok(words)
    }

    /// Whether `area` is that of the facets in `facets`.
    pub(super) fn covers(&self, area: f64, facets: Range<u32>) -> bool {
        let surface = &self.cx.surface;
        let whole = facets.len() == surface.facets().len();
        let of = |f: u32| surface.facet_area(f);
        let expected = if whole { surface.area() } else { self.live(facets).map(of).sum() };
        (area - expected).abs() <= COVER * expected
    }

    /// Whether `area`, that of pieces in R³, is that of the facets in `facets` there.
    pub(super) fn covers_places(&self, area: f64, facets: Range<u32>) -> bool {
        if P::IS_PLACE {
            return self.covers(area, facets);
        }
        let surface = &self.cx.surface;
        let of = |f: u32| {
            let [a, b, c] = surface.corners(f).map(P::place);
            0.5 * (b - a).cross(c - a).length()
        };
        // A piece's vertices are off by a share of how far they are in R⁶.
        let expected: f64 = self.live(facets.clone()).map(of).sum();
        let lifted: f64 = self.live(facets).map(|f| surface.facet_area(f)).sum();
        (area - expected).abs() <= COVER * lifted
    }

    /// Those of `facets` that have an area.
    fn live(&self, facets: Range<u32>) -> impl Iterator<Item = u32> {
        facets.filter(|&f| !self.cx.surface.skips(f as usize))
    }

    /// Units of area, as limbs, between which the pieces of all facets cover the surface; within what
    /// [`Self::covers`] says by more than a rounding.
    pub(super) fn area_bounds(&self) -> ([u32; 2], [u32; 2]) {
        let at = |share: f64| self.scales.area * self.cx.surface.area() * (1.0 + 0.999 * share);
        let limbs = |units: u64| [units as u32, (units >> 32) as u32];
        (limbs(at(-COVER).ceil() as u64), limbs(at(COVER).floor() as u64))
    }
}

#[derive(Clone, Copy)]
pub(super) struct Launch {
    /// Candidates that are entered first.
    pub candidates: Option<Params>,
    pub variant: Variant,
    pub steps: u32,
}
