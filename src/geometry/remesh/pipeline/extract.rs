//! The triangulation of a diagram: a draft, and the result of the best one.
//!
//! Purpose: [`Extraction::draft`] makes a triangulation of the dual of the last seeds: repairs it, places its vertices and
//! fits them. [`Extraction::finish`] recovers lost edges of curves, and improves what needs it.
//! Invariant: the draft is oriented as the input; corners stay where the input has them. No place ends up farther
//! away, but where facets would cross others.
//! Must not know: iterations, options but those of its own.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::crossings::crossing_facets;
use crate::mesh::csr::Csr;
use crate::mesh::edges::undirected;
use crate::mesh::features::CurveKind;
use crate::remesh::constants::{CORNER_ROUNDING, OFF_CURVE_SHARE};
use crate::remesh::distance::{HausdorffEstimate, InputSamples, Reference, SurfaceSample, missed_places};
use crate::remesh::features::KeptCurves;
use crate::remesh::features::envelope::CurveEnvelope;
use crate::remesh::fit::{self, Target};
use crate::remesh::improve::MeshEditor;
use crate::remesh::improve::exchange::exchange;
use crate::remesh::improve::flat::flatten;
use crate::remesh::improve::places::{improve, recover_edge, round_off};
use crate::remesh::improve::shapes::{Mobility, MotionBounds, improve_shapes, restore, tighten};
use crate::remesh::manifold::{LocalMesh, boundary_ears, notches, repair, rims};
use crate::remesh::report::{AdaptedFigures, RepairFigures};
use crate::remesh::triangle::Shapes;
use crate::remesh::{Placement, RemeshError};
use crate::rvd::{Surface, dual};
use crate::tasks;
use crate::token::{Stopped, Token};

pub(super) struct Extraction<'a> {
    pub(super) divided: &'a TriMesh,
    pub(super) surface: &'a Surface,
    pub(super) curves: &'a KeptCurves,
    pub(super) placement: Placement,
    /// Seeds from this one on were added where the result was far from the input. They stay there.
    pub(super) first_added: u32,
    /// Places of the input farther away than this were missed, unit frame; a share of an edge if `None`.
    pub(super) tolerance: Option<f64>,
    /// Whether seeds are added until nothing is missed.
    pub(super) adds: bool,
    pub(super) shapes: Shapes,
    /// Where it is stopped, a draft is left as it is and must not be used.
    pub(super) token: &'a Token,
}

pub(super) struct Draft<'a> {
    /// Caller's coordinates.
    pub(super) positions: Vec<DVec3>,
    pub(super) facets: Vec<[u32; 3]>,
    pub(super) vertex_seed: Vec<u32>,
    /// For each segment of the curves its edge, if it is there.
    pub(super) curve_edges: Vec<Option<[u32; 2]>>,
    /// Vertices that share a corner that stays with others. Until the draft is finished they are as far beside it as repair puts them.
    pub(super) at_corners: Vec<u32>,
    pub(super) repair: RepairFigures,
    pub(super) fitted: Option<Fitted<'a>>,
    pub(super) missed: Missed,
    pub(super) seeds: usize,
}

pub(super) struct Fitted<'a> {
    /// Unit frame. Its facets are those of the draft.
    pub(super) mesh: LocalMesh,
    pub(super) target: Target,
    pub(super) envelope: CurveEnvelope,
    /// The input that improved places are compared with.
    pub(super) reference: Reference<'a>,
    /// Distance from the input around each vertex.
    pub(super) distances: Vec<f64>,
}

/// What a draft lacks of the input.
#[derive(Clone, Default)]
pub(super) struct Missed {
    /// Places that it is far from, with the nearest seed, by falling deviation; unit frame. Empty if it was not fitted.
    pub(super) places: Vec<(u32, DVec3)>,
    /// Hausdorff distance, unit frame; 0 if the vertices were not fitted.
    pub(super) deviation: f64,
    /// Seeds without a vertex, other than those of curves: the surface in their cells lies back to back.
    pub(super) seeds_without_vertex: Vec<u32>,
    /// Where as many seeds are of use: midpoints of long edges, unit frame.
    pub(super) long_edge_midpoints: Vec<DVec3>,
}

impl<'a> Extraction<'a> {
    /// The dual made a triangulation: repaired, its vertices placed, with the seed of each vertex.
    pub(super) fn draft(&self, dual: &dual::Dual, seeds: &[DVec3]) -> Result<Draft<'a>, RemeshError> {
        let at_corner = self.parts_at_corners(dual);
        let positions = self.vertex_positions(dual, &at_corner, seeds);
        self.token.check()?;
        let repaired = repair::repair(&positions, &dual.triangles, self.token)?;
        if repaired.facets.is_empty() {
            let too_few = RemeshError::too_few(seeds.len());
            return Err(if repair::all_cancel(self.surface.welded()) { RemeshError::NoThickness } else { too_few });
        }
        let vertex_seed: Vec<u32> = repaired.source.iter().map(|&c| dual.components[c as usize].seed).collect();
        // Ascending, as the components are.
        let present = vertex_seed.chunk_by(|a, b| a == b).count();
        let repair = RepairFigures {
            split_cells: dual.split_cells,
            not_disks: dual.not_disks.len(),
            multiple_edges: dual.multiple_edges.len(),
            multiple_boundary_arcs: dual.multiple_boundary_arcs.len(),
            inconsistent_vertices: dual.inconsistent,
            seeds_without_vertex: seeds.len() - present,
            extra_vertices: vertex_seed.len() - present,
            ..repaired.figures
        };
        let (positions, mut facets) = (repaired.positions, repaired.facets);
        let mut curve_edges = self.curves.edges_in(&facets, &vertex_seed);
        let missing = self.curves.missing(&curve_edges, &vertex_seed, |kind| kind == CurveKind::Boundary);
        // On a lifted surface the cell of a crease's seed may reach the boundary too.
        let on_boundaries = if self.shapes == Shapes::Round { Vec::new() } else { self.curves.on_boundaries() };
        let is_free = |v: u32| {
            let seed = vertex_seed[v as usize] as usize;
            seed >= self.curves.seeds.len() || on_boundaries.get(seed).is_some_and(|on| !on)
        };
        if boundary_ears::fill(&positions, &mut facets, &missing, is_free) > 0 {
            curve_edges = self.curves.edges_in(&facets, &vertex_seed);
        }
        if self.shapes != Shapes::Round {
            // An edge of the surface's own boundary is between two cells that meet it.
            let meets = |&v: &u32| dual.at_boundary.binary_search(&repaired.source[v as usize]).is_ok();
            let is_rim = |edge: [u32; 2]| edge.iter().all(meets);
            if boundary_ears::close_gaps(&positions, &mut facets, is_rim, self.token)? > 0 {
                curve_edges = self.curves.edges_in(&facets, &vertex_seed);
            }
        }
        let (fitted, missed, seeds) = (None, Missed::default(), seeds.len());
        let at_corners =
            (0..).zip(&repaired.source).filter(|(_, part)| at_corner.contains(part)).map(|(v, _)| v).collect();
        let mut draft =
            Draft { positions, facets, vertex_seed, curve_edges, at_corners, repair, fitted, missed, seeds };
        match (self.placement, self.shapes) {
            (Placement::Fitted, _) => self.fit(&mut draft, &repaired.source, dual),
            (_, Shapes::Round) => {}
            _ => self.flip(&mut draft, &repaired.source, dual),
        }
        self.token.check()?;
        Ok(draft)
    }

    /// Improves the worst facets, if they are to be round; where `hold_curves`, without the vertices of curves.
    fn improve_shapes(
        &self,
        mesh: &mut LocalMesh,
        draft: &Draft<'_>,
        fixed: &[bool],
        envelope: &CurveEnvelope,
        hold_curves: bool,
    ) {
        if self.shapes != Shapes::Round {
            return;
        }
        let mut mobility = mobility(&mesh.positions, &draft.curve_edges, fixed);
        let held = mobility.iter_mut().filter(|m| hold_curves && **m != Mobility::Free);
        held.for_each(|m| *m = Mobility::Fixed);
        let off_curve = self.tolerance.map_or(f64::INFINITY, |tolerance| OFF_CURVE_SHARE * tolerance);
        improve_shapes(mesh, MotionBounds { mobility: &mobility, envelope, off_curve }, self.token);
    }

    /// Where the dual's vertices go, caller's coordinates. A cell in one piece has its vertex at its seed, which is on the
    /// surface, or at its centroid; a component of a split cell has it at the closest point to its own centroid, but for the largest of
    /// a curve's seed.
    fn vertex_positions(&self, dual: &dual::Dual, at_corner: &HashSet<u32>, seeds: &[DVec3]) -> Vec<DVec3> {
        let frame = self.surface.frame();
        let closest = dual.components.iter().any(|c| !c.whole).then(|| ClosestPoint::new(self.divided));
        // The largest part of a cell has its vertex on the curve; a fit takes it on from there.
        let mut largest: HashMap<u32, f64> = HashMap::new();
        let on_curve = |seed: u32| match self.placement {
            Placement::Fitted => self.curves.has_seed(seed),
            _ => self.curves.stays(seed),
        };
        for c in dual.components.iter().filter(|c| !c.whole && on_curve(c.seed)) {
            let area = largest.entry(c.seed).or_default();
            *area = area.max(c.area);
        }
        let is_at_seed =
            |k: u32, c: &dual::Component| c.whole || largest.get(&c.seed) == Some(&c.area) || at_corner.contains(&k);
        let place = |(k, c): (u32, &dual::Component)| match &closest {
            _ if self.curves.has_seed(c.seed) && is_at_seed(k, c) => self.curves.position(self.divided, frame, c.seed),
            _ if self.placement == Placement::Centroids => frame.to_world(c.centroid),
            Some(tree) if !c.whole && !self.token.is_stopped() => tree.project(frame.to_world(c.centroid)).position,
            _ => frame.to_world(seeds[c.seed as usize]),
        };
        (0..).zip(&dual.components).map(place).collect()
    }

    /// Parts of split cells that have the vertex of a corner that stays: all of them meet there, as where a boundary touches itself.
    fn parts_at_corners(&self, dual: &dual::Dual) -> HashSet<u32> {
        let is_split = |c: &dual::Component| !c.whole && self.curves.is_corner(c.seed) && self.curves.stays(c.seed);
        if !dual.components.iter().any(is_split) {
            return HashSet::new();
        }
        let has_corner = |piece: &&dual::Piece| {
            let component = &dual.components[piece.component as usize];
            let facet = self.surface.welded()[piece.facet as usize];
            // Seeds of corners differ from their vertices by rounding.
            let is_at =
                |k: usize, seed: DVec3| self.surface.positions()[facet[k] as usize].distance(seed) <= CORNER_ROUNDING;
            let seed = is_split(component).then(|| self.curves.seeds.seeds[component.seed as usize]);
            seed.is_some_and(|seed| (0..3).any(|k| piece.corners & (1 << k) != 0 && is_at(k, seed)))
        };
        dual.pieces.iter().filter(has_corner).map(|piece| piece.component).collect()
    }

    /// Flips edges of a draft whose vertices stay on the input, or at their centroids. `component` is by vertex.
    fn flip(&self, draft: &mut Draft<'a>, component: &[u32], dual: &dual::Dual) {
        let (vertex, unit, kept) = (vertex_of(component, dual), self.unit(draft), kept_edges(draft));
        let mut mesh = LocalMesh::new(unit, std::mem::take(&mut draft.facets), kept);
        let (input, reference) = self.input(&vertex, dual, draft.positions.len());
        let stays = |&s: &u32| self.placement != Placement::Surface || self.curves.has_seed(s);
        let fixed = draft.vertex_seed.iter().map(stays).collect();
        let mut target = Target { input, curves: Vec::new(), fixed };
        fit::flip(&mut mesh, &mut target, &reference, self.shapes, self.token);
        let (frame, (positions, facets)) = (self.surface.frame(), mesh.into_parts());
        draft.facets = facets;
        let places = draft.positions.iter_mut().zip(positions);
        places.filter(|(p, u)| frame.to_unit(**p) != *u).for_each(|(p, u)| *p = frame.to_world(u));
        draft.curve_edges = self.curves.edges_in(&draft.facets, &draft.vertex_seed);
    }

    fn unit(&self, draft: &Draft<'_>) -> Vec<DVec3> {
        let frame = self.surface.frame();
        tasks::map(draft.positions.len(), |v| frame.to_unit(draft.positions[v]))
    }

    /// Moves the draft's vertices to where facets are nearest to the input. Corners stay. `component` is by vertex.
    fn fit(&self, draft: &mut Draft<'a>, component: &[u32], dual: &dual::Dual) {
        let vertex = vertex_of(component, dual);
        // Several sheets have the vertices of a curve where they meet, and rims have those that they had.
        let stays: Vec<bool> = draft.vertex_seed.iter().map(|&s| self.curves.stays(s)).collect();
        let is_fixed = |(&s, &stays): (&u32, &bool)| self.curves.is_corner(s) || s >= self.first_added || stays;
        let fixed: Vec<bool> = draft.vertex_seed.iter().zip(&stays).map(is_fixed).collect();
        let curves = self.curves.samples(&draft.curve_edges);
        let unit = self.unit(draft);
        // Added seeds bring edges to the curves. An envelope as well would fold facets between them.
        let envelope = CurveEnvelope::new(&unit, &fixed, if self.adds { &[] } else { &curves });
        let facets = std::mem::take(&mut draft.facets);
        // Most poor facets are improved where the fit brings their vertices back to the surface. Curves have not settled yet.
        let improved = || {
            let mut mesh = LocalMesh::new(unit, facets, kept_edges(draft));
            self.improve_shapes(&mut mesh, draft, &fixed, &envelope, true);
            mesh
        };
        let (mut mesh, (input, reference)) = rayon::join(improved, || self.input(&vertex, dual, draft.positions.len()));
        let mut target = Target { input, curves, fixed };
        fit::fit(&mut mesh, &mut target, self.shapes, self.token);
        restore(&mut mesh, &envelope, self.token);
        self.improve_shapes(&mut mesh, draft, &target.fixed, &envelope, false);
        for v in tighten(&mut mesh, &envelope, (&target.fixed, &stays), self.token) {
            target.fixed[v as usize] = false;
        }
        let HausdorffEstimate { missed, largest, by_vertex } =
            HausdorffEstimate::of(&mesh, &target.input, self.tolerance, self.token);
        let places = missed.into_iter().map(|(v, place)| (draft.vertex_seed[v as usize], place)).collect();
        let mut there = vec![false; draft.seeds];
        draft.vertex_seed.iter().for_each(|&s| there[s as usize] = true);
        let lost: Vec<_> =
            (self.curves.seeds.len() as u32..draft.seeds as u32).filter(|&s| !there[s as usize]).collect();
        let long_edge_midpoints = long_edge_midpoints(&mesh.positions, mesh.facets(), &target.fixed, lost.len());
        draft.missed = Missed { places, deviation: largest, seeds_without_vertex: lost, long_edge_midpoints };
        draft.fitted = Some(Fitted { mesh, target, envelope, reference, distances: by_vertex });
    }

    /// The input by vertex of the draft: a sample a piece, vertices and facets. `vertex` is by component of the dual.
    fn input(&self, vertex: &[u32], dual: &dual::Dual, vertices: usize) -> (InputSamples, Reference<'a>) {
        let surface = self.surface;
        let of = |p: &dual::Piece| if p.area > 0.0 { vertex[p.component as usize] } else { u32::MAX };
        let owners: Vec<u32> = tasks::map(dual.pieces.len(), |k| of(&dual.pieces[k]));
        let sample = |k: usize| {
            let p = &dual.pieces[k];
            SurfaceSample { position: p.centroid, normal: surface.normal(p.facet), area: p.area }
        };
        // The owner of the first piece that has the vertex of the input as a corner.
        let mut owner_of = vec![u32::MAX; surface.positions().len()];
        for (p, &owner) in dual.pieces.iter().zip(&owners).filter(|(p, owner)| p.corners != 0 && **owner != u32::MAX) {
            let facet = surface.welded()[p.facet as usize];
            for corner in (0..3).filter(|c| p.corners & (1 << c) != 0) {
                let known = &mut owner_of[facet[corner] as usize];
                *known = if *known == u32::MAX { owner } else { *known };
            }
        }
        let input_vertices = Csr::group(vertices, &owner_of, |v| surface.positions()[v]);
        let facets = Csr::group(vertices, &owners, |k| dual.pieces[k].facet);
        let reference = Reference { surface, facets, vertices: input_vertices.clone() };
        (InputSamples { samples: Csr::group(vertices, &owners, sample), vertices: input_vertices }, reference)
    }

    /// The draft improved locally, in the caller's coordinates.
    pub(super) fn finish(&self, mut draft: Draft<'a>) -> Result<Built, RemeshError> {
        let mut missed = 0;
        if let Some(mut fitted) = draft.fitted.take() {
            missed = self.improve(&mut draft, &mut fitted)?;
            self.token.check()?;
            let frame = self.surface.frame();
            if self.shapes != Shapes::Round {
                let start = self.unit(&draft);
                fit::uncross(&mut fitted.mesh, &start, &fitted.target.fixed, self.token)?;
            }
            let (positions, facets) = fitted.mesh.into_parts();
            draft.facets = facets;
            let moved = draft.positions.iter_mut().zip(positions).zip(&fitted.target.fixed);
            moved.filter(|(_, fixed)| !**fixed).for_each(|((p, u), _)| *p = frame.to_world(u));
        }
        let frame = self.surface.frame();
        for &v in &draft.at_corners {
            draft.positions[v as usize] = self.curves.position(self.divided, frame, draft.vertex_seed[v as usize]);
        }
        self.straighten_rims(&mut draft);
        let Draft { positions, facets, vertex_seed, curve_edges, repair, seeds, .. } = draft;
        // Only one thing can be wrong with it: seeds on a line leave no facet with an area.
        let mesh = TriMesh::new(positions, facets).map_err(|_| RemeshError::too_few(seeds))?;
        let segments = curve_edges;
        let curve_edges = segments.iter().flatten().copied().collect();
        Ok(Built { mesh, vertex_seed, segments, curve_edges, repair, missed, metric: None })
    }

    /// Takes the vertices within edges that stay out of the draft, and those that keep boundaries from edges that they have to have.
    fn straighten_rims(&self, draft: &mut Draft<'_>) {
        let within = self.curves.seeds_within_rims();
        let mut of_seed: HashMap<u32, Vec<u32>> = within.iter().map(|&seed| (seed, Vec::new())).collect();
        for (&seed, v) in draft.vertex_seed.iter().zip(0..) {
            of_seed.entry(seed).and_modify(|vertices| vertices.push(v));
        }
        let mut vertices: Vec<u32> = within.iter().flat_map(|seed| &of_seed[seed]).copied().collect();
        let before = draft.facets.len();
        vertices.extend(self.close_boundaries(draft, false));
        if vertices.is_empty() && draft.facets.len() == before {
            return;
        }
        let gone = rims::take_out(&draft.positions, &mut draft.facets, &vertices);
        let mut number = vec![u32::MAX; draft.positions.len()];
        let kept: Vec<usize> = (0..draft.positions.len()).filter(|&v| !gone.contains(&(v as u32))).collect();
        kept.iter().zip(0..).for_each(|(&v, k)| number[v] = k);
        draft.positions = kept.iter().map(|&v| draft.positions[v]).collect();
        draft.vertex_seed = kept.iter().map(|&v| draft.vertex_seed[v]).collect();
        draft.facets.iter_mut().for_each(|t| *t = t.map(|v| number[v as usize]));
        draft.curve_edges = self.curves.edges_in(&draft.facets, &draft.vertex_seed);
        self.close_boundaries(draft, true);
        draft.curve_edges = self.curves.edges_in(&draft.facets, &draft.vertex_seed);
    }

    /// As [`notches::close`], for the boundaries that have to have all of their edges.
    fn close_boundaries(&self, draft: &mut Draft<'_>, all: bool) -> Vec<u32> {
        let missing = self.curves.missing_closing(&draft.curve_edges, &draft.vertex_seed);
        if missing.is_empty() {
            return Vec::new();
        }
        let Draft { positions, facets, vertex_seed, .. } = draft;
        let on_boundaries = self.curves.on_boundaries();
        let may_fill = |v: u32| !on_boundaries.get(vertex_seed[v as usize] as usize).is_some_and(|on| *on);
        let mut out = notches::close(positions, facets, &missing, may_fill, all);
        // Vertices of creases stay.
        out.retain(|&v| !self.curves.has_seed(vertex_seed[v as usize]));
        out
    }

    /// Recovers edges of curves and improves the places that need it. Returns how many places are still far.
    fn improve(&self, draft: &mut Draft<'a>, fitted: &mut Fitted<'a>) -> Result<usize, Stopped> {
        let absent = self.curves.missing(&draft.curve_edges, &draft.vertex_seed, |_| true);
        if !absent.is_empty() {
            let mobility = mobility(&fitted.mesh.positions, &draft.curve_edges, &fitted.target.fixed);
            let mut editor = MeshEditor::new(&mut fitted.mesh, &mobility, self.shapes, &fitted.reference, self.token);
            let recover = |&ends: &[u32; 2]| {
                !self.token.is_stopped() && recover_edge(&mut editor, ends, self.curves.are_joined())
            };
            if absent.into_iter().filter(recover).count() > 0 {
                self.find_curves(draft, &mut fitted.mesh);
                self.improve_shapes(&mut fitted.mesh, draft, &fitted.target.fixed, &fitted.envelope, false);
                let input = &fitted.target.input;
                fitted.distances = HausdorffEstimate::of(&fitted.mesh, input, self.tolerance, self.token).by_vertex;
            }
        }
        let Fitted { mesh, target, reference, distances, .. } = fitted;
        let mobility = mobility(&mesh.positions, &draft.curve_edges, &target.fixed);
        let mut editor = MeshEditor::new(mesh, &mobility, self.shapes, reference, self.token);
        let mut improved = improve(&mut editor, distances);
        let is_even = !self.adds && self.tolerance.is_none() && self.surface.is_uniform();
        if is_even && self.shapes == Shapes::Round {
            improved += self.round_off(mesh, &mobility, reference)?;
        }
        improved += flatten(mesh, &mobility, reference, self.token)?;
        let before = draft.missed.places.len();
        let mut missed = before;
        if improved > 0 || before > 0 {
            self.find_curves(draft, mesh);
            // Improvement takes nothing farther away, but a place's nearest facet may have left the one-ring that is searched.
            missed = missed_places(mesh, &target.input, self.tolerance, self.token).len().min(before);
        }
        if matches!(self.shapes, Shapes::Nearest(_)) && !self.adds {
            let free: Vec<bool> = mobility.iter().map(|of| *of == Mobility::Free).collect();
            for (v, place) in exchange(mesh, (&target.input, reference), &free, self.shapes.wanted(), self.token) {
                draft.positions[v as usize] = self.surface.frame().to_world(place);
            }
            self.find_curves(draft, mesh);
        }
        Ok(missed)
    }

    /// As [`round_off`], unless more facets cross others then.
    fn round_off(
        &self,
        mesh: &mut LocalMesh,
        mobility: &[Mobility],
        reference: &Reference<'_>,
    ) -> Result<usize, Stopped> {
        let crossing = |mesh: &LocalMesh| {
            let now = TriMesh::new(mesh.positions.clone(), mesh.facets().to_vec());
            now.map_or(Ok(0), |now| crossing_facets(&now, self.token).map(|facets| facets.len()))
        };
        let before = mesh.clone();
        let improved = round_off(&mut MeshEditor::new(mesh, mobility, self.shapes, reference, self.token));
        if improved > 0 {
            let crossed = crossing(mesh)?;
            if crossed > 0 && crossed > crossing(&before)? {
                *mesh = before;
                return Ok(0);
            }
        }
        Ok(improved)
    }

    /// Finds the edges of curves again, in the order of the facets. They stay from now on.
    fn find_curves(&self, draft: &mut Draft<'_>, mesh: &mut LocalMesh) {
        draft.curve_edges = self.curves.edges_in(mesh.facets(), &draft.vertex_seed);
        draft.curve_edges.iter().flatten().for_each(|&edge| mesh.keep(edge));
    }
}

/// The vertex of each component of the dual, where it has one. `component` is by vertex.
fn vertex_of(component: &[u32], dual: &dual::Dual) -> Vec<u32> {
    let mut vertex = vec![u32::MAX; dual.components.len()];
    component.iter().enumerate().rev().for_each(|(v, &c)| vertex[c as usize] = v as u32);
    vertex
}

fn kept_edges(draft: &Draft<'_>) -> HashSet<[u32; 2]> {
    draft.curve_edges.iter().flatten().map(|&e| undirected(e)).collect()
}

/// The midpoints of the longest edges with free ends, `count` of them. No two edges have an end in common.
fn long_edge_midpoints(positions: &[DVec3], facets: &[[u32; 3]], fixed: &[bool], count: usize) -> Vec<DVec3> {
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

/// How each vertex may move: vertices with two edges of curves along these, other ends of such edges hardly at all.
fn mobility(positions: &[DVec3], curve_edges: &[Option<[u32; 2]>], fixed: &[bool]) -> Vec<Mobility> {
    let mut ends: Vec<(u32, u32)> = curve_edges.iter().flatten().flat_map(|&[a, b]| [(a, b), (b, a)]).collect();
    ends.sort_unstable();
    let of = |&fixed: &bool| if fixed { Mobility::Fixed } else { Mobility::Free };
    let mut mobility: Vec<Mobility> = fixed.iter().map(of).collect();
    for group in ends.chunk_by(|a, b| a.0 == b.0) {
        let own = &mut mobility[group[0].0 as usize];
        if *own == Mobility::Free {
            *own = match group {
                [(_, a), (_, b)] => (positions[*b as usize] - positions[*a as usize])
                    .try_normalize()
                    .map_or(Mobility::End, Mobility::Along),
                _ => Mobility::End,
            };
        }
    }
    mobility
}

pub(super) struct Built {
    pub(super) mesh: TriMesh,
    pub(super) vertex_seed: Vec<u32>,
    /// For each segment of the curves its edge, if it is there; before an adaptation to a metric, if there was one.
    pub(super) segments: Vec<Option<[u32; 2]>>,
    pub(super) curve_edges: Vec<[u32; 2]>,
    pub(super) repair: RepairFigures,
    /// Lengths in the metric, if there is one.
    pub(super) metric: Option<AdaptedFigures>,
    /// Places of the input that it is still far from.
    pub(super) missed: usize,
}
