//! Neighbours and first cells: the device's search, and the host's where that is not enough.
//!
//! Purpose: rows of neighbours from a uniform grid on the device, the nearest seed of each facet by a
//! walk over them, and the decision whether the host does it instead.
//! Invariant: a row is the beginning of every longer row, whoever made it: its order is that of
//! [`layout::Seed::key`], then of indices. Rows and first cells are proved, or the host makes them with
//! its tree; nothing is cut off. Who makes them depends on the seeds alone.
//! Seeds that converge hardly move, so the device keeps the nearest of each in a list, somewhat longer than its row, as
//! molecular dynamics does (Verlet 1967), and takes rows from the lists while those prove them: a seed that was beyond a
//! list's reach is no nearer now than that less what both have moved. A row is the same wherever it comes from; what
//! is done is decided on the device (`shaders/rows.wgsl`), so that passes without the host can do it too.
//! Must not know: clipping.

use std::mem::offset_of;
use std::sync::Arc;

use glam::DVec3;
use rayon::prelude::*;

use super::layout::{self, COMPLETE, INDEX, ListState, NONE, STRIDE, State, Totals, halt};
use super::plan::{grid_cells, search_arguments, size};
use super::{Gpu, GpuSession, OnDevice, fixed, lane, pack};
use crate::gpu::buffers;
use crate::gpu::dispatch::Stage;
use crate::gpu::limits::Limits;
use crate::knn::{NeighbourRow, NeighbourTable, SeedIndex, Threads};
use crate::mesh::coincident;
use crate::rvd::start::Starts;
use crate::rvd::{RvdError, Session, SessionOptions, Surface, check_seed};
use crate::token::{Stopped, Token};

/// The device's fixed-point scales hold where a seed is within this of all of the surface's box
/// (`NEAR` in `shaders/count.wgsl`): twice the box's half diagonal and some. Without such a seed
/// the host searches, and takes the radius from the seeds.
const COVERING_RADIUS: f64 = 2.0;

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

/// Who made the rows that the device has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Rows {
    /// Nobody yet.
    Missing,
    /// The device.
    Device,
    /// The host.
    Host,
}

/// What the host knows of the seeds on the device. Of no use while not fresh, but for `starts`,
/// which are guesses.
pub(super) struct HostCopy {
    pub fresh: bool,
    /// The records as on the device, longer rows noted.
    pub records: Vec<layout::Seed>,
    /// Positions. Those that the device sees, unless seeds are far.
    pub seen: Vec<DVec3>,
    pub index: SeedIndex,
    /// Rows of the host's search; without rows if the device made them.
    pub table: NeighbourTable,
    /// The device's table, if the host made it.
    pub packed: Vec<u32>,
    /// Entries of the device's table in use.
    pub packed_end: usize,
    /// First cell of every facet.
    pub first: Vec<u32>,
    /// Rows are in the order of f64 and so are distances: seeds are farther than floats reach.
    pub far: bool,
    starts: Starts,
}

impl Default for HostCopy {
    fn default() -> Self {
        Self {
            fresh: false,
            records: Vec::new(),
            seen: Vec::new(),
            index: SeedIndex::new(&[]),
            table: NeighbourTable::default(),
            packed: Vec::new(),
            packed_end: 0,
            first: Vec::new(),
            far: false,
            starts: Starts::default(),
        }
    }
}

/// Puts a row of the tree into the device's order. The end of a row that is not complete goes, as far as
/// a seed that is not in it might come before it in that order: a key is good to 4e-7 of itself.
pub(super) fn in_device_order(i: u32, records: &[layout::Seed], row: &mut NeighbourRow) {
    let own = &records[i as usize];
    let mut keyed: Vec<(f32, u32)> = row.seeds.iter().map(|&j| (own.key(&records[j as usize]), j)).collect();
    keyed.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    if !row.complete
        && let Some(&(last, _)) = keyed.last()
    {
        keyed.retain(|&(key, _)| key < last * (1.0 - 2e-6));
    }
    row.seeds.clear();
    row.seeds.extend(keyed.iter().map(|&(_, j)| j));
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

impl Gpu {
    /// Searches for the neighbours of each of `sets` of seeds (unit frame) in turn and the first cells of `surface`, as
    /// every pass of one session does, and shows what was found.
    ///
    /// # Errors
    /// Those of a pass.
    pub fn search(
        &self,
        surface: Arc<Surface>,
        sets: &[&[DVec3]],
        options: SessionOptions,
        token: &Token,
    ) -> Result<Vec<Found>, RvdError> {
        self.pool.install(|| {
            let mut session = GpuSession::new(self, surface, options);
            let find = |seeds: &&[DVec3]| {
                session.set_seeds(seeds)?;
                session.search_now(token)?;
                session.start_now(token)?;
                session.found()
            };
            sets.iter().map(find).collect()
        })
    }
}

impl GpuSession {
    /// Rows and first cells as they are on the device.
    fn found(&mut self) -> Result<Found, RvdError> {
        self.host.fresh = false;
        self.view()?;
        let device = Arc::clone(&self.device);
        let b = &self.on_device()?.buffers;
        let table: Vec<u32> = b.staging.read(&device, &b.table, 0..b.plan().counts.table as usize)?;
        let list_state: Vec<ListState> = b.staging.read(&device, &b.list_state, 0..1)?;
        let from_lists =
            list_state.first().filter(|k| k.mode == layout::search::FROM_LISTS && self.rows == Rows::Device);
        let row = |r: &layout::Seed| {
            let begin = r.row_begin as usize;
            let seeds = table[begin..begin + (r.row_length & INDEX) as usize].to_vec();
            NeighbourRow { seeds, complete: r.row_length & COMPLETE != 0 }
        };
        Ok(Found {
            rows: self.host.records.iter().map(row).collect(),
            first: self.roots.iter().map(|r| (r[0], r[1])).collect(),
            duplicates: self.duplicates,
            by_host: self.rows == Rows::Host,
            from_lists: from_lists.map_or(0, |k| self.count as u64 - u64::from(k.open)),
        })
    }

    /// The seeds are others than those that rows and first cells were made for.
    pub(super) fn moved(&mut self) {
        self.rows = Rows::Missing;
        self.started = false;
        self.host.fresh = false;
        self.host.far = false;
        self.merged = false;
        self.scales = fixed::Scales::new(self.mass, self.surface.area(), COVERING_RADIUS);
        self.walker.reset(&Token::default());
    }

    /// Encodes the seeds' arrival and the search for their rows.
    pub(super) fn encode_search(&mut self, encoder: &mut wgpu::CommandEncoder, token: &Token) -> Result<(), RvdError> {
        let (device, pipelines) = (Arc::clone(&self.device), Arc::clone(&self.pipelines));
        let (n, place, params) = (self.count as u64, self.place, self.params());
        if place == Place::Set {
            self.host.records.clear();
            self.host.records.extend(self.seeds.iter().map(|&p| pack::record(p)));
            self.on_device()?;
        }
        if let Place::Trial(_) = place {
            self.encode_trial(encoder)?;
        }
        let there = self.on_device.as_ref().ok_or_else(|| RvdError::Internal("no buffers".to_owned()))?;
        let OnDevice { buffers: b, bindings } = there;
        match (place, &self.moving) {
            (Place::Set, _) => buffers::write(&device, &b.seeds, 0, &self.host.records)?,
            (Place::Point, Some(moving)) => {
                let bytes = n * size_of::<layout::Seed>() as u64;
                encoder.copy_buffer_to_buffer(&moving.buffers.points, 0, &b.seeds, 0, bytes);
            }
            _ => {}
        }
        for of_cells in [&b.cells, &b.drifts] {
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
        let (anew, with_lists) = (search_arguments(n, false), search_arguments(n, true));
        let stages = [
            stage(&pipelines.count, &bindings.count, n, size::ITEM),
            stage(&pipelines.offsets, &bindings.offsets, u64::from(params.side).pow(2), size::ITEM),
            stage(&pipelines.scatter, &bindings.scatter, n, size::ITEM),
            stage(&pipelines.duplicates, &bindings.duplicates, n, size::ITEM),
            chosen(&pipelines.from_lists, &bindings.from_lists, &b.arguments, 0),
            chosen(&pipelines.search, &bindings.search, &b.list_state, anew),
            chosen(&pipelines.search_lists, &bindings.search_lists, &b.list_state, with_lists),
        ];
        there.encode(&device, encoder, lane::NEIGHBOURS, &stages, token)?;
        self.listed_for = self.count;
        Ok(())
    }

    /// Encodes the search for the facets' first cells.
    pub(super) fn encode_start(&mut self, encoder: &mut wgpu::CommandEncoder, token: &Token) -> Result<(), RvdError> {
        let (device, pipelines) = (Arc::clone(&self.device), Arc::clone(&self.pipelines));
        let (roots, window) = (self.roots_of(&self.layout.facets()).len() as u64, self.layout.present());
        self.on_device()?;
        let size = if self.guessed { size::FACET } else { size::LOOK };
        let there = self.on_device()?;
        let bindings = &there.bindings.windows[window].first_cells;
        let stage = Stage { pipeline: &pipelines.first_cells, bindings, items: roots, size, arguments: None };
        there.encode(&device, encoder, lane::START, &[stage], token)
    }

    /// Ends `encoder` with the totals, if they are wanted and all windows are done, and reads the summary.
    pub(super) fn read_summary(&mut self, mut encoder: wgpu::CommandEncoder) -> Result<State, RvdError> {
        let steps = self.moving.as_ref().is_some_and(|m| m.steps);
        if self.layout.is_last() {
            self.encode_totals(&mut encoder)?;
        }
        let device = Arc::clone(&self.device);
        self.on_device()?;
        let Some(OnDevice { buffers: b, .. }) = &self.on_device else {
            return Err(RvdError::Internal("no buffers".to_owned()));
        };
        let mut parts = vec![(&b.state, 0, size_of::<State>() as u64)];
        let wanted = self.moving.as_ref().filter(|m| m.wants_totals());
        parts.extend(wanted.map(|m| (&m.buffers.totals, 0, size_of::<Totals>() as u64)));
        let (mut state, mut totals) = (State::default(), None);
        b.staging.read_parts(&device, encoder, &parts, |bytes| {
            let (first, rest) = bytes.split_at(size_of::<State>());
            state = bytemuck::pod_read_unaligned(first);
            totals = (!rest.is_empty()).then(|| bytemuck::pod_read_unaligned(rest));
        })?;
        if let (Some(moving), Some(totals)) = (&mut self.moving, totals) {
            moving.totals = totals;
            moving.moved |= steps && state.halt == 0;
        }
        state.halt &= !halt::INCOMPLETE;
        Ok(state)
    }

    /// The rows, if they are not there, in a submission of their own.
    pub(super) fn search_now(&mut self, token: &Token) -> Result<(), RvdError> {
        if self.rows != Rows::Missing {
            return Ok(());
        }
        self.promote()?;
        let (device, params) = (Arc::clone(&self.device), self.params());
        let b = &self.on_device()?.buffers;
        buffers::write(&device, &b.params, 0, &[params])?;
        buffers::write(&device, &b.state, 0, &[State::default()])?;
        let mut encoder = device.encoder();
        self.encode_search(&mut encoder, token)?;
        let state = self.read_summary(encoder)?;
        self.take_search_result(&state, token)?;
        Ok(())
    }

    /// The first cells likewise.
    pub(super) fn start_now(&mut self, token: &Token) -> Result<(), RvdError> {
        token.check()?;
        if self.started {
            return Ok(());
        }
        self.on_device()?;
        let device = Arc::clone(&self.device);
        let mut all = State::default();
        for k in 0..self.layout.windows().len() {
            self.layout.turn_to(k);
            let params = self.params();
            let b = &self.on_device()?.buffers;
            buffers::write(&device, &b.params, 0, &[params])?;
            buffers::write(&device, &b.state, 0, &[State::default()])?;
            let mut encoder = device.encoder();
            self.encode_start(&mut encoder, token)?;
            all.unproved += self.read_summary(encoder)?.unproved;
        }
        self.take_first_cells(&all)?;
        Ok(())
    }

    /// What came of the search. `false` if the host searched instead.
    pub(super) fn take_search_result(&mut self, state: &State, token: &Token) -> Result<bool, RvdError> {
        if state.halt & halt::BAD != 0 {
            let i = (u32::MAX - state.bad) as usize;
            let device = Arc::clone(&self.device);
            let b = &self.on_device()?.buffers;
            let record: Vec<layout::Seed> = b.staging.read(&device, &b.seeds, i..i + 1)?;
            let place = record.first().map_or(DVec3::NAN, |r| DVec3::from_array(r.position()));
            check_seed(i, place)?;
            // Beyond the range by a rounding.
            return Err(RvdError::SeedTooFar { seed: i, boxes: place.abs().max_element() });
        }
        let far = state.halt & halt::FAR != 0 || state.near == 0;
        if far || state.halt != 0 {
            self.search_on_host(far, token)?;
            return Ok(false);
        }
        self.rows = Rows::Device;
        self.duplicates = u64::from(state.duplicates);
        // Seeds that the device cannot tell apart and the host can are for the host.
        self.merged = self.duplicates > 0
            && self.place == Place::Set
            && coincident::find(&self.seeds).len() as u64 != self.duplicates;
        Ok(true)
    }

    /// What came of the facets' first cells. `false` if the host found some of them.
    pub(super) fn take_first_cells(&mut self, state: &State) -> Result<bool, RvdError> {
        self.started = true;
        self.guessed = true;
        if state.unproved == 0 {
            return Ok(true);
        }
        self.host_searches += 1;
        self.host.fresh = false;
        self.view()?;
        let HostCopy { index, first, .. } = &mut self.host;
        let surface = &self.surface;
        self.roots.par_iter_mut().filter(|root| root[1] == NONE).for_each(|root| {
            root[1] = index.nearest(surface.centroid(root[0]));
        });
        for root in &self.roots {
            first[root[0] as usize] = root[1];
        }
        self.upload_roots()?;
        Ok(false)
    }

    /// Rows and first cells by the host's tree, and onto the device with them.
    fn search_on_host(&mut self, far: bool, token: &Token) -> Result<(), RvdError> {
        self.host_searches += 1;
        self.fetch_records()?;
        let seeds = &self.seeds;
        let host = &mut self.host;
        host.far = far;
        host.seen.clear();
        match self.place {
            // Where floats do not reach, the host decides, so it takes what it was given.
            Place::Set if far => host.seen.extend_from_slice(&self.seeds),
            _ => host.seen.extend(host.records.iter().map(|r| DVec3::from_array(r.position()))),
        }
        host.index = SeedIndex::new(&host.seen);
        if !host.table.fill(&host.index, self.capacities.neighbours, Threads::Pool, &|| token.is_stopped()) {
            return Err(RvdError::Stopped(Stopped::Cancelled));
        }
        self.duplicates = host.index.duplicates() as u64;
        self.merged = !far
            && self.duplicates > 0
            && self.place == Place::Set
            && coincident::find(seeds).len() as u64 != self.duplicates;
        let rows: Vec<NeighbourRow> = (0..host.seen.len() as u32)
            .into_par_iter()
            .map(|i| {
                let (seeds, complete) = host.table.row(i);
                let mut row = NeighbourRow { seeds: seeds.to_vec(), complete };
                if !far {
                    in_device_order(i, &host.records, &mut row);
                }
                row
            })
            .collect();
        host.packed.clear();
        for (record, row) in host.records.iter_mut().zip(&rows) {
            record.row_begin = host.packed.len() as u32;
            record.row_length = row.seeds.len() as u32 | if row.complete { COMPLETE } else { 0 };
            host.packed.extend_from_slice(&row.seeds);
        }
        host.packed_end = host.packed.len();
        if far {
            let radius = fixed::covering_radius(&host.seen);
            self.scales = fixed::Scales::new(self.mass, self.surface.area(), radius);
        }
        let facets = self.facets.len() as u32;
        let mut starts = std::mem::take(&mut self.host.starts);
        self.host.first.clear();
        self.host.first.extend_from_slice(starts.find(self.diagram(), 0..facets, token));
        self.host.starts = starts;
        for root in &mut self.roots {
            root[1] = self.host.first[root[0] as usize];
        }
        self.rows = Rows::Host;
        self.started = true;
        self.host.fresh = true;
        if self.host.packed.len() as u64 > self.counts.table {
            let end = self.host.packed.len() as u64;
            self.counts.table = (end * 3 / 2).min(Limits::of(&self.device.limits()).seen_bytes() / 4).max(end);
            return self.release();
        }
        let device = Arc::clone(&self.device);
        self.on_device()?;
        if let Some(there) = &self.on_device {
            buffers::write(&device, &there.buffers.seeds, 0, &self.host.records)?;
            buffers::write(&device, &there.buffers.table, 0, &self.host.packed)?;
        }
        self.upload_roots()
    }

    /// The records as they are on the device.
    fn fetch_records(&mut self) -> Result<(), RvdError> {
        let (device, n) = (Arc::clone(&self.device), self.count);
        let b = &self.on_device()?.buffers;
        self.host.records = b.staging.read(&device, &b.seeds, 0..n)?;
        Ok(())
    }

    /// Brings what the host knows of the device's seeds, rows and first cells up to date: for pairs
    /// that the device could not end.
    pub(super) fn view(&mut self) -> Result<(), RvdError> {
        if self.host.fresh {
            return Ok(());
        }
        self.fetch_records()?;
        self.download_roots()?;
        let host = &mut self.host;
        host.first.clear();
        host.first.resize(self.facets.len(), 0);
        for root in &self.roots {
            host.first[root[0] as usize] = root[1];
        }
        host.seen.clear();
        host.seen.extend(host.records.iter().map(|r| DVec3::from_array(r.position())));
        host.index = SeedIndex::new(&host.seen);
        host.table.clear();
        let end = |r: &layout::Seed| (r.row_begin + (r.row_length & INDEX)) as usize;
        let by_device = if self.rows == Rows::Device { self.count * STRIDE as usize } else { 0 };
        host.packed_end = host.records.iter().map(end).max().unwrap_or(0).max(by_device);
        host.fresh = true;
        Ok(())
    }
}
