//! Pieces as the dual sees them.
//!
//! Purpose: keep of each piece what the dual needs while batches of polygons pass by; then join
//! pieces to components across mesh edges and name the triangles.
//! Invariant: nothing is decided by coordinates. Must not know: how polygons were made.

use glam::DVec3;

use super::conditions::{self, Crossing, Stretch};
use super::{Component, Dual, Piece};
use crate::mesh::disjoint::DisjointSets;
use crate::mesh::edges::EdgeGroups;
use crate::rvd::cells::facet_edge;
use crate::rvd::{PieceBatch, Surface};

/// What the dual needs of each piece, in facet order.
#[derive(Default)]
pub(super) struct Pieces {
    facet: Vec<u32>,
    seed: Vec<u32>,
    area: Vec<f64>,
    /// ∫ p, unit frame.
    moment: Vec<DVec3>,
    /// Bit e: the piece reaches facet edge e.
    edges: Vec<u8>,
    /// Bit c: facet corner c is in the piece.
    corners: Vec<u8>,
    /// First piece of each facet.
    first: Vec<u32>,
    /// (piece of the lowest seed, the other two seeds in order).
    vertices: Vec<(u32, [u32; 2])>,
    /// Bisectors within facets: (piece of the lower seed, the higher seed).
    stretches: Vec<(u32, u32)>,
    /// Where they cross mesh edges: (facet * 3 + local edge, stretch).
    crossings: Vec<(u32, u32)>,
}

/// Pieces joined across mesh edges.
struct Joined {
    sets: DisjointSets,
    /// One piece for each mesh edge between two pieces of a cell.
    joints: Vec<u32>,
    /// Number of the edge of each half-edge.
    edge: Vec<u32>,
    /// Whether an edge has one facet.
    rim_edge: Vec<bool>,
    /// Whether a mesh vertex lies on a boundary.
    rim: Vec<bool>,
}

impl Pieces {
    pub(super) fn take(&mut self, batch: &PieceBatch) {
        for i in 0..batch.len() {
            let (facet, seed) = (batch.facet[i], batch.seed[i]);
            let piece = self.facet.len() as u32;
            self.first.resize(self.first.len().max(facet as usize + 1), piece);
            let range = batch.vertices(i);
            let (p, label) = (&batch.position[range.clone()], &batch.opposite[range]);
            let (mut area, mut moment) = (0.0, DVec3::ZERO);
            for k in 2..p.len() {
                let part = 0.5 * (p[k - 1] - p[0]).cross(p[k] - p[0]).length();
                area += part;
                moment += part / 3.0 * (p[0] + p[k - 1] + p[k]);
            }
            let (mut edges, mut corners) = (0, 0);
            for k in 0..label.len() {
                let (before, after) = (label[if k == 0 { label.len() - 1 } else { k - 1 }], label[k]);
                match (facet_edge(before), facet_edge(after)) {
                    (from, Some(e)) => {
                        edges |= 1 << e;
                        corners |= u8::from(from.is_some()) << e;
                    }
                    // Around the vertex, counter-clockwise: this cell, the one across the edge
                    // that arrives, the one across the edge that leaves.
                    (None, None) if before != after && seed < before && seed < after => {
                        self.vertices.push((piece, [before, after]));
                    }
                    _ => {}
                }
                if facet_edge(after).is_none() && seed < after {
                    let stretch = self.stretches.len() as u32;
                    self.stretches.push((piece, after));
                    let next = label[if k + 1 == label.len() { 0 } else { k + 1 }];
                    let ends = [before, next].into_iter().filter_map(facet_edge);
                    self.crossings.extend(ends.map(|e| (facet * 3 + e as u32, stretch)));
                }
            }
            self.facet.push(facet);
            self.seed.push(seed);
            self.area.push(area);
            self.moment.push(moment);
            self.edges.push(edges);
            self.corners.push(corners);
        }
    }

    pub(super) fn close(&mut self, facets: u32) {
        self.first.resize(facets as usize + 1, self.facet.len() as u32);
    }

    fn of_facet(&self, facet: u32) -> std::ops::Range<usize> {
        self.first[facet as usize] as usize..self.first[facet as usize + 1] as usize
    }

    /// The piece of `seed` in `facet`.
    fn find(&self, facet: u32, seed: u32) -> Option<u32> {
        let range = self.of_facet(facet);
        let start = range.start;
        self.seed[range].binary_search(&seed).ok().map(|k| (start + k) as u32)
    }

    /// Joins pieces of one cell across mesh edges, numbers the components, names the triangles, and
    /// counts what breaks the topology.
    pub(super) fn join(&self, surface: &Surface, seeds: usize) -> Dual {
        let mut joined = self.across_edges(surface);
        let (mut dual, component) = self.number(&mut joined.sets, seeds);
        let count = dual.components.len();
        let of = |pieces: &[u32]| pieces.iter().map(|&p| component[p as usize]).collect::<Vec<u32>>();
        let inner = self.inner_vertices(surface, &joined.rim);
        dual.not_disks = conditions::not_disks(count, &component, &of(&joined.joints), &of(&inner));
        let stretches: Vec<Stretch> =
            self.stretches.iter().map(|&(p, j)| [p, self.find(self.facet[p as usize], j).unwrap_or(p)]).collect();
        // A stretch of boundary ends where a bisector crosses it, for the cells on both sides.
        let at_rim = self.crossings.iter().filter(|(half, _)| joined.rim_edge[joined.edge[*half as usize] as usize]);
        let ends = at_rim.flat_map(|&(_, s)| stretches[s as usize]).map(|p| component[p as usize]);
        dual.multiple_rims = conditions::multiple_rims(count, ends);
        let crossings: Vec<Crossing> = self
            .crossings
            .iter()
            .map(|&(half, s)| {
                let (piece, j) = self.stretches[s as usize];
                ((joined.edge[half as usize], [self.seed[piece as usize], j]), s)
            })
            .collect();
        dual.multiple_edges = conditions::multiple_edges(&stretches, crossings, &component);
        dual.pieces = self.centres(&component);
        dual
    }

    fn centres(&self, component: &[u32]) -> Vec<Piece> {
        let centre = |p: usize| Piece {
            component: component[p],
            facet: self.facet[p],
            corners: self.corners[p],
            area: self.area[p],
            centroid: if self.area[p] > 0.0 { self.moment[p] / self.area[p] } else { DVec3::ZERO },
        };
        (0..self.facet.len()).map(centre).collect()
    }

    fn across_edges(&self, surface: &Surface) -> Joined {
        let mut joined = Joined {
            sets: DisjointSets::new(self.facet.len()),
            joints: Vec::new(),
            edge: vec![0; surface.facets().len() * 3],
            rim_edge: Vec::new(),
            rim: vec![false; surface.positions().len()],
        };
        let joining = surface.welded().iter().copied().enumerate().filter(|&(f, _)| surface.joins(f));
        EdgeGroups::new(surface.positions().len(), joining).for_each(|_, group| {
            let [first, rest @ ..] = group else { return };
            let number = joined.rim_edge.len() as u32;
            group.iter().for_each(|half| joined.edge[half.facet as usize * 3 + half.side] = number);
            joined.rim_edge.push(rest.is_empty());
            let (f, e) = (first.facet, first.side);
            if rest.is_empty() {
                let corners = surface.welded()[f as usize];
                [e, (e + 1) % 3].into_iter().for_each(|c| joined.rim[corners[c] as usize] = true);
            }
            for piece in self.of_facet(f).filter(|&p| self.edges[p] & (1 << e) != 0) {
                let mut met = false;
                for half in rest {
                    if let Some(other) = self.find(half.facet, self.seed[piece])
                        && self.edges[other as usize] & (1 << half.side) != 0
                    {
                        joined.sets.join(piece, other as usize);
                        met = true;
                    }
                }
                if met {
                    joined.joints.push(piece as u32);
                }
            }
        });
        joined
    }

    /// For each mesh vertex that is on no boundary, a piece that holds it.
    fn inner_vertices(&self, surface: &Surface, rim: &[bool]) -> Vec<u32> {
        let mut holder = vec![u32::MAX; surface.positions().len()];
        for (piece, &corners) in self.corners.iter().enumerate().filter(|(_, c)| **c != 0) {
            let facet = surface.welded()[self.facet[piece] as usize];
            for vertex in (0..3).filter(|c| corners & (1 << c) != 0).map(|c| facet[c] as usize) {
                if !rim[vertex] {
                    holder[vertex] = piece as u32;
                }
            }
        }
        holder.retain(|&piece| piece != u32::MAX);
        holder
    }

    /// The components and triangles, and the component of each piece.
    fn number(&self, sets: &mut DisjointSets, seeds: usize) -> (Dual, Vec<u32>) {
        // A root is the lowest piece of its set, so (seed, root) orders by first facet.
        let mut sums = vec![(0.0, DVec3::ZERO); self.facet.len()];
        let mut components = Vec::new();
        for piece in 0..self.facet.len() {
            let root = sets.root(piece);
            if root == piece {
                components.push((self.seed[piece], root));
            }
            sums[root].0 += self.area[piece];
            sums[root].1 += self.moment[piece];
        }
        components.sort_unstable();
        let mut dual = Dual { area: self.area.iter().sum(), ..Dual::default() };
        let mut number = vec![u32::MAX; self.facet.len()];
        let mut largest: Vec<u32> = vec![u32::MAX; seeds];
        for (seed, root) in components {
            let (area, moment) = sums[root];
            let id = dual.components.len() as u32;
            number[root] = id;
            let best = &mut largest[seed as usize];
            let whole = *best == u32::MAX;
            if whole || dual.components[*best as usize].area < area {
                *best = id;
            }
            let centroid = if area > 0.0 { moment / area } else { DVec3::ZERO };
            dual.components.push(Component { seed, area, centroid, whole });
        }
        for pair in 1..dual.components.len() {
            if dual.components[pair].seed == dual.components[pair - 1].seed {
                dual.split_cells += usize::from(dual.components[pair - 1].whole);
                dual.components[pair - 1].whole = false;
                dual.components[pair].whole = false;
            }
        }
        dual.empty_cells = largest.iter().filter(|&&id| id == u32::MAX).count();
        let component: Vec<u32> = (0..self.facet.len()).map(|piece| number[sets.root(piece)]).collect();
        for &(piece, others) in &self.vertices {
            let facet = self.facet[piece as usize];
            let corners = others.map(|seed| match self.find(facet, seed) {
                Some(p) => component[p as usize],
                None => {
                    dual.disputed += 1;
                    largest[seed as usize]
                }
            });
            let own = component[piece as usize];
            if corners.iter().all(|&c| c != u32::MAX) {
                dual.triangles.push([own, corners[0], corners[1]]);
            }
        }
        (dual, component)
    }
}
