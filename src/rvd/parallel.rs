//! f64 on all cores.
//!
//! Purpose: the fast CPU backend. Sums are taken of all cells of a facet at once (`facet`), from lists that
//! serve several passes (`lists`), and by [`super::serial`]'s walk where that does not suffice; pieces by the walk
//! alone.
//! Invariant: the diagram of [`super::serial`], pieces to the bit and sums to rounding; and the same
//! bits whatever the number of threads and whatever passes came before: facets are cut into chunks of fixed size, each chunk writes its
//! pieces' integrals down in facet order, and every cell adds its own up in that order.
//! Must not know: iterations.

mod chunk;
mod facets;
mod gather;
mod groups;
mod lanes;
mod lists;
mod moments;

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use self::chunk::{Chunk, Walkers};
use self::groups::Listed;
use self::lists::KeptLists;
use super::incident::Diagram;
use super::on_host::OnHost;
use super::start::Starts;
use super::{
    Backend, BackendKind, CancelFlag, Capacities, CellSums, PassStats, PieceBatch, RvdError, Session, SessionOptions,
    Surface, elapsed_ms, take_seeds,
};
use crate::knn::{NeighbourTable, SeedIndex, Threads};

/// f64, on all threads of its own rayon pool.
#[derive(Clone, Debug)]
pub struct Parallel {
    pool: Arc<rayon::ThreadPool>,
}

impl Parallel {
    /// A pool of `threads` threads, or one a core with `None`.
    ///
    /// # Errors
    /// `Internal` if the operating system refuses the threads.
    pub fn new(threads: Option<usize>) -> Result<Self, RvdError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads.unwrap_or(0))
            .thread_name(|i| format!("tessera-cpu-{i}"))
            .build()
            .map_err(|e| RvdError::Internal(format!("no thread pool: {e}")))?;
        Ok(Self { pool: Arc::new(pool) })
    }

    /// On a pool that is there already.
    pub(super) fn on(pool: Arc<rayon::ThreadPool>) -> Self {
        Self { pool }
    }
}

impl Backend for Parallel {
    fn kind(&self) -> BackendKind {
        BackendKind::Parallel
    }

    fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        Ok(Box::new(OnHost::new(ParallelSession {
            pool: Arc::clone(&self.pool),
            surface,
            max_seeds: options.max_seeds,
            flat_pieces: options.flat_pieces,
            capacities: options.capacities,
            seeds: Vec::new(),
            index: SeedIndex::new(&[]),
            table: NeighbourTable::default(),
            stale: false,
            starts: Starts::default(),
            lists: KeptLists::default(),
            no_table: NeighbourTable::default(),
            chunks: Vec::new(),
        })))
    }
}

/// Facets per task, at most: enough that those with as many members fill the lanes of a register. Part of no result:
/// sums are added facet by facet all the same.
const CHUNK: usize = 1024;
/// Pairs that a task should have, so that coarse meshes with many seeds are shared out too,
const CHUNK_PAIRS: usize = 8192;
/// and tasks that each thread should have, so that none waits long for the last.
const SHARES: usize = 8;
/// Seeds a facet, from which on facets are divided and walked by rows of neighbours instead of by lists that are kept.
const MANY: usize = 8;
/// Tasks between two additions, which bounds the memory of the integrals written down.
const WAVE: usize = 128;

struct ParallelSession {
    pool: Arc<rayon::ThreadPool>,
    surface: Arc<Surface>,
    max_seeds: usize,
    flat_pieces: bool,
    capacities: Capacities,
    seeds: Vec<DVec3>,
    index: SeedIndex,
    table: NeighbourTable,
    /// The index and the table are not those of `seeds` yet.
    stale: bool,
    starts: Starts,
    lists: KeptLists,
    /// Stands for the table where that is stale.
    no_table: NeighbourTable,
    chunks: Vec<Chunk>,
}

impl ParallelSession {
    /// Builds the index and the table of new seeds. Returns the milliseconds spent.
    fn refresh(&mut self, cancel: &CancelFlag) -> Result<f64, RvdError> {
        if !self.stale {
            return if self.seeds.is_empty() { Err(RvdError::NoSeeds) } else { Ok(0.0) };
        }
        let begin = Instant::now();
        self.index = SeedIndex::with_threads(&self.seeds, Threads::Pool);
        if !self.table.fill(&self.index, self.capacities.neighbours, Threads::Pool, &|| cancel.is_cancelled()) {
            return Err(RvdError::Cancelled);
        }
        self.stale = false;
        Ok(elapsed_ms(begin))
    }

    /// Sums of all facets, from the lists if they still hold, or else from new ones.
    fn sum_up(&mut self, out: &mut CellSums, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        let mut stats = PassStats::default();
        let by_rows = self.seeds.len() > MANY * self.surface.facets().len();
        let kept = self.stale && !self.seeds.is_empty() && self.lists.hold(&self.seeds);
        if !kept {
            stats.neighbours_ms = self.refresh(cancel)?;
            stats.duplicate_seeds = self.index.duplicates() as u64;
            // Where facets have many cells, the walk does most of the work, and it needs rows.
            self.lists.choose(&self.seeds, &self.table, by_rows);
        }
        let size = self.chunk_size();
        let facets = 0..self.surface.facets().len() as u32;
        let tasks = facets.len().div_ceil(size);
        self.chunks.resize_with(WAVE.min(tasks), Chunk::default);
        let table = if kept { &self.no_table } else { &self.table };
        let diagram = Diagram { surface: &self.surface, seeds: &self.seeds, index: &self.index, table };
        let begin = Instant::now();
        let starts = self.starts.guesses(diagram, facets.clone());
        stats.start_ms = elapsed_ms(begin);
        let (slack, lists) = self.lists.split(tasks);
        let capacities = self.capacities;
        let mut unlisted = 0;
        for (w, (lists, starts)) in lists.chunks_mut(WAVE).zip(starts.chunks_mut(size * WAVE)).enumerate() {
            cancel.check()?;
            let begin = Instant::now();
            let chunks = &mut self.chunks[..lists.len()];
            let each = chunks.par_iter_mut().zip(lists).zip(starts.par_chunks_mut(size)).enumerate();
            each.for_each_init(Walkers::default, |walkers, (c, ((chunk, lists), starts))| {
                if cancel.is_cancelled() {
                    return;
                }
                let first = ((w * WAVE + c) * size) as u32;
                if kept {
                    chunk.sum_listed(walkers, Listed { diagram, first, starts, lists, capacities, by_rows });
                } else {
                    chunk.sum(walkers, (diagram, slack, by_rows), first, lists, starts, capacities);
                }
            });
            cancel.check()?;
            stats.clip_ms += elapsed_ms(begin);
            let begin = Instant::now();
            for chunk in &*chunks {
                stats.add(&chunk.stats);
                unlisted += chunk.unlisted;
            }
            chunk::add_up(out, chunks);
            stats.update_ms += elapsed_ms(begin);
        }
        self.lists.end_pass(&self.seeds, !kept && unlisted == 0);
        Ok(stats)
    }

    /// Pieces of `facets`, of flat ones too if they are asked for.
    fn cut(&mut self, facets: Range<u32>, out: &mut PieceBatch, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        let mut stats = PassStats { neighbours_ms: self.refresh(cancel)?, ..PassStats::default() };
        stats.duplicate_seeds = self.index.duplicates() as u64;
        let begin = Instant::now();
        let diagram = Diagram { surface: &self.surface, seeds: &self.seeds, index: &self.index, table: &self.table };
        let size = self.chunk_size();
        let starts = self.starts.find(diagram, facets.clone());
        stats.start_ms = elapsed_ms(begin);
        let (capacities, flat) = (self.capacities, self.flat_pieces);
        self.chunks.resize_with(WAVE.min(facets.len().div_ceil(size)), Chunk::default);
        for (w, starts) in starts.chunks(size * WAVE).enumerate() {
            cancel.check()?;
            let begin = Instant::now();
            let chunks = &mut self.chunks[..starts.len().div_ceil(size)];
            let each = chunks.par_iter_mut().zip(starts.par_chunks(size)).enumerate();
            each.for_each_init(Walkers::default, |walkers, (c, (chunk, starts))| {
                if !cancel.is_cancelled() {
                    let first = facets.start + ((w * WAVE + c) * size) as u32;
                    chunk.cut(walkers, diagram, first, starts, capacities, flat);
                }
            });
            cancel.check()?;
            stats.clip_ms += elapsed_ms(begin);
            let begin = Instant::now();
            for chunk in &*chunks {
                stats.add(&chunk.stats);
                out.extend(&chunk.pieces);
            }
            stats.update_ms += elapsed_ms(begin);
        }
        Ok(stats)
    }

    /// Facets per task.
    fn chunk_size(&self) -> usize {
        // A facet meets its share of the cells and some more at its rim.
        let facets = self.surface.facets().len();
        let per_facet = 3 + 2 * self.seeds.len() / facets;
        let share = facets / (rayon::current_num_threads() * SHARES);
        (CHUNK_PAIRS / per_facet).min(share).clamp(1, CHUNK)
    }
}

impl Session for ParallelSession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        take_seeds(seeds, self.max_seeds, &mut self.seeds)?;
        self.stale = true;
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        out.reset(self.seeds.len());
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.sum_up(out, cancel))
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        out.clear();
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.cut(facets, out, cancel))
    }
}
