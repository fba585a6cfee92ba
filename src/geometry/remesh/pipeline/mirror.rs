//! Surfaces that are symmetric at a plane.
//!
//! Purpose: [`remesh`] has one half of a surface remeshed and joins it with its mirror image. Invariant: each vertex of the other half is the
//! reflection of one of the first, to the bit; vertices of the seam lie in the plane, and both halves have them. Attributes are those of
//! the whole input, each half's own. Must not know: how a surface is remeshed.

mod half;

use std::collections::HashMap;
use std::time::Instant;

use glam::DVec3;

use super::carried::{Carried, carry};
use super::measured::compare;
use super::optimize;
use super::preprocess::match_reach;
use super::preprocess::preprocess;
use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind, weld_unless};
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::crossings::crossings;
use crate::mesh::edges::{sides, undirected};
use crate::mesh::features::Features;
use crate::mesh::measure::{Topology, coincident_vertices, topology_unless};
use crate::mesh::plane::Plane;
use crate::remesh::constants::HALF_COUNT_ROUNDS;
use crate::remesh::report::{CountReason, MirrorFigures};
use crate::remesh::{Remesh, RemeshError, RemeshOptions, Result, Seeds};
use crate::rvd::{RvdError, elapsed_ms};
use crate::token::Token;
use half::Half;

/// Remeshes a half.
type Run<'a> = &'a mut dyn FnMut(&TriMesh, &RemeshOptions) -> Result<Remesh>;

/// Remeshes the half that the normal of `plane` points to.
pub(super) fn remesh(
    given: &TriMesh,
    options: &RemeshOptions,
    plane: Plane,
    run: Run<'_>,
    token: &Token,
) -> Result<Remesh> {
    let begin = Instant::now();
    options.attributes.iter().try_for_each(|attributes| attributes.check_mesh(given))?;
    Features::check(given, options.crease_angle_deg, &options.creases, token)?;
    let class = weld_unless(given, token)?;
    let half = Half::of(given, plane, &class, token)?;
    let mut own = half.options((given, &class), options)?;
    let asked = options.seeds.drawn();
    // Of N vertices, s of them on the seam, a half has (N + s) / 2.
    let share = |points: usize| {
        let edge = (4.0 / 3f64.sqrt() * half.mesh.area() / points.max(1) as f64).sqrt();
        let on_seam = if edge > 0.0 { half.seam_length() / edge } else { 0.0 };
        (0.5 * (points as f64 + on_seam)).round().max(1.0) as usize
    };
    if let Some(most) = own.refine.as_mut().and_then(|refine| refine.max_points.as_mut()) {
        *most = share(*most);
    }
    let mut points = asked.map(share);
    let reach = match_reach(given);
    let input = preprocess(given, own.weld.map(|weld| weld.length(given)), token)?;
    // An asymmetric input is none that a result can be compared with.
    let doubled = half.doubled(plane)?;
    let symmetric = preprocess(&doubled, own.weld.map(|weld| weld.length(given)), token)?;
    let wanted = symmetric.figures.topology;
    let whole = |error: RemeshError| match (error, asked) {
        (RemeshError::TooFewSeeds { .. } | RemeshError::EdgeTooLong { .. }, asked) => {
            let edge_length = options.density.edge_length.filter(|_| asked.is_none());
            RemeshError::too_few(asked.unwrap_or(0)).for_surface(&wanted, doubled.area(), edge_length)
        }
        (error, _) => error,
    };
    for round in 0.. {
        if let (Seeds::Sample { points: own, .. }, Some(points)) = (&mut own.seeds, points) {
            *own = points;
        }
        let done = run(&half.mesh, &own).map_err(whole)?;
        token.check()?;
        let seam = Seam::of(&done, (plane, reach), options.keep_non_manifold, token)?;
        let is_manifold = |of: Topology| of.non_manifold_edges + of.non_manifold_vertices == 0;
        let was_manifold = is_manifold(done.report.result.topology);
        let reason = done.report.vertex_count.reason;
        let joined = seam.edges > 0 || half.seam.is_empty();
        let (mut done, curve_edges) = seam.double(plane, done)?;
        let vertices = done.mesh.positions().len();
        let each = (0..vertices as u32).collect();
        let of_result = topology_unless(&done.mesh, &Adjacency::with(&done.mesh, each, token)?, token)?;
        if !joined || was_manifold && !options.keep_non_manifold && !is_manifold(of_result) {
            let Some(points) = points.as_mut().filter(|_| round < HALF_COUNT_ROUNDS) else {
                return Err(RemeshError::SeamLost { plane });
            };
            *points += *points / 4 + 1;
            continue;
        }
        if let (Some(asked), Some(points), None) = (asked, &mut points, &options.refine)
            && round < HALF_COUNT_ROUNDS
        {
            let next = (*points as i64 + (asked as i64 - vertices as i64) / 2).max(1) as usize;
            if !optimize::is_near(vertices, asked) && next != *points && reason.is_none() {
                *points = next;
                continue;
            }
        }
        let (low, high) = given.bounds();
        let asymmetry_percent = 100.0 * asymmetry(given, plane, &half.mesh, token)? / (high - low).length();
        let mirror = MirrorFigures { seam_edges: seam.edges, asymmetry_percent };
        finish((given, symmetric.mesh(&doubled)), options, &mut done, mirror, token)?;
        let sheets_meet = options.keep_non_manifold || is_manifold(wanted);
        // Where sheets meet, the result has them apart, as the half has.
        if sheets_meet {
            done.report.topology_changes = wanted.changes(&done.report.result.topology);
        }
        done.report.input = input.figures;
        done.curve_edges = curve_edges;
        let count = &mut done.report.vertex_count;
        count.asked = asked.unwrap_or(2 * count.asked - seam.vertices().min(count.asked));
        count.reason = match optimize::is_near(vertices, count.asked) {
            true => None,
            false => Some(count.reason.unwrap_or(CountReason::CloseSheets)),
        };
        done.report.timings_ms.total = elapsed_ms(begin);
        return Ok(done);
    }
    Err(RvdError::Internal("a mirrored surface has no result".to_owned()).into())
}

/// How far the input's other half is from the mirror image of the one that is remeshed, caller's units.
fn asymmetry(given: &TriMesh, plane: Plane, half: &TriMesh, token: &Token) -> Result<f64> {
    let mut used = vec![false; given.positions().len()];
    given.facets().iter().flatten().for_each(|&v| used[v as usize] = true);
    let behind = given.positions().iter().zip(used).filter(|(p, used)| *used && plane.height(**p) < 0.0);
    let reflected: Vec<DVec3> = behind.map(|(&p, _)| plane.reflect(p)).collect();
    let distances = ClosestPoint::unless(half, token)?.distances(&reflected, token)?;
    Ok(distances.into_iter().fold(0.0, f64::max))
}

/// Where a remeshed half meets its mirror image.
struct Seam {
    /// For each vertex, whether both halves have it.
    shared: Vec<bool>,
    /// Those of the half that are not flat in the plane, where they would lie on their mirror images.
    facets: Vec<[u32; 3]>,
    /// How many edges both halves have.
    edges: usize,
}

impl Seam {
    /// `all`: also vertices and edges in the plane that are on no boundary.
    fn of(
        Remesh { mesh, seeds, vertex_seed, .. }: &Remesh,
        (plane, reach): (Plane, f64),
        all: bool,
        token: &Token,
    ) -> Result<Self> {
        // The fit moves vertices a little off the plane, but no seeds of curves.
        let near: Vec<bool> =
            vertex_seed.iter().map(|&seed| plane.height(seeds[seed as usize]).abs() <= reach).collect();
        let adjacency = Adjacency::unless(mesh, token)?;
        let mut shared = if all { near.clone() } else { vec![false; near.len()] };
        for half_edge in (0..3 * mesh.facets().len()).filter(|&h| adjacency.kind(h) == EdgeKind::Boundary) {
            let edge = sides(mesh.facets()[half_edge / 3])[half_edge % 3];
            if edge.iter().all(|&v| near[v as usize]) {
                edge.iter().for_each(|&v| shared[v as usize] = true);
            }
        }
        let on_seam = |corners: &[u32]| corners.iter().all(|&v| shared[v as usize]);
        let facets: Vec<[u32; 3]> = mesh.facets().iter().copied().filter(|t| !on_seam(t)).collect();
        let mut of_edge: HashMap<[u32; 2], usize> = HashMap::new();
        for edge in facets.iter().flat_map(|&t| sides(t)).filter(|edge| on_seam(edge)) {
            *of_edge.entry(undirected(edge)).or_default() += 1;
        }
        Ok(Self { shared, facets, edges: of_edge.len() })
    }

    fn vertices(&self) -> usize {
        self.shared.iter().filter(|&&shared| shared).count()
    }

    /// The half with its mirror image, and its curve edges without those of the seam. Attributes, provenance and the figures of the result
    /// are the half's.
    fn double(&self, plane: Plane, mut done: Remesh) -> Result<(Remesh, Vec<[u32; 2]>)> {
        let own = &self.facets;
        let mut used = vec![false; self.shared.len()];
        own.iter().flatten().for_each(|&v| used[v as usize] = true);
        let (mut first, mut second) = (vec![u32::MAX; used.len()], vec![u32::MAX; used.len()]);
        let (mut places, mut of_seed) = (Vec::new(), Vec::new());
        // The fit brings vertices beyond the plane where the surface touches it.
        let is_in_plane = |v: usize, p: DVec3| self.shared[v] || plane.height(p) < 0.0;
        for (v, &p) in done.mesh.positions().iter().enumerate().filter(|(v, _)| used[*v]) {
            first[v] = places.len() as u32;
            places.push(if is_in_plane(v, p) { plane.project(p) } else { p });
            of_seed.push(done.vertex_seed[v]);
        }
        let mut image: Vec<Option<u32>> = vec![None; done.seeds.len()];
        for v in (0..used.len()).filter(|&v| used[v]) {
            if self.shared[v] {
                second[v] = first[v];
                continue;
            }
            second[v] = places.len() as u32;
            places.push(plane.reflect(places[first[v] as usize]));
            let seed = done.vertex_seed[v] as usize;
            let next = done.seeds.len() as u32;
            let reflected = *image[seed].get_or_insert(next);
            if reflected == next {
                done.seeds.push(plane.reflect(done.seeds[seed]));
            }
            of_seed.push(reflected);
        }
        let of = |number: &[u32], [a, b, c]: [u32; 3]| [a, b, c].map(|v| number[v as usize]);
        let facets = own.iter().map(|&t| of(&first, t));
        let facets = facets.chain(own.iter().map(|&[a, b, c]| of(&second, [a, c, b]))).collect();
        let there = |&[a, b]: &[u32; 2]| used[a as usize] && used[b as usize];
        let curves: Vec<[u32; 2]> = done.curve_edges.iter().copied().filter(there).collect();
        let both =
            |number: &[u32]| -> Vec<[u32; 2]> { curves.iter().map(|edge| edge.map(|v| number[v as usize])).collect() };
        let on_seam = |edge: &[u32; 2]| edge.iter().all(|&v| self.shared[v as usize]);
        let (seam, beside): (Vec<_>, Vec<_>) = curves.iter().zip(both(&first)).partition(|(edge, _)| on_seam(edge));
        let reflected = curves.iter().zip(both(&second)).filter(|(edge, _)| !on_seam(edge)).map(|(_, edge)| edge);
        let curve_edges: Vec<[u32; 2]> = beside.into_iter().map(|(_, edge)| edge).chain(reflected).collect();
        done.curve_edges = curve_edges.iter().copied().chain(seam.into_iter().map(|(_, edge)| edge)).collect();
        let broken = |e| RvdError::Internal(format!("a surface was valid before it was mirrored: {e}"));
        (done.mesh, done.vertex_seed) = (TriMesh::new(places, facets).map_err(broken)?, of_seed);
        Ok((done, curve_edges))
    }
}

/// What is known of the whole result; `symmetric` is the input whose other half is the mirror image of the one that was remeshed.
fn finish(
    (given, symmetric): (&TriMesh, &TriMesh),
    options: &RemeshOptions,
    done: &mut Remesh,
    mirror: MirrorFigures,
    token: &Token,
) -> Result<()> {
    let mesh = &done.mesh;
    // Also along the seam, so that each half has its own regions.
    let Carried { attributes, provenance, regions } =
        carry(given, options.attributes.as_ref(), (mesh, &done.curve_edges), token)?;
    (done.attributes, done.provenance) = (attributes, provenance);
    let result = &mut done.report.result;
    (result.vertices, result.facets) = (mesh.positions().len(), mesh.facets().len());
    result.topology = topology_unless(mesh, &Adjacency::unless(mesh, token)?, token)?;
    result.coincident_vertices = coincident_vertices(mesh, token)?;
    result.regions = regions;
    result.mirror = Some(mirror);
    if options.measure {
        (result.quality, result.lost) = Some(compare(symmetric, None, mesh, token)?).unzip();
        result.crossings = Some(crossings(mesh, token)?);
    }
    done.report.vertex_count.seeds = done.seeds.len();
    Ok(())
}
