//! The surface lifted to R^6 by its normals, for anisotropic cells.
//!
//! Purpose: [`Lift::new`] gives every vertex a normal times a length (Lévy and Bonneel 2012): cells of equal size there are
//! stretched on the surface along the direction in which the normal turns least. At kept creases a vertex is split, with a normal
//! for each side, as points would crowd along the bend otherwise.
//! Invariant: facets keep their numbers and places. The same bits on any number of threads. Must not know: seeds, backends.

use std::collections::HashSet;
use std::sync::Arc;

use glam::DVec3;

use super::constants::*;
use super::features::KeptCurves;
use super::{Anisotropy, Result};
use crate::cvt::density::{LONGEST, Net, SizeField, principal};
use crate::cvt::lifts::CurveLifts;
use crate::mesh::TriMesh;
use crate::mesh::edges::{DisjointSets, EdgeGroups, Half, undirected};
use crate::mesh::features::CurveKind;
use crate::rvd::{Lifted, Point, RvdError, Surface};
use crate::token::Token;

/// What a lifted remesh has beside the surface.
#[derive(Clone)]
pub(super) struct Lift {
    pub(super) surface: Arc<Surface<Lifted>>,
    pub(super) curves: Arc<CurveLifts>,
    /// Weights of the mesh's vertices by whose roots seeds are spread evenly over the lifted surface.
    pub(super) sampling: Vec<f64>,
    /// The length of the lift at each vertex of the mesh, caller's units.
    pub(super) lengths: Vec<f64>,
    /// How many more seeds a curve has for its length at each vertex, 1 elsewhere.
    pub(super) along_curves: Vec<f64>,
}

/// How a surface is lifted.
pub(super) struct Lifting<'a> {
    pub(super) anisotropy: Anisotropy,
    /// Of the input's bounding box, caller's units.
    pub(super) diagonal: f64,
    /// About how long edges are, caller's units.
    pub(super) edge: f64,
    /// Lengths of the lift, one a vertex, to be graded.
    pub(super) lengths: Option<&'a [f64]>,
    /// Whether weights are those of the surface itself, and not of the lifted one.
    pub(super) in_space: bool,
    /// The most that the length of the lift changes per distance.
    pub(super) steepest: f64,
}

impl Lift {
    /// Lifts `mesh`, which `surface` was made of.
    pub(super) fn new(
        mesh: &TriMesh,
        weights: Option<&[f64]>,
        surface: &Surface,
        kept: &KeptCurves,
        Lifting { anisotropy, diagonal, edge, lengths, in_space, steepest }: Lifting<'_>,
        token: &Token,
    ) -> Result<Self> {
        let creases: HashSet<[u32; 2]> = kept.curve_edges(|kind| kind == CurveKind::Crease).map(undirected).collect();
        let (sector, sectors) = sectors(surface, &creases);
        token.check()?;
        // A vertex of each sector, and the sum of the facets' normals by their angles there.
        let mut vertex = vec![0; sectors];
        let mut normals = vec![DVec3::ZERO; sectors];
        for f in (0..mesh.facets().len()).filter(|&f| !surface.skips(f)) {
            let p = mesh.corners(f);
            let normal = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
            for c in 0..3 {
                let at = sector[3 * f + c] as usize;
                let (a, b) = (p[(c + 1) % 3] - p[c], p[(c + 2) % 3] - p[c]);
                vertex[at] = surface.welded()[f][c];
                normals[at] += a.angle_between(b) * normal;
            }
        }
        for f in (0..mesh.facets().len()).filter(|&f| surface.skips(f)) {
            (0..3).for_each(|c| vertex[sector[3 * f + c] as usize] = surface.welded()[f][c]);
        }
        normals.iter_mut().for_each(|normal| *normal = normal.normalize_or_zero());
        let places = vertex.iter().map(|&v| mesh.positions()[v as usize]).collect();
        let corners = |f: usize| [0, 1, 2].map(|c| sector[3 * f + c]);
        let split = TriMesh::new(places, (0..mesh.facets().len()).map(corners).collect())
            .map_err(|e| RvdError::Internal(format!("a surface was valid before its vertices were split: {e}")))?;
        let graded = |lengths: Vec<f64>| -> Result<Vec<f64>> {
            let net = Net::new(mesh, token)?;
            let mut field = SizeField::new(&net, lengths)?;
            field.grade(&net, steepest, token)?;
            Ok(field.into_sizes())
        };
        let around = Around::of(&split, surface);
        if anisotropy == Anisotropy::Auto {
            let mean_edge = (2.0 / 3f64.sqrt() * mesh.area() / mesh.positions().len() as f64).sqrt();
            around.smooth(&mut normals, edge, mean_edge);
            token.check()?;
        }
        // Another number of points may divide other facets.
        let lengths = lengths.filter(|lengths| lengths.len() == mesh.positions().len());
        let lengths = match (anisotropy, lengths) {
            (_, Some(lengths)) => graded(lengths.to_vec())?,
            (Anisotropy::None, None) => vec![0.0; mesh.positions().len()],
            (Anisotropy::Share(share), None) => vec![share * diagonal; mesh.positions().len()],
            (Anisotropy::Auto, None) => {
                let lengths = around.best_lengths(split.positions(), &normals, diagonal);
                let mut of_vertex = vec![diagonal; mesh.positions().len()];
                for (&v, length) in vertex.iter().zip(lengths) {
                    let least = &mut of_vertex[v as usize];
                    *least = least.min(length);
                }
                graded(of_vertex)?
            }
        };
        let lift: Vec<DVec3> = normals.iter().zip(&vertex).map(|(&normal, &v)| lengths[v as usize] * normal).collect();
        let mut larger = around.larger(&split, &lift, &vertex, mesh.positions().len());
        // Vertices in one place are one.
        for (own, first) in mesh.facets().iter().zip(surface.welded()).flat_map(|(own, first)| own.iter().zip(first)) {
            larger[*own as usize] = larger[*first as usize];
        }
        // The density of points on the lifted surface is the root of its weight.
        let lifted_weights: Option<Vec<f64>> = match (weights, in_space) {
            (Some(weights), true) => Some(weights.iter().zip(&larger).map(|(w, j)| w / (j * j)).collect()),
            (weights, _) => weights.map(<[f64]>::to_vec),
        };
        let weight = |v: usize| lifted_weights.as_ref().map_or(1.0, |weights| weights[v]);
        let sampling = larger.iter().enumerate().map(|(v, j)| weight(v) * j * j).collect();
        let of_vertex: Option<Vec<f64>> =
            lifted_weights.as_ref().map(|weights| vertex.iter().map(|&v| weights[v as usize]).collect());
        let lifted = Surface::lifted(&split, of_vertex.as_deref(), &lift, token)?;
        token.check()?;
        let edges: HashSet<[u32; 2]> = kept.curve_edges(|_| true).map(undirected).collect();
        let mut along_curves = vec![1.0f64; mesh.positions().len()];
        for (f, facet) in surface.welded().iter().enumerate().filter(|(f, _)| !lifted.skips(*f)) {
            let (flat, corners) = (surface.corners(f as u32), lifted.corners(f as u32));
            for c in 0..3 {
                let d = (c + 1) % 3;
                if edges.contains(&undirected([facet[c], facet[d]])) {
                    let longer = corners[c].distance(corners[d]) / flat[c].distance(flat[d]);
                    for v in [facet[c], facet[d]].map(|v| v as usize).into_iter().filter(|_| longer.is_finite()) {
                        along_curves[v] = along_curves[v].max(longer);
                    }
                }
            }
        }
        let on_curve: HashSet<u32> = kept.curve_vertices().collect();
        // By the first vertex at a place; the lifted surface has other numbers, but the same facets.
        let at_curve = |f: u32| surface.welded()[f as usize].iter().any(|v| on_curve.contains(v));
        let curves = CurveLifts::new(&lifted, at_curve, token);
        if in_space {
            along_curves.iter_mut().zip(&larger).for_each(|(along, j)| *along /= j.sqrt());
        }
        Ok(Self { sampling, lengths, along_curves, surface: Arc::new(lifted), curves: Arc::new(curves) })
    }
}

/// Facets with area and their areas.
struct Around(Vec<([u32; 3], f64)>);

impl Around {
    fn of(split: &TriMesh, surface: &Surface) -> Self {
        let with_area = (0..split.facets().len()).filter(|&f| !surface.skips(f));
        Self(with_area.map(|f| (split.facets()[f], surface.facet_area(f as u32))).collect())
    }

    /// Means of normals over neighbours, within about an edge: noise of a scan turns normals either way, and
    /// facets cannot follow what is smaller than an edge.
    fn smooth(&self, normals: &mut [DVec3], edge: f64, mean_edge: f64) {
        let rounds = (edge / mean_edge).powi(2).round().min(MOST_SMOOTHING_ROUNDS) as usize;
        for _ in 0..rounds {
            let mut sums = vec![DVec3::ZERO; normals.len()];
            for (v, area) in &self.0 {
                let mean = *area * (normals[v[0] as usize] + normals[v[1] as usize] + normals[v[2] as usize]);
                v.iter().for_each(|&v| sums[v as usize] += mean);
            }
            for (normal, sum) in normals.iter_mut().zip(sums) {
                *normal = sum.try_normalize().unwrap_or(*normal);
            }
        }
    }

    /// How much larger the lifted surface is at each of the mesh's vertices, at most [`LONGEST`]: there the normal turns both
    /// ways, or the surface is undersampled. `vertex` has the mesh's vertex of each sector.
    fn larger(&self, split: &TriMesh, lift: &[DVec3], vertex: &[u32], vertices: usize) -> Vec<f64> {
        let mut areas = vec![[0.0; 2]; vertices];
        for (v, area) in &self.0 {
            let [a, b, c] = v.map(|v| Lifted { place: split.positions()[v as usize], lift: lift[v as usize] });
            let lifted = (b - a).parallelogram(c - a);
            let flat = (b.place - a.place).cross(c.place - a.place).length();
            for v in v.map(|v| vertex[v as usize] as usize) {
                areas[v][0] += area;
                areas[v][1] += area * (lifted / flat).min(LONGEST);
            }
        }
        areas.into_iter().map(|[flat, lifted]| if flat > 0.0 { lifted / flat } else { 1.0 }).collect()
    }

    /// The length that gives cells the aspect √(k₁/k₂) of the best triangles, |K|^(-1/2), where that is not longer than wide by
    /// more than [`LONGEST`].
    fn best_lengths(&self, places: &[DVec3], normals: &[DVec3], most: f64) -> impl Iterator<Item = f64> {
        let curvatures = principal(places, normals, &self.0);
        curvatures.into_iter().map(move |[larger, smaller]| {
            let best = (larger * smaller).abs().sqrt().recip();
            let length = best.min((LONGEST * LONGEST - 1.0).sqrt() / larger.abs());
            // Where nothing is known of the curvature, cells are as long as wide.
            if length.is_nan() { LEAST_LIFT * most } else { length.clamp(LEAST_LIFT * most, most) }
        })
    }
}

/// The sector of each corner of each facet, and how many there are: around a vertex, corners of facets between which no crease
/// lies are in one.
fn sectors(surface: &Surface, creases: &HashSet<[u32; 2]>) -> (Vec<u32>, usize) {
    let facets = surface.welded();
    let mut sets = DisjointSets::new(3 * facets.len());
    let joined = facets.iter().copied().enumerate().filter(|(f, _)| surface.joins(*f));
    EdgeGroups::new(surface.positions().len(), joined).for_each(|_, halves| {
        let [a, b] = halves else { return };
        let ends = |half: &Half| {
            [half.side, (half.side + 1) % 3].map(|c| (3 * half.facet as usize + c, facets[half.facet as usize][c]))
        };
        let (here, there) = (ends(a), ends(b));
        if creases.contains(&undirected(here.map(|end| end.1))) {
            return;
        }
        for (corner, vertex) in here {
            there.iter().filter(|(_, other)| *other == vertex).for_each(|&(other, _)| sets.join(corner, other));
        }
    });
    let mut number = vec![u32::MAX; sets.len()];
    let mut count = 0;
    let mut sector = Vec::with_capacity(sets.len());
    for corner in 0..sets.len() {
        let slot = &mut number[sets.root(corner)];
        if *slot == u32::MAX {
            *slot = count;
            count += 1;
        }
        sector.push(*slot);
    }
    (sector, count as usize)
}
