//! Pieces as the dual sees them.
//!
//! Purpose: keep of each piece what the dual needs while batches of polygons pass by; then join
//! pieces to components across mesh edges and name the triangles.
//! Invariant: nothing is decided by coordinates. Must not know: how polygons were made.

use glam::DVec3;

use super::{Component, Crossing, Dual, Piece, Stretch};
use crate::mesh::csr::ascending;
use crate::mesh::edges::{DisjointSets, EdgeGroups, Half};
use crate::rvd::{PieceBatch, Surface, facet_edge};
use crate::tasks;
use crate::token::{Stopped, Token};

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

struct Joined {
    sets: DisjointSets,
    /// One piece for each mesh edge between two pieces of a cell.
    joints: Vec<u32>,
    /// Number of the edge of each half-edge.
    edge: Vec<u32>,
    boundary_edge: Vec<bool>,
    /// Whether a mesh vertex lies on a boundary.
    boundary: Vec<bool>,
}

#[derive(Default)]
struct Seams {
    /// Half-edges with the number of their edge among these.
    halves: Vec<(u32, u32)>,
    boundary_edge: Vec<bool>,
    boundary: Vec<u32>,
    /// Pieces of one cell, and whether the first has no other partner before at this edge.
    pairs: Vec<(u32, u32, bool)>,
}

/// Components that are not disks, that have multiple boundary arcs, and pairs with multiple edges.
type Failing = (Vec<u32>, (Vec<u32>, Vec<[u32; 2]>));

/// Pieces that are one task.
const RUN: usize = 2048;

impl Pieces {
    pub(super) fn take(&mut self, batch: &PieceBatch) {
        let part = |run: usize| Self::of(batch, run * RUN..batch.len().min((run + 1) * RUN));
        let parts: Vec<Self> = tasks::alone(batch.len().div_ceil(RUN), part);
        self.facet.extend_from_slice(&batch.facet);
        self.seed.extend_from_slice(&batch.seed);
        for part in parts {
            let (piece, stretch) = (self.area.len() as u32, self.stretches.len() as u32);
            self.area.extend(part.area);
            self.moment.extend(part.moment);
            self.edges.extend(part.edges);
            self.corners.extend(part.corners);
            self.vertices.extend(part.vertices.into_iter().map(|(p, others)| (piece + p, others)));
            self.stretches.extend(part.stretches.into_iter().map(|(p, other)| (piece + p, other)));
            self.crossings.extend(part.crossings.into_iter().map(|(half, s)| (half, stretch + s)));
        }
    }

    /// What some pieces of a batch are, numbered from the first of them, but for facets and seeds.
    fn of(batch: &PieceBatch, range: std::ops::Range<usize>) -> Self {
        let mut part = Self::default();
        for i in range {
            let (facet, seed) = (batch.facet[i], batch.seed[i]);
            let piece = part.area.len() as u32;
            let range = batch.vertices(i);
            let (p, label) = (&batch.position[range.clone()], &batch.opposite[range]);
            let (mut area, mut moment) = (0.0, DVec3::ZERO);
            for k in 2..p.len() {
                let third = 0.5 * (p[k - 1] - p[0]).cross(p[k] - p[0]).length();
                area += third;
                moment += third / 3.0 * (p[0] + p[k - 1] + p[k]);
            }
            let (mut edges, mut corners) = (0, 0);
            for k in 0..label.len() {
                let (before, after) = (label[if k == 0 { label.len() - 1 } else { k - 1 }], label[k]);
                match (facet_edge(before), facet_edge(after)) {
                    (from, Some(e)) => {
                        edges |= 1 << e;
                        corners |= u8::from(from.is_some()) << e;
                    }
                    // Counter-clockwise around the vertex: this cell, that across the arriving edge, that across the leaving one.
                    (None, None) if before != after && seed < before && seed < after => {
                        part.vertices.push((piece, [before, after]));
                    }
                    _ => {}
                }
                if facet_edge(after).is_none() && seed < after {
                    let stretch = part.stretches.len() as u32;
                    part.stretches.push((piece, after));
                    let next = label[if k + 1 == label.len() { 0 } else { k + 1 }];
                    let ends = [before, next].into_iter().filter_map(facet_edge);
                    part.crossings.extend(ends.map(|e| (facet * 3 + e as u32, stretch)));
                }
            }
            part.area.push(area);
            part.moment.push(moment);
            part.edges.push(edges);
            part.corners.push(corners);
        }
        part
    }

    /// After the last batch.
    pub(super) fn close(&mut self, facets: u32) {
        let count = self.facet.len() as u32;
        self.first.reserve_exact(facets as usize + 1);
        for (&facet, piece) in self.facet.iter().zip(0..) {
            self.first.resize(self.first.len().max(facet as usize + 1), piece);
        }
        self.first.resize(facets as usize + 1, count);
    }

    fn of_facet(&self, facet: u32) -> std::ops::Range<usize> {
        self.first[facet as usize] as usize..self.first[facet as usize + 1] as usize
    }

    fn find(&self, facet: u32, seed: u32) -> Option<u32> {
        let range = self.of_facet(facet);
        let start = range.start;
        self.seed[range].binary_search(&seed).ok().map(|k| (start + k) as u32)
    }

    /// Joins pieces of one cell across mesh edges, numbers the components, names triangles, and finds what breaks the topology.
    pub(super) fn join(&self, surface: &Surface, seeds: usize, token: &Token) -> Result<Dual, Stopped> {
        token.check()?;
        let mut joined = self.across_edges(surface);
        token.check()?;
        let (dual, component) = self.number(&mut joined.sets, seeds);
        token.check()?;
        let count = dual.components.len();
        let failing = || self.failing(surface, &joined, count, &component);
        let (failing, pieces) = rayon::join(failing, || self.centres(&component));
        let (not_disks, (multiple_boundary_arcs, multiple_edges)) = failing;
        let at_boundary = self.at_boundary(&joined, &component);
        Ok(Dual { not_disks, multiple_boundary_arcs, multiple_edges, at_boundary, pieces, ..dual })
    }

    /// What breaks the topology, of `count` components.
    fn failing(&self, surface: &Surface, joined: &Joined, count: usize, component: &[u32]) -> Failing {
        let of = |pieces: &[u32]| pieces.iter().map(|&p| component[p as usize]).collect::<Vec<u32>>();
        let disks = || {
            let inner = self.inner_vertices(surface, &joined.boundary);
            super::not_disks(count, component, &of(&joined.joints), &of(&inner))
        };
        let edges = || {
            let other = |&(p, j): &(u32, u32)| [p, self.find(self.facet[p as usize], j).unwrap_or(p)];
            let stretches: Vec<Stretch> = tasks::map(self.stretches.len(), |k| other(&self.stretches[k]));
            // A stretch of boundary ends where a bisector crosses it, for the cells on both sides.
            let at_rim =
                self.crossings.iter().filter(|(half, _)| joined.boundary_edge[joined.edge[*half as usize] as usize]);
            let ends = at_rim.flat_map(|&(_, s)| stretches[s as usize]).map(|p| component[p as usize]);
            let boundary_arcs = super::multiple_boundary_arcs(count, ends);
            let crossing = |&(half, s): &(u32, u32)| -> Crossing {
                let (piece, j) = self.stretches[s as usize];
                ((joined.edge[half as usize], [self.seed[piece as usize], j]), s)
            };
            let crossings: Vec<Crossing> = tasks::map(self.crossings.len(), |k| crossing(&self.crossings[k]));
            (boundary_arcs, super::multiple_edges(&stretches, crossings, component))
        };
        rayon::join(disks, edges)
    }

    /// Components that have a part of a boundary edge.
    fn at_boundary(&self, joined: &Joined, component: &[u32]) -> Vec<u32> {
        if !joined.boundary_edge.contains(&true) {
            return Vec::new();
        }
        let is_boundary = |half: usize| joined.boundary_edge[joined.edge[half] as usize];
        let meets = |p: &usize| {
            let half = |e: usize| 3 * self.facet[*p] as usize + e;
            (0..3).any(|e| self.edges[*p] & (1 << e) != 0 && is_boundary(half(e)))
        };
        ascending((0..self.facet.len()).filter(meets).map(|p| component[p]))
    }

    fn centres(&self, component: &[u32]) -> Vec<Piece> {
        let centre = |p: usize| Piece {
            component: component[p],
            facet: self.facet[p],
            corners: self.corners[p],
            area: self.area[p],
            centroid: if self.area[p] > 0.0 { self.moment[p] / self.area[p] } else { DVec3::ZERO },
        };
        tasks::map(self.facet.len(), centre)
    }

    fn across_edges(&self, surface: &Surface) -> Joined {
        let joining = surface.welded().iter().copied().enumerate().filter(|&(f, _)| surface.joins(f));
        let groups = EdgeGroups::new(surface.positions().len(), joining);
        let seams = groups.gather(|seams: &mut Seams, _, group| self.across_edge(surface, group, seams));
        let sets = || {
            let mut sets = DisjointSets::new(self.facet.len());
            let pairs = seams.iter().flat_map(|seams| &seams.pairs);
            pairs.for_each(|&(a, b, _)| sets.join(a as usize, b as usize));
            // A seed with several points may have several pieces of a facet.
            let same = |p: &usize| (self.facet[*p - 1], self.seed[*p - 1]) == (self.facet[*p], self.seed[*p]);
            (1..self.facet.len()).filter(same).for_each(|p| sets.join(p - 1, p));
            sets
        };
        let rest = || {
            let mut edge = vec![0; surface.facets().len() * 3];
            let (mut boundary_edge, mut boundary) = (Vec::new(), vec![false; surface.positions().len()]);
            for seams in &seams {
                let number = boundary_edge.len() as u32;
                seams.halves.iter().for_each(|&(half, k)| edge[half as usize] = number + k);
                boundary_edge.extend_from_slice(&seams.boundary_edge);
                seams.boundary.iter().for_each(|&v| boundary[v as usize] = true);
            }
            let joints = seams.iter().flat_map(|seams| &seams.pairs).filter(|p| p.2).map(|p| p.0).collect();
            (joints, edge, boundary_edge, boundary)
        };
        let (sets, (joints, edge, boundary_edge, boundary)) = rayon::join(sets, rest);
        Joined { sets, joints, edge, boundary_edge, boundary }
    }

    fn across_edge(&self, surface: &Surface, group: &[Half], seams: &mut Seams) {
        let [first, rest @ ..] = group else { return };
        let number = seams.boundary_edge.len() as u32;
        seams.halves.extend(group.iter().map(|half| (half.facet * 3 + half.side as u32, number)));
        seams.boundary_edge.push(rest.is_empty());
        let (f, e) = (first.facet, first.side);
        if rest.is_empty() {
            let corners = surface.welded()[f as usize];
            seams.boundary.extend([e, (e + 1) % 3].map(|c| corners[c]));
        }
        for piece in self.of_facet(f).filter(|&p| self.edges[p] & (1 << e) != 0) {
            let mut met = false;
            for half in rest {
                if let Some(other) = self.find(half.facet, self.seed[piece])
                    && self.edges[other as usize] & (1 << half.side) != 0
                {
                    seams.pairs.push((piece as u32, other, !met));
                    met = true;
                }
            }
        }
    }

    /// For each mesh vertex that is on no boundary, a piece that holds it.
    fn inner_vertices(&self, surface: &Surface, boundary: &[bool]) -> Vec<u32> {
        let mut holder = vec![u32::MAX; surface.positions().len()];
        for (piece, &corners) in self.corners.iter().enumerate().filter(|(_, c)| **c != 0) {
            let facet = surface.welded()[self.facet[piece] as usize];
            for vertex in (0..3).filter(|c| corners & (1 << c) != 0).map(|c| facet[c] as usize) {
                if !boundary[vertex] {
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
        let mut roots = Vec::with_capacity(self.facet.len());
        for piece in 0..self.facet.len() {
            let root = sets.root(piece);
            roots.push(root as u32);
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
        let component: Vec<u32> = tasks::map(roots.len(), |k| number[roots[k] as usize]);
        let triangle = |&(piece, others): &(u32, [u32; 2])| {
            let facet = self.facet[piece as usize];
            let known = others.map(|seed| self.find(facet, seed).map(|p| component[p as usize]));
            let inconsistent = known.iter().filter(|c| c.is_none()).count();
            let [a, b] = [0, 1].map(|k| known[k].unwrap_or(largest[others[k] as usize]));
            ([component[piece as usize], a, b], inconsistent)
        };
        let triangles: Vec<([u32; 3], usize)> = tasks::map(self.vertices.len(), |k| triangle(&self.vertices[k]));
        dual.inconsistent = triangles.iter().map(|t| t.1).sum();
        dual.triangles = triangles.into_iter().map(|t| t.0).filter(|t| !t.contains(&u32::MAX)).collect();
        (dual, component)
    }
}
