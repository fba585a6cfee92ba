//! The pieces themselves.
//!
//! Purpose: batches of the pairs of a pass are clipped once more by the stage `emit`, which writes polygons, and converted to
//! the unit frame in f64. Invariant: one batch of polygons at a time is on the device and in readback memory. Must not know:
//! sums.

use glam::dvec3;

use super::{Clip, Result};
use crate::diagram::lane;
use crate::diagram::layout::Params;
use crate::diagram::memory::Memory;
use crate::diagram::neighbours::{Neighbours, Place};
use crate::diagram::pipelines::SLOTS;
use crate::diagram::space::DeviceSpace;
use crate::dispatch::run;
use geometry::rvd::cells::PieceBatch;
use geometry::rvd::clip::Vertex;
use geometry::rvd::{PassStats, Point};
use geometry::token::Token;

/// Status of a pair that ended, in the heads that the device writes.
const DONE: u32 = 0;

struct Emitted {
    heads: Vec<[u32; 4]>,
    vertices: Vec<[f32; 4]>,
    labels: Vec<u32>,
}

impl<P: DeviceSpace> Clip<P> {
    pub(crate) fn emit_all(
        &mut self,
        memory: &Memory<P>,
        neighbours: &mut Neighbours<P>,
        out: &mut PieceBatch,
        token: &Token,
    ) -> Result<()> {
        let length = self.pass.length;
        let batch = memory.counts.emitted as u32;
        let mut first = 0;
        while first < length {
            token.check()?;
            let count = batch.min(length - first);
            let emitted = self.emit(memory, neighbours, first, count)?;
            self.collect(memory, neighbours, first, &emitted, out)?;
            first += count;
        }
        self.collect_walked(memory, neighbours, out)
    }

    fn emit(&self, memory: &Memory<P>, neighbours: &Neighbours<P>, first: u32, count: u32) -> Result<Emitted> {
        let params =
            Params { emit_begin: first, emit_count: count, polygon: SLOTS as u32, ..self.params(memory, neighbours) };
        let (device, there) = (&self.cx.device, memory.there()?);
        memory.write_params(params)?;
        let mut encoder = device.encoder();
        let mut compute = device.pass(&mut encoder, lane::CLIP);
        let bindings = &there.bindings.windows[memory.windows.present].emit;
        run(&mut compute, &self.cx.pipelines.emit, bindings, count.into(), self.cx.limits());
        drop(compute);
        device.run(encoder)?;
        let vertices = count as usize * SLOTS;
        Ok(Emitted {
            heads: memory.read(|b| &b.heads, 0..count as usize)?,
            vertices: memory.read(|b| &b.vertices, 0..vertices)?,
            labels: memory.read(|b| &b.labels, 0..vertices)?,
        })
    }

    fn collect(
        &mut self,
        memory: &Memory<P>,
        neighbours: &mut Neighbours<P>,
        first: u32,
        emitted: &Emitted,
        out: &mut PieceBatch,
    ) -> Result<()> {
        if neighbours.place != Place::Set {
            neighbours.view(memory)?;
        }
        for (k, &[facet, seed, size, status]) in emitted.heads.iter().enumerate() {
            let at = first + k as u32;
            if self.pass.walked.contains(&facet) || self.pass.repeats.iter().any(|r| r.contains(&at)) {
                continue;
            }
            if status != DONE {
                // The device cannot write it: too many vertices for the slots, or finished in f64.
                neighbours.view(memory)?;
                self.walker.clip(None, neighbours.diagram(), facet, seed, &mut PassStats::default());
                push(facet, seed, neighbours.host.seen[seed as usize], self.walker.clipper().polygon(), out);
                continue;
            }
            if size == 0 {
                continue;
            }
            let set = if neighbours.place == Place::Set { &neighbours.seeds } else { &neighbours.host.seen };
            let origin = set[seed as usize].place();
            let vertices = (k * SLOTS..k * SLOTS + size as usize).map(|v| {
                let [x, y, z, w] = emitted.vertices[v].map(f64::from);
                (origin + dvec3(x, y, z), w, emitted.labels[v])
            });
            out.push(facet, seed, vertices);
        }
        Ok(())
    }

    fn collect_walked(
        &mut self,
        memory: &Memory<P>,
        neighbours: &mut Neighbours<P>,
        out: &mut PieceBatch,
    ) -> Result<()> {
        if self.pass.walked.is_empty() {
            return Ok(());
        }
        neighbours.view(memory)?;
        let mut ignored = PassStats::default();
        for &facet in &self.pass.walked {
            let start = neighbours.host.first[facet as usize];
            let diagram = neighbours.diagram();
            self.walker.walk(None, diagram, facet, start, &mut ignored, |i, clipper| {
                push(facet, i, neighbours.host.seen[i as usize], clipper.polygon(), out);
            });
        }
        Ok(())
    }
}

fn push<P: Point>(facet: u32, seed: u32, origin: P, polygon: &[Vertex<P>], out: &mut PieceBatch) {
    if !polygon.is_empty() {
        out.push(facet, seed, polygon.iter().map(|v| ((origin + v.p).place(), v.w, v.edge)));
    }
}
