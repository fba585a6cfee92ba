//! Curves that a remesh keeps: boundaries and creases.
//!
//! Purpose: [`Features::find`] collects the edges that are a boundary, whose dihedral angle exceeds a threshold, or that the
//! caller named; [`graph`] removes features too short for a remesh, which are noise on scans; [`chains`] joins the rest to
//! curves between corners. Invariant: a curve is a chain of mesh edges through welded vertices, simple inside, either closed or
//! between two corners. A boundary is never removed. Depends on the mesh and the options alone. Must not know: seeds, diagrams.

mod chains;
mod graph;

use std::collections::{BTreeSet, HashSet};

use glam::DVec3;

use super::adjacency::{Adjacency, EdgeKind, weld, weld_unless};
use super::csr::ascending;
use super::edges::{DisjointSets, EdgeGroups, Half, undirected};
use super::{TriMesh, normal};
use crate::token::{Stopped, Token};
use chains::CornerMerge;
use graph::{DihedralAngles, EdgeInfo, Graph};

/// The criteria for features. [`Default`] is boundaries alone. Lengths are in the frame of the positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeatureOptions {
    /// Edges whose facets' normals differ by more than this are creases, degrees; 0 finds none.
    pub crease_angle_deg: f64,
    /// Edges that are creases whatever their angle: two vertices each.
    pub given_creases: Vec<[u32; 2]>,
    /// Vertices that are corners if a curve has them.
    pub given_corners: Vec<u32>,
    /// Vertices of facets that are corners in any case.
    pub points: Vec<u32>,
    /// Edges that are curves whatever their angle, between corners that are given.
    pub rims: Vec<[u32; 2]>,
    /// Shortest crease found by angle with a free end; shorter ones are removed. A connected network of creases is removed
    /// if its total length is below twice this, or if its curves are much shorter on average.
    pub min_crease_length: f64,
    /// Shorter creases are left out where both ends are near each other on one boundary or named curve.
    pub min_chord_length: f64,
    /// The turning angle of a curve at a vertex is measured over this length on either side.
    pub turn_reach: f64,
    /// An edge of at least half the crease angle is a crease too if no edge within this length beside it has nearly its angle,
    /// and if it continues a crease, connects two, or is part of a long ridge. 0 finds none.
    pub ridge_clearance: f64,
    /// Two corners that are connected by a boundary shorter than this become one, if the curves hardly change. 0 merges none.
    pub merge_length: f64,
    /// Factor of lengths at each vertex, at least 0: how fine the remesh is, whose edges they count. All 1 if empty.
    pub resolution: Vec<f64>,
}

/// Facets whose normals differ by less are in one plane, degrees: the rounding of single precision is less on all but the smallest facets.
const FLAT_DEG: f64 = 0.1;
/// An edge with a larger dihedral angle is one of the surface, and not of the facets that a round face was made of, degrees: nine facets
/// around a cylinder have as much.
pub(crate) const SHARP_DEG: f64 = 40.0;
/// Facets at an edge with a larger dihedral angle lie on each other, degrees.
const FOLDED_DEG: f64 = 150.0;

/// Curves may change by merging corners if chords as long as [`FeatureOptions::turn_reach`] leave them by less than this share
/// of it, about as far as chords leave a smooth curve.
const MERGE_DEVIATION: f64 = 0.1;

/// The kind of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CurveKind {
    /// Edges with one facet.
    Boundary,
    /// Edges with a large dihedral angle, and edges that the caller named.
    Crease,
}

/// A chain of edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Its kind.
    pub kind: CurveKind,
    /// Mesh vertices, in order. A closed curve does not repeat its first vertex.
    pub vertices: Vec<u32>,
    /// Whether the last vertex joins the first. Otherwise both ends are corners.
    pub closed: bool,
    /// Mean dihedral angle of its edges, degrees; 180 for a boundary and for edges that the caller named.
    pub angle_deg: f64,
    /// Mean angles of its first and its last edges.
    pub ends_deg: [f64; 2],
    /// Whether it is one of [`FeatureOptions::rims`].
    pub is_rim: bool,
}

/// The curves of a surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Ordered by their first vertices.
    pub curves: Vec<Curve>,
    /// Vertices where curves end or meet, and [`FeatureOptions::points`]; ascending.
    pub corners: Vec<u32>,
    /// Corners that stay without curves, ascending.
    pub points: Vec<u32>,
    /// Edges above the crease angle that were left out, as their crease is too short.
    pub left_out: usize,
    /// Corners that were merged into others ([`FeatureOptions::merge_length`]).
    pub joined: usize,
}

/// Why given creases were refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FeatureError {
    /// A pair of vertices is no edge of the surface.
    #[error("crease {crease} names vertices {a} and {b}, which no facet joins; name the two ends of a mesh edge")]
    NoSuchEdge {
        /// Its place in the list, from 0.
        crease: usize,
        /// First vertex.
        a: u32,
        /// Second vertex.
        b: u32,
    },
    /// The angle makes no sense.
    #[error("the crease angle is {0}°; give 0 (no creases) to 180")]
    BadAngle(f64),
    /// The caller asked to stop, or a limit was reached.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

type Edge = [u32; 2];
/// An edge, its dihedral angle in degrees, and whether each of its facets is in a plane with another.
type FeatureEdge = (Edge, f64, bool);

/// Lengths, multiplied by [`FeatureOptions::resolution`].
#[derive(Clone, Copy)]
struct Metric<'a> {
    positions: &'a [DVec3],
    resolution: &'a [f64],
}

impl Metric<'_> {
    fn resolution(&self, v: u32) -> f64 {
        self.resolution.get(v as usize).copied().unwrap_or(1.0)
    }

    fn at(&self, v: u32) -> DVec3 {
        self.positions[v as usize]
    }

    fn edge(&self, a: u32, b: u32) -> f64 {
        self.at(a).distance(self.at(b)) * (0.5 * (self.resolution(a) + self.resolution(b)))
    }

    fn chain(&self, chain: &[u32]) -> f64 {
        chain.windows(2).map(|p| self.edge(p[0], p[1])).sum()
    }
}

impl Features {
    /// Finds the curves of `mesh`. `positions` are its vertices in the frame in which lengths are meant.
    pub fn find(
        mesh: &TriMesh,
        positions: &[DVec3],
        options: &FeatureOptions,
        token: &Token,
    ) -> Result<Self, FeatureError> {
        check_angle(options.crease_angle_deg)?;
        let adjacency = Adjacency::unless(mesh, token)?;
        let class = adjacency.representative();
        let metric = Metric { positions, resolution: &options.resolution };
        let angles = DihedralAngles::new(mesh, metric, &adjacency);
        token.check()?;
        let (sharp, boundary) = classify(mesh, &angles, &adjacency, options.crease_angle_deg, token)?;
        token.check()?;
        let mut graph = Graph::default();
        let required = |kind| EdgeInfo { kind, required: true, angle: 180.0, beside_planes: false };
        for (k, &(e, _, beside_planes)) in boundary.iter().enumerate() {
            token.check_at(k)?;
            graph.insert(e, EdgeInfo { beside_planes, ..required(CurveKind::Boundary) });
        }
        let edges = (!options.given_creases.is_empty()).then(|| all_edges(mesh, &adjacency)).into_iter().flatten();
        let known: HashSet<Edge> = edges.collect();
        let welded = |v: u32| class.get(v as usize).copied();
        for &[a, b] in &options.rims {
            if let (Some(p), Some(q)) = (welded(a), welded(b)) {
                graph.insert(undirected([p, q]), required(CurveKind::Crease));
            }
        }
        for (crease, &[a, b]) in options.given_creases.iter().enumerate() {
            token.check_at(crease)?;
            match (welded(a), welded(b)) {
                (Some(p), Some(q)) if known.contains(&undirected([p, q])) => {
                    graph.insert(undirected([p, q]), required(CurveKind::Crease))
                }
                _ => return Err(FeatureError::NoSuchEdge { crease, a, b }),
            }
        }
        for (k, &(e, angle, beside_planes)) in sharp.iter().enumerate() {
            token.check_at(k)?;
            graph.insert(e, EdgeInfo { kind: CurveKind::Crease, required: false, angle, beside_planes });
        }
        if options.min_chord_length > 0.0 {
            graph.drop_chords(metric, options.min_chord_length, token)?;
        }
        let left_out = graph.prune(metric, options.min_crease_length, token)?;
        if options.ridge_clearance > 0.0 && options.crease_angle_deg > 0.0 {
            let lengths = (options.ridge_clearance, options.min_crease_length);
            angles.add_ridges(&mut graph, options.crease_angle_deg, lengths, token)?;
        }
        let (length, reach) = (options.merge_length, options.turn_reach);
        let merge = CornerMerge { length, reach, off: MERGE_DEVIATION * reach };
        let points = ascending(options.points.iter().filter_map(|&v| welded(v)));
        let given: BTreeSet<u32> =
            options.given_corners.iter().filter_map(|&v| welded(v)).chain(points.iter().copied()).collect();
        let (mut curves, mut corners, joined) = chains::curves(&graph, metric, merge, &given, token)?;
        if !options.rims.is_empty() {
            let ends = |edge: [u32; 2]| Some(undirected([welded(edge[0])?, welded(edge[1])?]));
            let rims: HashSet<Edge> = options.rims.iter().filter_map(|&edge| ends(edge)).collect();
            curves.iter_mut().for_each(|c| c.is_rim = rims.contains(&undirected([c.vertices[0], c.vertices[1]])));
        }
        if !points.is_empty() {
            corners = ascending(corners.into_iter().chain(points.iter().copied()));
        }
        Ok(Self { curves, corners, points, left_out, joined })
    }

    /// Checks that an angle makes sense and that `given` edges are there.
    pub fn check(mesh: &TriMesh, crease_angle_deg: f64, given: &[[u32; 2]], token: &Token) -> Result<(), FeatureError> {
        check_angle(crease_angle_deg)?;
        if given.is_empty() {
            return Ok(());
        }
        let options = FeatureOptions { given_creases: given.to_vec(), ..FeatureOptions::default() };
        Self::find(mesh, mesh.positions(), &options, token).map(|_| ())
    }

    /// Keeps the curves that `keep` accepts, their corners and [`FeatureOptions::points`].
    pub fn retain(&mut self, mut keep: impl FnMut(usize, &Curve) -> bool) {
        let mut number = 0;
        self.curves.retain(|c| {
            number += 1;
            keep(number - 1, c)
        });
        let ends: HashSet<u32> = self.curves.iter().filter(|c| !c.closed).flat_map(Curve::ends).collect();
        self.corners.retain(|v| ends.contains(v) || self.points.binary_search(v).is_ok());
    }

    /// For each facet of `mesh` the number of its region: curves separate regions.
    pub fn regions(&self, mesh: &TriMesh) -> Vec<u32> {
        let class = weld(mesh);
        let welded = |t: &[u32; 3]| t.map(|v| class[v as usize]);
        let mut curves = HashSet::new();
        for c in &self.curves {
            let chain: Vec<u32> = c.round().map(|v| class[v as usize]).collect();
            curves.extend(chain.windows(2).map(|w| undirected([w[0], w[1]])));
        }
        let mut regions = DisjointSets::new(mesh.facets().len());
        let facets = mesh.facets().iter().map(welded).enumerate();
        EdgeGroups::new(class.len(), facets).for_each(|_, halves| {
            let Some(&Half { facet, side }) = halves.first() else { return };
            let t = welded(&mesh.facets()[facet as usize]);
            if !curves.contains(&undirected([t[side], t[(side + 1) % 3]])) {
                halves.windows(2).for_each(|pair| regions.join(pair[0].facet as usize, pair[1].facet as usize));
            }
        });
        (0..regions.len()).map(|f| regions.root(f) as u32).collect()
    }
}

impl Curve {
    /// Its vertices in order, a closed curve's first one again at the end.
    pub fn round(&self) -> impl Iterator<Item = u32> + '_ {
        self.vertices.iter().copied().chain(self.closed.then(|| self.vertices[0]))
    }

    /// Its first and its last vertex.
    pub(crate) fn ends(&self) -> [u32; 2] {
        [self.vertices[0], self.vertices[self.vertices.len() - 1]]
    }
}

/// What the edges of a surface are like.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct EdgeShares {
    /// Share of their length where the two facets are in one plane, but for [`FLAT_DEG`].
    pub(crate) flat: f64,
    /// Share of their length with a dihedral angle of more than [`SHARP_DEG`].
    pub(crate) sharp: f64,
    /// Edges with a dihedral angle of more than [`FOLDED_DEG`].
    pub(crate) folded: usize,
}

/// The shares of the length of edges between two facets.
pub(crate) fn edge_shares(mesh: &TriMesh, token: &Token) -> Result<EdgeShares, Stopped> {
    let class = weld_unless(mesh, token)?;
    let facets = mesh.facets().iter().map(|t| t.map(|v| class[v as usize])).enumerate();
    let unit = |f: u32| normal(mesh.corners(f as usize)).normalize_or_zero();
    let [least_flat, least_smooth, folded] =
        [FLAT_DEG, SHARP_DEG, FOLDED_DEG].map(|angle: f64| angle.to_radians().cos());
    let (mut shares, mut all) = (EdgeShares::default(), 0.0);
    EdgeGroups::unless(class.len(), facets, token)?.for_each(|_, halves| {
        let [a, b] = halves else { return };
        let t = mesh.facets()[a.facet as usize];
        let [p, q] = [t[a.side], t[(a.side + 1) % 3]].map(|v| mesh.positions()[v as usize]);
        let length = p.distance(q);
        all += length;
        let cosine = unit(a.facet).dot(unit(b.facet));
        if cosine.abs() > least_flat {
            shares.flat += length;
        } else if cosine < least_smooth {
            shares.sharp += length;
        }
        shares.folded += usize::from(cosine < folded);
    });
    shares.flat /= all.max(f64::MIN_POSITIVE);
    shares.sharp /= all.max(f64::MIN_POSITIVE);
    Ok(shares)
}

fn check_angle(degrees: f64) -> Result<(), FeatureError> {
    if (0.0..=180.0).contains(&degrees) { Ok(()) } else { Err(FeatureError::BadAngle(degrees)) }
}

fn all_edges<'a>(mesh: &'a TriMesh, adjacency: &'a Adjacency) -> impl Iterator<Item = Edge> + 'a {
    (0..3 * mesh.facets().len()).map(move |half| undirected(adjacency.ends(mesh, half)))
}

/// Edges whose dihedral angle exceeds `angle` degrees, with their angles, and boundary edges; both ascending.
fn classify(
    mesh: &TriMesh,
    angles: &DihedralAngles<'_>,
    adjacency: &Adjacency,
    angle: f64,
    token: &Token,
) -> Result<(Vec<FeatureEdge>, Vec<FeatureEdge>), Stopped> {
    let (mut sharp, mut boundary) = (Vec::new(), Vec::new());
    for (half, e) in all_edges(mesh, adjacency).enumerate() {
        token.check_at(half)?;
        match (adjacency.kind(half), adjacency.opposite(half)) {
            (EdgeKind::Boundary, _) => {
                let crease = if angle > 0.0 { angle } else { 180.0 };
                boundary.push((e, 180.0, angles.is_plane_beside(half, crease)));
            }
            (_, Some(other)) if angle > 0.0 && half < other => {
                let bend = angles.at(half).filter(|&bend| bend > angle);
                let between = || [half, other].into_iter().all(|half| angles.is_plane_beside(half, angle));
                sharp.extend(bend.map(|bend| (e, bend, between())));
            }
            _ => {}
        }
    }
    sharp.sort_unstable_by_key(|b| b.0);
    boundary.sort_unstable_by_key(|b| b.0);
    Ok((sharp, boundary))
}
