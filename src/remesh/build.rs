//! From a diagram to a surface.
//!
//! Purpose: the dual of the last seeds, repaired, with its vertices placed.
//! Invariant: the result is oriented as the input; vertices of corners are where the input has them.
//! Must not know: iterations, options but those of its own.

use std::collections::HashSet;

use glam::DVec3;
use rayon::prelude::*;

use super::fences::{CurveSample, Fences};
use super::ground::Ground;
use super::mend::{Bench, Vain};
use super::report::RepairFigures;
use super::tips::Tip;
use super::{Placement, RemeshError, curves, fit, notches, polish, regular, repair};
use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::csr::Csr;
use crate::mesh::edges::undirected;
use crate::mesh::features::CurveKind;
use crate::rvd::{Surface, dual};
use crate::token::Token;

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
    /// Whether seeds are added until nothing is missed.
    pub(super) adds: bool,
    /// What works on a draft ends early where it is stopped, and leaves a triangulation that nobody may use.
    pub(super) token: &'a Token,
}

/// The dual made a triangulation that may still change.
pub(super) struct Draft {
    /// Caller's coordinates.
    positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
    vertex_seed: Vec<u32>,
    curve_edges: Vec<Option<[u32; 2]>>,
    repair: RepairFigures,
    fitted: Option<Fitted>,
    /// How many seeds there were.
    seeds: usize,
}

/// Vertices that were fitted.
struct Fitted {
    /// Where they are, unit frame.
    positions: Vec<DVec3>,
    target: fit::Target,
    fences: Fences,
    /// Vertices and the input's facets that their cells meet.
    cells: Vec<(u32, u32)>,
    missed: Missed,
    /// How far it is from the input around each vertex.
    far: Vec<f64>,
}

/// What a result is far from.
#[derive(Clone, Default)]
pub(super) struct Missed {
    /// Places that it is far from, with the seed nearest to each, the farthest first; unit frame. Known
    /// where the vertices were fitted.
    pub(super) places: Vec<(u32, DVec3)>,
    /// How far the two surfaces are apart at most, unit frame; 0 where it is not known.
    pub(super) deviation: f64,
    /// Seeds, of no curve, that no vertex is of: what their cells hold closes without them.
    pub(super) lost: Vec<u32>,
    /// Where as many could be of use: middles of long edges, unit frame.
    pub(super) room: Vec<DVec3>,
}

impl Draft {
    /// What it is far from.
    pub(super) fn missed(&self) -> Missed {
        self.fitted.as_ref().map_or_else(Missed::default, |f| f.missed.clone())
    }

    /// Edges of curves, lower end first.
    fn curves(&self) -> HashSet<[u32; 2]> {
        self.curve_edges.iter().flatten().map(|&e| undirected(e)).collect()
    }
}

/// The dual made a surface.
pub(super) struct Built {
    pub(super) mesh: TriMesh,
    pub(super) vertex_seed: Vec<u32>,
    /// For each segment of the curves the result's edge, if it is there.
    pub(super) curve_edges: Vec<Option<[u32; 2]>>,
    pub(super) repair: RepairFigures,
    /// Places that it is still far from.
    pub(super) missed: usize,
}

impl Source<'_> {
    /// The dual made a triangulation: repaired, its vertices placed, with the seed of each vertex.
    pub(super) fn draft(&self, dual: &dual::Dual, seeds: &[DVec3]) -> Result<Draft, RemeshError> {
        let positions = self.vertex_positions(dual, seeds);
        self.token.check()?;
        let repaired = repair::repair(&positions, &dual.triangles, self.token)?;
        if repaired.facets.is_empty() {
            let too_few = RemeshError::too_few(seeds.len());
            return Err(if repair::all_cancel(self.surface.welded()) { RemeshError::NoThickness } else { too_few });
        }
        let repair = RepairFigures {
            split_cells: dual.split_cells,
            not_disks: dual.not_disks.len(),
            multiple_edges: dual.multiple_edges.len(),
            multiple_rims: dual.multiple_rims.len(),
            disputed_vertices: dual.disputed,
            ..repaired.figures
        };
        let vertex_seed: Vec<u32> = repaired.source.iter().map(|&c| dual.components[c as usize].seed).collect();
        // Ascending, as the components are.
        let present = vertex_seed.chunk_by(|a, b| a == b).count();
        let repair = RepairFigures {
            seeds_without_vertex: seeds.len() - present,
            further_vertices: vertex_seed.len() - present,
            ..repair
        };
        let (positions, mut facets) = (repaired.positions, repaired.facets);
        let mut curve_edges = self.kept.edges_in(&facets, &vertex_seed);
        let notches = self.kept.missing(&curve_edges, &vertex_seed, |kind| kind == CurveKind::Boundary);
        let is_free = |v: u32| vertex_seed[v as usize] as usize >= self.kept.seeds.len();
        if notches::fill(&positions, &mut facets, &notches, is_free) > 0 {
            curve_edges = self.kept.edges_in(&facets, &vertex_seed);
        }
        let mut draft = Draft { positions, facets, vertex_seed, curve_edges, repair, fitted: None, seeds: seeds.len() };
        if self.placement == Placement::Fitted {
            self.fit(&mut draft, &repaired.source, dual);
        }
        self.token.check()?;
        Ok(draft)
    }

    /// What is wrong with a draft in places, mended; its vertices in the caller's coordinates.
    pub(super) fn finish(&self, mut draft: Draft) -> Result<Built, RemeshError> {
        let mut missed = 0;
        if let Some(mut fitted) = draft.fitted.take() {
            missed = self.mend(&mut draft, &mut fitted);
            self.token.check()?;
            let frame = self.surface.frame();
            let moved = draft.positions.iter_mut().zip(fitted.positions).zip(&fitted.target.fixed);
            moved.filter(|(_, fixed)| !**fixed).for_each(|((p, u), _)| *p = frame.to_world(u));
        }
        let Draft { positions, facets, vertex_seed, curve_edges, repair, seeds, .. } = draft;
        // All that can be wrong with it is that no facet has an area: seeds on a line.
        let mesh = TriMesh::new(positions, facets).map_err(|_| RemeshError::too_few(seeds))?;
        Ok(Built { mesh, vertex_seed, curve_edges, repair, missed })
    }

    /// Returns how many places are still far from it.
    fn mend(&self, draft: &mut Draft, fitted: &mut Fitted) -> usize {
        let Fitted { positions, target, fences, cells, missed, far } = fitted;
        let before = missed.places.len();
        let ground = Ground::new(self.surface, positions.len(), cells, target.tips.all());
        let absent = self.kept.missing(&draft.curve_edges, &draft.vertex_seed, |_| true);
        if !absent.is_empty() {
            let (rails, curves) = (rails(positions, &draft.curve_edges, &target.fixed), draft.curves());
            let mut bench = Bench::new(positions, &mut draft.facets, &rails, (curves, &ground), self.token);
            let insert = |&ends: &[u32; 2]| !self.token.is_stopped() && regular::insert(&mut bench, ends);
            let there = absent.into_iter().filter(insert).count();
            if there > 0 {
                self.find_curves(draft);
                self.polish(positions, draft, target, fences);
                *far = fit::Far::of(positions, &draft.facets, target, self.tolerance, self.token).by_vertex;
            }
        }
        let (rails, curves) = (rails(positions, &draft.curve_edges, &target.fixed), draft.curves());
        let mut bench = Bench::new(positions, &mut draft.facets, &rails, (curves, &ground), self.token);
        // What is irregular has more room before its places are mended; some that has not then, has it after.
        let mut vain = Vain::default();
        let mut changed = regular::valences(&mut bench, &mut vain);
        changed += bench.mend(far);
        changed += regular::valences(&mut bench, &mut vain);
        if changed == 0 && missed.places.is_empty() {
            return 0;
        }
        self.find_curves(draft);
        // Nothing gets farther by being mended, but what is nearest to a place may not be looked at any more.
        fit::missed(positions, &draft.facets, target, self.tolerance, self.token).len().min(before)
    }

    /// Looks again which edges of curves there are, in facets' order.
    fn find_curves(&self, draft: &mut Draft) {
        draft.curve_edges = self.kept.edges_in(&draft.facets, &draft.vertex_seed);
    }

    fn polish(&self, positions: &mut [DVec3], draft: &mut Draft, target: &fit::Target, fences: &Fences) {
        let (rails, curves) = (rails(positions, &draft.curve_edges, &target.fixed), draft.curves());
        // Half of what the result may be off: chords between such places are off too.
        let off_curve = self.tolerance.map_or(f64::INFINITY, |tolerance| 0.5 * tolerance);
        let bounds = polish::Bounds { rails: &rails, fences, off_curve };
        polish::polish(positions, &mut draft.facets, bounds, &curves, self.token);
    }

    /// Where the dual's vertices go, caller's coordinates: a cell in one piece at its seed, which is
    /// on the surface, or its centroid; a component of a split cell at the closest point to its own centroid.
    fn vertex_positions(&self, dual: &dual::Dual, seeds: &[DVec3]) -> Vec<DVec3> {
        let frame = self.surface.frame();
        let closest = dual.components.iter().any(|c| !c.whole).then(|| ClosestPoint::new(self.mesh));
        let place = |c: &dual::Component| match &closest {
            _ if (c.seed as usize) < self.kept.seeds.len() && c.whole => self.kept.position(self.mesh, frame, c.seed),
            _ if self.placement == Placement::Centroids => frame.to_world(c.centroid),
            Some(tree) if !c.whole && !self.token.is_stopped() => tree.project(frame.to_world(c.centroid)).position,
            _ => frame.to_world(seeds[c.seed as usize]),
        };
        dual.components.iter().map(place).collect()
    }

    /// Moves the draft's vertices to where its facets are nearest to the input ([`fit`]). Corners of curves stay.
    /// `component` is that of the dual for each vertex.
    fn fit(&self, draft: &mut Draft, component: &[u32], dual: &dual::Dual) {
        let mut vertex = vec![u32::MAX; dual.components.len()];
        component.iter().enumerate().rev().for_each(|(v, &c)| vertex[c as usize] = v as u32);
        let fixed = draft.vertex_seed.iter().map(|&s| self.kept.is_corner(s) || s >= self.first_added).collect();
        let mut target =
            self.target(&vertex, dual, draft.positions.len(), self.kept.samples(&draft.curve_edges), fixed);
        let own = |p: &dual::Piece| (p.area > 0.0).then(|| (vertex[p.component as usize], p.facet));
        let cells = dual.pieces.par_iter().filter_map(own).filter(|c| c.0 != u32::MAX).collect();
        let frame = self.surface.frame();
        let mut unit: Vec<DVec3> = draft.positions.par_iter().map(|&p| frame.to_unit(p)).collect();
        // Seeds that are added bring edges to the curves; to hold these there as well would fold facets between them.
        let fences = Fences::new(&unit, &target.fixed, if self.adds { &[] } else { &target.curves });
        fit::fit(&mut unit, &mut draft.facets, &target, self.token);
        fences.restore(&mut unit, &draft.facets, self.token);
        self.polish(&mut unit, draft, &target, &fences);
        for v in fences.tighten(&mut unit, &draft.facets, &target.fixed, self.token) {
            target.fixed[v as usize] = false;
        }
        let fit::Far { missed, deviation, by_vertex } =
            fit::Far::of(&unit, &draft.facets, &target, self.tolerance, self.token);
        let places = missed.into_iter().map(|(v, place)| (draft.vertex_seed[v as usize], place)).collect();
        let lost = self.lost(draft);
        let room = roomy(&unit, &draft.facets, &target.fixed, lost.len());
        let missed = Missed { places, deviation, lost, room };
        draft.fitted = Some(Fitted { positions: unit, target, fences, cells, missed, far: by_vertex });
    }

    /// See [`Missed::lost`].
    fn lost(&self, draft: &Draft) -> Vec<u32> {
        let mut there = vec![false; draft.seeds];
        draft.vertex_seed.iter().for_each(|&s| there[s as usize] = true);
        (self.kept.seeds.len() as u32..draft.seeds as u32).filter(|&s| !there[s as usize]).collect()
    }

    /// What there is to fit to: a sample a piece, and the input's vertices. `vertex` is that of the draft for each
    /// component of the dual.
    fn target(
        &self,
        vertex: &[u32],
        dual: &dual::Dual,
        vertices: usize,
        curves: Vec<CurveSample>,
        fixed: Vec<bool>,
    ) -> fit::Target {
        let surface = self.surface;
        let of = |p: &dual::Piece| if p.area > 0.0 { vertex[p.component as usize] } else { u32::MAX };
        let owners: Vec<u32> = dual.pieces.par_iter().map(of).collect();
        let sample = |k: usize| {
            let p = &dual.pieces[k];
            fit::Sample { position: p.centroid, normal: surface.normal(p.facet), area: p.area }
        };
        // The first piece that a vertex of the input is a corner of.
        let mut holder = vec![u32::MAX; surface.positions().len()];
        for (p, &owner) in dual.pieces.iter().zip(&owners).filter(|(p, owner)| p.corners != 0 && **owner != u32::MAX) {
            let facet = surface.welded()[p.facet as usize];
            for corner in (0..3).filter(|c| p.corners & (1 << c) != 0) {
                let holder = &mut holder[facet[corner] as usize];
                *holder = if *holder == u32::MAX { owner } else { *holder };
            }
        }
        let tip = |v: usize| Tip { position: surface.positions()[v], vertex: holder[v] };
        let tips = Csr::group(vertices, &holder, tip);
        fit::Target { samples: Csr::group(vertices, &owners, sample), curves, tips, fixed }
    }
}

/// The middles of the longest edges with free ends, `count` of them, none beside another.
fn roomy(positions: &[DVec3], facets: &[[u32; 3]], fixed: &[bool], count: usize) -> Vec<DVec3> {
    if count == 0 {
        return Vec::new();
    }
    let at = |v: u32| positions[v as usize];
    let edges = facets.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).filter(|[a, b]| a < b);
    let mut edges: Vec<(f64, [u32; 2])> = edges.map(|e| (at(e[0]).distance_squared(at(e[1])), e)).collect();
    edges.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut taken = fixed.to_vec();
    let free = |e: &[u32; 2]| !e.iter().any(|&v| std::mem::replace(&mut taken[v as usize], true));
    edges.into_iter().map(|(_, e)| e).filter(free).map(|[a, b]| at(a).midpoint(at(b))).take(count).collect()
}

/// How each vertex may move: those with two edges of curves along these, and other ends of curves hardly at all.
fn rails(positions: &[DVec3], curve_edges: &[Option<[u32; 2]>], fixed: &[bool]) -> Vec<polish::Rail> {
    let mut ends: Vec<(u32, u32)> = curve_edges.iter().flatten().flat_map(|&[a, b]| [(a, b), (b, a)]).collect();
    ends.sort_unstable();
    let of = |v: usize| match fixed[v] {
        true => polish::Rail::Fixed,
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
