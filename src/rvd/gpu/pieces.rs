//! The pieces themselves.
//!
//! Purpose: a pass finds the pairs of a range of facets; then batches of them are clipped once
//! more by the stage that writes polygons, and converted to the unit frame in f64.
//! Invariant: one batch of polygons at a time is on the device and in readback memory; pieces
//! come out by facet, then seed.
//! Must not know: sums.

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use glam::{DVec3, dvec3};

use super::layout::Params;
use super::search::Place;
use super::{GpuSession, lane};
use crate::gpu::buffers;
use crate::gpu::dispatch::run;
use crate::gpu::limits::Limits;
use crate::rvd::cells::PieceBatch;
use crate::rvd::{PassStats, RvdError, elapsed_ms};
use crate::token::Token;

/// Status of a pair that ended, in the heads that the device writes.
const DONE: u32 = 0;

/// One batch as read back.
struct Emitted {
    heads: Vec<[u32; 4]>,
    vertices: Vec<[f32; 4]>,
    labels: Vec<u32>,
}

impl GpuSession {
    pub(super) fn compute_pieces(
        &mut self,
        facets: Range<u32>,
        out: &mut PieceBatch,
        token: &Token,
    ) -> Result<PassStats, RvdError> {
        out.clear();
        let end = facets.end.min(self.facets.len() as u32);
        let facets = facets.start.min(end)..end;
        let before = self.work();
        let mut stats = self.begin_pass(token)?;
        let mut next = facets.start;
        while next < facets.end {
            let begin = Instant::now();
            next = self.run_pairs(next..facets.end, token, &mut stats)?;
            stats.clip_ms += elapsed_ms(begin);
            let begin = Instant::now();
            self.emit_all(out, token)?;
            stats.update_ms += elapsed_ms(begin);
        }
        let begin = Instant::now();
        out.sort();
        stats.pairs = out.len() as u64;
        stats.update_ms += elapsed_ms(begin);
        if self.merged || !self.covers((0..out.len()).map(|i| out.area(i)).sum(), facets.clone()) {
            stats = self.pieces_in_f64(facets, out, stats, token)?;
        }
        self.meter(&before, &mut stats);
        Ok(stats)
    }

    /// All pieces of the list.
    fn emit_all(&mut self, out: &mut PieceBatch, token: &Token) -> Result<(), RvdError> {
        let length = self.pass.length;
        let batch = self.counts.emitted as u32;
        let mut first = 0;
        while first < length {
            token.check()?;
            let count = batch.min(length - first);
            let emitted = self.emit(first, count)?;
            self.collect(first, &emitted, out)?;
            first += count;
        }
        self.collect_walked(out)
    }

    fn emit(&mut self, first: u32, count: u32) -> Result<Emitted, RvdError> {
        let params = Params { emit_begin: first, emit_count: count, polygon: self.slots as u32, ..self.params() };
        let (device, pipelines, slots) = (Arc::clone(&self.device), Arc::clone(&self.pipelines), self.slots);
        let (limits, window) = (Limits::of(&device.limits()), self.layout.present());
        let there = self.on_device()?;
        let buffers = &there.buffers;
        buffers::write(&device, &buffers.params, 0, &[params])?;
        let mut encoder = device.encoder();
        {
            let mut compute = device.pass(&mut encoder, lane::CLIP);
            let bindings = &there.bindings.windows[window].emit;
            run(&mut compute, &pipelines.emit, bindings, count.into(), limits);
        }
        device.run(encoder)?;
        let vertices = count as usize * slots;
        Ok(Emitted {
            heads: buffers.staging.read(&device, &buffers.heads, 0..count as usize)?,
            vertices: buffers.staging.read(&device, &buffers.vertices, 0..vertices)?,
            labels: buffers.staging.read(&device, &buffers.labels, 0..vertices)?,
        })
    }

    fn collect(&mut self, first: u32, emitted: &Emitted, out: &mut PieceBatch) -> Result<(), RvdError> {
        if self.place != Place::Set {
            self.view()?;
        }
        for (k, &[facet, seed, size, status]) in emitted.heads.iter().enumerate() {
            let at = first + k as u32;
            if self.pass.walked.contains(&facet) || self.pass.repeats.iter().any(|r| r.contains(&at)) {
                continue;
            }
            if status != DONE {
                self.collect_pair(facet, seed, out)?;
                continue;
            }
            if size == 0 {
                continue;
            }
            let set = if self.place == Place::Set { &self.seeds } else { &self.host.seen };
            let origin = set[seed as usize];
            let vertices = k * self.slots..k * self.slots + size as usize;
            out.push(
                facet,
                seed,
                vertices.map(|v| {
                    let [x, y, z, w] = emitted.vertices[v].map(f64::from);
                    (origin + dvec3(x, y, z), w, emitted.labels[v])
                }),
            );
        }
        Ok(())
    }

    /// A pair that the device cannot write: too many vertices for the slots, or finished in f64.
    fn collect_pair(&mut self, facet: u32, seed: u32, out: &mut PieceBatch) -> Result<(), RvdError> {
        self.view()?;
        let mut walker = std::mem::take(&mut self.walker);
        let mut ignored = PassStats::default();
        walker.clip_to_end(self.diagram(), facet, seed, self.capacities, &mut ignored);
        push(facet, seed, self.host.seen[seed as usize], walker.clipper().polygon(), out);
        self.walker = walker;
        Ok(())
    }

    fn collect_walked(&mut self, out: &mut PieceBatch) -> Result<(), RvdError> {
        if self.pass.walked.is_empty() {
            return Ok(());
        }
        self.view()?;
        let mut walker = std::mem::take(&mut self.walker);
        let mut ignored = PassStats::default();
        for &facet in &self.pass.walked {
            let start = self.host.first[facet as usize];
            walker.walk(self.diagram(), facet, start, self.capacities, &mut ignored, |i, clipper| {
                push(facet, i, self.host.seen[i as usize], clipper.polygon(), out);
            });
        }
        self.walker = walker;
        Ok(())
    }
}

fn push(facet: u32, seed: u32, origin: DVec3, polygon: &[crate::rvd::clip::Vertex], out: &mut PieceBatch) {
    if !polygon.is_empty() {
        out.push(facet, seed, polygon.iter().map(|v| (origin + v.p, v.w, v.edge)));
    }
}
