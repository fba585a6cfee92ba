//! Double precision on all cores.
//!
//! Purpose: the fast CPU backend. Sums are taken of all cells of a facet at once (`facets`), from lists (`builder`) that
//! serve several passes (`lists`) but for a few seeds (`escaped seeds`), and by [`super::serial`]'s walk where that does not
//! suffice; pieces by the walk alone.
//! Invariant: the diagram of [`super::serial`], pieces to the bit and sums to rounding; and the same bits whatever the
//! number of threads and whatever passes came before: facets are taken in one order (`order`), blocks of it, whose size
//! depends on the counts of facets and seeds alone, are added up for themselves, and every cell adds those sums up in
//! that order. Must not know: iterations.

mod candidates;
mod divide;
mod order;
mod schedule;
mod windowed;

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use rayon::prelude::*;

use self::candidates::verlet::VerletLists;
use self::schedule::chunk::{self, Chunk, Task, Walkers};
use super::incident::{Diagram, Starts};
use super::on_host::OnHost;
use super::{
    Backend, BackendKind, CellSums, PassStats, PieceBatch, RvdError, Session, SessionOptions, Surface, elapsed_ms,
    take_seeds,
};
use crate::knn::{Lifted, NeighbourTable, Point, SeedIndex, Threads};
use crate::token::Token;
use order::Order;

/// The backend in double precision on all threads of its own rayon pool.
#[derive(Clone, Debug)]
pub struct Parallel {
    pool: Arc<rayon::ThreadPool>,
}

impl Parallel {
    /// A pool of `threads` threads, or one a core with `None`.
    pub fn new(threads: Option<usize>) -> Result<Self, RvdError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads.unwrap_or(0))
            .thread_name(|i| format!("tessera-cpu-{i}"))
            .build()
            .map_err(|e| RvdError::Internal(format!("no thread pool: {e}")))?;
        Ok(Self { pool: Arc::new(pool) })
    }

    /// On a pool that is there already.
    pub fn on(pool: Arc<rayon::ThreadPool>) -> Self {
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

    fn pool(&self) -> Option<Arc<rayon::ThreadPool>> {
        Some(Arc::clone(&self.pool))
    }

    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        Ok(ParallelSession::open(&self.pool, surface, options))
    }

    fn lifted_session(
        &self,
        surface: Arc<Surface<Lifted>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Lifted>>, RvdError> {
        Ok(ParallelSession::open(&self.pool, surface, options))
    }
}

impl<P: Point> ParallelSession<P> {
    fn open(pool: &Arc<rayon::ThreadPool>, surface: Arc<Surface<P>>, options: SessionOptions) -> Box<dyn Session<P>> {
        Box::new(OnHost::new(Self::new(pool, surface, options), Some(Arc::clone(pool))))
    }

    fn new(pool: &Arc<rayon::ThreadPool>, surface: Arc<Surface<P>>, options: SessionOptions) -> Self {
        Self {
            pool: Arc::clone(pool),
            of: surface.facets().len(),
            surface,
            options,
            seeds: Vec::new(),
            index: SeedIndex::new(&[]),
            table: NeighbourTable::default(),
            stale: false,
            no_rows: true,
            by_rows: 0,
            order: Order::default(),
            starts: Starts::default(),
            lists: VerletLists::default(),
            no_table: NeighbourTable::default(),
            chunks: Vec::new(),
            walkers: (0..pool.current_num_threads()).map(|_| Mutex::default()).collect(),
        }
    }
}

/// Facets that are added up together, at most: so few cells that their sums stay at hand, and most of a cell's pieces.
const BLOCK: usize = 256;
/// Pairs that a block should have, so that coarse meshes with many seeds are shared out too.
const BLOCK_PAIRS: usize = 2048;
/// Blocks per task, at most: enough that facets with as many members fill the lanes of a register.
const BLOCKS: usize = 8;
/// Tasks that each thread should have, so that none waits long for the last.
const SHARES: usize = 8;
/// Seeds per facet from which on facets are divided and walked by rows of neighbours instead of Verlet lists.
const MANY: usize = 8;
/// Passes by rows after lists without rows failed.
const LATER: usize = 8;
/// Tasks between two additions, which bounds the memory of the integrals written down.
const WAVE: usize = 128;

/// Facets by the block, which sums depend on, and blocks by the task, which they do not.
#[derive(Clone, Copy)]
struct Blocks {
    facets: usize,
    a_chunk: usize,
}

/// Where a pass finds the seeds that count on facets.
#[derive(Clone, Copy, PartialEq)]
enum From {
    /// In Verlet lists.
    Lists,
    /// By searches around groups of adjacent facets, where the seeds are now.
    Index,
    /// By searches around groups of adjacent facets, where the seeds are expected to be.
    Ahead,
    /// In rows of neighbours. Facets with many cells are walked by the rows too.
    Rows { coarse: bool },
}

/// Facets of a block, for the counts of seeds and of all facets.
fn block_of(seeds: usize, facets: usize) -> usize {
    // A facet meets its share of the cells and some more at its rim.
    let per_facet = 3 + 2 * seeds / facets.max(1);
    (BLOCK_PAIRS / per_facet).clamp(1, BLOCK)
}

/// What facets did that were added up.
struct Added {
    stats: PassStats,
    /// Facets without a list that holds.
    unlisted: u64,
}

struct ParallelSession<P: Point> {
    pool: Arc<rayon::ThreadPool>,
    /// The whole surface, or the window of it that is there.
    surface: Arc<Surface<P>>,
    /// Facets of the whole.
    of: usize,
    options: SessionOptions,
    seeds: Vec<P>,
    index: SeedIndex<P>,
    table: NeighbourTable,
    /// Whether the index is out of date with `seeds`.
    stale: bool,
    /// Whether the table is out of date with the index.
    no_rows: bool,
    /// Passes left that use rows, since lists without rows failed.
    by_rows: usize,
    order: Order<P>,
    /// First cells of the facets whose pieces were asked for.
    starts: Starts,
    lists: VerletLists<P>,
    /// Stands for the table where that is stale.
    no_table: NeighbourTable,
    chunks: Vec<Chunk<P>>,
    /// One for each thread of the pool.
    walkers: Vec<Mutex<Walkers<P>>>,
}

/// Scratch memory that no other thread uses now.
fn of_this_thread<P: Point>(walkers: &[Mutex<Walkers<P>>]) -> MutexGuard<'_, Walkers<P>> {
    let own = rayon::current_thread_index().unwrap_or_default() % walkers.len();
    // A pass that panics gives no sums.
    walkers[own].lock().unwrap_or_else(PoisonError::into_inner)
}

impl<P: Point> ParallelSession<P> {
    /// Builds the index of new seeds. Returns the milliseconds spent.
    fn refresh(&mut self) -> Result<f64, RvdError> {
        if !self.stale {
            return if self.seeds.is_empty() { Err(RvdError::NoSeeds) } else { Ok(0.0) };
        }
        let begin = Instant::now();
        self.lists.indexed = false;
        self.index = SeedIndex::with_threads(&self.seeds, Threads::Pool);
        (self.stale, self.no_rows) = (false, true);
        Ok(elapsed_ms(begin))
    }

    /// Builds the index of where seeds are expected to go, not of where they are. Returns whether lists can be made about it.
    fn look_ahead(&mut self, area: f64) -> bool {
        let Some(places) = self.lists.look_ahead(&self.seeds, area) else { return false };
        self.index = SeedIndex::with_threads(places, Threads::Pool);
        self.no_rows = true;
        let ahead = self.lists.check(&self.seeds, &self.index);
        if !ahead {
            self.lists.be_blind(LATER);
        }
        ahead
    }

    /// The same and the table.
    fn refresh_rows(&mut self, token: &Token) -> Result<f64, RvdError> {
        let index_ms = self.refresh()?;
        if !self.no_rows {
            return Ok(index_ms);
        }
        let begin = Instant::now();
        let neighbours = self.options.capacities.neighbours;
        if !self.table.fill(&self.index, neighbours, Threads::Pool, &|| token.is_stopped()) {
            token.check()?;
        }
        self.no_rows = false;
        Ok(index_ms + elapsed_ms(begin))
    }

    /// Sums of all facets, from the lists if they still hold, or else from new ones.
    fn sum_up(&mut self, out: &mut CellSums<P>, token: &Token) -> Result<PassStats, RvdError> {
        self.order.begin(&self.surface);
        let blocks = self.blocks(self.order.len());
        // Where facets have many cells, the walk does most of the work, and it needs rows.
        let coarse = self.seeds.len() > MANY * self.of;
        let listed = self.stale && !self.seeds.is_empty() && !coarse;
        if listed
            && self.lists.hold(&self.seeds, blocks.facets * blocks.a_chunk)
            && let Some(stats) = self.pass(out, From::Lists, token)?
        {
            return Ok(stats);
        }
        let area = self.surface.area() / self.seeds.len().max(1) as f64;
        let mut stats = PassStats::default();
        if listed && self.by_rows == 0 && self.index.is_even() {
            let begin = Instant::now();
            let ahead = self.look_ahead(area);
            stats.neighbours_ms += elapsed_ms(begin);
            if ahead {
                if let Some(pass) = self.pass(out, From::Ahead, token)? {
                    stats.add(&pass);
                    return Ok(stats);
                }
                self.lists.be_blind(LATER);
            }
        }
        stats.neighbours_ms += self.refresh()?;
        stats.duplicate_seeds = self.index.duplicates() as u64;
        if !coarse && self.by_rows == 0 && self.index.is_even() {
            let begin = Instant::now();
            self.lists.choose_evenly(&self.seeds, &self.index, area);
            stats.neighbours_ms += elapsed_ms(begin);
            if let Some(pass) = self.pass(out, From::Index, token)? {
                stats.add(&pass);
                return Ok(stats);
            }
            self.by_rows = LATER;
        }
        self.by_rows = self.by_rows.saturating_sub(1);
        stats.neighbours_ms += self.refresh_rows(token)?;
        match coarse {
            true => self.lists.leave(),
            false => self.lists.choose(&self.seeds, &self.table),
        }
        stats.add(&self.pass(out, From::Rows { coarse }, token)?.unwrap_or_default());
        Ok(stats)
    }

    /// Sums of all facets; `None` if those lists do not do.
    fn pass(&mut self, out: &mut CellSums<P>, from: From, token: &Token) -> Result<Option<PassStats>, RvdError> {
        out.reset(self.seeds.len());
        let added = self.add_facets(out, from, token)?;
        if let Some(stats) = &added {
            // Seeds move from pass to pass, and lists are made for where they go.
            self.lists.end_pass(&self.seeds, &out.area, from != From::Lists && stats.unlisted == 0);
        }
        Ok(added.map(|added| added.stats))
    }

    /// Adds the sums of all facets that are there.
    fn add_facets(&mut self, out: &mut CellSums<P>, from: From, token: &Token) -> Result<Option<Added>, RvdError> {
        self.reset_walkers(token);
        let mut stats = PassStats::default();
        let Blocks { facets: block, a_chunk } = self.blocks(self.order.len());
        let size = block * a_chunk;
        let tasks = self.order.len().div_ceil(size);
        self.chunks.resize_with(WAVE.min(tasks), Chunk::default);
        let table = if matches!(from, From::Rows { .. }) { &self.table } else { &self.no_table };
        let Self { surface, options, seeds, index, .. } = self;
        let diagram = Diagram { surface, seeds, index, table, capacities: options.capacities };
        let begin = Instant::now();
        let (facets, starts) = self.order.guesses(diagram, from != From::Lists, token);
        token.check()?;
        stats.start_ms = elapsed_ms(begin);
        let (verlet, lists) = self.lists.split(tasks, size);
        let rows = if verlet.even { &self.no_table } else { &self.table };
        let about = (from == From::Ahead).then_some(verlet.made_at);
        let task = Task {
            diagram,
            about,
            skin: verlet.skin,
            by_rows: from == From::Rows { coarse: true },
            even: matches!(from, From::Index | From::Ahead),
            block,
        };
        let mut unlisted = 0;
        let void = AtomicBool::new(false);
        let waves = lists.chunks_mut(WAVE).zip(facets.chunks(size * WAVE)).zip(starts.chunks_mut(size * WAVE));
        for ((lists, facets), starts) in waves {
            token.check()?;
            let begin = Instant::now();
            let chunks = &mut self.chunks[..lists.len()];
            let each = chunks.par_iter_mut().zip(lists).zip(facets.par_chunks(size)).zip(starts.par_chunks_mut(size));
            // Tasks differ; one by one, so that no thread waits while another has several left.
            each.with_max_len(1).for_each(|(((chunk, lists), facets), starts)| {
                if token.is_stopped() || void.load(Relaxed) {
                    return;
                }
                let walkers = &mut *of_this_thread(&self.walkers);
                let done = match from {
                    From::Lists => {
                        chunk.sum_from_lists(walkers, task.listed(facets, starts, lists), (verlet, rows), block)
                    }
                    _ => chunk.sum(walkers, task, (facets, starts), lists),
                };
                if !done {
                    void.store(true, Relaxed);
                }
            });
            token.check()?;
            if void.load(Relaxed) {
                return Ok(None);
            }
            stats.clip_ms += elapsed_ms(begin);
            let begin = Instant::now();
            for chunk in &*chunks {
                stats.add(&chunk.stats);
                unlisted += chunk.unlisted;
            }
            chunk::add_up(out, chunks);
            stats.update_ms += elapsed_ms(begin);
        }
        Ok(Some(Added { stats, unlisted }))
    }

    /// Pieces of `facets`, of flat ones too if they are asked for.
    fn cut(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        let mut stats = PassStats { neighbours_ms: self.refresh_rows(token)?, ..PassStats::default() };
        self.reset_walkers(token);
        stats.duplicate_seeds = self.index.duplicates() as u64;
        let begin = Instant::now();
        let Blocks { facets: block, a_chunk } = self.blocks(facets.len());
        let size = block * a_chunk;
        let Self { surface, options, seeds, index, table, .. } = self;
        let diagram = Diagram { surface, seeds, index, table, capacities: options.capacities };
        let starts = self.starts.find(diagram, facets.clone(), token);
        token.check()?;
        stats.start_ms = elapsed_ms(begin);
        let flat = self.options.flat_pieces;
        self.chunks.resize_with(WAVE.min(facets.len().div_ceil(size)), Chunk::default);
        for (w, starts) in starts.chunks(size * WAVE).enumerate() {
            token.check()?;
            let begin = Instant::now();
            let chunks = &mut self.chunks[..starts.len().div_ceil(size)];
            let each = chunks.par_iter_mut().zip(starts.par_chunks(size)).enumerate();
            each.with_max_len(1).for_each(|(c, (chunk, starts))| {
                if !token.is_stopped() {
                    let walkers = &mut *of_this_thread(&self.walkers);
                    let first = facets.start + ((w * WAVE + c) * size) as u32;
                    chunk.cut(walkers, diagram, first, starts, flat);
                }
            });
            token.check()?;
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

    /// Forgets what scratch memory has of other seeds.
    fn reset_walkers(&mut self, token: &Token) {
        for walkers in &mut self.walkers {
            // A panic left it as it was.
            if walkers.is_poisoned() {
                *walkers = Mutex::default();
            }
            walkers.get_mut().unwrap_or_else(PoisonError::into_inner).walker.reset(token);
        }
    }

    fn blocks(&self, facets: usize) -> Blocks {
        let block = block_of(self.seeds.len(), self.of);
        let share = facets / (rayon::current_num_threads() * SHARES);
        Blocks { facets: block, a_chunk: (share / block).clamp(1, BLOCKS) }
    }
}

impl<P: Point> Session<P> for ParallelSession<P> {
    fn set_seeds(&mut self, seeds: &[P]) -> Result<(), RvdError> {
        take_seeds(seeds, self.options.max_seeds, &mut self.seeds)?;
        self.stale = true;
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums<P>, token: &Token) -> Result<PassStats, RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.sum_up(out, token))
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        out.clear();
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.cut(facets, out, token))
    }
}
