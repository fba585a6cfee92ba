//! Facets in order, shared out to threads, and their sums.
//!
//! Purpose: facets beside one another are taken one after the other, whatever order the mesh has them in, so that a task meets few
//! cells, and what it reads of vertices and seeds is at hand. A [`chunk`] is a task's share of the facets. Facets are divided in any
//! order; their pieces are written down where they belong, and then added up in one order.
//! Invariant: every facet with area, once; the order depends on the surface alone. A cell adds its pieces within a block up in the
//! order of facets, and nothing else decides its bits: no sum depends on how facets are shared out.
//! Must not know: how seeds are listed, how pieces are found.

pub(super) mod chunk;

use std::iter::repeat_n;

use glam::DVec3;
use rayon::prelude::*;

use super::divide::facets::MEMBERS;
use crate::mesh::bvh::morton;
use crate::rvd::{Surface, clip::Integrals, incident::Diagram, refill};
use crate::token::Token;

/// Stands where a member has no piece.
pub(super) const NONE: u32 = u32::MAX;

#[derive(Default)]
pub(super) struct Written {
    /// Of as many seeds as each facet has members; [`NONE`] where a member has no piece.
    pub seeds: Vec<u32>,
    pub integrals: Vec<Integrals>,
    /// Where those of each facet begin, and the end of the last.
    begin: Vec<u32>,
    pub walked: Vec<(u32, Integrals)>,
    /// Of each facet that was walked its place, and the end of its pieces among those.
    inserts: Vec<(usize, usize)>,
    /// Of each seed its place among a block's cells, or [`NONE`].
    place: Vec<u32>,
}

impl Written {
    /// Gives every facet with a usable number of members room for their integrals; the others are to be walked.
    pub(super) fn begin(&mut self, members: &[u32], to_walk: &mut Vec<u32>) {
        self.begin.clear();
        self.walked.clear();
        self.inserts.clear();
        to_walk.clear();
        let mut end = 0;
        for (at, members) in members.iter().enumerate() {
            self.begin.push(end);
            let n = members.count_ones();
            if (1..=MEMBERS as u32).contains(&n) {
                end += n;
            } else {
                to_walk.push(at as u32);
            }
        }
        self.begin.push(end);
        // Each gets its value, so that what is there from an earlier task may stay until then.
        self.seeds.resize(end as usize, NONE);
        self.integrals.resize(end as usize, Integrals::default());
    }

    #[inline(always)]
    pub(super) fn first(&self, at: u32) -> usize {
        self.begin[at as usize] as usize
    }

    /// What was walked since belongs to the facet at `at`. Facets come in order.
    pub(super) fn end_walk(&mut self, at: usize) {
        self.inserts.push((at, self.walked.len()));
    }

    /// Appends the sums of all cells in blocks of `block` facets. `seeds` is the number of seeds.
    pub(super) fn add_blocks(&mut self, block: usize, seeds: usize, out: &mut Vec<(u32, Integrals)>) {
        if self.place.len() != seeds {
            refill(&mut self.place, repeat_n(NONE, seeds));
        }
        let Self { seeds, integrals, begin, walked, inserts, place } = self;
        let facets = begin.len() - 1;
        let mut inserts = inserts.iter().peekable();
        let (mut at, mut from) = (0, 0);
        for last in (0..facets).step_by(block).map(|first| facets.min(first + block)) {
            let mut sums = Block { place, first: out.len(), out };
            while let Some(&(place, end)) = inserts.next_if(|insert| insert.0 < last) {
                let before = begin[place] as usize;
                sums.add(&seeds[at..before], &integrals[at..before]);
                walked[from..end].iter().for_each(|(seed, sum)| sums.add_one(*seed, sum));
                (at, from) = (before, end);
            }
            let end = begin[last] as usize;
            sums.add(&seeds[at..end], &integrals[at..end]);
            sums.end();
            at = end;
        }
    }
}

struct Block<'a> {
    place: &'a mut [u32],
    first: usize,
    out: &'a mut Vec<(u32, Integrals)>,
}

impl Block<'_> {
    #[inline(always)]
    fn add(&mut self, seeds: &[u32], integrals: &[Integrals]) {
        seeds.iter().zip(integrals).filter(|(seed, _)| **seed != NONE).for_each(|(seed, sum)| self.add_one(*seed, sum));
    }

    #[inline(always)]
    fn add_one(&mut self, seed: u32, sum: &Integrals) {
        let place = &mut self.place[seed as usize];
        if *place == NONE {
            *place = (self.out.len() - self.first) as u32;
            self.out.push((seed, *sum));
        } else {
            let to = &mut self.out[self.first + *place as usize].1;
            to.mass += sum.mass;
            to.moment += sum.moment;
            to.energy += sum.energy;
            to.area += sum.area;
        }
    }

    fn end(self) {
        self.out[self.first..].iter().for_each(|(seed, _)| self.place[*seed as usize] = NONE);
    }
}

/// Facets that are looked at together at least.
const CHUNK: usize = 4096;
/// Facets between two looks at the token.
const ASKED: usize = 64;

/// Facets, and a seed near each.
#[derive(Default)]
pub(super) struct Order {
    /// All facets with area along a curve that fills space, by their centroids.
    facets: Vec<u32>,
    corners: Vec<[u32; 3]>,
    vertices: Vec<Vertex>,
    /// Of each facet, and how many seeds there were when they were found.
    starts: Vec<u32>,
    seeds: usize,
}

#[derive(Clone, Copy)]
#[repr(align(32))]
pub(super) struct Vertex {
    pub p: DVec3,
    pub weight: f64,
}

/// Facets one after the other, by their places among them.
#[derive(Clone, Copy)]
pub(super) struct Stretch<'a> {
    facets: &'a [u32],
    corners: &'a [[u32; 3]],
    vertices: &'a [Vertex],
}

impl<'a> Stretch<'a> {
    #[inline(always)]
    pub(super) fn len(&self) -> usize {
        self.facets.len()
    }

    /// A facet's number on the surface.
    #[inline(always)]
    pub(super) fn facet(&self, at: usize) -> u32 {
        self.facets[at]
    }

    #[inline(always)]
    pub(super) fn vertices(&self, at: usize) -> [Vertex; 3] {
        self.corners[at].map(|v| self.vertices[v as usize])
    }

    #[inline(always)]
    pub(super) fn corners(&self, at: usize) -> [DVec3; 3] {
        self.vertices(at).map(|vertex| vertex.p)
    }

    /// As [`Surface::centroid`] has it.
    #[inline(always)]
    pub(super) fn centroid(&self, at: usize) -> DVec3 {
        let [a, b, c] = self.corners(at);
        (a + b + c) / 3.0
    }

    pub(super) fn chunks(self, size: usize) -> impl Iterator<Item = Stretch<'a>> {
        let each = self.facets.chunks(size).zip(self.corners.chunks(size));
        each.map(move |(facets, corners)| Stretch { facets, corners, ..self })
    }

    pub(super) fn par_chunks(self, size: usize) -> impl IndexedParallelIterator<Item = Stretch<'a>> {
        let each = self.facets.par_chunks(size).zip(self.corners.par_chunks(size));
        each.map(move |(facets, corners)| Stretch { facets, corners, ..self })
    }
}

impl Order {
    /// Puts the facets in order, if they are not.
    pub(super) fn begin(&mut self, surface: &Surface) {
        if !self.facets.is_empty() {
            return;
        }
        let all = (0..surface.facets().len() as u32).into_par_iter().with_min_len(CHUNK);
        let with_area = all.filter(|&f| !surface.skips(f as usize));
        let mut places: Vec<(u64, u32)> = with_area.map(|f| (morton(surface.centroid(f)), f)).collect();
        places.par_sort_unstable();
        places.into_par_iter().with_min_len(CHUNK).map(|(_, facet)| facet).collect_into_vec(&mut self.facets);
        let mut new = vec![u32::MAX; surface.positions().len()];
        self.corners.reserve(self.facets.len());
        for &facet in &self.facets {
            self.corners.push(surface.facets()[facet as usize].map(|v| {
                let new = &mut new[v as usize];
                if *new == u32::MAX {
                    *new = self.vertices.len() as u32;
                    let (p, weight) = (surface.positions()[v as usize], surface.weights()[v as usize]);
                    self.vertices.push(Vertex { p, weight });
                }
                *new
            }));
        }
    }

    pub(super) fn len(&self) -> usize {
        self.facets.len()
    }

    pub(super) fn all(&self) -> Stretch<'_> {
        Stretch { facets: &self.facets, corners: &self.corners, vertices: &self.vertices }
    }

    /// The facets, and a guess for each: the last answer, or a seed not far away; to be replaced by a nearer one if `better`.
    pub(super) fn guesses(&mut self, diagram: Diagram<'_>, better: bool, token: &Token) -> (Stretch<'_>, &mut [u32]) {
        let mut starts = std::mem::take(&mut self.starts);
        if starts.is_empty() || self.seeds > diagram.seeds.len() {
            let all = self.all();
            starts.resize(all.len(), 0);
            starts.par_chunks_mut(CHUNK).enumerate().for_each(|(c, part)| {
                for (k, start) in part.iter_mut().enumerate() {
                    // A query may look at all seeds.
                    if k.is_multiple_of(ASKED) && token.is_stopped() {
                        return;
                    }
                    *start = diagram.index.near(all.centroid(c * CHUNK + k));
                }
            });
            self.seeds = diagram.seeds.len();
        }
        if better {
            self.seeds = diagram.seeds.len();
        }
        self.starts = starts;
        let all = Stretch { facets: &self.facets, corners: &self.corners, vertices: &self.vertices };
        (all, &mut self.starts)
    }
}
