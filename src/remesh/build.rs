//! From a diagram to a surface.
//!
//! Purpose: the dual of the last seeds, repaired, with its vertices placed.
//! Invariant: the result is oriented as the input; vertices of corners are where the input has them.
//! Must not know: iterations, options but those of its own.

use std::collections::HashSet;

use glam::DVec3;

use super::report::RepairFigures;
use super::tips::Tip;
use super::{Placement, RemeshError, curves, fit, flips, polish, repair};
use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::rvd::{Surface, dual};

/// What a result is made from.
pub(super) struct Source<'a> {
    pub(super) mesh: &'a TriMesh,
    pub(super) surface: &'a Surface,
    pub(super) kept: &'a curves::Kept,
    pub(super) placement: Placement,
    /// Seeds from this one on were added where the result was far from the input, and stay there.
    pub(super) first_added: u32,
    /// What is farther from the result than this was missed, unit frame; a share of an edge if `None`.
    pub(super) tolerance: Option<f64>,
}

/// The dual made a surface.
pub(super) struct Built {
    pub(super) mesh: TriMesh,
    pub(super) vertex_seed: Vec<u32>,
    /// For each segment of the curves the result's edge, if it is there.
    pub(super) curve_edges: Vec<Option<[u32; 2]>>,
    pub(super) repair: RepairFigures,
    /// Places that the result is far from, with the seed nearest to each, the farthest first; unit frame. Known
    /// where the vertices were fitted.
    pub(super) missed: Vec<(u32, DVec3)>,
    /// How far a vertex of the input is from the result at most, unit frame; 0 where it is not known.
    pub(super) deviation: f64,
}

impl Source<'_> {
    /// The dual made a surface: repaired, its vertices placed, with the seed of each vertex.
    pub(super) fn triangulated(&self, dual: &dual::Dual, seeds: &[DVec3]) -> Result<Built, RemeshError> {
        let positions = self.vertex_positions(dual, seeds);
        let repaired = repair::repair(&positions, &dual.triangles);
        let too_few = RemeshError::TooFewSeeds { seeds: seeds.len() };
        if repaired.facets.is_empty() {
            return Err(if repaired.figures.closed_pockets > 1 { RemeshError::NoThickness } else { too_few });
        }
        let figures = RepairFigures {
            split_cells: dual.split_cells,
            not_disks: dual.not_disks,
            multiple_edges: dual.multiple_edges,
            multiple_rims: dual.multiple_rims,
            disputed_vertices: dual.disputed,
            ..repaired.figures
        };
        let vertex_seed: Vec<u32> = repaired.source.iter().map(|&c| dual.components[c as usize].seed).collect();
        let (mut positions, mut facets) = (repaired.positions, repaired.facets);
        let curve_edges = self.kept.edges_in(&facets, &vertex_seed);
        let (mut missed, mut deviation) = (Vec::new(), 0.0);
        if self.placement == Placement::Fitted {
            let mut draft = Draft {
                positions: &mut positions,
                facets: &mut facets,
                source: &repaired.source,
                vertex_seed: &vertex_seed,
                curve_edges: &curve_edges,
            };
            (missed, deviation) = self.fit(&mut draft, dual);
        }
        // All that can be wrong with it is that no facet has an area: seeds on a line.
        let mesh = TriMesh::new(positions, facets).map_err(|_| too_few)?;
        Ok(Built { mesh, vertex_seed, curve_edges, repair: figures, missed, deviation })
    }

    /// Where the dual's vertices go, caller's coordinates: a cell in one piece at its seed, which is
    /// on the surface, or its centroid; a component of a split cell at the closest point to its own centroid.
    fn vertex_positions(&self, dual: &dual::Dual, seeds: &[DVec3]) -> Vec<DVec3> {
        let frame = self.surface.frame();
        let closest = dual.components.iter().any(|c| !c.whole).then(|| ClosestPoint::new(self.mesh));
        let place = |c: &dual::Component| match &closest {
            _ if (c.seed as usize) < self.kept.seeds.len() && c.whole => self.kept.position(self.mesh, frame, c.seed),
            _ if self.placement == Placement::Centroids => frame.to_world(c.centroid),
            Some(tree) if !c.whole => tree.project(frame.to_world(c.centroid)).position,
            _ => frame.to_world(seeds[c.seed as usize]),
        };
        dual.components.iter().map(place).collect()
    }

    /// Moves the result's vertices to where its facets are nearest to the input ([`fit`]). Corners of curves stay.
    /// Returns what was missed, and how far off the farthest place is.
    fn fit(&self, built: &mut Draft<'_>, dual: &dual::Dual) -> (Vec<(u32, DVec3)>, f64) {
        let mut vertex = vec![u32::MAX; dual.components.len()];
        built.source.iter().enumerate().rev().for_each(|(v, &c)| vertex[c as usize] = v as u32);
        let mut target = fit::Target {
            curves: self.kept.samples(built.curve_edges),
            fixed: built.vertex_seed.iter().map(|&s| self.kept.is_corner(s) || s >= self.first_added).collect(),
            ..fit::Target::default()
        };
        let mut first_tip: Vec<Option<u32>> = vec![None; self.surface.positions().len()];
        for p in dual.pieces.iter().filter(|p| p.area > 0.0 && vertex[p.component as usize] != u32::MAX) {
            let vertex = vertex[p.component as usize];
            let normal = self.surface.normal(p.facet);
            target.samples.push(fit::Sample { position: p.centroid, normal, area: p.area, vertex });
            for corner in (0..3).filter(|c| p.corners & (1 << c) != 0) {
                let v = self.surface.welded()[p.facet as usize][corner] as usize;
                if first_tip[v].is_none() {
                    first_tip[v] = Some(target.tips.len() as u32);
                    target.tips.push(Tip { position: self.surface.positions()[v], vertex });
                }
            }
        }
        let frame = self.surface.frame();
        let mut unit: Vec<DVec3> = built.positions.iter().map(|&p| frame.to_unit(p)).collect();
        fit::fit(&mut unit, built.facets, &target);
        let rails = rails(&unit, built.curve_edges, &target.fixed);
        let curves: HashSet<[u32; 2]> = built.curve_edges.iter().flatten().map(|&e| flips::sorted(e)).collect();
        polish::polish(&mut unit, built.facets, &rails, &curves);
        let (missed, deviation) = fit::missed(&unit, built.facets, &target, self.tolerance);
        for ((p, u), _) in built.positions.iter_mut().zip(unit).zip(&target.fixed).filter(|(_, fixed)| !**fixed) {
            *p = frame.to_world(u);
        }
        (missed.into_iter().map(|(v, place)| (built.vertex_seed[v as usize], place)).collect(), deviation)
    }
}

/// How each vertex may move: those with two edges of curves along these, and other ends of curves hardly at all.
fn rails(positions: &[DVec3], curve_edges: &[Option<[u32; 2]>], fixed: &[bool]) -> Vec<polish::Rail> {
    let mut ends: Vec<(u32, u32)> = curve_edges.iter().flatten().flat_map(|&[a, b]| [(a, b), (b, a)]).collect();
    ends.sort_unstable();
    let of = |v: usize| match fixed[v] {
        true => polish::Rail::Corner,
        false => polish::Rail::Free,
    };
    let mut rails: Vec<polish::Rail> = (0..positions.len()).map(of).collect();
    for group in ends.chunk_by(|a, b| a.0 == b.0) {
        let rail = &mut rails[group[0].0 as usize];
        if *rail == polish::Rail::Free {
            *rail = match group {
                [(_, a), (_, b)] => (positions[*b as usize] - positions[*a as usize])
                    .try_normalize()
                    .map_or(polish::Rail::Corner, polish::Rail::Along),
                _ => polish::Rail::Corner,
            };
        }
    }
    rails
}

/// A result whose vertices may still move.
struct Draft<'a> {
    positions: &'a mut [DVec3],
    facets: &'a mut [[u32; 3]],
    /// Component of the dual and seed of each vertex.
    source: &'a [u32],
    vertex_seed: &'a [u32],
    curve_edges: &'a [Option<[u32; 2]>],
}
