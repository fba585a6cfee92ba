//! Neighbours of the seeds, and first cells of the facets.
//!
//! Purpose: rows of neighbours from a uniform grid on the device, the nearest seed of each facet by a walk over them, and the
//! decision whether the host does it instead. Invariant: a row is the beginning of every longer row, wherever it comes from:
//! its order is that of [`layout::Seed::key`], then of indices. Rows and first cells are proved, or the host makes them with
//! its tree; nothing is cut off. The choice depends on the seeds alone. Seeds that converge hardly move. So the device keeps a
//! Verlet list for each seed (Verlet 1967), somewhat longer than its row, and takes the row from it while it proves the row: a
//! seed that was beyond a list's reach is no nearer now than that less what both have moved. A row is the same wherever it
//! comes from. The device decides (`shaders/neighbours/offsets.wgsl`), so that passes without the host can use lists too. Must
//! not know: clipping.

pub(super) mod grid;
mod host;

use std::mem::offset_of;
use std::ops::Range;
use std::sync::Arc;

use super::lane;
use super::layout::{self, COMPLETE, INDEX, ListState, Params, State, halt};
use super::memory::Memory;
use super::plan::{grid_cells, search_arguments, size};
use super::space::{DeviceSpace, SeedRecord};
use super::{Context, Result};
use crate::buffers::write;
use crate::dispatch::Stage;
use geometry::knn::NeighbourRow;
use geometry::rvd::{RvdError, check_seed, take_seeds};
use geometry::token::Token;
pub(super) use host::{HostCopy, LONGEST_ROW};

/// Which seeds a pass is of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Place {
    /// Those that the host has set.
    Set,
    /// The present point on the device.
    Point,
    /// So far along the direction from there.
    Trial(f32),
}

/// Where the rows that the device has come from. `far`: seeds are farther than floats reach, so rows and distances are in
/// the order of f64.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Rows {
    Missing,
    Device,
    Host { far: bool },
}

impl Rows {
    pub(super) fn are_of_host(self) -> bool {
        matches!(self, Self::Host { .. })
    }
}

/// What the device has of the facets' first cells.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FirstCells {
    /// They are those of the present seeds.
    pub known: bool,
    /// It has found some itself, if only of other seeds: guesses.
    guessed: bool,
}

/// What came of a search on the device. Without rows the host has to search, with what [`Rows`] says of `far`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Searched {
    Rows,
    Nothing { far: bool },
}

/// What a search found.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Neighbours of every seed, nearest first.
    pub rows: Vec<NeighbourRow>,
    /// First cell of every facet that is not degenerate.
    pub first: Vec<(u32, u32)>,
    /// Seeds that lie on an earlier one.
    pub duplicates: u64,
    /// The host made the rows.
    pub by_host: bool,
    /// Rows that came from lists of an earlier search.
    pub from_lists: u64,
}

/// The seeds of a session, and what is known of them.
pub(super) struct Neighbours<P: DeviceSpace> {
    cx: Arc<Context<P>>,
    /// The seeds as they were set, and how many there are.
    pub seeds: Vec<P>,
    /// Their records, if another device has made them.
    given: Vec<P::Seed>,
    pub count: usize,
    pub place: Place,
    /// Cells along a side of the grid in which seeds are searched: of these, and at most.
    pub side: u32,
    finest: u32,
    pub rows: Rows,
    pub first_cells: FirstCells,
    /// Seeds noted for lists when rows were last made.
    listed_for: usize,
    /// Later duplicates among the seeds, and whether some of those are none in f64.
    pub duplicates: u64,
    pub merged: bool,
    /// Whether cells of close seeds are lost in floats, once that is known.
    pub loses_cells: Option<bool>,
    /// (facet, first cell) of every facet that is not degenerate, by facet; cells as far as the host knows them.
    pub roots: Vec<[u32; 2]>,
    pub host: HostCopy<P>,
    pub host_searches: u64,
}

impl<P: DeviceSpace> Neighbours<P> {
    /// No seeds yet, in a grid of at most `finest` cells a side, and first cells of `roots` to be found.
    pub(super) fn new(cx: Arc<Context<P>>, finest: u32, roots: Vec<[u32; 2]>) -> Self {
        Self {
            cx,
            seeds: Vec::new(),
            given: Vec::new(),
            count: 0,
            place: Place::Set,
            side: finest,
            finest,
            rows: Rows::Missing,
            first_cells: FirstCells::default(),
            listed_for: 0,
            duplicates: 0,
            merged: false,
            loses_cells: None,
            roots,
            host: HostCopy::default(),
            host_searches: 0,
        }
    }

    /// Takes new seeds. [`Self::seeds_changed`] comes after it.
    pub(super) fn set_seeds(&mut self, seeds: &[P]) -> Result<()> {
        take_seeds(seeds, self.cx.max_seeds, &mut self.seeds)?;
        self.given.clear();
        self.count_changed();
        Ok(())
    }

    /// Takes seeds as another device has them. [`Self::seeds_changed`] comes after it.
    pub(super) fn set_records(&mut self, records: &[P::Seed]) {
        self.seeds.clear();
        self.seeds.extend(records.iter().map(P::of_record));
        self.given.clear();
        self.given.extend_from_slice(records);
        self.given.iter_mut().for_each(|record| record.set_row(0, 0));
        self.count_changed();
    }

    fn count_changed(&mut self) {
        if self.count != self.seeds.len() {
            self.first_cells = FirstCells::default();
            self.count = self.seeds.len();
            // There are buffers for the grid of the most seeds.
            self.side = match self.count == self.cx.max_seeds {
                true => self.finest,
                false => grid::grid_side_for(&self.cx.surface, self.count).min(self.finest),
            };
        }
        self.place = Place::Set;
    }

    /// The seeds are others than those that rows and first cells were made for.
    pub(super) fn seeds_changed(&mut self) {
        self.rows = Rows::Missing;
        self.first_cells.known = false;
        self.host.fresh = false;
        self.merged = false;
        self.loses_cells = None;
    }

    /// The device's memory is new. Rows of the host are uploaded again.
    pub(super) fn memory_changed(&mut self, memory: &Memory<P>) -> Result<()> {
        if self.rows.are_of_host() {
            self.upload_rows(memory)?;
        }
        self.first_cells.guessed = false;
        Ok(())
    }

    /// The device's memory is gone, and lists with it.
    pub(super) fn memory_lost(&mut self) {
        self.listed_for = 0;
    }

    pub(super) fn records(&self) -> Vec<P::Seed> {
        match self.given.is_empty() {
            true => self.seeds.iter().map(|p| p.record()).collect(),
            false => self.given.clone(),
        }
    }

    pub(super) fn upload_seeds(&mut self, memory: &Memory<P>) -> Result<()> {
        self.host.records = self.records();
        Ok(write(&self.cx.device, &memory.there()?.buffers.seeds, 0, &self.host.records)?)
    }

    /// Where the first cells of `facets` are among all.
    pub(super) fn roots_of(&self, facets: &Range<u32>) -> Range<usize> {
        let at = |facet: u32| self.roots.partition_point(|r| r[0] < facet);
        at(facets.start)..at(facets.end)
    }

    pub(super) fn upload_roots(&self, memory: &Memory<P>) -> Result<()> {
        for (window, to) in memory.by_window() {
            write(&self.cx.device, &to.candidates, 0, &self.roots[self.roots_of(&window.facets)])?;
        }
        Ok(())
    }

    fn download_roots(&mut self, memory: &Memory<P>) -> Result<()> {
        let staging = &memory.there()?.buffers.staging;
        let mut roots = Vec::with_capacity(self.roots.len());
        for (window, from) in memory.by_window() {
            let count = self.roots_of(&window.facets).len();
            roots.append(&mut staging.read(&self.cx.device, &from.candidates, 0..count)?);
        }
        self.roots = roots;
        Ok(())
    }

    pub(super) fn encode_search(
        &mut self,
        memory: &Memory<P>,
        params: &Params,
        encoder: &mut wgpu::CommandEncoder,
        token: &Token,
    ) -> Result<()> {
        let (n, pipelines, there) = (self.count as u64, &self.cx.pipelines, memory.there()?);
        let (b, bindings) = (&there.buffers, &there.bindings);
        let drifts = (memory.counts.listed > 0).then_some(&b.drifts);
        for of_cells in [Some(&b.cells), drifts].into_iter().flatten() {
            encoder.clear_buffer(of_cells, 0, Some(grid_cells(params.side) * 4));
        }
        // Lists of other seeds, or of a search that did not come to its end, are none.
        let known = std::mem::take(&mut self.listed_for) == self.count;
        let of_one_pass = offset_of!(ListState, open) as u64;
        encoder.clear_buffer(&b.list_state, 0, Some(if known { of_one_pass } else { size_of::<ListState>() as u64 }));
        let stage = |pipeline, bindings, items, size| Stage { pipeline, bindings, items, size, arguments: None };
        let chosen = |pipeline, bindings, buffer, first| {
            let arguments = Some((buffer, first));
            Stage { pipeline, bindings, items: n, size: size::SEARCH, arguments }
        };
        let (from_grid, with_lists) = (search_arguments(n, false), search_arguments(n, true));
        let stages = [
            stage(&pipelines.count, &bindings.count, n, size::ITEM),
            stage(&pipelines.offsets, &bindings.offsets, u64::from(params.side).pow(2), size::ITEM),
            stage(&pipelines.scatter, &bindings.scatter, n, size::ITEM),
            stage(&pipelines.duplicates, &bindings.duplicates, n, size::ITEM),
            chosen(&pipelines.from_lists, &bindings.from_lists, &b.arguments, 0),
            chosen(&pipelines.search, &bindings.search, &b.list_state, from_grid),
            chosen(&pipelines.search_lists, &bindings.search_lists, &b.list_state, with_lists),
        ];
        memory.encode(encoder, lane::NEIGHBOURS, &stages, token)?;
        self.listed_for = self.count;
        Ok(())
    }

    /// Encodes the search for the first cells of the window at work.
    pub(super) fn encode_first_cells(
        &self,
        memory: &Memory<P>,
        encoder: &mut wgpu::CommandEncoder,
        token: &Token,
    ) -> Result<()> {
        let roots = self.roots_of(&memory.windows.facets()).len() as u64;
        let size = if self.first_cells.guessed { size::FACET } else { size::FIRST_CELL };
        let bindings = &memory.there()?.bindings.windows[memory.windows.present].first_cells;
        let stage = Stage { pipeline: &self.cx.pipelines.first_cells, bindings, items: roots, size, arguments: None };
        memory.encode(encoder, lane::START, &[stage], token)
    }

    pub(super) fn take_search_result(&mut self, memory: &Memory<P>, state: &State) -> Result<Searched> {
        if state.halt & halt::BAD != 0 {
            let i = (u32::MAX - state.bad) as usize;
            let record: Vec<P::Seed> = memory.read(|b| &b.seeds, i..i + 1)?;
            let point = record.first().map_or(P::ZERO, P::of_record);
            check_seed(i, point)?;
            // Beyond the range by a rounding.
            let boxes = point.coordinates().as_ref().iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            return Err(RvdError::SeedTooFar { seed: i, boxes });
        }
        let far = state.halt & halt::FAR != 0 || state.near == 0;
        if far || state.halt != 0 {
            return Ok(Searched::Nothing { far });
        }
        self.rows = Rows::Device;
        self.duplicates = u64::from(state.duplicates);
        // Seeds that the device cannot tell apart and the host can are for the host.
        self.merged = self.duplicates > 0
            && self.place == Place::Set
            && P::coincident(&self.seeds).len() as u64 != self.duplicates;
        Ok(Searched::Rows)
    }

    /// Takes what came of the facets' first cells. `false` if the host found some of them.
    pub(super) fn take_first_cells(&mut self, memory: &Memory<P>, state: &State) -> Result<bool> {
        self.first_cells = FirstCells { known: true, guessed: true };
        if state.unproved == 0 {
            return Ok(true);
        }
        self.find_unproved(memory)?;
        Ok(false)
    }

    /// Rows and first cells as they are on the device.
    pub(super) fn found(&mut self, memory: &Memory<P>) -> Result<Found> {
        self.host.fresh = false;
        self.view(memory)?;
        // As long as the buffer is: the counts may be those of the next one already.
        let entries = memory.there()?.buffers.plan.table as usize / size_of::<u32>();
        let table: Vec<u32> = memory.read(|b| &b.table, 0..entries)?;
        let list_state: Vec<ListState> = memory.read(|b| &b.list_state, 0..1)?;
        let from_lists =
            list_state.first().filter(|s| s.mode == layout::search::FROM_LISTS && self.rows == Rows::Device);
        let row = |r: &P::Seed| {
            let (begin, length) = r.row();
            let begin = begin as usize;
            let seeds = table[begin..begin + (length & INDEX) as usize].to_vec();
            NeighbourRow { seeds, complete: length & COMPLETE != 0 }
        };
        Ok(Found {
            rows: self.host.records.iter().map(row).collect(),
            first: self.roots.iter().map(|r| (r[0], r[1])).collect(),
            duplicates: self.duplicates,
            by_host: self.rows.are_of_host(),
            from_lists: from_lists.map_or(0, |s| self.count as u64 - u64::from(s.open)),
        })
    }
}
