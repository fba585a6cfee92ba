//! Rows and first cells, by the device or by the host.
//!
//! Purpose: encodes the seeds' arrival and the search for them, and has the host search where the device could not.
//! Invariant: rows and first cells are those of the present seeds when a pass adds up. Must not know: clipping.

use std::sync::Arc;

use glam::DVec3;

use super::{GpuSession, Result, rooms};
use crate::diagram::Gpu;
use crate::diagram::clip::fixed;
use crate::diagram::layout::{State, Totals, halt};
use crate::diagram::neighbours::{Found, Place, Rows, Searched};
use crate::diagram::optimizer::Step;
use crate::diagram::space::DeviceSpace;
use geometry::rvd::{Lifted, Session, SessionOptions, Surface};
use geometry::token::Token;

impl Gpu {
    /// Searches for the neighbours of each of `sets` of seeds (unit frame) in turn and the first cells of `surface`, as
    /// every pass of one session does, and shows what was found.
    pub fn search(
        &self,
        surface: Arc<Surface>,
        sets: &[&[DVec3]],
        options: SessionOptions,
        token: &Token,
    ) -> Result<Vec<Found>> {
        self.search_in(surface, sets, options, token)
    }

    /// The same on a lifted surface.
    pub fn search_lifted(
        &self,
        surface: Arc<Surface<Lifted>>,
        sets: &[&[Lifted]],
        options: SessionOptions,
        token: &Token,
    ) -> Result<Vec<Found>> {
        self.search_in(surface, sets, options, token)
    }

    fn search_in<P: DeviceSpace>(
        &self,
        surface: Arc<Surface<P>>,
        sets: &[&[P]],
        options: SessionOptions,
        token: &Token,
    ) -> Result<Vec<Found>> {
        self.pool.install(|| {
            let mut session = GpuSession::new(self, surface, options)?;
            let find = |seeds: &&[P]| {
                session.set_seeds(seeds)?;
                session.search_now(token)?;
                session.start_now(token)?;
                session.neighbours.found(&session.memory)
            };
            sets.iter().map(find).collect()
        })
    }
}

impl<P: DeviceSpace> GpuSession<P> {
    /// Encodes the seeds' arrival and the search for their rows.
    pub(super) fn encode_search(&mut self, encoder: &mut wgpu::CommandEncoder, token: &Token) -> Result<()> {
        let params = self.params();
        match self.neighbours.place {
            Place::Set => self.neighbours.upload_seeds(&self.memory)?,
            Place::Point => self.optimizer.encode_point(rooms!(self), encoder)?,
            Place::Trial(_) => self.optimizer.encode_trial(rooms!(self), encoder)?,
        }
        self.neighbours.encode_search(&self.memory, &params, encoder, token)
    }

    /// Ends `encoder` with the totals, if they are wanted and all windows are done, and reads the summary.
    pub(super) fn read_summary(&mut self, mut encoder: wgpu::CommandEncoder) -> Result<State> {
        let steps = self.optimizer.moving.as_ref().is_some_and(|m| m.step == Step::Wanted);
        if self.memory.windows.is_last() {
            self.optimizer.encode_totals(rooms!(self), &mut encoder)?;
        }
        let buffers = &self.memory.there()?.buffers;
        let mut parts = vec![(&buffers.state, 0, size_of::<State>() as u64)];
        let wanted = self.optimizer.moving.as_ref().filter(|m| m.wants_totals());
        parts.extend(wanted.map(|m| (&m.buffers.totals, 0, size_of::<Totals>() as u64)));
        let (mut state, mut totals) = (State::default(), None);
        buffers.staging.read_parts(&self.cx.device, encoder, &parts, |bytes| {
            let (first, rest) = bytes.split_at(size_of::<State>());
            state = bytemuck::pod_read_unaligned(first);
            totals = (!rest.is_empty()).then(|| bytemuck::pod_read_unaligned(rest));
        })?;
        if let (Some(moving), Some(totals)) = (self.optimizer.moving.as_mut(), totals) {
            moving.totals = totals;
            if steps && state.halt == 0 {
                moving.step = Step::Taken;
            }
        }
        state.halt &= !halt::INCOMPLETE;
        Ok(state)
    }

    /// The rows, if they are not there, in a submission of their own.
    pub(super) fn search_now(&mut self, token: &Token) -> Result<()> {
        if self.neighbours.rows != Rows::Missing {
            return Ok(());
        }
        self.clip.promote(&mut self.memory)?;
        self.ensure_memory()?;
        self.memory.write_params(self.params())?;
        self.memory.write_state(State::default())?;
        let mut encoder = self.cx.device.encoder();
        self.encode_search(&mut encoder, token)?;
        let state = self.read_summary(encoder)?;
        self.take_search_result(&state, token).map(drop)
    }

    /// The first cells likewise.
    pub(super) fn start_now(&mut self, token: &Token) -> Result<()> {
        token.check()?;
        if self.neighbours.first_cells.known {
            return Ok(());
        }
        self.ensure_memory()?;
        let mut all = State::default();
        for k in 0..self.memory.windows.all.len() {
            self.memory.turn_to(k)?;
            self.memory.write_params(self.params())?;
            self.memory.write_state(State::default())?;
            let mut encoder = self.cx.device.encoder();
            self.neighbours.encode_first_cells(&self.memory, &mut encoder, token)?;
            all.unproved += self.read_summary(encoder)?.unproved;
        }
        self.neighbours.take_first_cells(&self.memory, &all).map(drop)
    }

    /// What came of the search. `false` if the host searched instead.
    pub(super) fn take_search_result(&mut self, state: &State, token: &Token) -> Result<bool> {
        match self.neighbours.take_search_result(&self.memory, state)? {
            Searched::Rows => Ok(true),
            Searched::Nothing { far } => self.search_on_host(far, token).map(|()| false),
        }
    }

    /// Rows and first cells by the host's tree, and onto the device with them.
    fn search_on_host(&mut self, far: bool, token: &Token) -> Result<()> {
        let fits = self.neighbours.search_on_host(&mut self.memory, far, token)?;
        if far {
            self.clip.set_radius(fixed::covering_radius(&self.neighbours.host.seen, self.cx.longest_lift));
        }
        if !fits {
            return self.release();
        }
        self.neighbours.upload_rows(&self.memory)?;
        self.neighbours.upload_roots(&self.memory)
    }

    pub(super) fn view(&mut self) -> Result<()> {
        self.ensure_memory()?;
        self.neighbours.view(&self.memory)
    }
}
