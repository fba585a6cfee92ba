//! Patches between creases that have no room for cells of their own.
//!
//! Purpose: where sheets are apart that meet along curves, [`mend`] looks for those whose dual lacks edges of the curves around them, or
//! has another topology, or is far from the patch, as at a needle whose tip is lost, or leaves the plane of a patch that is in one. It
//! replaces them by the patch of the input itself, of which all vertices but the seeds of the curves are taken out ([`simplified`]).
//! Invariant: a patch that was replaced has all edges of its curves, which its neighbours have too. Others stay as they are.
//! Must not know: how seeds of curves are placed, why the surface was divided.

mod flat;

use std::collections::{BTreeMap, HashMap, HashSet};

use glam::DVec3;

use super::extract::Built;
use crate::mesh::adjacency::weld_unless;
use crate::mesh::apart::Apart;
use crate::mesh::closest_point::{ClosestPoint, closest_on_facet};
use crate::mesh::edges::{sides, undirected};
use crate::mesh::{MeshError, TriMesh};
use crate::remesh::constants::IN_PLANE;
use crate::remesh::features::{Chain, KeptCurves};
use crate::remesh::manifold::LocalMesh;
use crate::remesh::triangle::{score, unit_normal};
use crate::tasks;
use crate::token::{Stopped, Token};

/// Facets do not turn by more than this from the patch, cosines, and have a better score, as long as vertices can be taken out so.
const LEAST: [(f64, f64); 5] = [(0.5, 0.1), (0.5, 0.01), (0.5, 1e-6), (0.0, 0.0), (-1.0, -1.0)];
/// A patch with more facets has room for cells of its own, but for what it is far from, as a shaft that is thinner than an edge.
const MOST_FACETS: usize = 50;
/// Patches with more facets that are replaced have at most this share of all vertices within: others would be missed elsewhere.
const MOST_REPLACED: f64 = 0.1;
/// A vertex within a patch stays if the patch would be farther from it without, share of the edges of its curves.
const FARTHEST: f64 = 0.25;
/// A seed this near to an end of an edge of the input is there, share of the edge.
const IN_PLACE: f64 = 1e-9;
const PASSES: usize = 50;
const ROUNDS: usize = 4;
/// Facets that a flip makes face the patch within this, cosine.
const FLIPPED: f64 = 0.3;
/// No flip makes a facet with a smaller angle, degrees, where there was none: its edge would be divided in the same place again.
const LEAST_FLIPPED: f64 = 1e-6;
/// Facets that turn by less than this are of one smooth surface, cosine: the other diagonal is as near to it.
const SMOOTH: f64 = 0.9;
/// Edges this near to the patch are in it, share of the edges of its curves: of those the better facets decide.
const IN_PATCH: f64 = 0.02;

/// What a patch is made of.
#[derive(Default)]
struct Patch {
    /// Of the divided surface.
    facets: Vec<u32>,
    /// Of the result.
    result: Vec<u32>,
    chains: Vec<usize>,
}

impl Patch {
    /// The corners of the facets of the divided surface.
    fn places(&self, mesh: &TriMesh) -> Vec<[DVec3; 3]> {
        self.facets.iter().map(|&f| mesh.facets()[f as usize].map(|v| mesh.positions()[v as usize])).collect()
    }

    /// The plane that all of its vertices are in, as a place and a normal; `None` if there is none.
    fn plane(&self, mesh: &TriMesh, reach: f64) -> Option<(DVec3, DVec3)> {
        let places = self.places(mesh);
        let normal: DVec3 = places.iter().map(|[a, b, c]| (*b - *a).cross(*c - *a)).sum();
        let (origin, normal) = (places.first()?[0], normal.try_normalize()?);
        places.iter().flatten().all(|p| (*p - origin).dot(normal).abs() <= reach).then_some((origin, normal))
    }

    /// Whether its facets in the result are in its plane, and none is turned over.
    fn is_in(&self, built: &Built, (origin, normal): (DVec3, DVec3), reach: f64) -> bool {
        let corners = |&f: &u32| built.mesh.facets()[f as usize].map(|v| built.mesh.positions()[v as usize]);
        self.result.iter().map(corners).all(|[a, b, c]| {
            [a, b, c].iter().all(|p| (*p - origin).dot(normal).abs() <= reach)
                && (b - a).cross(c - a).dot(normal) >= 0.0
        })
    }

    /// The vertices of the result that are of none of the curves, with their seeds: one of each.
    fn within(&self, built: &Built, chains: &[&Chain]) -> Vec<(u32, DVec3)> {
        let mut seen: HashSet<u32> = chains.iter().flat_map(|chain| &chain.seeds).copied().collect();
        let mut vertices: Vec<u32> = self.result.iter().flat_map(|&f| built.mesh.facets()[f as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let own = |v: u32| (built.vertex_seed[v as usize], built.mesh.positions()[v as usize]);
        vertices.into_iter().map(own).filter(|own| seen.insert(own.0)).collect()
    }
}

/// Replaces the patches that need it. Returns whether all have their edges then: a curved one with room for cells of its own stays as it is.
pub(super) fn mend(
    built: &mut Built,
    (mesh, curves, seeds): (&TriMesh, &KeptCurves, &[DVec3]),
    apart: &Apart,
    token: &Token,
) -> Result<Result<bool, MeshError>, Stopped> {
    let class = weld_unless(mesh, token)?;
    let chains = curves.chains();
    let mut patches: BTreeMap<usize, Patch> = BTreeMap::new();
    for (f, t) in mesh.facets().iter().enumerate() {
        patches.entry(apart.part(mesh.positions()[t[0] as usize])).or_default().facets.push(f as u32);
    }
    for (f, t) in built.mesh.facets().iter().enumerate() {
        let middle = t.iter().map(|&v| built.mesh.positions()[v as usize]).sum::<DVec3>() / 3.0;
        patches.entry(apart.part(middle)).or_default().result.push(f as u32);
    }
    for (k, chain) in chains.iter().enumerate() {
        patches.entry(apart.part(mesh.positions()[chain.vertices[0] as usize])).or_default().chains.push(k);
    }
    let narrow = curves.narrow();
    let at = |seed: u32| curves.corner(seed).map_or(seeds[seed as usize], |v| mesh.positions()[v as usize]);
    let closest = ClosestPoint::unless(&built.mesh, token)?;
    let mut left = (MOST_REPLACED * built.mesh.positions().len() as f64) as usize;
    let mut all = true;
    let mut gone: HashSet<u32> = HashSet::new();
    let mut made: Vec<Simplified> = Vec::new();
    for patch in patches.values() {
        token.check()?;
        let of = || patch.chains.iter().map(|&k| &chains[k]);
        let wanted: HashSet<[u32; 2]> =
            of().filter(|chain| chain.boundary).flat_map(|chain| chain.edges()).map(undirected).collect();
        let is_narrow = patch.facets.iter().any(|&f| narrow.get(f as usize) == Some(&true));
        if wanted.is_empty() {
            continue;
        }
        let is_large = !is_narrow && patch.result.len() > MOST_FACETS;
        let is_whole = is_narrow || is_whole(built, patch, &wanted, (mesh, &class));
        let chains: Vec<&Chain> = of().collect();
        let mut within = if is_narrow { Vec::new() } else { patch.within(built, &chains) };
        let lengths = of().flat_map(|chain| chain.edges()).map(|ends| at(ends[0]).distance(at(ends[1])));
        let longest = lengths.fold(0.0, f64::max);
        let plane = patch.plane(mesh, IN_PLANE * longest);
        let is_in_plane = plane.is_none_or(|plane| patch.is_in(built, plane, IN_PLANE * longest));
        if let Some((origin, normal)) = plane {
            within.iter_mut().for_each(|(_, p)| *p -= (*p - origin).dot(normal) * normal);
        }
        // Where sheets only touch, as in a scan, curves may be noise.
        if !narrow.is_empty()
            && (is_narrow || !is_whole || !is_in_plane)
            && let Some(new) = flat::triangulated(&patch.places(mesh), &chains, at, &within)
        {
            gone.extend(&patch.result);
            made.push(new);
            continue;
        }
        if !is_narrow && (is_whole || is_large) {
            let may_replace = !is_large || within.len() <= left;
            if !may_replace || is_whole && !is_far(&closest, patch, mesh, longest) {
                all &= is_whole;
                continue;
            }
        }
        let facets: Vec<[u32; 3]> =
            patch.facets.iter().map(|&f| mesh.facets()[f as usize].map(|v| class[v as usize])).collect();
        if let Some(new) = simplified((mesh, &facets), &chains, at, within.len(), token)? {
            gone.extend(&patch.result);
            made.push(new);
            left -= if is_large { within.len() } else { 0 };
        } else {
            all = false;
        }
    }
    if made.is_empty() {
        return Ok(Ok(all));
    }
    Ok(replace(built, curves, &gone, made).map(|()| all))
}

/// Whether a patch has the edges of its curves, as a boundary, and the topology of the input.
fn is_whole(built: &Built, patch: &Patch, wanted: &HashSet<[u32; 2]>, (mesh, class): (&TriMesh, &[u32])) -> bool {
    let of_seeds = |[a, b]: [u32; 2]| undirected([a, b].map(|v| built.vertex_seed[v as usize]));
    let facets = || patch.result.iter().map(|&f| built.mesh.facets()[f as usize]);
    let Some((euler, rim)) = outline(facets()) else { return false };
    let given = patch.facets.iter().map(|&f| mesh.facets()[f as usize].map(|v| class[v as usize]));
    let given = given.filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
    rim.len() == wanted.len()
        && rim.iter().all(|&edge| wanted.contains(&of_seeds(edge)))
        && outline(given).is_none_or(|(of_given, _)| of_given == euler)
}

/// Whether a vertex of a patch is farther than this from the result.
fn is_far(closest: &ClosestPoint, patch: &Patch, mesh: &TriMesh, reach: f64) -> bool {
    let mut vertices: Vec<u32> = patch.facets.iter().flat_map(|&f| mesh.facets()[f as usize]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    tasks::any(vertices.len(), |k| closest.distance(mesh.positions()[vertices[k] as usize]) > reach)
}

/// The Euler number of some facets, and their boundary; `None` if a half-edge is there twice.
fn outline(facets: impl Iterator<Item = [u32; 3]>) -> Option<(i64, Vec<[u32; 2]>)> {
    let (mut halves, mut vertices, mut count) = (HashSet::new(), HashSet::new(), 0i64);
    for t in facets {
        count += 1;
        vertices.extend(t);
        for side in sides(t) {
            if !halves.insert(side) {
                return None;
            }
        }
    }
    let rim: Vec<[u32; 2]> = halves.iter().copied().filter(|&[a, b]| !halves.contains(&[b, a])).collect();
    let edges = (halves.len() + rim.len()) as i64 / 2;
    Some((vertices.len() as i64 - edges + count, rim))
}

/// A patch with the seeds of its curves as its vertices, each with its place, and others where one could not be taken out.
type Simplified = (Vec<(u32, DVec3)>, Vec<[u32; 3]>);

/// The seed of a vertex that is of no curve.
const NO_SEED: u32 = u32::MAX;

/// `facets` without all vertices but the seeds of `chains`, and `within` new ones where edges are long; `None` if the boundary would have
/// others.
fn simplified(
    (mesh, facets): (&TriMesh, &[[u32; 3]]),
    chains: &[&Chain],
    at: impl Fn(u32) -> DVec3,
    within: usize,
    token: &Token,
) -> Result<Option<Simplified>, Stopped> {
    let mut vertices: Vec<u32> = facets.iter().flatten().copied().collect();
    vertices.sort_unstable();
    vertices.dedup();
    let local = |v: u32| vertices.binary_search(&v).ok().map(|k| k as u32);
    let places = vertices.iter().map(|&v| mesh.positions()[v as usize]).collect();
    let own: Vec<[u32; 3]> = facets
        .iter()
        .filter_map(|t| Some([local(t[0])?, local(t[1])?, local(t[2])?]))
        .filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0])
        .collect();
    let mut curve_edges = HashSet::new();
    let mut lines = Vec::with_capacity(chains.len());
    for chain in chains {
        let line: Option<Vec<u32>> = chain.vertices.iter().map(|&v| local(v)).collect();
        let Some(line) = line else { return Ok(None) };
        curve_edges.extend(line.windows(2).map(|pair| undirected([pair[0], pair[1]])));
        lines.push(line);
    }
    let mut patch = LocalMesh::new(places, own, curve_edges);
    let mut seed_of: HashMap<u32, u32> = HashMap::new();
    for (chain, line) in chains.iter().zip(&lines) {
        let places: Vec<DVec3> = line.iter().map(|&v| patch.positions[v as usize]).collect();
        let Some(along) = chain.along(&places, &at) else { return Ok(None) };
        // From the far end on, so that what comes before stays one edge.
        let mut k = line.len() - 2;
        let mut next = line[k + 1];
        for &(seed, edge, share) in along.iter().rev() {
            while k > edge {
                k -= 1;
                next = line[k + 1];
            }
            // A vertex of the input may be in the place, and a corner is one for each of its curves.
            let is_free = |v: u32| seed_of.get(&v).is_none_or(|&own| own == seed);
            let v = if share <= IN_PLACE && is_free(line[edge]) {
                line[edge]
            } else if share >= 1.0 - IN_PLACE && is_free(line[edge + 1]) {
                line[edge + 1]
            } else {
                next = patch.split([line[edge], next], at(seed));
                next
            };
            seed_of.insert(v, seed);
        }
    }
    for (&v, &seed) in &seed_of {
        patch.place(v, at(seed));
    }
    let lengths = || chains.iter().flat_map(|chain| chain.edges()).map(|ends| at(ends[0]).distance(at(ends[1])));
    let edge = lengths().sum::<f64>() / lengths().count().max(1) as f64;
    let Ok(whole) = TriMesh::new(patch.positions.clone(), patch.facets().to_vec()) else { return Ok(None) };
    let surface = Original { closest: ClosestPoint::unless(&whole, token)?, reach: IN_PATCH * edge };
    let facing: Vec<DVec3> = (0..patch.positions.len() as u32).map(|v| patch.vertex_normal(v)).collect();
    let is_left = |patch: &LocalMesh, v: u32| !seed_of.contains_key(&v) && !patch.ring(v).is_empty();
    for _ in 0..ROUNDS {
        take_out(&mut patch, &surface, (&facing, FARTHEST * edge), |v| seed_of.contains_key(&v), token)?;
        if !(0..patch.positions.len() as u32).any(|v| is_left(&patch, v) && patch.is_on_boundary(v)) {
            break;
        }
        // Another diagonal may let a vertex of the boundary go.
        flip(&mut patch, &surface, &facing, -1.0);
    }
    let (kept, _) = patch.compact();
    let seed = |v: &u32| seed_of.get(v).copied().unwrap_or(NO_SEED);
    if kept.iter().zip(0..).any(|(v, k)| seed(v) == NO_SEED && patch.is_on_boundary(k)) {
        return Ok(None);
    }
    let mut facing: Vec<DVec3> = kept.iter().map(|&v| facing[v as usize]).collect();
    flip(&mut patch, &surface, &facing, -1.0);
    let inner = kept.iter().filter(|v| seed(v) == NO_SEED).count();
    divide(&mut patch, &surface, &mut facing, (edge, within.saturating_sub(inner)), token)?;
    let seeds = kept.iter().map(seed).chain(std::iter::repeat(NO_SEED));
    let of: Vec<(u32, DVec3)> = seeds.zip(patch.positions.iter().copied()).collect();
    Ok(Some((of, patch.into_parts().1)))
}

/// Splits the longest edges within a patch, as long as they are longer than `edge`, until there are `wanted` vertices more.
fn divide(
    patch: &mut LocalMesh,
    surface: &Original,
    facing: &mut Vec<DVec3>,
    (edge, mut wanted): (f64, usize),
    token: &Token,
) -> Result<(), Stopped> {
    for _ in 0..PASSES {
        token.check()?;
        let mut seen = HashSet::new();
        let inner = patch.facets().iter().flat_map(|&t| sides(t)).map(undirected).filter(|&side| !seen.insert(side));
        let length = |[a, b]: [u32; 2]| patch.positions[a as usize].distance(patch.positions[b as usize]);
        let mut longest: Vec<(f64, [u32; 2])> =
            inner.map(|side| (length(side), side)).filter(|own| own.0 > edge).collect();
        longest.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut touched: HashSet<u32> = HashSet::new();
        for (_, ends) in longest {
            if wanted == 0 || touched.contains(&ends[0]) || touched.contains(&ends[1]) {
                continue;
            }
            let [p, q] = ends.map(|v| patch.positions[v as usize]);
            patch.split(ends, 0.5 * (p + q));
            facing.push((facing[ends[0] as usize] + facing[ends[1] as usize]).normalize_or_zero());
            touched.extend(ends);
            wanted -= 1;
        }
        if touched.is_empty() {
            break;
        }
        flip(patch, surface, facing, SMOOTH);
    }
    Ok(())
}

/// Collapses edges until no vertex but those that stay can be taken out. `facing` are the normals of the patch at its vertices.
fn take_out(
    patch: &mut LocalMesh,
    surface: &Original,
    (facing, farthest): (&[DVec3], f64),
    stays: impl Fn(u32) -> bool,
    token: &Token,
) -> Result<(), Stopped> {
    for (least, least_score) in LEAST {
        for _ in 0..PASSES {
            token.check()?;
            let mut taken = 0;
            for v in (0..patch.positions.len() as u32).filter(|v| !stays(*v)) {
                if patch.ring(v).is_empty() {
                    continue;
                }
                // How far its new edges are off, the worst score, and where it goes.
                let mut best: Option<(f64, f64, u32)> = None;
                for to in patch.neighbours(v).into_iter().filter(|&to| to != v && patch.may_collapse(v, to)) {
                    let after = patch.collapse_corners(v, to);
                    let turn = after.iter().map(|&(_, t)| {
                        let wanted: DVec3 = t.iter().map(|&u| facing[u as usize]).sum();
                        unit_normal(patch.places(t)).dot(wanted.normalize_or_zero())
                    });
                    if turn.fold(1.0, f64::min) < least {
                        continue;
                    }
                    let place = patch.positions[v as usize];
                    let apart = after.iter().map(|&(_, t)| closest_on_facet(place, patch.places(t), t).0);
                    if !patch.is_on_boundary(v) && apart.fold(f64::INFINITY, f64::min) > farthest.powi(2) {
                        continue;
                    }
                    let worst = after.iter().map(|&(_, t)| score(patch.places(t))).fold(1.0, f64::min);
                    if worst < least_score {
                        continue;
                    }
                    let new = patch.neighbours(v).into_iter().filter(|&u| u != v && u != to);
                    let off = new.map(|u| surface.off(patch, [to, u])).fold(0.0, f64::max);
                    if best.is_none_or(|known| off < known.0 || off == known.0 && worst > known.1) {
                        best = Some((off, worst, to));
                    }
                }
                if let Some((_, _, to)) = best {
                    patch.collapse(v, to);
                    taken += 1;
                }
            }
            if taken == 0 {
                break;
            }
        }
    }
    Ok(())
}

/// The patch as it is in the input.
struct Original {
    closest: ClosestPoint,
    reach: f64,
}

impl Original {
    /// How far the middle of an edge is from the patch; 0 if it is in it.
    fn off(&self, patch: &LocalMesh, ends: [u32; 2]) -> f64 {
        let [p, q] = ends.map(|v| patch.positions[v as usize]);
        (self.closest.distance(p.midpoint(q)) - self.reach).max(0.0)
    }
}

/// Flips edges as long as they come nearer to the patch, or as near and the worse of two facets gets better. Those whose facets turn by
/// more than a cosine are left out. `facing` are the normals of the patch at its vertices.
fn flip(patch: &mut LocalMesh, surface: &Original, facing: &[DVec3], least: f64) {
    for _ in 0..PASSES {
        let mut flipped = false;
        for f in 0..patch.facets().len() as u32 {
            for side in 0..3 {
                // The normal of a facet without an area says nothing.
                let Some(flip) = patch.flip_any(f, side, [2, usize::MAX]) else { continue };
                let direction: DVec3 = flip.corners.iter().flatten().map(|&v| facing[v as usize]).sum();
                let [n, m] = flip.facets.map(|f| unit_normal(patch.corners(f)));
                if n.dot(m) < least || !patch.faces(&flip, direction.normalize_or_zero(), FLIPPED) {
                    continue;
                }
                let worst = |corners: [[DVec3; 3]; 2]| score(corners[0]).min(score(corners[1]));
                let before = worst(flip.facets.map(|f| patch.corners(f)));
                let after = worst(flip.corners.map(|t| patch.places(t)));
                if after < before.min(LEAST_FLIPPED) {
                    continue;
                }
                let is_better = after > before + 1e-9;
                let t = patch.facets()[f as usize];
                let off = [[t[side], t[(side + 1) % 3]], [flip.corners[0][1], flip.corners[0][2]]]
                    .map(|ends| surface.off(patch, ends));
                if off[1] < off[0] || off[1] == off[0] && is_better {
                    patch.apply(&flip);
                    flipped = true;
                }
            }
        }
        if !flipped {
            break;
        }
    }
}

/// Puts new facets in the places of those that are gone.
fn replace(
    built: &mut Built,
    curves: &KeptCurves,
    gone: &HashSet<u32>,
    made: Vec<Simplified>,
) -> Result<(), MeshError> {
    let mut facets: Vec<[u32; 3]> = Vec::new();
    let mut all: Vec<(u32, DVec3)> =
        built.vertex_seed.iter().copied().zip(built.mesh.positions().iter().copied()).collect();
    for (f, &t) in built.mesh.facets().iter().enumerate() {
        if !gone.contains(&(f as u32)) {
            facets.push(t);
        }
    }
    for (vertices, own) in made {
        let first = all.len() as u32;
        all.extend(vertices);
        facets.extend(own.into_iter().map(|t| t.map(|v| first + v)));
    }
    let mut used = vec![false; all.len()];
    facets.iter().flatten().for_each(|&v| used[v as usize] = true);
    // By seeds, as before; a vertex without one is the last.
    let mut order: Vec<usize> = (0..all.len()).filter(|&v| used[v]).collect();
    order.sort_by_key(|&v| all[v].0);
    let mut number = vec![u32::MAX; all.len()];
    order.iter().zip(0..).for_each(|(&v, k)| number[v] = k);
    facets.iter_mut().for_each(|t| *t = t.map(|v| number[v as usize]));
    let mut seen: HashSet<u32> = HashSet::new();
    let has_own = |v: &&usize| all[**v].0 == NO_SEED || seen.insert(all[**v].0);
    built.repair.extra_vertices = order.len() - order.iter().filter(has_own).count();
    let last = built.vertex_seed.last().copied().unwrap_or(0);
    built.vertex_seed = order.iter().map(|&v| if all[v].0 == NO_SEED { last } else { all[v].0 }).collect();
    built.mesh = TriMesh::new(order.iter().map(|&v| all[v].1).collect(), facets)?;
    built.segments = curves.edges_in(built.mesh.facets(), &built.vertex_seed);
    built.curve_edges = built.segments.iter().flatten().copied().collect();
    Ok(())
}
