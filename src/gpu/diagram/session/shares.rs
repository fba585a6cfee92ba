//! A surface's facets shared out to several devices.
//!
//! Purpose: each device has all seeds, and does a range of the facets. The session on the first one has those on the others. It moves
//! the seeds, hands their records on before a pass, and adds what the others found to its own sums.
//! Invariant: every choice that shows in bits is by the whole surface and the seeds, and sums are integers of one scale. So the
//! bits do not depend on how many devices there are, nor on which of them does a facet.
//! Must not know: which devices there are.

use std::ops::Range;
use std::sync::Arc;
use std::thread::ScopedJoinHandle;

use glam::DVec3;

use super::{GpuSession, Result};
use crate::diagram::Gpu;
use crate::diagram::clip::fixed;
use crate::diagram::neighbours::Place;
use crate::diagram::space::DeviceSpace;
use geometry::rvd::{
    CellSums, DeviceWork, PassStats, PhasesMs, PieceBatch, Resident, RvdError, Session, SessionOptions, Surface,
};
use geometry::token::Token;

/// What a device found of its facets: sums of all cells, in units.
struct Share {
    words: Vec<u32>,
    scales: fixed::Scales,
    stats: PassStats,
}

impl<P: DeviceSpace> GpuSession<P> {
    /// Has this session do these facets alone. Before anything is allocated.
    fn take_share(&mut self, share: Range<u32>) {
        self.neighbours.roots.retain(|root| share.contains(&root[0]));
        self.memory.counts.facets = u64::from(share.end - share.start);
        self.memory.windows.take_share(share);
    }

    /// Brings the pairs of all facets to their end, on all devices at once, and adds them up.
    pub(super) fn run_shares(&mut self, token: &Token, stats: &mut PassStats) -> Result<()> {
        let records = match self.neighbours.place {
            // All have them.
            Place::Set => None,
            Place::Point | Place::Trial(_) => Some(self.seed_records(token)?),
        };
        let records = records.as_deref();
        let mut others = std::mem::take(&mut self.others);
        let (own, theirs) = std::thread::scope(|scope| {
            let refused = |error| RvdError::Internal(format!("no thread for a device: {error}"));
            let lost = |_| Err(RvdError::Internal("a device's share came to no end".to_owned()));
            let running: Vec<_> = others
                .iter_mut()
                .map(|other| {
                    std::thread::Builder::new().spawn_scoped(scope, move || other.share_of_sums(records, token))
                })
                .collect();
            let own = self.run_share(token, stats);
            let end = |share: std::io::Result<ScopedJoinHandle<'_, Result<Share>>>| {
                share.map_err(refused).and_then(|share| share.join().unwrap_or_else(lost))
            };
            (own, running.into_iter().map(end).collect::<Vec<_>>())
        });
        self.others = others;
        own?;
        for share in theirs {
            let Share { words, scales, stats: of_share } = share?;
            if scales != self.clip.scales {
                return Err(RvdError::Internal("devices chose different units for one pass".to_owned()));
            }
            // Times are not added up: devices work at the same time.
            stats.add(&PassStats { neighbours_ms: 0.0, start_ms: 0.0, ..of_share });
            // As if the host had clipped them.
            for (seed, cell) in words.chunks_exact(P::SUM_WORDS).enumerate() {
                if cell.iter().any(|&word| word != 0) {
                    self.clip.pass.finished.push((seed as u32, fixed::units(cell)));
                }
            }
        }
        Ok(())
    }

    /// The seeds of the pass, as the device has them.
    fn seed_records(&mut self, token: &Token) -> Result<Vec<P::Seed>> {
        self.ensure_memory()?;
        self.search_now(token)?;
        self.ensure_memory()?;
        self.memory.read(|b| &b.seeds, 0..self.neighbours.count)
    }

    fn share_of_sums(&mut self, records: Option<&[P::Seed]>, token: &Token) -> Result<Share> {
        self.on_pool(|session| {
            if let Some(records) = records {
                session.neighbours.set_records(records);
                session.seeds_changed();
            }
            let mut stats = session.begin_pass(token)?;
            session.run_share(token, &mut stats)?;
            session.ensure_memory()?;
            let words = session.clip.sum_words(&session.memory, session.neighbours.count)?;
            Ok(Share { words, scales: session.clip.scales, stats })
        })
    }
}

/// A session on several devices. Pieces come from the first one alone, which then has all facets.
pub(in crate::diagram) struct SharedSession {
    session: GpuSession<DVec3>,
    gpu: Arc<Gpu>,
    surface: Arc<Surface>,
    options: SessionOptions,
    /// For pieces, once they are asked for.
    whole: Option<GpuSession<DVec3>>,
    /// `whole` has the present seeds.
    whole_is_present: bool,
}

impl SharedSession {
    /// Plans and allocates a range of the facets on each.
    pub(in crate::diagram) fn open(gpus: &[Arc<Gpu>], surface: &Arc<Surface>, options: SessionOptions) -> Result<Self> {
        let facets = surface.facets().len() as u64;
        let count = (gpus.len() as u64).min(facets).max(1);
        let at = |k: u64| (facets * k / count) as u32;
        let mut sessions = (0..count).zip(gpus).map(|(k, gpu)| {
            gpu.pool.install(|| {
                let mut session = GpuSession::new(gpu, Arc::clone(surface), options)?;
                session.take_share(at(k)..at(k + 1));
                session.ensure_memory()?;
                Ok::<_, RvdError>(session)
            })
        });
        let none = || RvdError::Internal("no device to share facets out to".to_owned());
        let mut session = sessions.next().ok_or_else(none)??;
        session.others = sessions.collect::<Result<_>>()?;
        let gpu = Arc::clone(gpus.first().ok_or_else(none)?);
        Ok(Self { session, gpu, surface: Arc::clone(surface), options, whole: None, whole_is_present: false })
    }

    fn all(&self) -> impl Iterator<Item = &GpuSession<DVec3>> {
        std::iter::once(&self.session).chain(&self.session.others).chain(&self.whole)
    }
}

impl Session for SharedSession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<()> {
        self.whole_is_present = false;
        self.session.set_seeds(seeds)?;
        self.session.others.iter_mut().try_for_each(|other| other.set_seeds(seeds))
    }

    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats> {
        self.session.sums(out, token)
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats> {
        let whole = match &mut self.whole {
            Some(whole) => whole,
            none => {
                let open = || GpuSession::new(&self.gpu, Arc::clone(&self.surface), self.options);
                none.insert(self.gpu.pool.install(open)?)
            }
        };
        if let Place::Trial(_) = self.session.neighbours.place {
            self.session.neighbours.place = Place::Point;
            self.session.seeds_changed();
        }
        if !self.whole_is_present {
            if self.session.neighbours.place == Place::Set {
                whole.set_seeds(&self.session.neighbours.seeds)?;
            } else {
                let records = self.session.on_pool(|session| session.seed_records(token))?;
                whole.neighbours.set_records(&records);
                whole.seeds_changed();
            }
            self.whole_is_present = true;
        }
        whole.pieces(facets, out, token)
    }

    fn device_bytes(&self) -> u64 {
        self.all().map(Session::device_bytes).sum()
    }

    fn device_work(&self) -> DeviceWork {
        let mut work = DeviceWork::default();
        std::iter::once(&self.session).chain(&self.session.others).for_each(|session| work += session.work());
        // Submissions and bytes of its device are the first session's.
        if let Some(whole) = &self.whole {
            work += DeviceWork { host_searches: whole.neighbours.host_searches, ..whole.clip.work };
        }
        work
    }

    fn device_phases(&self) -> Option<PhasesMs> {
        self.session.device_phases()
    }

    fn resident(&mut self) -> Option<&mut dyn Resident> {
        // The caller may move them.
        self.whole_is_present = false;
        self.session.resident()
    }
}
