//! The reference: f64, one thread, written to be read.
//!
//! Purpose: what the other backends are judged by. It takes one facet after the other, walks its
//! cells and adds each piece to its cell's sums, and nothing else.
//! Invariant: a cell's sums are added in the order of the facets. Must not know: batches, threads.

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use super::clip::Clipper;
use super::incident::{Diagram, FacetWalker};
use super::on_host::OnHost;
use super::{
    Backend, BackendKind, CellSums, PassStats, PieceBatch, RvdError, Session, SessionOptions, Surface, elapsed_ms,
    refill, take_seeds,
};
use crate::knn::{Lifted, NeighbourTable, Point, SeedIndex, Threads};
use crate::token::Token;

/// The f64 reference, one thread.
#[derive(Clone, Copy, Debug, Default)]
pub struct Serial;

impl Backend for Serial {
    fn kind(&self) -> BackendKind {
        BackendKind::Serial
    }

    fn threads(&self) -> usize {
        1
    }

    fn pool(&self) -> Option<Arc<rayon::ThreadPool>> {
        // One for each caller: two that share a thread would wait for each other. Without one, the caller's does the work.
        let name = |_| "tessera-serial".to_owned();
        rayon::ThreadPoolBuilder::new().num_threads(1).thread_name(name).build().ok().map(Arc::new)
    }

    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        Ok(SerialSession::open(surface, options))
    }

    fn lifted_session(
        &self,
        surface: Arc<Surface<Lifted>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Lifted>>, RvdError> {
        Ok(SerialSession::open(surface, options))
    }
}

impl<P: Point> SerialSession<P> {
    fn open(surface: Arc<Surface<P>>, options: SessionOptions) -> Box<dyn Session<P>> {
        let session = Self {
            surface,
            options,
            seeds: Vec::new(),
            index: SeedIndex::with_threads(&[], Threads::One),
            table: NeighbourTable::default(),
            walker: FacetWalker::default(),
            stale: false,
        };
        Box::new(OnHost::new(session, None))
    }
}

struct SerialSession<P: Point> {
    surface: Arc<Surface<P>>,
    options: SessionOptions,
    seeds: Vec<P>,
    index: SeedIndex<P>,
    table: NeighbourTable,
    walker: FacetWalker<P>,
    /// The index and the table are not those of `seeds` yet.
    stale: bool,
}

/// Facets between two looks at the token.
const BATCH: usize = 128;

impl<P: Point> SerialSession<P> {
    /// Builds the index and the table of new seeds. Returns the milliseconds spent.
    fn refresh(&mut self, token: &Token) -> Result<f64, RvdError> {
        if !self.stale {
            return if self.seeds.is_empty() { Err(RvdError::NoSeeds) } else { Ok(0.0) };
        }
        let begin = Instant::now();
        self.index = SeedIndex::with_threads(&self.seeds, Threads::One);
        let neighbours = self.options.capacities.neighbours;
        if !self.table.fill(&self.index, neighbours, Threads::One, &|| token.is_stopped()) {
            token.check()?;
        }
        self.walker.reset(token);
        self.stale = false;
        Ok(elapsed_ms(begin))
    }

    /// Walks the facets in `range`; the nearest seed of each is found first.
    fn walk(
        &mut self,
        range: Range<u32>,
        wanted: impl Fn(&Surface<P>, usize) -> bool,
        token: &Token,
        mut visit: impl FnMut(u32, u32, P, &Clipper<P>),
    ) -> Result<PassStats, RvdError> {
        let mut stats = PassStats { neighbours_ms: self.refresh(token)?, ..PassStats::default() };
        stats.duplicate_seeds = self.index.duplicates() as u64;
        let Self { surface, options, seeds, index, table, .. } = self;
        let diagram = Diagram { surface, seeds, index, table, capacities: options.capacities };
        let mut starts = Vec::with_capacity(BATCH);
        for first in range.clone().step_by(BATCH) {
            token.check()?;
            let batch = first..range.end.min(first + BATCH as u32);
            let begin = Instant::now();
            refill(&mut starts, batch.clone().map(|f| index.nearest(surface.centroid(f))));
            stats.start_ms += elapsed_ms(begin);
            let begin = Instant::now();
            for facet in batch.clone().filter(|&f| wanted(surface, f as usize)) {
                let start = starts[(facet - first) as usize];
                self.walker.walk(None, diagram, facet, start, &mut stats, |i, clipper| {
                    visit(facet, i, diagram.seeds[i as usize], clipper);
                });
            }
            stats.clip_ms += elapsed_ms(begin);
        }
        Ok(stats)
    }
}

impl<P: Point> Session<P> for SerialSession<P> {
    fn set_seeds(&mut self, seeds: &[P]) -> Result<(), RvdError> {
        take_seeds(seeds, self.options.max_seeds, &mut self.seeds)?;
        self.stale = true;
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums<P>, token: &Token) -> Result<PassStats, RvdError> {
        out.reset(self.seeds.len());
        let facets = 0..self.surface.facets().len() as u32;
        self.walk(facets, |s, f| !s.skips(f), token, |_, i, _, clipper| out.add(i as usize, &clipper.integrals()))
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        out.clear();
        let flat = self.options.flat_pieces;
        let wanted = |s: &Surface<P>, f: usize| if flat { s.joins(f) } else { !s.skips(f) };
        let stats = self.walk(facets, wanted, token, |facet, i, origin, clipper| {
            out.push(facet, i, clipper.polygon().iter().map(|v| ((origin + v.p).place(), v.w, v.edge)));
        })?;
        out.sort();
        Ok(stats)
    }
}
