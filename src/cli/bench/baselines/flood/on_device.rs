//! The labels of a flood on a GPU.
//!
//! Purpose: seeds go to the device, all passes of a flood are one submission, and the labels that are asked for come back, to be
//! summed on the host. Invariant: the rules of [`super`], on voxels and on texels by the same shaders; where two seeds are as
//! near, the device may round otherwise. Must not know: what labels are for.

use std::sync::Arc;

use super::super::stages::{Buffers, Stage};
use super::{BYTES, Labels, NONE, Samples};
use geometry::rvd::RvdError;
use geometry::token::Token;
use gpu::buffers::{Staging, write};
use gpu::shader::Sources;
use gpu::wgpu::Buffer;
use gpu::{Device, GpuError};

const SOURCES: Sources = &[
    ("params", include_str!("params.wgsl")),
    ("distance", include_str!("distance.wgsl")),
    ("plant", include_str!("plant.wgsl")),
    ("pass", include_str!("pass.wgsl")),
    ("gather", include_str!("gather.wgsl")),
];

pub(in super::super) struct OnDevice {
    buffers: Buffers,
    samples: Samples,
    /// Which of both buffers has the present labels.
    front: usize,
    both: [Buffer; 2],
    seeds: Buffer,
    planted: Buffer,
    /// How many samples hold seeds.
    planting: Buffer,
    staging: Staging,
    plant: Stage,
    /// For each distance (1, 2, 4 and so on) and each front.
    pass: Stage,
    /// Not if all labels are asked for.
    gather: Option<(Stage, Buffer)>,
    /// Those that are asked for.
    labels: Vec<u32>,
}

impl OnDevice {
    /// For `count` seeds at most. The labels of the samples `codes` are asked for, or all.
    pub(in super::super) fn new(
        device: &Arc<Device>,
        samples: Samples,
        codes: Option<&[u32]>,
        count: usize,
    ) -> Result<Self, GpuError> {
        let (all, of_seeds) = (samples.count(), count as u64);
        let asked = codes.map_or(all as usize, <[u32]>::len);
        let of_places = samples.places.as_ref().map_or(0, |places| 12 * places.len() as u64);
        let of_codes = codes.map_or(0, |codes| 8 * codes.len() as u64);
        let bytes = BYTES * u64::from(all) + 4 * asked as u64 + of_codes + of_places + 24 * of_seeds;
        let mut buffers = Buffers::new(device, bytes);
        let each = 4 * u64::from(all);
        let both = [buffers.make("labels", each)?, buffers.make("next labels", each)?];
        let (seeds, planted) = (buffers.make("seeds", 16 * of_seeds)?, buffers.make("planted", 8 * of_seeds)?);
        let places = match &samples.places {
            Some(of) => {
                let places = buffers.make("places", of_places)?;
                write(device, &places, 0, of)?;
                Some(places)
            }
            None => None,
        };
        let (places, constants) = (places.as_ref(), [("PLACES", i64::from(places.is_some()))]);
        let planting = buffers.words("parameters", &params(&samples, 0, 0))?;
        let fronts = [0, 1];
        let choices = fronts.map(|front| seen([&planting, &seeds, &planted, &both[front]], places));
        let plant = buffers.stage(SOURCES, "plant", &constants, &choices)?;
        let mut steps = Vec::new();
        for k in 0..=samples.first_step().ilog2() {
            steps.push(buffers.words("parameters", &params(&samples, 1 << k, all))?);
        }
        let of_step = |step| fronts.map(|front| seen([step, &seeds, &both[front], &both[1 - front]], places));
        let choices: Vec<Vec<&Buffer>> = steps.iter().flat_map(of_step).collect();
        let pass = buffers.stage(SOURCES, "pass", &constants, &choices)?;
        let gather = match codes {
            Some(codes) => {
                let gathering = buffers.words("parameters", &params(&samples, 0, codes.len() as u32))?;
                let (at, gathered) = (buffers.words("codes", codes)?, buffers.make("gathered", 4 * asked as u64)?);
                let choices = fronts.map(|front| seen([&gathering, &at, &both[front], &gathered], None));
                Some((buffers.stage(SOURCES, "gather", &[], &choices)?, gathered))
            }
            None => None,
        };
        let (staging, labels) = (buffers.staging(4 * asked as u64)?, vec![NONE; asked]);
        Ok(Self { buffers, samples, front: 0, both, seeds, planted, planting, staging, plant, pass, gather, labels })
    }
}

/// As in the shaders.
fn params(samples: &Samples, step: u32, items: u32) -> [u32; 8] {
    let [x, y, z] = samples.size;
    [x, y, z, step, items, 0, 0, 0]
}

/// What a stage sees.
fn seen<'a>(four: [&'a Buffer; 4], places: Option<&'a Buffer>) -> Vec<&'a Buffer> {
    four.into_iter().chain(places).collect()
}

impl Labels for OnDevice {
    fn flood(
        &mut self,
        seeds: &[[f32; 3]],
        planted: &[[u32; 2]],
        kept: bool,
        step: u32,
        token: &Token,
    ) -> Result<(), RvdError> {
        token.check()?;
        let device = &self.buffers.device;
        let padded: Vec<[f32; 4]> = seeds.iter().map(|&[x, y, z]| [x, y, z, 0.0]).collect();
        let count = planted.len() as u32;
        write(device, &self.seeds, 0, &padded)?;
        write(device, &self.planted, 0, planted)?;
        write(device, &self.planting, 0, &params(&self.samples, 0, count))?;
        let mut encoder = device.encoder();
        if !kept {
            encoder.clear_buffer(&self.both[self.front], 0, None);
        }
        let mut pass = self.buffers.pass(&mut encoder);
        self.plant.run(&mut pass, self.front, count);
        for k in (0..=step.ilog2() as usize).rev() {
            self.pass.run(&mut pass, 2 * k + self.front, self.samples.count());
            self.front = 1 - self.front;
        }
        let from = match &self.gather {
            Some((gather, gathered)) => {
                gather.run(&mut pass, self.front, self.labels.len() as u32);
                gathered
            }
            None => &self.both[self.front],
        };
        drop(pass);
        let labels = &mut self.labels;
        let asked = 0..labels.len();
        self.staging.read_with(device, encoder, from, asked, |found: &[u32]| {
            // On the device 0 is no seed.
            labels.iter_mut().zip(found).for_each(|(label, found)| *label = found.wrapping_sub(1));
        })?;
        Ok(())
    }

    fn label(&self, k: usize, _: u32) -> u32 {
        self.labels[k]
    }

    fn bytes(&self) -> u64 {
        self.buffers.bytes()
    }
}
