//! The host's copy of the seeds, and its search.
//!
//! Purpose: where the device cannot prove rows or first cells, or a pair needs a longer row, the host finds them with its tree.
//! Invariant: rows are in the device's order, unless seeds are farther than floats reach. Must not know: clipping.

use rayon::prelude::*;

use super::{Neighbours, Place, Result, Rows};
use crate::buffers::write;
use crate::diagram::layout::{COMPLETE, INDEX, NONE, STRIDE};
use crate::diagram::memory::Memory;
use crate::diagram::space::{DeviceSpace, SeedRecord};
pub(super) use geometry::knn::{NeighbourRow, NeighbourTable, SeedIndex, Threads};
use geometry::rvd::RvdError;
use geometry::rvd::incident::{Diagram, Starts};
use geometry::token::{Stopped, Token};

/// The longest row that is sent to the device.
pub(crate) const LONGEST_ROW: u32 = 4096;

/// Seeds nearer to each other, unit frame, may have cells that single precision loses: the corners of a facet are a few roundings off, and
/// the cells of seeds at a hundred roundings have been lost.
const CLUMPED: f64 = 1.0 / 65536.0;

/// Neighbours among which the nearest is sought: one at the same distance as others is not in a shorter row.
const NEAREST: usize = 8;

/// What the host knows of the seeds on the device. Of no use while not fresh, but for `starts`, which are guesses.
pub(crate) struct HostCopy<P: DeviceSpace> {
    /// It is of the present seeds.
    pub fresh: bool,
    /// The records as on the device, longer rows noted.
    pub records: Vec<P::Seed>,
    /// Positions. Those that the device sees, unless seeds are far.
    pub seen: Vec<P>,
    pub index: SeedIndex<P>,
    /// Rows of the host's search; without rows if the device made them.
    pub table: NeighbourTable,
    /// The device's table, if the host made it.
    pub packed: Vec<u32>,
    /// Entries of the device's table in use.
    pub packed_end: usize,
    /// First cell of every facet.
    pub first: Vec<u32>,
    pub starts: Starts,
}

impl<P: DeviceSpace> Default for HostCopy<P> {
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
            starts: Starts::default(),
        }
    }
}

/// The word of a record that says how long its row is.
fn length_of(row: &NeighbourRow) -> u32 {
    row.seeds.len() as u32 | if row.complete { COMPLETE } else { 0 }
}

/// Puts a row of the tree into the device's order. The end of a row that is not complete goes, as far as
/// a seed that is not in it might come before it in that order: a key is good to 4e-7 of itself.
pub(super) fn in_device_order(i: u32, records: &[impl SeedRecord], row: &mut NeighbourRow) {
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

impl<P: DeviceSpace> Neighbours<P> {
    /// For the pairs that the host does; [`Self::view`] comes before.
    pub(crate) fn diagram(&self) -> Diagram<'_, P> {
        let HostCopy { seen, index, table, .. } = &self.host;
        Diagram { surface: &self.cx.surface, seeds: seen, index, table, capacities: self.cx.capacities }
    }

    /// Rows and first cells by the host's tree. Whether the table has room for them; if so, they are to be uploaded.
    /// `far`: seeds are farther than floats reach.
    pub(crate) fn search_on_host(&mut self, memory: &mut Memory<P>, far: bool, token: &Token) -> Result<bool> {
        self.host_searches += 1;
        self.host.records = match self.place {
            Place::Set => self.records(),
            _ => memory.read(|b| &b.seeds, 0..self.count)?,
        };
        let seeds = &self.seeds;
        let host = &mut self.host;
        host.seen.clear();
        match self.place {
            // Where floats do not reach, the host decides, so it takes what it was given.
            Place::Set if far => host.seen.extend_from_slice(&self.seeds),
            _ => host.seen.extend(host.records.iter().map(P::of_record)),
        }
        host.index = SeedIndex::new(&host.seen);
        if !host.table.fill(&host.index, self.cx.capacities.neighbours, Threads::Pool, &|| token.is_stopped()) {
            return Err(RvdError::Stopped(Stopped::Cancelled));
        }
        self.duplicates = host.index.duplicates() as u64;
        self.merged = !far
            && self.duplicates > 0
            && self.place == Place::Set
            && P::coincident(seeds).len() as u64 != self.duplicates;
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
            record.set_row(host.packed.len() as u32, length_of(row));
            host.packed.extend_from_slice(&row.seeds);
        }
        host.packed_end = host.packed.len();
        let facets = memory.facets.len() as u32;
        let mut starts = std::mem::take(&mut self.host.starts);
        self.host.first.clear();
        self.host.first.extend_from_slice(starts.find(self.diagram(), 0..facets, token));
        self.host.starts = starts;
        for root in &mut self.roots {
            root[1] = self.host.first[root[0] as usize];
        }
        self.rows = Rows::Host { far };
        self.first_cells.known = true;
        self.host.fresh = true;
        Ok(memory.has_room(self.host.packed.len() as u64))
    }

    pub(crate) fn upload_rows(&self, memory: &Memory<P>) -> Result<()> {
        let buffers = &memory.there()?.buffers;
        write(&self.cx.device, &buffers.seeds, 0, &self.host.records)?;
        Ok(write(&self.cx.device, &buffers.table, 0, &self.host.packed)?)
    }

    /// Nearest seeds of facets whose first cell the device could not prove.
    pub(crate) fn find_unproved(&mut self, memory: &Memory<P>) -> Result<()> {
        self.host_searches += 1;
        self.host.fresh = false;
        self.view(memory)?;
        let HostCopy { index, first, .. } = &mut self.host;
        let surface = &self.cx.surface;
        self.roots.par_iter_mut().filter(|root| root[1] == NONE).for_each(|root| {
            root[1] = index.nearest(surface.centroid(root[0]));
        });
        for root in &self.roots {
            first[root[0] as usize] = root[1];
        }
        self.upload_roots(memory)
    }

    /// Brings what the host knows of the device's seeds, rows and first cells up to date: for pairs
    /// that the device could not end.
    pub(crate) fn view(&mut self, memory: &Memory<P>) -> Result<()> {
        if self.host.fresh {
            return Ok(());
        }
        self.host.records = memory.read(|b| &b.seeds, 0..self.count)?;
        self.download_roots(memory)?;
        let host = &mut self.host;
        host.first.clear();
        host.first.resize(memory.facets.len(), 0);
        for root in &self.roots {
            host.first[root[0] as usize] = root[1];
        }
        host.seen.clear();
        host.seen.extend(host.records.iter().map(P::of_record));
        host.index = SeedIndex::new(&host.seen);
        host.table.clear();
        let end = |r: &P::Seed| {
            let (begin, length) = r.row();
            (begin + (length & INDEX)) as usize
        };
        let by_device = if self.rows == Rows::Device { self.count * STRIDE as usize } else { 0 };
        host.packed_end = host.records.iter().map(end).max().unwrap_or(0).max(by_device);
        host.fresh = true;
        Ok(())
    }

    /// Whether one of these seeds is nearer to another than [`CLUMPED`], and not in its place; [`Self::view`] comes before.
    pub(crate) fn any_clumped(&self, seeds: &[u32]) -> bool {
        let HostCopy { seen, index, .. } = &self.host;
        let is_clumped = |row: &mut NeighbourRow, &i: &u32| {
            index.row(i, NEAREST, row);
            row.seeds.iter().any(|&j| {
                let apart = (seen[i as usize] - seen[j as usize]).length();
                apart > 0.0 && apart < CLUMPED
            })
        };
        seeds.par_iter().map_init(NeighbourRow::default, is_clumped).any(|is_clumped| is_clumped)
    }

    /// The length of a row that is to be longer.
    pub(crate) fn longer(&self, seed: u32) -> u32 {
        (self.host.records[seed as usize].row().1 & INDEX).max(1).saturating_mul(4).min(LONGEST_ROW)
    }

    /// Four times longer rows for `seeds`, behind the table. Whether the table has room for them.
    pub(crate) fn lengthen(&mut self, memory: &mut Memory<P>, seeds: &[u32]) -> Result<bool> {
        let HostCopy { index, records, .. } = &self.host;
        let far = self.rows == Rows::Host { far: true };
        let query = |&i: &u32| {
            let mut row = NeighbourRow::default();
            let known = (records[i as usize].row().1 & INDEX) as usize;
            // Rows stop short of ties, so the next length counts from what was asked for.
            let mut k = (known.max(1) * 4).min(LONGEST_ROW as usize);
            loop {
                index.row(i, k, &mut row);
                if !far {
                    in_device_order(i, records, &mut row);
                }
                if row.complete || row.seeds.len() > known {
                    return row;
                }
                // All of them at one distance: only a row that reaches past them says more.
                k *= 4;
            }
        };
        let rows: Vec<NeighbourRow> = seeds.par_iter().map(query).collect();
        let mut tail = Vec::new();
        for (&i, row) in seeds.iter().zip(&rows) {
            let record = &mut self.host.records[i as usize];
            record.set_row((self.host.packed_end + tail.len()) as u32, length_of(row));
            tail.extend_from_slice(&row.seeds);
        }
        let first = self.host.packed_end;
        self.host.packed_end += tail.len();
        if self.rows.are_of_host() {
            self.host.packed.extend_from_slice(&tail);
        }
        if !memory.has_room(self.host.packed_end as u64) {
            return Ok(false);
        }
        let buffers = &memory.there()?.buffers;
        write(&self.cx.device, &buffers.table, first, &tail)?;
        // One write costs as much as copying a few hundred records.
        if seeds.len() * 256 > self.host.records.len() {
            write(&self.cx.device, &buffers.seeds, 0, &self.host.records)?;
        } else {
            for &i in seeds {
                write(&self.cx.device, &buffers.seeds, i as usize, &[self.host.records[i as usize]])?;
            }
        }
        Ok(true)
    }
}
