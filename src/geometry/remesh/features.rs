//! Creases and boundaries that a remesh keeps.
//!
//! Purpose: [`KeptCurves`] finds them, places their seeds and reads their edges off a result; [`envelope`] bounds these.
//! Invariant: if the curves would take too many of the seeds, creases are dropped first and boundaries last, and both are
//! counted. Where the surface was divided along its creases, none is dropped ([`crowded`]). Must not know: backends, iterations, how a result is improved.

mod chain;
mod crowded;
pub(super) mod envelope;
mod followed;
pub(super) mod polyline;
pub(super) mod seams;
mod sectors;
mod tips;

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use glam::DVec3;

use super::constants::*;
use super::report::{DroppedCurve, FeatureFigures};
use super::{RemeshError, RemeshOptions, Seeds};
use crate::cvt::curves::{CurveSeeds, INNER_POINTS, Segment, edge_length};
use crate::cvt::density::Plan;
use crate::mesh::TriMesh;
use crate::mesh::csr::ascending;
use crate::mesh::edges::undirected;
use crate::mesh::features::{Curve, CurveKind, FeatureOptions, Features};
use crate::mesh::sample::spread_unless;
use crate::rvd::{Frame, Surface};
use crate::tasks;
use crate::token::{Stopped, Token};
pub(crate) use chain::Chain;
use crowded::{Crowded, Of};
use envelope::CurveSample;
use polyline::{Polyline, Stretch};
use seams::periods::Signs;
use seams::{Joint, Seams};
use tips::tips;

/// For each seed, whether it stays at its place.
fn staying(seeds: &CurveSeeds, features: &Features) -> Vec<bool> {
    let mut stays = seeds.on_shared();
    let rims = seeds.segments.iter().filter(|segment| features.curves[segment.curve as usize].is_rim);
    rims.flat_map(|segment| segment.ends).for_each(|seed| stays[seed as usize] = true);
    // Corners are the first seeds.
    let corners = stays.iter_mut().zip(&features.corners);
    corners.for_each(|(stays, corner)| *stays |= features.points.binary_search(corner).is_ok());
    stays
}

/// A curve as a report has it.
fn dropped_curve(curve: &Curve, mesh: &TriMesh) -> DroppedCurve {
    let at = |v: u32| mesh.positions()[v as usize];
    let chain: Vec<u32> = curve.round().collect();
    let length = chain.windows(2).map(|pair| at(pair[0]).distance(at(pair[1]))).sum();
    DroppedCurve { length, place: at(chain[chain.len() / 2]).to_array() }
}

/// `count` of some points in an order, evenly spaced in it; all if there are fewer.
fn evenly(points: &[DVec3], count: usize) -> impl Iterator<Item = DVec3> + '_ {
    let count = count.min(points.len());
    (0..count).map(move |k| points[(k as u64 * points.len() as u64 / count as u64) as usize])
}

/// What curves obey beside the options.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Held<'a> {
    /// Where sheets that are apart met.
    pub(crate) seams: Option<&'a Arc<Seams>>,
    /// Edges that stay as they are.
    pub(crate) rims: &'a [[u32; 2]],
    /// Vertices that stay where they are.
    pub(crate) vertices: &'a [u32],
    /// Whether all boundaries have all of their edges, since something else meets them there.
    pub(crate) closes: bool,
    /// Creases of a smaller angle are dropped, degrees: all for the sake of boundaries, or those between the facets of round surfaces.
    pub(crate) least_crease_deg: Option<f64>,
    /// Whether sheets were divided along creases that are close to others: the boundaries there get longer edges until there are points
    /// enough.
    pub(crate) crowded: bool,
    /// Whether seeds of bent curves of a divided surface are beside those of curves near them.
    pub(crate) beside: bool,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct KeptCurves {
    features: Features,
    pub(crate) seeds: CurveSeeds,
    /// Curves that there were too few points for.
    dropped: Vec<DroppedCurve>,
    /// Whether curves are borders of regions or sheets.
    has_regions: bool,
    /// Where several sheets have a curve.
    seams: Option<Arc<Seams>>,
    /// For each seed, whether it stays at its place: several sheets have it, or an edge that stays.
    stays: Vec<bool>,
    /// For each seed with copies at other sheets, what it is joined by; empty if there are none.
    joints: Vec<Option<Joint>>,
    /// Seeds that are joined to others.
    copies: usize,
    /// As for [`Held`].
    closes: bool,
    /// Facets of patches that are too narrow for seeds within.
    narrow: Vec<bool>,
    /// Whether creases had to be dropped, since others are too close or points too few, or were left out as noise.
    pub(crate) is_crowded: bool,
    /// What curves were sought by.
    criteria: FeatureOptions,
}

impl KeptCurves {
    /// Finds what `options` ask for; nothing where seeds are given.
    pub(crate) fn find(
        mesh: &TriMesh,
        plan: &Plan<'_>,
        surface: &Surface,
        (options, by_error): (&RemeshOptions, bool),
        Held { seams, rims, vertices, closes, least_crease_deg, crowded, beside }: Held<'_>,
        token: &Token,
    ) -> Result<Self, RemeshError> {
        Features::check(mesh, options.crease_angle_deg, &options.creases, token)?;
        if matches!(options.seeds, Seeds::Given(_)) {
            return Ok(Self::default());
        }
        let points = plan.points;
        let has_regions =
            options.keep_non_manifold || options.attributes.as_ref().is_some_and(|a| a.regions().is_some());
        // By error, edges are short where the surface bends both ways. What these alone resolve is noise more often than a crease.
        let mass = if by_error { surface.area() } else { surface.root_mass() };
        // The shortest target edge, where the weight is 1.
        let scale = edge_length(surface, (&Features::default(), &[]), mass, points, token)?;
        let resolution = match by_error || surface.is_uniform() {
            true => Vec::new(),
            false => surface.weights().iter().map(|w| w.powf(0.25)).collect(),
        };
        // A larger angle asks for fewer creases, so weaker ones are not sought.
        let weaker = options.crease_angle_deg <= RemeshOptions::CREASE_ANGLE_DEG;
        let mut criteria = FeatureOptions {
            crease_angle_deg: options.crease_angle_deg,
            given_creases: plan.edges(&options.creases, token)?,
            given_corners: ascending(
                rims.iter().flatten().copied().chain(seams.map(|seams| seams.ends()).into_iter().flatten()),
            ),
            points: seams.map(|seams| seams.points()).into_iter().flatten().chain(vertices.iter().copied()).collect(),
            rims: plan.edges(rims, token)?,
            // On a designed part what is short is no noise.
            min_crease_length: if crowded { 0.0 } else { SHORTEST_CREASE * scale },
            // What a grid leaves beside the curves in which sheets meet.
            min_chord_length: if crowded || seams.is_none() { 0.0 } else { scale },
            turn_reach: BEND_REACH * scale,
            ridge_clearance: if weaker { SMOOTH_REACH * scale } else { 0.0 },
            // Corners of curves that end there have to stay.
            merge_length: if crowded { 0.0 } else { JOINED_CORNERS * scale },
            resolution,
        };
        let mut dropped: Vec<DroppedCurve> = Vec::new();
        let named = |curve: &Curve| dropped_curve(curve, &plan.mesh);
        let mut rims_alone = false;
        let mut is_crowded = false;
        if let Some(least) = least_crease_deg {
            let all = Features::find(&plan.mesh, surface.positions(), &criteria, token)?;
            let is_less = |c: &&Curve| c.kind == CurveKind::Crease && c.angle_deg < least;
            dropped.extend(all.curves.iter().filter(is_less).map(named));
            // 0 seeks none.
            criteria.crease_angle_deg = if least < 180.0 { least } else { 0.0 };
        }
        let all = criteria.clone();
        loop {
            // What a search drops, the next one may find again.
            let dropped_before = dropped.len();
            let mut features = Features::find(&plan.mesh, surface.positions(), &criteria, token)?;
            // A corner in one sheet is one in all that meet there. Each may cut curves at others.
            while let Some(corners) = seams.map(|seams| seams.corners(&features))
                && corners.iter().any(|corner| criteria.given_corners.binary_search(corner).is_err())
            {
                criteria.given_corners = ascending(corners.into_iter().chain(criteria.given_corners));
                features = Features::find(&plan.mesh, surface.positions(), &criteria, token)?;
            }
            is_crowded |= features.left_out > 0;
            if !options.keep_boundaries || rims_alone {
                features.retain(|_, c| c.is_rim || c.kind != CurveKind::Boundary && !rims_alone);
            }
            let edge = edge_length(surface, (&features, &[]), surface.root_mass(), points, token)?;
            let is_crease = |c: &&Curve| c.kind == CurveKind::Crease && !c.is_rim;
            let creases = |features: &Features| features.curves.iter().filter(is_crease).count();
            let found = criteria.crease_angle_deg > 0.0;
            let most_of = |creases| if creases == 0 || !found { 1.0 } else { LARGEST_SHARE };
            // Close curves are dropped next, but do not make room for more than this.
            let most = points.saturating_mul(MOST_SEEDS).saturating_add(SPARE_SEEDS);
            if crowded {
                let before = |curve: &Curve| {
                    let known =
                        seams.and_then(|seams| curve.vertices.iter().find_map(|&v| Some((v, seams.before(v)?))));
                    known.map_or(DVec3::ZERO, |(v, p)| surface.positions()[v as usize] - surface.frame().to_unit(p))
                };
                let moved: Option<Vec<DVec3>> = beside.then(|| features.curves.iter().map(before).collect());
                let moved = moved.as_deref();
                let of = Of { surface, mesh: &plan.mesh, features: &features, seams, moved, points, most, token };
                let found = of.fitted(edge)?;
                let Some(Crowded { seeds, joints, copies, narrow, .. }) = found else { return Ok(Self::default()) };
                let stays = staying(&seeds, &features);
                let seams = seams.cloned();
                return Ok(Self {
                    features,
                    seeds,
                    dropped,
                    has_regions,
                    seams,
                    stays,
                    joints,
                    copies,
                    closes: true,
                    narrow,
                    is_crowded: false,
                    criteria: all,
                });
            }
            let mut placed = CurveSeeds::place(surface, (&features, &[]), edge, most, token)?;
            while let Some(seeds) = &placed {
                let too_close = seeds.too_close(&features, token)?;
                if too_close.is_empty() {
                    break;
                }
                is_crowded = true;
                dropped.extend(too_close.iter().map(|&k| named(&features.curves[k as usize])));
                features.retain(|k, _| !too_close.contains(&(k as u32)));
                placed = CurveSeeds::place(surface, (&features, &[]), edge, most, token)?;
            }
            if let Some(mut seeds) = placed {
                seeds.split_by_deviation(f64::INFINITY, token)?;
                let is_rim = |c: u32| features.curves[c as usize].is_rim;
                seeds.split_alike(&tips(&features, &plan.mesh, seams));
                let may_split = |c: u32| is_rim(c) || features.curves[c as usize].kind == CurveKind::Boundary;
                seeds.split_between_others((may_split, is_rim), token)?;
                let share = |seams: &Arc<Seams>| seams.share(&mut seeds, &features, surface.positions());
                let (joints, copies) = seams.map(share).unwrap_or_default();
                if seeds.len() as f64 <= most_of(creases(&features)) * points as f64 {
                    let stays = staying(&seeds, &features);
                    let seams = seams.cloned();
                    return Ok(Self {
                        features,
                        seeds,
                        dropped,
                        has_regions,
                        seams,
                        stays,
                        joints,
                        copies,
                        closes,
                        narrow: Vec::new(),
                        is_crowded,
                        criteria: all,
                    });
                }
            }
            // Where creases end at a curve, it goes on without them.
            criteria.given_corners.clone_from(&all.given_corners);
            if criteria.ridge_clearance > 0.0 {
                criteria.ridge_clearance = 0.0;
                dropped.truncate(dropped_before);
                continue;
            }
            let creases = creases(&features);
            is_crowded |= creases > 0;
            if found && !criteria.given_creases.is_empty() {
                // Those that the caller named, or where sheets meet, are dropped after all others.
                dropped.extend(features.curves.iter().filter(is_crease).filter(|c| c.angle_deg < 180.0).map(named));
                criteria.crease_angle_deg = 0.0;
                continue;
            }
            dropped.extend(features.curves.iter().filter(is_crease).map(named));
            if creases == 0 && !(rims.is_empty() && vertices.is_empty()) {
                if rims_alone {
                    let rims = criteria.given_corners.len() + vertices.len();
                    return Err(RemeshError::TooFewForRims { points, rims });
                }
                dropped.extend(features.curves.iter().filter(|c| !c.is_rim).map(named));
                rims_alone = true;
            } else if creases == 0 {
                dropped.extend(features.curves.iter().map(named));
                return Ok(Self { dropped, is_crowded, criteria: all, ..Self::default() });
            }
            criteria.crease_angle_deg = 0.0;
            criteria.given_creases.clear();
        }
    }

    /// The curves' seeds and as many drawn ones as make `points`, by the roots of `weights`, clear of the curves; caller's
    /// coordinates.
    pub(crate) fn with_others(
        &self,
        plan: &Plan<'_>,
        weights: Option<&[f64]>,
        surface: &Surface,
        seed: u64,
        token: &Token,
    ) -> Result<Vec<DVec3>, Stopped> {
        let (mesh, points): (&TriMesh, usize) = (&plan.mesh, plan.points);
        let frame = surface.frame();
        let mut all: Vec<DVec3> = (0..self.seeds.len() as u32).map(|i| self.position(mesh, frame, i)).collect();
        // Some seeds have no vertex of their own in the end.
        let all_narrow = !self.narrow.is_empty() && !self.narrow.contains(&false);
        let others = if all_narrow { 0 } else { (points + self.surplus()).saturating_sub(all.len()) };
        let clearance = self.seeds.clearance(CLEARANCE);
        let clear = |p: &DVec3| clearance.holds(frame.to_unit(*p));
        // Seeds do not cross curves, so each region gets its own share.
        let regions = self.features.regions(mesh);
        token.check()?;
        let wide = self.wide(mesh, weights);
        let weights = wide.as_deref().or(weights);
        let draw = |count: usize| -> Result<(Vec<DVec3>, Vec<DVec3>), Stopped> {
            let drawn = spread_unless(mesh, (weights, Some(&regions)), count, seed, token)?;
            let is_clear = tasks::map(drawn.len(), |k| clear(&drawn[k].position));
            let (mut kept, mut rest) = (Vec::new(), Vec::new());
            for (sample, is_clear) in drawn.iter().zip(is_clear) {
                if is_clear { &mut kept } else { &mut rest }.push(sample.position);
            }
            Ok((kept, rest))
        };
        let (mut kept, mut rest) = draw(others + others / SPARE_POINTS)?;
        if kept.len() < others {
            let share = (kept.len() as f64 / (others + others / SPARE_POINTS) as f64).max(LEAST_CLEAR);
            (kept, rest) = draw((others as f64 / share) as usize + others / SPARE_POINTS + 1)?;
        }
        // If curves cover nearly all of the surface, seeds begin near them.
        let lacking = others.saturating_sub(kept.len());
        all.extend(evenly(&rest, lacking));
        all.extend(evenly(&kept, others - lacking));
        Ok(all)
    }

    /// The weights of vertices, 0 at those of narrow patches, if there are any.
    fn wide(&self, mesh: &TriMesh, weights: Option<&[f64]>) -> Option<Vec<f64>> {
        if !self.narrow.contains(&true) || !self.narrow.contains(&false) {
            return None;
        }
        let mut wide = weights.map_or_else(|| vec![1.0; mesh.positions().len()], <[f64]>::to_vec);
        for (&t, _) in mesh.facets().iter().zip(&self.narrow).filter(|(_, narrow)| **narrow) {
            t.iter().for_each(|&v| wide[v as usize] = 0.0);
        }
        Some(wide)
    }

    /// Where a curve's seed lies, caller's coordinates: a corner exactly at its vertex.
    pub(crate) fn position(&self, mesh: &TriMesh, frame: Frame, seed: u32) -> DVec3 {
        match self.features.corners.get(seed as usize) {
            Some(&vertex) => mesh.positions()[vertex as usize],
            None => frame.to_world(self.seeds.seeds[seed as usize]),
        }
    }

    /// For each segment of the curves the edge between its seeds, where the facets have it.
    pub(crate) fn edges_in(&self, facets: &[[u32; 3]], vertex_seed: &[u32]) -> Vec<Option<[u32; 2]>> {
        let n = self.seeds.len() as u32;
        let edges = facets.iter().flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]);
        let on_curves = edges.filter(|e| e.iter().all(|&v| vertex_seed[v as usize] < n));
        let mut by_seeds: Vec<([u32; 2], [u32; 2])> = on_curves
            .map(|e| {
                let [a, b] = e.map(|v| vertex_seed[v as usize]);
                if a < b { ([a, b], e) } else { ([b, a], [e[1], e[0]]) }
            })
            .collect();
        by_seeds.sort_unstable();
        let find = |ends: [u32; 2]| {
            let key = undirected(ends);
            let at = by_seeds.partition_point(|(seeds, _)| *seeds < key);
            by_seeds.get(at).filter(|(seeds, _)| *seeds == key).map(|&(_, e)| e)
        };
        self.seeds.segments.iter().map(|s| find(s.ends)).collect()
    }

    /// Vertices between which there is no edge though their seeds follow each other on a curve of a kind that `counts`.
    pub(crate) fn missing(
        &self,
        edges: &[Option<[u32; 2]>],
        vertex_seed: &[u32],
        counts: impl Fn(CurveKind) -> bool,
    ) -> Vec<[u32; 2]> {
        // Seeds of curves are the first ones, and so are their vertices, unless a cell is in parts.
        let vertex = |seed: u32| {
            let first = vertex_seed.partition_point(|&s| s < seed);
            let copies = vertex_seed[first..].iter().take_while(|&&s| s == seed).count();
            (copies == 1).then_some(first as u32)
        };
        let kind = |s: &Segment| self.features.curves[s.curve as usize].kind;
        let missing = self.seeds.segments.iter().zip(edges).filter(|(s, e)| e.is_none() && counts(kind(s)));
        missing.filter_map(|(s, _)| Some([vertex(s.ends[0])?, vertex(s.ends[1])?])).collect()
    }

    /// Places the seeds again for a lifted surface, on which curves are longer by `stretch` at each vertex. Where they are more
    /// than curves may have, they stay as they are.
    pub(crate) fn place_lifted(
        &mut self,
        surface: &Surface,
        stretch: &[f64],
        root_mass: f64,
        points: usize,
        token: &Token,
    ) -> Result<(), Stopped> {
        let features = &self.features;
        let edge = edge_length(surface, (features, stretch), root_mass, points, token)?;
        let most = (LARGEST_SHARE * points as f64) as usize;
        if let Some(mut seeds) = CurveSeeds::place(surface, (features, stretch), edge, most, token)? {
            let even = edge_length(surface, (&Features::default(), &[]), surface.area(), points, token)?;
            seeds.split_by_deviation(LIFTED_CHORD_EDGE * even, token)?;
            let share = |seams: &Arc<Seams>| seams.share(&mut seeds, features, surface.positions());
            let (joints, copies) = self.seams.as_ref().map(share).unwrap_or_default();
            if seeds.len() <= most {
                (self.joints, self.copies) = (joints, copies);
                self.stays = staying(&seeds, features);
                self.seeds = seeds;
            }
        }
        Ok(())
    }

    /// Edges of the curves of some kinds, by the first vertex at each place.
    pub(crate) fn curve_edges(&self, wanted: impl Fn(CurveKind) -> bool) -> impl Iterator<Item = [u32; 2]> {
        let curves = self.features.curves.iter().filter(move |c| wanted(c.kind));
        curves.flat_map(|c| c.round().zip(c.round().skip(1)).map(|(a, b)| [a, b]).collect::<Vec<_>>())
    }

    /// Vertices of curves, by the first at each place; some more than once.
    pub(crate) fn curve_vertices(&self) -> impl Iterator<Item = u32> {
        self.features.curves.iter().flat_map(|c| &c.vertices).chain(&self.features.corners).copied()
    }

    /// How many seeds have no vertex of their own in the end: they are in the places of others, where sheets meet, or within an edge
    /// that stays.
    pub(crate) fn surplus(&self) -> usize {
        self.copies + self.seeds_within_rims().len()
    }

    /// The seeds between the ends of each edge that stays, the outer ones first: their vertices are taken out of the result.
    pub(crate) fn seeds_within_rims(&self) -> Vec<u32> {
        let rims = self.seeds.segments.iter().filter(|segment| self.features.curves[segment.curve as usize].is_rim);
        let mut within: Vec<(u32, f64, u32)> = Vec::new();
        for (segment, seed) in rims.flat_map(|segment| segment.ends.map(|seed| (segment, seed))) {
            if !self.is_corner(seed) {
                let place = self.seeds.seeds[seed as usize];
                let corner = |v: u32| self.features.corners.binary_search(&v).ok();
                let ends = self.features.curves[segment.curve as usize].ends().map(corner).into_iter().flatten();
                let apart = ends.map(|end| self.seeds.seeds[end].distance(place)).fold(f64::INFINITY, f64::min);
                within.push((segment.curve, apart, seed));
            }
        }
        within.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        within.dedup();
        within.into_iter().map(|(.., seed)| seed).collect()
    }

    /// What a seed with copies at other sheets is joined by.
    pub(crate) fn joint(&self, seed: u32) -> Option<Joint> {
        self.joints.get(seed as usize).copied().flatten()
    }

    /// Whether a seed stays at its place, since several sheets have it, or an edge that stays.
    pub(crate) fn stays(&self, seed: u32) -> bool {
        self.stays.get(seed as usize).copied().unwrap_or(false)
    }

    /// For each seed whether it is on a boundary.
    pub(crate) fn on_boundaries(&self) -> Vec<bool> {
        let mut on = vec![false; self.seeds.len()];
        let kind = |s: &&Segment| self.features.curves[s.curve as usize].kind == CurveKind::Boundary;
        self.seeds.segments.iter().filter(kind).flat_map(|s| s.ends).for_each(|seed| on[seed as usize] = true);
        on
    }

    /// The ends of boundary edges that a result lacks and has to have, as [`KeptCurves::missing`]: where sheets meet, too.
    pub(crate) fn missing_closing(&self, edges: &[Option<[u32; 2]>], vertex_seed: &[u32]) -> Vec<[u32; 2]> {
        if self.are_joined() {
            self.missing(edges, vertex_seed, |kind| kind == CurveKind::Boundary)
        } else {
            Vec::new()
        }
    }

    /// Whether sheets are joined along curves: where an edge of one is missing, the result is open.
    pub(crate) fn are_joined(&self) -> bool {
        self.closes || self.seams.is_some()
    }

    fn signs(&self, curve: &Curve) -> Option<&Signs> {
        self.seams.as_ref().and_then(|seams| seams.signs(curve))
    }

    /// For each edge that a result is to have at a boundary that a motion takes to another: its seeds, the motions, and the edge if the
    /// result has it; `edges` are those of [`KeptCurves::edges_in`].
    pub(crate) fn periodic<'a>(
        &'a self,
        edges: &'a [Option<[u32; 2]>],
    ) -> impl Iterator<Item = ([u32; 2], &'a Signs, Option<[u32; 2]>)> + 'a {
        let signs: Vec<Option<&Signs>> = self.features.curves.iter().map(|curve| self.signs(curve)).collect();
        let segments = self.seeds.segments.iter().zip(edges);
        segments.filter_map(move |(segment, &edge)| Some((segment.ends, signs[segment.curve as usize]?, edge)))
    }

    /// For each facet, whether its patch is too narrow for seeds within; empty if there are none.
    pub(crate) fn narrow(&self) -> &[bool] {
        &self.narrow
    }

    /// The vertices that corners are for without any curve, each with its seed.
    pub(crate) fn points(&self) -> impl Iterator<Item = (u32, u32)> {
        let seed = |v: &u32| Some((*v, self.features.corners.binary_search(v).ok()? as u32));
        self.features.points.iter().filter_map(seed)
    }

    /// The vertex of a corner.
    pub(crate) fn corner(&self, seed: u32) -> Option<u32> {
        self.features.corners.get(seed as usize).copied()
    }

    /// The curves as chains of their seeds.
    pub(crate) fn chains(&self) -> Vec<Chain> {
        let mut of_curve: Vec<HashMap<u32, u32>> = vec![HashMap::new(); self.features.curves.len()];
        let mut first: Vec<Option<u32>> = vec![None; self.features.curves.len()];
        for Segment { ends, curve, .. } in &self.seeds.segments {
            of_curve[*curve as usize].insert(ends[0], ends[1]);
            first[*curve as usize].get_or_insert(ends[0]);
        }
        let mut chains = Vec::new();
        for ((curve, next), first) in self.features.curves.iter().zip(of_curve).zip(first) {
            let corner = self.features.corners.binary_search(&curve.vertices[0]).ok().filter(|_| !curve.closed);
            let Some(start) = corner.map(|k| k as u32).or(first) else { continue };
            let mut seeds = vec![start];
            while seeds.len() <= next.len()
                && let Some(&after) = next.get(&seeds[seeds.len() - 1])
            {
                seeds.push(after);
            }
            // An edge that stays has none between its ends in the result.
            if curve.is_rim {
                seeds.drain(1..(seeds.len() - 1).max(1));
            }
            let boundary = curve.kind == CurveKind::Boundary;
            chains.push(Chain { vertices: curve.round().collect(), closed: curve.closed, seeds, boundary });
        }
        chains
    }

    /// The edges of all curves that there are, those that were dropped or left out as noise too, by the first `vertices` of a surface.
    pub(crate) fn every_edge(
        &self,
        (mesh, surface): (&TriMesh, &Surface),
        vertices: usize,
        token: &Token,
    ) -> Result<Vec<[u32; 2]>, RemeshError> {
        let criteria = FeatureOptions { min_crease_length: 0.0, ..self.criteria.clone() };
        let all = Features::find(mesh, surface.positions(), &criteria, token)?;
        let mut edges = Vec::new();
        for curve in &all.curves {
            let chain: Vec<u32> = curve.round().filter(|v| (*v as usize) < vertices).collect();
            edges.extend(chain.windows(2).map(|pair| [pair[0], pair[1]]));
        }
        Ok(edges)
    }

    pub(crate) fn dropped(&self) -> &[DroppedCurve] {
        &self.dropped
    }

    /// Moves the places of curves that were dropped.
    pub(crate) fn move_dropped(&mut self, to: impl Fn(DVec3) -> DVec3) {
        self.dropped.iter_mut().for_each(|curve| curve.place = to(curve.place.into()).to_array());
    }

    /// Whether any curve was sought by an angle.
    pub(crate) fn seeks_creases(&self) -> bool {
        self.criteria.crease_angle_deg > 0.0
    }

    /// Whether curves divide a surface of so many sheets.
    pub(crate) fn divide(&self, mesh: &TriMesh, sheets: usize) -> bool {
        let patches: HashSet<u32> = self.features.regions(mesh).into_iter().collect();
        patches.len() > sheets
    }

    pub(crate) fn is_corner(&self, seed: u32) -> bool {
        (seed as usize) < self.seeds.corners
    }

    /// Points of the curves that the result has edges for; `edges` are those of [`KeptCurves::edges_in`].
    pub(crate) fn samples(&self, edges: &[Option<[u32; 2]>]) -> Vec<CurveSample> {
        let present = self.seeds.segments.iter().zip(edges).filter_map(|(s, &e)| Some((s, e?)));
        let beside_acute = self.seeds.beside_acute();
        let of = |(segment, edge): (&Segment, [u32; 2])| {
            let [a, b] = segment.ends.map(|e| self.seeds.seeds[e as usize]);
            let area = a.distance_squared(b) / INNER_POINTS as f64;
            let limit = segment.edge
                * match self.features.curves[segment.curve as usize].kind {
                    _ if segment.ends.iter().any(|&e| beside_acute[e as usize]) => ACUTE_LIMIT,
                    _ if self.has_regions => REGION_LIMIT,
                    CurveKind::Boundary => BOUNDARY_LIMIT,
                    CurveKind::Crease => CREASE_LIMIT,
                };
            segment.between.map(|position| CurveSample { position, edge, area, limit })
        };
        present.flat_map(of).collect()
    }

    /// The curves by arc length, unit frame, and the stretches of those edges that a result has; `edges` are those of
    /// [`KeptCurves::edges_in`].
    pub(crate) fn stretches(
        &self,
        surface: &Surface,
        edges: &[Option<[u32; 2]>],
        vertex_seed: &[u32],
    ) -> (Vec<Polyline>, Vec<([u32; 2], Stretch)>) {
        let at = |v: u32| surface.positions()[v as usize];
        let of = |c: &Curve| Polyline::new(c.round().map(at).collect(), c.closed);
        let lines: Vec<Polyline> = self.features.curves.iter().map(of).collect();
        let stretch = |k: usize| {
            let segment = &self.seeds.segments[k];
            let [a, b] = edges[k]?;
            let line = &lines[segment.curve as usize];
            let place = |end: usize| match segment.ends[end] {
                // The corner at the beginning of an open curve may be at its end too.
                seed if self.is_corner(seed) && end == 0 => 0.0,
                seed if self.is_corner(seed) => line.length(),
                seed => line.nearest(self.seeds.seeds[seed as usize]),
            };
            let edge = if vertex_seed[a as usize] == segment.ends[0] { [a, b] } else { [b, a] };
            Some((edge, line.stretch(segment.curve, [place(0), place(1)])))
        };
        let stretches = tasks::flat_map(edges.len().min(self.seeds.segments.len()), stretch);
        (lines, stretches)
    }

    /// Whether a seed is one of a curve's.
    pub(crate) fn has_seed(&self, seed: u32) -> bool {
        (seed as usize) < self.seeds.len()
    }

    /// As [`sectors::angle_bound_deg`], for a result with the seeds of its vertices.
    pub(crate) fn angle_bound_deg(&self, mesh: &TriMesh, edges: &[[u32; 2]], vertex_seed: &[u32]) -> Option<f64> {
        sectors::angle_bound_deg(mesh, edges, |v| self.is_corner(vertex_seed[v as usize]))
    }

    /// What the report says but for that; `edges` are those of [`KeptCurves::edges_in`].
    pub(crate) fn figures(&self, edges: &[Option<[u32; 2]>]) -> FeatureFigures {
        // Where sheets are joined again, their boundaries are none of the result.
        let kind = |(k, c): (u32, &Curve)| match c.kind {
            CurveKind::Boundary if self.seeds.is_shared(k) && self.signs(c).is_none() => CurveKind::Crease,
            kind => kind,
        };
        let own = || (0..).zip(&self.features.curves).filter(|(_, c)| !c.is_rim);
        // Of copies in one place, the first counts.
        let mut met = HashSet::new();
        let is_copy = |c: &Curve| {
            let seams = self.seams.as_ref().filter(|_| !self.narrow.is_empty());
            seams.and_then(|seams| seams.first_edge(c)).is_some_and(|edge| !met.insert(edge))
        };
        let copies: Vec<bool> = self.features.curves.iter().map(is_copy).collect();
        let count = |wanted| own().filter(|curve| kind(*curve) == wanted && !copies[curve.0 as usize]).count();
        // What becomes of edges that stay is seen where both parts are put together.
        let is_rim = |s: &Segment| self.features.curves[s.curve as usize].is_rim;
        let own = self.seeds.segments.iter().zip(edges).filter(|(s, _)| !is_rim(s));
        let missing: Vec<u32> = own.filter(|(_, e)| e.is_none()).map(|(s, _)| s.curve).collect();
        let broken: HashSet<u32> = missing.iter().copied().collect();
        let mut dropped = self.dropped.clone();
        dropped.sort_by(|a, b| b.length.total_cmp(&a.length));
        let dropped_length = dropped.iter().fold(0.0, |sum, curve| sum + curve.length);
        dropped.truncate(MOST_DROPPED_NAMED);
        FeatureFigures {
            boundaries: count(CurveKind::Boundary),
            creases: count(CurveKind::Crease),
            corners: self.features.corners.len(),
            merged_corners: self.features.joined,
            seeds: self.seeds.len() - if self.narrow.is_empty() { 0 } else { self.copies },
            segments: self.seeds.segments.len(),
            missing_segments: missing.len(),
            broken_curves: broken.len(),
            dropped_curves: self.dropped.len(),
            dropped_length,
            dropped,
            short_crease_edges: self.features.left_out,
            angle_bound_deg: None,
            is_designed: false,
            dropped_share: 0.0,
            away_share: 0.0,
        }
    }
}
