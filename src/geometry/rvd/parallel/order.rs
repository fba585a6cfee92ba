//! The order in which facets are taken.
//!
//! Purpose: facets beside one another are taken one after the other, whatever order the mesh has them in, so that a task meets few
//! cells, and what it reads of vertices and seeds is at hand. Vertices are in that order too.
//! Invariant: every facet with area, once; the order depends on the surface alone. Must not know: tasks, lists.

use rayon::prelude::*;

use crate::knn::Point;
use crate::mesh::bvh::morton;
use crate::rvd::{Surface, incident::Diagram};
use crate::token::Token;

/// Facets that are looked at together at least.
const CHUNK: usize = 4096;
/// Facets between two looks at the token.
const ASKED: usize = 64;

/// Facets, and a seed near each.
#[derive(Default)]
pub(super) struct Order<P> {
    /// All facets with area along a curve that fills space, by their centroids.
    facets: Vec<u32>,
    corners: Vec<[u32; 3]>,
    vertices: Vec<Vertex<P>>,
    /// Of each facet, and how many seeds there were when they were found.
    starts: Vec<u32>,
    seeds: usize,
}

#[derive(Clone, Copy)]
#[repr(align(32))]
pub(super) struct Vertex<P> {
    pub p: P,
    pub weight: f64,
}

/// Facets one after the other, by their places among them.
#[derive(Clone, Copy)]
pub(super) struct Stretch<'a, P> {
    facets: &'a [u32],
    corners: &'a [[u32; 3]],
    vertices: &'a [Vertex<P>],
}

impl<'a, P: Point> Stretch<'a, P> {
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
    pub(super) fn vertices(&self, at: usize) -> [Vertex<P>; 3] {
        self.corners[at].map(|v| self.vertices[v as usize])
    }

    #[inline(always)]
    pub(super) fn corners(&self, at: usize) -> [P; 3] {
        self.vertices(at).map(|vertex| vertex.p)
    }

    /// As [`Surface::centroid`] has it.
    #[inline(always)]
    pub(super) fn centroid(&self, at: usize) -> P {
        let [a, b, c] = self.corners(at);
        (a + b + c) / 3.0
    }

    pub(super) fn chunks(self, size: usize) -> impl Iterator<Item = Stretch<'a, P>> {
        let each = self.facets.chunks(size).zip(self.corners.chunks(size));
        each.map(move |(facets, corners)| Stretch { facets, corners, ..self })
    }

    pub(super) fn par_chunks(self, size: usize) -> impl IndexedParallelIterator<Item = Stretch<'a, P>> {
        let each = self.facets.par_chunks(size).zip(self.corners.par_chunks(size));
        each.map(move |(facets, corners)| Stretch { facets, corners, ..self })
    }
}

impl<P: Point> Order<P> {
    /// Puts the facets in order, if they are not.
    pub(super) fn begin(&mut self, surface: &Surface<P>) {
        if !self.facets.is_empty() {
            return;
        }
        let all = (0..surface.facets().len() as u32).into_par_iter().with_min_len(CHUNK);
        let with_area = all.filter(|&f| !surface.skips(f as usize));
        let mut places: Vec<(u64, u32)> = with_area.map(|f| (morton(surface.centroid(f).place()), f)).collect();
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

    /// Takes a surface whose facets all have area and are in order, each with vertices of its own.
    pub(super) fn take_in_turn(&mut self, surface: &Surface<P>) {
        let count = surface.facets().len();
        self.facets.clear();
        self.facets.extend(0..count as u32);
        surface.facets().clone_into(&mut self.corners);
        let vertices = surface.positions().par_iter().zip(surface.weights()).with_min_len(CHUNK);
        vertices.map(|(&p, &weight)| Vertex { p, weight }).collect_into_vec(&mut self.vertices);
        self.starts.clear();
    }

    pub(super) fn len(&self) -> usize {
        self.facets.len()
    }

    pub(super) fn all(&self) -> Stretch<'_, P> {
        Stretch { facets: &self.facets, corners: &self.corners, vertices: &self.vertices }
    }

    /// The facets, and a guess for each: the last answer, or a seed not far away; to be replaced by a nearer one if `better`.
    pub(super) fn guesses(
        &mut self,
        diagram: Diagram<'_, P>,
        better: bool,
        token: &Token,
    ) -> (Stretch<'_, P>, &mut [u32]) {
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
