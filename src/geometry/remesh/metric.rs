//! Triangles with unit edges in a metric.
//!
//! Purpose: [`adapt`] changes a triangulation until its edges have about length 1 in the metric: rounds of [`collapse`] of short
//! edges, [`split`] of long ones, [`flips`] towards facets that are equilateral in the metric, and [`relocate`] of vertices on the
//! surface. Each pass has proposals, which are pure functions of the mesh as the pass finds it, and commits them by rank as long as
//! nothing that they depend on has changed.
//! Invariant: a manifold stays one, of the same topology. Vertices lie on the input, those of curves on their curves; corners and
//! boundaries without a curve stay. No change makes a facet that faces away from the input where none did; the rest are counted. The
//! same bits whatever the number of threads.
//! Must not know: seeds, diagrams, where the metric comes from.

mod collapse;
mod flips;
mod rails;
mod relocate;
mod split;

use glam::DVec3;

use super::Result;
use super::constants::*;
use super::features::polyline::{Polyline, Stretch};
use super::manifold::LocalMesh;
use crate::mesh::edges::{sides, undirected};
use crate::mesh::metric::{MetricField, Site, area, length, quality};
use crate::tasks;
use crate::token::Token;
use rails::Rails;

/// A triangulation on the input, unit frame.
#[derive(Clone)]
pub(super) struct Draft {
    pub(super) positions: Vec<DVec3>,
    pub(super) facets: Vec<[u32; 3]>,
    /// Vertices that stay.
    pub(super) fixed: Vec<bool>,
    /// The curves, and the edges that lie on them.
    pub(super) lines: Vec<Polyline>,
    pub(super) stretches: Vec<([u32; 2], Stretch)>,
}

/// What became of it.
pub(super) struct Adapted {
    pub(super) positions: Vec<DVec3>,
    pub(super) facets: Vec<[u32; 3]>,
    /// For each vertex that stayed, which one of the draft it was.
    pub(super) fixed: Vec<Option<u32>>,
    pub(super) curve_edges: Vec<[u32; 2]>,
    /// What lengths in the metric were multiplied by for the number of vertices: below 1, edges are longer.
    pub(super) scale: f64,
    pub(super) rounds: usize,
    /// Facets that face away from the input.
    pub(super) facing_away: usize,
}

/// How a vertex may move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mobility {
    Fixed,
    /// Along its curve.
    Along,
    /// On the surface.
    Free,
}

/// The triangulation while it changes.
struct Adapting<'a> {
    /// Its positions are those of the sites.
    mesh: LocalMesh,
    sites: Vec<Site>,
    mobility: Vec<Mobility>,
    /// By vertex, which one of the draft it was, if it was one.
    origin: Vec<Option<u32>>,
    rails: Rails,
    field: &'a MetricField,
    /// The most vertices there may be.
    most: usize,
    token: &'a Token,
}

/// A number of vertices to make, if one is asked for, and the most there may be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    pub(super) vertices: Option<usize>,
    pub(super) most: usize,
}

/// Makes the edges of `draft` unit edges. With a number of vertices, `field` is scaled for it: first by the area of the draft in the
/// metric, then by what came of that. Each attempt begins with the draft: edges from 0.71 to 1.41 stay, so that a triangulation that
/// is scaled again keeps its number, or loses many vertices at once.
pub(super) fn adapt(draft: Draft, field: &mut MetricField, wanted: Wanted, token: &Token) -> Result<Adapted> {
    let Some(asked) = wanted.vertices else { return adapt_once(draft, field, wanted.most, token) };
    let mut scale = scale_for(&draft, asked as f64, field, token)?;
    field.scale(scale);
    let mut best = Adapted { scale, ..adapt_once(draft.clone(), field, wanted.most, token)? };
    for _ in 0..SCALING_TIMES {
        let share = asked as f64 / best.positions.len() as f64;
        if (share - 1.0).abs() < SCALING_TOLERANCE {
            break;
        }
        let to = best.scale * share.sqrt();
        field.scale(to / scale);
        scale = to;
        let next = adapt_once(draft.clone(), field, wanted.most, token)?;
        let rounds = best.rounds + next.rounds;
        if next.positions.len().abs_diff(asked) >= best.positions.len().abs_diff(asked) {
            best.rounds = rounds;
            break;
        }
        best = Adapted { scale, rounds, ..next };
    }
    field.scale(best.scale / scale);
    Ok(best)
}

fn adapt_once(draft: Draft, field: &MetricField, most: usize, token: &Token) -> Result<Adapted> {
    let mut state = Adapting::new(draft, field, most, token)?;
    let rounds = state.rounds()?;
    let facing_away = state.facing_away()?;
    let Adapting { mesh, mobility, origin, rails, .. } = state;
    let (positions, facets) = mesh.into_parts();
    let stays = |(origin, mobility): (Option<u32>, Mobility)| origin.filter(|_| mobility == Mobility::Fixed);
    let fixed = origin.into_iter().zip(mobility).map(stays).collect();
    Ok(Adapted { positions, facets, fixed, curve_edges: rails.edges(), scale: 1.0, rounds, facing_away })
}

/// What lengths are multiplied by so that unit edges make `asked` vertices: n = c A s² + B s / 2, with the area A and the boundary B
/// of the draft in the metric.
fn scale_for(draft: &Draft, asked: f64, field: &MetricField, token: &Token) -> Result<f64> {
    let sites = Adapting::sites(field, &draft.positions, token)?;
    let of = |v: u32| &sites[v as usize];
    let area: f64 = draft.facets.iter().map(|t| area(t.map(of))).sum();
    let mut edges: Vec<[u32; 2]> = draft.facets.iter().flat_map(|&t| sides(t).map(undirected)).collect();
    edges.sort_unstable();
    let open = edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).map(|same| same[0]);
    let boundary: f64 = open.map(|[a, b]| length(of(a), of(b))).sum();
    let (by_area, by_boundary) = (VERTICES_PER_AREA * area, 0.5 * boundary);
    Ok(2.0 * asked / (by_boundary + (by_boundary * by_boundary + 4.0 * by_area * asked).sqrt()))
}

impl<'a> Adapting<'a> {
    fn new(draft: Draft, field: &'a MetricField, most: usize, token: &'a Token) -> Result<Self> {
        let Draft { positions, facets, fixed, lines, stretches } = draft;
        let rails = Rails::new(lines, &stretches);
        let curves = rails.edges().into_iter().collect();
        let sites = Self::sites(field, &positions, token)?;
        let mesh = LocalMesh::new(positions, facets, curves);
        let of = |(v, &fixed): (usize, &bool)| match rails.around(&mesh, v as u32).len() {
            _ if fixed => Mobility::Fixed,
            0 if mesh.is_on_boundary(v as u32) => Mobility::Fixed,
            0 => Mobility::Free,
            2 if rails.beside(&mesh, v as u32).is_some() => Mobility::Along,
            _ => Mobility::Fixed,
        };
        let mobility = fixed.iter().enumerate().map(of).collect();
        let origin = (0..fixed.len() as u32).map(Some).collect();
        let most = (fixed.len() * MOST_GROWTH + SPARE_VERTICES).min(most);
        Ok(Self { mesh, sites, mobility, origin, rails, field, most, token })
    }

    fn sites(field: &MetricField, positions: &[DVec3], token: &Token) -> Result<Vec<Site>> {
        Ok(field.sites(positions, token)?)
    }

    /// Rounds until little changes. Returns how many there were.
    fn rounds(&mut self) -> Result<usize> {
        for round in 1..=ADAPTING_ROUNDS {
            let mut changed = self.collapse()?;
            self.flip()?;
            let [split, astray] = self.split()?;
            changed += split;
            self.flip()?;
            self.relocate(RELOCATION_PASSES)?;
            self.flip()?;
            if astray == 0 && (changed as f64) < SETTLED_SHARE * self.sites.len() as f64 {
                return Ok(round);
            }
        }
        Ok(ADAPTING_ROUNDS)
    }

    fn site(&self, v: u32) -> &Site {
        &self.sites[v as usize]
    }

    fn length(&self, [a, b]: [u32; 2]) -> f64 {
        length(self.site(a), self.site(b))
    }

    fn quality(&self, t: [u32; 3]) -> f64 {
        quality(t.map(|v| self.site(v)))
    }

    /// Whether facets may take the place of others: they face as the input does, or better than those before.
    fn face(&self, new: &[[DVec3; 3]], old: impl Iterator<Item = [DVec3; 3]>) -> bool {
        let least = |least: f64, corners: [DVec3; 3]| least.min(self.field.facing(corners));
        let now = new.iter().copied().fold(f64::INFINITY, least);
        now >= FACING_COSINE || now >= old.fold(f64::INFINITY, least)
    }

    fn facing_away(&self) -> Result<usize> {
        let facets = self.mesh.facets();
        let faces_away = |(): &mut (), f: usize| {
            self.token.check_at(f).map(|()| self.field.facing(self.mesh.places(facets[f])) < 0.0)
        };
        let all = tasks::try_map(facets.len(), || (), faces_away)?;
        Ok(all.into_iter().filter(|faces_away| *faces_away).count())
    }

    /// Leaves out what was taken out.
    fn compact(&mut self) {
        let (kept, number) = self.mesh.compact();
        self.sites = kept.iter().map(|&v| self.sites[v as usize]).collect();
        self.mobility = kept.iter().map(|&v| self.mobility[v as usize]).collect();
        self.origin = kept.iter().map(|&v| self.origin[v as usize]).collect();
        self.rails.renumber(&number);
    }

    /// Moves a vertex.
    fn put(&mut self, v: u32, site: Site) {
        self.sites[v as usize] = site;
        self.mesh.place(v, site.position);
    }
}
