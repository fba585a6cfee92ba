//! Parts that stay as they are.
//!
//! Purpose: [`remesh`] takes the facets that stay out of a surface. It has the rest remeshed, with the edges between and single vertices
//! held, and puts both together. Where the new part lacks one, the facets beside it stay too, and the rest is remeshed again.
//! Invariant: facets that stay are the first of the result, with their vertices, to the bit; at each edge of theirs there are as many new
//! facets as the input has others. Must not know: how edges are held.

use std::collections::{BTreeMap, HashMap, HashSet};

use glam::DVec3;

use super::attributes;
use super::measured::compare;
use super::preprocess::{Preprocessed, preprocess};
use crate::cvt::density::{DensityError, DensitySource};
use crate::mesh::adjacency::{Adjacency, weld_unless};
use crate::mesh::apart::bits;
use crate::mesh::attributes::Attributes;
use crate::mesh::crossings::crossings;
use crate::mesh::csr::ascending;
use crate::mesh::edges::{DisjointSets, EdgeGroups, sides, undirected};
use crate::mesh::features::Features;
use crate::mesh::measure::{coincident_vertices, topology_unless};
use crate::mesh::parts::{Inclusion, Indices, Part, PartError};
use crate::mesh::{TriMesh, normal};
use crate::remesh::constants::{ENCLOSED_CELLS, FURTHER_KEPT_ROUNDS};
use crate::remesh::features::Held;
use crate::remesh::report::KeptFigures;
use crate::remesh::{Provenance, Remesh, RemeshError, RemeshOptions, Result, Seeds, Tolerance};
use crate::rvd::RvdError;
use crate::token::Token;

/// Remeshes a surface, and holds these of its edges and vertices.
type Run<'a> = &'a mut dyn FnMut((&TriMesh, Held<'_>), &RemeshOptions) -> Result<Remesh>;

/// Remeshes what does not stay.
pub(super) fn remesh(given: &TriMesh, options: &RemeshOptions, run: Run<'_>, token: &Token) -> Result<Remesh> {
    options.attributes.iter().try_for_each(|attributes| attributes.check_mesh(given))?;
    Features::check(given, options.crease_angle_deg, &options.creases, token)?;
    let mut stays = staying(given, options, token)?;
    let class = weld_unless(given, token)?;
    // Vertices in one place that differ in nothing are one, as in files that name no vertices.
    let alike = options.attributes.as_ref().is_none_or(|attributes| !attributes.are_by_vertex());
    let welded = (alike && class.iter().zip(0..).any(|(&lowest, v)| lowest != v)).then(|| {
        let facets = given.facets().iter().map(|t| t.map(|v| class[v as usize])).collect();
        TriMesh::new(given.positions().to_vec(), facets)
    });
    let welded = welded.transpose().map_err(|e| RvdError::Internal(format!("a surface was valid before: {e}")))?;
    let given = welded.as_ref().unwrap_or(given);
    let single = single_vertices(given, options, &class)?;
    let asked = count(&stays);
    let whole = preprocess(given, None, token)?;
    let mut farthest = None;
    stay_without_area(given, &class, &mut stays);
    stay_enclosed(given, (&class, &single), options, &mut stays);
    for round in 1.. {
        token.check()?;
        let Some(free) = Free::of(given, &class, (&stays, &single), options.keep_rims) else {
            return Err(farthest.unwrap_or(RemeshError::AllKept));
        };
        let (part, rims) = free.mesh(given)?;
        let vertices: Vec<u32> = free.single.iter().map(|&v| free.number(v)).collect();
        let held = Held { rims: &rims, vertices: &vertices, ..Held::default() };
        if whole.figures.divided_edges > 0 {
            let within = preprocess(&part, None, token)?.figures.divided_edges;
            if within < whole.figures.divided_edges {
                return Err(RemeshError::KeptAcrossJunction { edges: whole.figures.divided_edges - within });
            }
        }
        let inner = free.options((given, &class), options)?;
        let done = run((&part, held), &inner).map_err(|error| free.counted(error))?;
        token.check()?;
        let mut missed = free.missed(&done.mesh);
        missed.extend(free.missed_vertices(given, &done.mesh).into_iter().map(|v| [class[v as usize]; 2]));
        if missed.is_empty() {
            let further_facets = count(&stays) - asked;
            let kept = KeptFigures {
                facets: free.kept.len(),
                vertices: free.kept_vertices.len(),
                rim_edges: free.rims.len(),
                single_vertices: free.single.len(),
                further_facets,
            };
            return free.join((given, whole), options, done, kept, token);
        }
        let [a, b] = missed[0].map(|v| given.positions()[v as usize]);
        let error = RemeshError::RimsMissed { edges: missed.len(), place: a.midpoint(b) };
        if round == FURTHER_KEPT_ROUNDS {
            return Err(error);
        }
        farthest = Some(error);
        // Farther around each time.
        let mut around: Vec<bool> = vec![false; given.positions().len()];
        missed.iter().flatten().for_each(|&v| around[v as usize] = true);
        for _ in 0..round {
            let touched: Vec<usize> = (0..stays.len())
                .filter(|&f| given.facets()[f].iter().any(|&v| around[class[v as usize] as usize]))
                .collect();
            touched.iter().for_each(|&f| stays[f] = true);
            let corners = touched.iter().flat_map(|&f| given.facets()[f]);
            corners.for_each(|v| around[class[v as usize] as usize] = true);
        }
    }
    Err(RemeshError::AllKept)
}

fn count(stays: &[bool]) -> usize {
    stays.iter().filter(|&&stays| stays).count()
}

/// For each facet whether it is to stay.
fn staying(given: &TriMesh, options: &RemeshOptions, token: &Token) -> Result<Vec<bool>> {
    let regions = options.attributes.as_ref().and_then(Attributes::regions);
    let mut stays = vec![!options.only.is_empty(); given.facets().len()];
    for part in &options.only {
        token.check()?;
        let within = part.facets((given, regions), Inclusion::Within)?;
        stays.iter_mut().zip(within).for_each(|(stays, within)| *stays &= !within);
    }
    for part in options.keep.iter().filter(|part| !matches!(part, Part::Vertices(_))) {
        token.check()?;
        let touching = part.facets((given, regions), Inclusion::Touching)?;
        stays.iter_mut().zip(touching).for_each(|(stays, touching)| *stays |= touching);
    }
    Ok(stays)
}

/// The vertices that are to stay without facets: one in each place, the lowest that a facet has, ascending.
fn single_vertices(given: &TriMesh, options: &RemeshOptions, class: &[u32]) -> Result<Vec<u32>> {
    let lists = options.keep.iter().filter_map(|part| if let Part::Vertices(list) = part { Some(list) } else { None });
    let lists: Vec<&Indices> = lists.collect();
    if lists.is_empty() {
        return Ok(Vec::new());
    }
    // By place, since a facet may have another vertex there.
    let mut of_facets: HashMap<u32, u32> = HashMap::new();
    for &v in given.facets().iter().flatten() {
        of_facets.entry(class[v as usize]).and_modify(|lowest| *lowest = v.min(*lowest)).or_insert(v);
    }
    let vertices = given.positions().len();
    let of = |vertex: u32| {
        let place = class.get(vertex as usize).and_then(|place| of_facets.get(place));
        place.copied().ok_or(PartError::NoSuchVertex { vertex, vertices })
    };
    let all: Vec<u32> = lists.iter().flat_map(|list| list.iter()).map(of).collect::<Result<_, _>>()?;
    Ok(ascending(all))
}

/// Facets without area beside those that stay: no result has their edges.
fn stay_without_area(given: &TriMesh, class: &[u32], stays: &mut [bool]) {
    let welded = |f: usize| given.facets()[f].map(|v| class[v as usize]);
    let flat: Vec<usize> = (0..stays.len()).filter(|&f| given.is_degenerate(f)).collect();
    if flat.is_empty() || !stays.contains(&true) {
        return;
    }
    let mut on_kept = vec![false; class.len()];
    let kept = (0..stays.len()).filter(|&f| stays[f]);
    kept.flat_map(welded).for_each(|v| on_kept[v as usize] = true);
    loop {
        let beside = |&&f: &&usize| !stays[f] && welded(f).iter().any(|&v| on_kept[v as usize]);
        let more: Vec<usize> = flat.iter().filter(beside).copied().collect();
        if more.is_empty() {
            return;
        }
        for f in more {
            stays[f] = true;
            welded(f).iter().for_each(|&v| on_kept[v as usize] = true);
        }
    }
}

/// Facets between those that stay and without a vertex of their own, where each is too small for a new one: nothing there can change.
fn stay_enclosed(given: &TriMesh, (class, single): (&[u32], &[u32]), options: &RemeshOptions, stays: &mut [bool]) {
    let Seeds::Sample { points, .. } = options.seeds else { return };
    let largest = ENCLOSED_CELLS * given.area() / points.max(1) as f64;
    let welded = |f: usize| given.facets()[f].map(|v| class[v as usize]);
    let mut held = vec![false; class.len()];
    (0..stays.len()).filter(|&f| stays[f]).flat_map(welded).for_each(|v| held[v as usize] = true);
    single.iter().for_each(|&v| held[class[v as usize] as usize] = true);
    let free: Vec<usize> = (0..stays.len()).filter(|&f| !stays[f]).collect();
    let mut patches = DisjointSets::new(stays.len());
    EdgeGroups::new(class.len(), free.iter().map(|&f| (f, welded(f)))).for_each(|_, halves| {
        halves.windows(2).for_each(|pair| patches.join(pair[0].facet as usize, pair[1].facet as usize));
    });
    let is_room =
        |f: usize| !welded(f).iter().all(|&v| held[v as usize]) || 0.5 * normal(given.corners(f)).length() > largest;
    let with_room: HashSet<usize> = free.iter().filter(|&&f| is_room(f)).map(|&f| patches.root(f)).collect();
    // What is all that there is to remesh is not given up.
    if !with_room.is_empty() {
        free.into_iter().filter(|&f| !with_room.contains(&patches.root(f))).for_each(|f| stays[f] = true);
    }
}

/// The part of a surface that is remeshed. Vertices and facets are those of the surface.
struct Free {
    facets: Vec<u32>,
    /// Its vertices, ascending.
    vertices: Vec<u32>,
    kept: Vec<u32>,
    kept_vertices: Vec<u32>,
    /// Edges that are held, by the lowest vertices in their places, each with its vertices in this part and how many of its facets have
    /// it, and the end where a facet's side begins.
    rims: BTreeMap<[u32; 2], ([u32; 2], usize, u32)>,
    /// For each vertex of a rim, by its place: the lowest vertex there, and a vertex there that a facet has that stays.
    places: HashMap<[u64; 3], (u32, Option<u32>)>,
    /// Edges of facets that stay with both ends on rims that are no rims themselves: new facets must not have them.
    inside: HashSet<[u32; 2]>,
    /// Vertices that stay and are neither of rims nor of facets that stay.
    single: Vec<u32>,
}

impl Free {
    /// `None` if there is nothing. `class` has the lowest vertex in the place of each.
    fn of(given: &TriMesh, class: &[u32], (stays, single): (&[bool], &[u32]), keep_rims: bool) -> Option<Self> {
        let (kept, facets): (Vec<u32>, Vec<u32>) = (0..stays.len() as u32).partition(|&f| stays[f as usize]);
        if facets.iter().all(|&f| given.is_degenerate(f as usize)) {
            return None;
        }
        let corners = |facets: &[u32]| ascending(facets.iter().flat_map(|&f| given.facets()[f as usize]));
        let (vertices, kept_vertices) = (corners(&facets), corners(&kept));
        let welded = |edge: [u32; 2]| undirected(edge.map(|v| class[v as usize]));
        let edges_of = |facets: &[u32]| -> Vec<([u32; 2], [u32; 2])> {
            let edges = facets.iter().flat_map(|&f| sides(given.facets()[f as usize]));
            let mut all: Vec<_> = edges.map(|edge| (welded(edge), edge)).filter(|(at, _)| at[0] != at[1]).collect();
            all.sort_unstable();
            all
        };
        let (own, others) = (edges_of(&facets), edges_of(&kept));
        let is_rim = |at: [u32; 2], count: usize| {
            let of_kept = others.partition_point(|edge| edge.0 < at);
            others.get(of_kept).is_some_and(|edge| edge.0 == at) || keep_rims && count == 1
        };
        let groups = own.chunk_by(|a, b| a.0 == b.0).filter(|edge| is_rim(edge[0].0, edge.len()));
        let rims: BTreeMap<_, _> =
            groups.map(|edge| (edge[0].0, (edge[0].1, edge.len(), class[edge[0].1[0] as usize]))).collect();
        let mut lowest: HashMap<u32, Option<u32>> = rims.keys().flatten().map(|&v| (v, None)).collect();
        for &v in kept_vertices.iter().rev() {
            lowest.entry(class[v as usize]).and_modify(|own| *own = Some(v));
        }
        let place = |(v, own)| (bits(given.positions()[v as usize]), (v, own));
        let inside = others.iter().map(|edge| edge.0);
        let on_rims = |at: &[u32; 2]| at.iter().all(|v| lowest.contains_key(v)) && !rims.contains_key(at);
        let inside = inside.filter(on_rims).collect();
        let places: HashMap<_, _> = lowest.into_iter().map(place).collect();
        let of_kept: HashSet<u32> = kept_vertices.iter().map(|&v| class[v as usize]).collect();
        let stays_alone = |v: &u32| {
            !of_kept.contains(&class[*v as usize]) && !places.contains_key(&bits(given.positions()[*v as usize]))
        };
        let single = single.iter().copied().filter(stays_alone).collect();
        Some(Self { facets, vertices, kept, kept_vertices, rims, places, inside, single })
    }

    /// The number of a vertex in this part.
    fn number(&self, v: u32) -> u32 {
        self.vertices.partition_point(|&own| own < v) as u32
    }

    /// The surface of this part, and the edges of its rims.
    fn mesh(&self, given: &TriMesh) -> Result<(TriMesh, Vec<[u32; 2]>)> {
        let positions = self.vertices.iter().map(|&v| given.positions()[v as usize]).collect();
        let facets = self.facets.iter().map(|&f| given.facets()[f as usize].map(|v| self.number(v))).collect();
        let mesh = TriMesh::new(positions, facets).map_err(|_| RemeshError::AllKept)?;
        Ok((mesh, self.rims.values().map(|(edge, ..)| edge.map(|v| self.number(v))).collect()))
    }

    /// Vertices of facets that stay and are not on a rim.
    fn inner(&self) -> usize {
        let on_rims = self.places.values().filter(|place| place.1.is_some()).count();
        self.kept_vertices.len().saturating_sub(on_rims)
    }

    /// How many fans of facets there are at vertices of rims beyond one each: a result has a vertex for each of them, in one place.
    fn further_fans(&self, given: &TriMesh, class: &[u32]) -> usize {
        let welded = |f: u32| given.facets()[f as usize].map(|v| class[v as usize]);
        let on_rims: HashSet<u32> = self.rims.keys().flatten().copied().collect();
        let mut around: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
        for t in self.facets.iter().map(|&f| welded(f)) {
            t.iter().filter(|v| on_rims.contains(v)).for_each(|&v| around.entry(v).or_default().push(t));
        }
        let fans = |(&v, facets): (&u32, &Vec<[u32; 3]>)| {
            let mut fans = DisjointSets::new(facets.len());
            let mut first: HashMap<u32, usize> = HashMap::new();
            for (k, &other) in facets.iter().enumerate().flat_map(|(k, t)| t.iter().map(move |other| (k, other))) {
                if other != v {
                    fans.join(*first.entry(other).or_insert(k), k);
                }
            }
            (0..facets.len()).filter(|&k| fans.root(k) == k).count() - 1
        };
        around.iter().map(fans).sum()
    }

    /// The options for this part.
    fn options(&self, (given, class): (&TriMesh, &[u32]), options: &RemeshOptions) -> Result<RemeshOptions> {
        let mut own = options.clone();
        (own.keep, own.only, own.keep_rims, own.measure) = (Vec::new(), Vec::new(), false, false);
        // A sheet that goes on in another could not face as both do, and what stays of them cannot be turned.
        own.keep_non_manifold |= !self.kept.is_empty();
        let all = self.inner() + self.places.len() + self.single.len();
        let further = self.further_fans(given, class);
        let fewer = |points: usize| match points.checked_sub(self.inner()) {
            Some(rest) if rest >= self.places.len() + self.single.len() && rest > 0 => Ok(rest + further),
            _ => Err(RemeshError::TooFewForRims { points, rims: all }),
        };
        if let Seeds::Sample { points, .. } = &mut own.seeds {
            *points = fewer(*points)?;
        }
        if let Some(refine) = &mut own.refine
            && let Some(most) = &mut refine.max_points
        {
            *most = fewer(*most)?;
        }
        own.weld = own.weld.map(|weld| Tolerance::Length(weld.length(given)));
        own.attributes = own.attributes.map(|attributes| attributes.of_part(&self.vertices, &self.facets));
        let vertices = given.positions().len();
        let select = |values: &mut Vec<f64>| -> Result<()> {
            if values.len() != vertices {
                return Err(DensityError::SizeCount { given: values.len(), vertices }.into());
            }
            *values = self.vertices.iter().map(|&v| values[v as usize]).collect();
            Ok(())
        };
        match &mut own.density.source {
            DensitySource::Sizes(values) | DensitySource::Weights(values) => select(values)?,
            _ => {}
        }
        for zone in &mut own.density.zones {
            if let Part::Facets(facets) = &mut zone.part {
                *facets = (0..).zip(&self.facets).filter(|(_, f)| facets.contains(**f)).map(|(own, _)| own).collect();
            }
        }
        if !own.creases.is_empty() {
            let welded = |edge: [u32; 2]| undirected(edge.map(|v| class[v as usize]));
            let edges = self.facets.iter().flat_map(|&f| sides(given.facets()[f as usize]));
            let known: HashMap<[u32; 2], [u32; 2]> = edges.map(|edge| (welded(edge), edge)).collect();
            let of = |edge: &[u32; 2]| known.get(&welded(*edge)).map(|edge| edge.map(|v| self.number(v)));
            own.creases = options.creases.iter().filter_map(of).collect();
        }
        Ok(own)
    }

    /// An error about the number of points, of which those that stay are some.
    fn counted(&self, error: RemeshError) -> RemeshError {
        let more = self.inner();
        match error {
            RemeshError::TooFewSeeds { seeds, least } => {
                RemeshError::TooFewSeeds { seeds: seeds + more, least: least + more }
            }
            RemeshError::TooFewForRims { points, rims } => {
                RemeshError::TooFewForRims { points: points + more, rims: rims + more }
            }
            error => error,
        }
    }

    /// For each vertex of a new part, the lowest vertex in its place if that is on a rim.
    fn places_of(&self, new: &TriMesh) -> Vec<Option<u32>> {
        new.positions().iter().map(|&p| self.places.get(&bits(p)).map(|place| place.0)).collect()
    }

    /// Single vertices that stay, by the lowest vertices in their places, that a new part has not.
    fn missed_vertices(&self, given: &TriMesh, new: &TriMesh) -> Vec<u32> {
        let used = |v: &u32| bits(new.positions()[*v as usize]);
        let there: HashSet<[u64; 3]> = match self.single.is_empty() {
            true => HashSet::new(),
            false => new.facets().iter().flatten().map(used).collect(),
        };
        let is_missed = |v: &u32| !there.contains(&bits(given.positions()[*v as usize]));
        self.single.iter().copied().filter(is_missed).collect()
    }

    /// Edges of rims, by the lowest vertices in their places, that a new part has not as often as this one.
    fn missed(&self, new: &TriMesh) -> Vec<[u32; 2]> {
        let place = self.places_of(new);
        let mut count: HashMap<[u32; 2], usize> = HashMap::new();
        for edge in new.facets().iter().flat_map(|&t| sides(t)) {
            if let [Some(a), Some(b)] = edge.map(|v| place[v as usize]) {
                *count.entry(undirected([a, b])).or_default() += 1;
            }
        }
        let is_missed = |(at, (_, facets, _)): &(&[u32; 2], &([u32; 2], usize, u32))| count.get(*at) != Some(facets);
        let absent = self.rims.iter().filter(is_missed).map(|(&at, _)| at);
        let mut doubled: Vec<[u32; 2]> = count.keys().filter(|at| self.inside.contains(*at)).copied().collect();
        doubled.sort_unstable();
        absent.chain(doubled).collect()
    }

    /// Turns components of a new part over that face another way than what they take the place of: sheets that were moved apart may.
    fn turn(&self, mut done: Remesh) -> Result<Remesh> {
        let new = &done.mesh;
        let place = self.places_of(new);
        let mut components = DisjointSets::new(new.facets().len());
        EdgeGroups::new(new.positions().len(), new.facets().iter().copied().enumerate()).for_each(|_, halves| {
            halves.windows(2).for_each(|pair| components.join(pair[0].facet as usize, pair[1].facet as usize));
        });
        let mut against: HashMap<usize, i64> = HashMap::new();
        for (f, &t) in new.facets().iter().enumerate() {
            for edge in sides(t) {
                if let [Some(a), Some(b)] = edge.map(|v| place[v as usize])
                    && let Some(&(_, 1, begins)) = self.rims.get(&undirected([a, b]))
                {
                    *against.entry(components.root(f)).or_default() += if begins == a { -1 } else { 1 };
                }
            }
        }
        if against.values().all(|&count| count <= 0) {
            return Ok(done);
        }
        let facets = new.facets().iter().enumerate().map(|(f, &[a, b, c])| {
            let turns = against.get(&components.root(f)).is_some_and(|&count| count > 0);
            if turns { [a, c, b] } else { [a, b, c] }
        });
        let broken = |e| RvdError::Internal(format!("a surface was valid before it was turned: {e}"));
        done.mesh = TriMesh::new(new.positions().to_vec(), facets.collect()).map_err(broken)?;
        Ok(done)
    }

    /// What stays, with the new part.
    fn join(
        &self,
        (given, whole): (&TriMesh, Preprocessed),
        options: &RemeshOptions,
        done: Remesh,
        kept: KeptFigures,
        token: &Token,
    ) -> Result<Remesh> {
        let done = self.turn(done)?;
        let Remesh { mesh: new, vertex_seed, mut curve_edges, mut seeds, mut report, attributes, provenance } = done;
        let renumber = |v: u32| self.kept_vertices.partition_point(|&own| own < v) as u32;
        let first = self.kept_vertices.len() as u32;
        // New vertices that are none of what stays.
        let mut own: Vec<u32> = Vec::with_capacity(new.positions().len());
        let mut number: Vec<u32> = Vec::with_capacity(new.positions().len());
        let mut seed_of_kept: Vec<Option<u32>> = vec![None; first as usize];
        // For each place of a rim, a vertex there.
        let mut on_rims: HashMap<u32, u32> = HashMap::new();
        for (v, &p) in (0..).zip(new.positions()) {
            let place = self.places.get(&bits(p));
            match place {
                Some(&(_, Some(there))) => {
                    let there = renumber(there);
                    seed_of_kept[there as usize].get_or_insert(vertex_seed[v as usize]);
                    number.push(there);
                }
                _ => {
                    number.push(first + own.len() as u32);
                    own.push(v);
                }
            }
            place.map(|&(place, _)| on_rims.entry(place).or_insert(number[v as usize]));
        }
        let kept_places = self.kept_vertices.iter().map(|&v| given.positions()[v as usize]);
        let places: Vec<DVec3> = kept_places.chain(own.iter().map(|&v| new.positions()[v as usize])).collect();
        let kept_facets: Vec<[u32; 3]> = self.kept.iter().map(|&f| given.facets()[f as usize].map(renumber)).collect();
        let new_facets = new.facets().iter().map(|t| t.map(|v| number[v as usize]));
        let broken = |e| RvdError::Internal(format!("both parts of a surface were valid: {e}"));
        let mesh = TriMesh::new(places, kept_facets.iter().copied().chain(new_facets).collect()).map_err(broken)?;
        // A vertex that stays is a seed of its own.
        let mut of_vertex: Vec<u32> = Vec::with_capacity(mesh.positions().len());
        for (seed, &v) in seed_of_kept.into_iter().zip(&self.kept_vertices) {
            of_vertex.push(seed.unwrap_or(seeds.len() as u32));
            if seed.is_none() {
                seeds.push(given.positions()[v as usize]);
            }
        }
        of_vertex.extend(own.iter().map(|&v| vertex_seed[v as usize]));
        curve_edges.iter_mut().for_each(|edge| *edge = edge.map(|v| number[v as usize]));
        // All edges of rims, and each once.
        let rims: Vec<[u32; 2]> =
            self.rims.keys().filter_map(|edge| Some([*on_rims.get(&edge[0])?, *on_rims.get(&edge[1])?])).collect();
        let of_rims: HashSet<[u32; 2]> = rims.iter().copied().map(undirected).collect();
        curve_edges.retain(|&edge| !of_rims.contains(&undirected(edge)));
        curve_edges.extend(rims);
        let attributes = attributes.zip(options.attributes.as_ref()).map(|(new, given)| {
            given.of_part(&self.kept_vertices, &self.kept).followed_by(&kept_facets, new.of_vertices(&own))
        });
        let provenance = if provenance.is_empty() { provenance } else { self.provenance(given, &provenance, &own) };

        let adjacency = Adjacency::unless(&mesh, token)?;
        let result = &mut report.result;
        (result.vertices, result.facets) = (mesh.positions().len(), mesh.facets().len());
        result.topology = topology_unless(&mesh, &adjacency, token)?;
        result.coincident_vertices = coincident_vertices(&mesh, token)?;
        result.kept = Some(kept);
        let regions = |attributes: Option<&Attributes>| attributes.and_then(Attributes::regions).cloned();
        if let Some((before, after)) = regions(options.attributes.as_ref()).zip(regions(attributes.as_ref())) {
            result.regions = attributes::regions::figures(&before, given, (&mesh, after.of_facet()));
        }
        if options.measure {
            (result.quality, result.lost) = Some(compare(whole.mesh(given), None, &mesh, token)?).unzip();
            result.crossings = Some(crossings(&mesh, token)?);
        }
        report.topology_changes = whole.figures.topology.changes(&result.topology);
        report.input = whole.figures;
        report.vertex_count.asked += self.inner();
        report.vertex_count.seeds = seeds.len();
        Ok(Remesh { mesh, vertex_seed: of_vertex, curve_edges, seeds, report, attributes, provenance })
    }

    /// Where on the whole the vertices of the result lie, of which `own` are new ones with these places in this part.
    fn provenance(&self, given: &TriMesh, places: &[Provenance], own: &[u32]) -> Vec<Provenance> {
        let mut all: Vec<Option<Provenance>> = vec![None; self.kept_vertices.len()];
        for &facet in &self.kept {
            for (corner, v) in given.facets()[facet as usize].into_iter().enumerate() {
                let at = self.kept_vertices.partition_point(|&own| own < v);
                let mut barycentric = [0.0; 3];
                barycentric[corner] = 1.0;
                all[at].get_or_insert(Provenance { facet, barycentric });
            }
        }
        let new = own.iter().map(|&v| {
            let place = places[v as usize];
            Provenance { facet: self.facets[place.facet as usize], ..place }
        });
        all.into_iter().flatten().chain(new).collect()
    }
}
