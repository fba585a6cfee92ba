//! The facets of a surface in one order, in a scratch file.
//!
//! Purpose: [`FacetFile::new`] reads the file of a surface a few times from one end to the other: for its bounds, for vertices at one
//! place, and for its facets, which are sorted by the Morton order of their centroids. A window of them is a surface in the
//! frame of the whole.
//! Invariant: frame, area, facets without area, centroids and corners have the bits of [`Surface::new`]. Must not know: seeds'
//! cells.

use glam::DVec3;
use rayon::prelude::*;

use super::draws::Draws;
use super::plan::record_bytes;
use super::{OutOfCoreError, Plan};
use crate::mesh::bvh::morton;
use crate::mesh::out_of_core::{MeshFile, READ, Room, Scratch, Sorter, Welds, Window, WriteAt, position, put_position};
use crate::mesh::{CHUNK, twice_area};
use crate::rvd::surface::{Frame, Whole, area_of, is_flat, snap};
use crate::rvd::{RvdError, Surface};
use crate::token::Token;

/// A surface whose facets are in a file, in the unit frame of the whole.
#[derive(Debug)]
pub struct FacetFile {
    source: MeshFile,
    scratch: Scratch,
    low: DVec3,
    extent: f64,
    frame: Frame,
    /// Facets with area, one after the other.
    records: WriteAt,
    count: usize,
    degenerate: usize,
    /// Caller's units squared.
    world_area: f64,
    /// Of all facets with area, the box's longest side being 1.
    mass: f64,
    /// Unit frame.
    area: f64,
    window: usize,
    vertex_bytes: usize,
}

/// What is made of a facet on the way into the file.
struct Made<const N: usize> {
    /// Twice its area, the box's longest side being 1.
    twice: Option<f64>,
    /// Its area in the unit frame, and its record, if it is not flat there.
    record: Option<(f64, [u8; N])>,
}

impl FacetFile {
    /// Reads a surface and puts its facets in order, in the memory of the plan. Errors: what the file lacks; `NoArea`.
    pub fn new(source: MeshFile, plan: &Plan, scratch: &Scratch, token: &Token) -> Result<Self, OutOfCoreError> {
        let (low, high) = source.bounds(token)?;
        let (frame, extent) = (Frame::of_bounds(low, high), (high - low).max_element());
        let mut file = Self {
            records: scratch.file()?,
            scratch: scratch.clone(),
            low,
            extent: if extent > 0.0 { extent } else { 1.0 },
            frame,
            count: 0,
            degenerate: 0,
            world_area: 0.0,
            mass: 0.0,
            area: 0.0,
            window: plan.window_facets,
            vertex_bytes: plan.vertex_bytes as usize,
            source,
        };
        let sort = plan.sort_bytes as usize;
        let welds = Welds::find(&file.source, sort, scratch, token)?;
        match file.source.number_bytes() {
            4 => file.sort::<49>(welds.as_ref(), sort, token)?,
            _ => file.sort::<85>(welds.as_ref(), sort, token)?,
        }
        if file.degenerate == file.source.facets() {
            let facets = file.source.facets();
            return Err(crate::mesh::out_of_core::MeshFileError::from(crate::mesh::MeshError::NoArea { facets }).into());
        }
        if file.count == 0 {
            return Err(RvdError::NoArea.into());
        }
        Ok(file)
    }

    fn room(&self) -> Room<'_> {
        Room { vertex_bytes: self.vertex_bytes, scratch: &self.scratch }
    }

    /// Writes the records. `N` is their length behind their keys.
    fn sort<const N: usize>(
        &mut self,
        welds: Option<&Welds>,
        memory: usize,
        token: &Token,
    ) -> Result<(), OutOfCoreError> {
        let mut sorter = Sorter::<N>::new(&self.scratch, memory, self.source.facets());
        let mut made: Vec<Made<N>> = Vec::new();
        let (mut world, mut part, mut area) = (0.0, 0.0, -0.0);
        let (mut mass, mut degenerate) = (0.0, 0);
        self.source.each_window(self.room(), welds, token, |window| -> Result<(), OutOfCoreError> {
            let facets = window.corners.par_iter().zip(&window.welded).enumerate();
            facets
                .map(|(k, (corners, welded))| self.make(window.first + k, corners, welded))
                .collect_into_vec(&mut made);
            for (k, Made { twice, record }) in made.iter().enumerate() {
                // In parts, as the area of a mesh is added up.
                if (window.first + k).is_multiple_of(CHUNK) {
                    (world, part) = (world + part, 0.0);
                }
                match twice {
                    None => degenerate += 1,
                    Some(twice) => {
                        part += 0.5 * twice;
                        mass += twice;
                    }
                }
                if let Some((facet_area, record)) = record {
                    area += facet_area;
                    sorter.push(*record)?;
                }
            }
            Ok(())
        })?;
        drop(made);
        (self.mass, self.degenerate, self.area) = (mass, degenerate, area);
        self.world_area = (world + part) * self.extent * self.extent;
        let mut merge = sorter.merge(token)?;
        let mut bytes = Vec::with_capacity(READ + N);
        let mut at = 0;
        let mut end = |bytes: &mut Vec<u8>| {
            token.check()?;
            self.records.write(at, bytes)?;
            at += bytes.len() as u64;
            bytes.clear();
            Ok::<(), OutOfCoreError>(())
        };
        while let Some(record) = merge.take()? {
            bytes.extend_from_slice(&record[KEY..]);
            self.count += 1;
            if bytes.len() >= READ {
                end(&mut bytes)?;
            }
        }
        end(&mut bytes)
    }

    fn make<const N: usize>(&self, facet: usize, corners: &[DVec3; 3], welded: &[u32; 3]) -> Made<N> {
        let twice = twice_area(corners.map(|p| (p - self.low) / self.extent));
        let unit = corners.map(|p| self.unit(p));
        if twice.is_none() || is_flat(unit) {
            return Made { twice, record: None };
        }
        let mut record = [0; N];
        let [a, b, c] = unit;
        record[..8].copy_from_slice(&morton((a + b + c) / 3.0).to_be_bytes());
        record[8..KEY].copy_from_slice(&(facet as u32).to_be_bytes());
        let number = self.source.number_bytes();
        for (out, &p) in record[KEY..N - 1].chunks_exact_mut(3 * number).zip(corners) {
            put_position(out, number, p);
        }
        record[N - 1] = ranks(welded);
        Made { twice, record: Some((area_of(unit), record)) }
    }

    fn unit(&self, p: DVec3) -> DVec3 {
        snap(self.frame.to_unit(p))
    }

    /// Draws points as [`crate::mesh::sample::sample`] does without weights, caller's coordinates.
    pub fn sample(&self, count: usize, seed: u64, token: &Token) -> Result<Vec<DVec3>, OutOfCoreError> {
        let mut draws = Draws::new(count, seed, self.mass);
        self.source.each_window(self.room(), None, token, |window: &Window| -> Result<(), OutOfCoreError> {
            for &corners in &window.corners {
                let twice = twice_area(corners.map(|p| (p - self.low) / self.extent));
                draws.meet(corners, twice.unwrap_or(0.0));
            }
            Ok(())
        })?;
        Ok(draws.finish())
    }

    /// The map to the caller's coordinates.
    pub fn frame(&self) -> Frame {
        self.frame
    }

    /// Facets of the surface, those without area too.
    pub fn facets(&self) -> usize {
        self.source.facets()
    }

    /// Vertices of the file.
    pub fn vertices(&self) -> usize {
        self.source.vertices()
    }

    /// Facets without area.
    pub fn degenerate_facets(&self) -> usize {
        self.degenerate
    }

    /// Area, caller's units squared.
    pub fn world_area(&self) -> f64 {
        self.world_area
    }

    /// As [`Surface::hexagonal_energy`].
    pub fn hexagonal_energy(&self, seeds: usize) -> f64 {
        crate::rvd::surface::hexagonal_energy(self.area, seeds)
    }

    /// Facets of a window.
    pub(in crate::rvd) fn window(&self) -> usize {
        self.window
    }

    /// Facets with area.
    pub(in crate::rvd) fn count(&self) -> usize {
        self.count
    }

    /// Puts `count` facets from `first` on into `surface`. `bytes` is scratch memory.
    pub(in crate::rvd) fn read(
        &self,
        first: usize,
        count: usize,
        bytes: &mut Vec<u8>,
        surface: &mut Surface,
    ) -> Result<(), RvdError> {
        let number = self.source.number_bytes();
        let length = record_bytes(number);
        bytes.resize(count * length, 0);
        let read = self.records.read((first * length) as u64, bytes);
        read.map_err(|error| RvdError::Unreadable(error.to_string()))?;
        let whole = Whole { frame: self.frame, area: self.area };
        surface.set_alone(whole, bytes.par_chunks_exact(length), |record| {
            let corners = [0, 1, 2].map(|c| self.unit(position(&record[3 * number * c..], number)));
            (corners, order_of(record[length - 1]))
        });
        Ok(())
    }
}

/// Bytes of a key: a place on the curve, and the facet's number.
const KEY: usize = 12;

/// Which of three vertices are lower than which, as a byte.
fn ranks(vertices: &[u32; 3]) -> u8 {
    let rank = |c: usize| vertices.iter().filter(|&&other| other < vertices[c]).count() as u8;
    rank(0) | rank(1) << 2 | rank(2) << 4
}

/// Three numbers in that order.
fn order_of(ranks: u8) -> [u32; 3] {
    [0, 2, 4].map(|shift| u32::from(ranks >> shift & 3))
}
