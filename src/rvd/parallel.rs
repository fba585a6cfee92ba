//! f64 on all cores.
//!
//! Purpose: the fast CPU backend. Sums are taken of all cells of a facet at once (`facet`), and by
//! [`super::serial`]'s walk where that does not suffice; pieces by the walk alone.
//! Invariant: the diagram of [`super::serial`], pieces to the bit and sums to rounding; and the same
//! bits whatever the number of threads: facets are cut into chunks of fixed size, each chunk writes its
//! pieces' integrals down in facet order, and every cell adds its own up in that order.
//! Must not know: iterations.

mod facet;
mod gather;

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use self::facet::FacetCells;
use super::clip::Integrals;
use super::incident::{Diagram, FacetWalker};
use super::on_host::OnHost;
use super::start::{self, Starts};
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
            chunks: Vec::new(),
        })))
    }
}

/// Facets per task, at most. Part of no result: sums are added facet by facet all the same.
const CHUNK: usize = 256;
/// Pairs that a task should have, so that coarse meshes with many seeds are shared out too.
const CHUNK_PAIRS: usize = 2048;
/// Tasks between two additions, which bounds the memory of the integrals written down.
const WAVE: usize = 512;

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
    chunks: Vec<Chunk>,
}

/// What one task found, in facet order. Reused from wave to wave.
#[derive(Default)]
struct Chunk {
    integrals: Vec<(u32, Integrals)>,
    pieces: PieceBatch,
    stats: PassStats,
}

/// What a task writes down.
#[derive(Clone, Copy, PartialEq)]
enum Wanted {
    Integrals,
    Pieces,
    /// Of facets without area too.
    FlatPieces,
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

    /// Runs all tasks of `facets`, wave by wave; `merge` gets each wave's chunks in order.
    fn waves(
        &mut self,
        facets: Range<u32>,
        wanted: Wanted,
        cancel: &CancelFlag,
        mut merge: impl FnMut(&[Chunk]) + Send,
    ) -> Result<PassStats, RvdError> {
        let mut stats = PassStats { neighbours_ms: self.refresh(cancel)?, ..PassStats::default() };
        stats.duplicate_seeds = self.index.duplicates() as u64;
        let begin = Instant::now();
        let diagram = Diagram { surface: &self.surface, seeds: &self.seeds, index: &self.index, table: &self.table };
        let starts = match wanted {
            Wanted::Integrals => self.starts.guesses(diagram, facets.clone()),
            Wanted::Pieces | Wanted::FlatPieces => self.starts.find(diagram, facets.clone()),
        };
        stats.start_ms = elapsed_ms(begin);
        let capacities = self.capacities;
        // A facet meets its share of the cells and some more at its rim.
        let per_facet = 3 + 2 * self.seeds.len() / self.surface.facets().len();
        let size = (CHUNK_PAIRS / per_facet).clamp(1, CHUNK);
        self.chunks.resize_with(WAVE.min(facets.len().div_ceil(size)), Chunk::default);
        for wave in facets.clone().step_by(size * WAVE) {
            cancel.check()?;
            let begin = Instant::now();
            let tasks = ((facets.end - wave) as usize).div_ceil(size).min(WAVE);
            let of_wave = &mut starts[(wave - facets.start) as usize..];
            self.chunks[..tasks].par_iter_mut().zip(of_wave.par_chunks_mut(size)).enumerate().for_each_init(
                Walkers::default,
                |walkers, (c, (chunk, starts))| {
                    if cancel.is_cancelled() {
                        return;
                    }
                    let first = wave + (c * size) as u32;
                    let range = first..facets.end.min(first + size as u32);
                    chunk.fill(walkers, diagram, range, starts, capacities, wanted);
                },
            );
            cancel.check()?;
            stats.clip_ms += elapsed_ms(begin);
            let begin = Instant::now();
            for chunk in &self.chunks[..tasks] {
                stats.add(&chunk.stats);
            }
            merge(&self.chunks[..tasks]);
            stats.update_ms += elapsed_ms(begin);
        }
        Ok(stats)
    }
}

/// One thread's scratch memory.
#[derive(Default)]
struct Walkers {
    at_once: FacetCells,
    walker: FacetWalker,
}

impl Chunk {
    fn fill(
        &mut self,
        walkers: &mut Walkers,
        diagram: Diagram<'_>,
        facets: Range<u32>,
        starts: &mut [u32],
        capacities: Capacities,
        wanted: Wanted,
    ) {
        self.integrals.clear();
        self.pieces.clear();
        self.stats = PassStats::default();
        let Self { integrals, pieces, stats } = self;
        let Walkers { at_once, walker } = walkers;
        for (facet, start) in facets.zip(starts) {
            match wanted {
                Wanted::Integrals => {
                    if diagram.surface.skips(facet as usize) {
                        continue;
                    }
                    let before = integrals.len();
                    if let Some(nearest) = at_once.divide(diagram, facet, *start, |i, sum| integrals.push((i, sum))) {
                        *start = nearest;
                        stats.pairs += (integrals.len() - before) as u64;
                    } else {
                        *start = start::nearest(diagram, diagram.surface.centroid(facet), *start);
                        walker.walk(diagram, facet, *start, capacities, stats, |i, clipper| {
                            integrals.push((i, clipper.integrals()));
                        });
                    }
                }
                Wanted::Pieces | Wanted::FlatPieces => {
                    let flat = wanted == Wanted::FlatPieces;
                    if if flat { diagram.surface.joins(facet as usize) } else { !diagram.surface.skips(facet as usize) }
                    {
                        walker.walk(diagram, facet, *start, capacities, stats, |i, clipper| {
                            let origin = diagram.seeds[i as usize];
                            pieces.push(facet, i, clipper.polygon().iter().map(|v| (origin + v.p, v.w, v.edge)));
                        });
                    }
                }
            }
        }
        if wanted != Wanted::Integrals {
            self.pieces.sort();
        }
    }
}

/// Adds what the chunks wrote down. Every thread owns a range of seeds and reads everything, so
/// that each cell is added up in facet order without a lock.
fn add_up(out: &mut CellSums, chunks: &[Chunk]) {
    let share = out.mass.len().div_ceil(rayon::current_num_threads()).max(1);
    out.mass
        .par_chunks_mut(share)
        .zip(out.moment.par_chunks_mut(share))
        .zip(out.energy.par_chunks_mut(share).zip(out.area.par_chunks_mut(share)))
        .enumerate()
        .for_each(|(part, ((mass, moment), (energy, area)))| {
            let base = (part * share) as u32;
            for (seed, sum) in chunks.iter().flat_map(|c| &c.integrals) {
                let local = seed.wrapping_sub(base) as usize;
                if local < mass.len() {
                    mass[local] += sum.mass;
                    moment[local] += sum.moment;
                    energy[local] += sum.energy;
                    area[local] += sum.area;
                }
            }
        });
}

impl Session for ParallelSession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        take_seeds(seeds, self.max_seeds, &mut self.seeds)?;
        self.stale = true;
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        out.reset(self.seeds.len());
        let facets = 0..self.surface.facets().len() as u32;
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.waves(facets, Wanted::Integrals, cancel, |chunks| add_up(out, chunks)))
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        out.clear();
        let pool = Arc::clone(&self.pool);
        pool.install(|| {
            let wanted = if self.flat_pieces { Wanted::FlatPieces } else { Wanted::Pieces };
            self.waves(facets, wanted, cancel, |chunks| {
                for chunk in chunks {
                    out.extend(&chunk.pieces);
                }
            })
        })
    }
}
