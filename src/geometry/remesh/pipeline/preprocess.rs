//! The input, made fit for a remesh: connected where it meets, one side out, its sheets apart.
//!
//! Purpose: [`preprocess`] connects boundaries that meet ([`Connected`]), leaves out duplicate facets, then makes orientations consistent; each step exposes the defects of the next. [`Preprocessed::separate`]
//! moves sheets apart. [`Separated`] brings what the caller says of vertices and edges to the changed surface.
//! Invariant: depends on the surface and the options alone. Vertices keep their numbers; copies come behind them. Every change is
//! counted. Must not know: densities, seeds, backends.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::Arc;

use super::connect::{self, Connected};
use super::prepare::Asked;
use crate::cvt::density::{DensityOptions, DensitySource};
use crate::mesh::adjacency::{Adjacency, weld_unless};
use crate::mesh::apart::Apart;
use crate::mesh::attributes::Attributes;
use crate::mesh::duplicates::{self, InputKind};
use crate::mesh::edges::{DisjointSets, sides, undirected};
use crate::mesh::hanging::{Divided, DividedEdges};
use crate::mesh::input::make_consistent;
use crate::mesh::measure::{Topology, topology_unless};
use crate::mesh::motion::Motion;
use crate::mesh::pairs::{self, Pairs};
use crate::mesh::parts::{Inclusion, Part, Zone};
use crate::mesh::regions::Regions;
use crate::mesh::sheets::pieces::PieceOptions;
use crate::mesh::sheets::{Link, Sheets};
use crate::mesh::{MeshError, TriMesh};
use crate::remesh::constants::{MATCH_DIAGONAL, POINTS_PER_COMPONENT, SEPARATION_DIAGONAL, SEPARATION_EDGES};
use crate::remesh::features::Held;
use crate::remesh::features::seams::periods::Periods;
use crate::remesh::features::seams::{Joints, Seams};
use crate::remesh::report::InputFigures;
use crate::remesh::{RemeshError, RemeshOptions, Result, Seeds};
use crate::token::{Stopped, Token};

pub(super) struct Preprocessed {
    pub(super) figures: InputFigures,
    /// The surface, if anything had to be changed.
    pub(super) changed: Option<TriMesh>,
    /// For each facet the one of the input that it is of, if there are fewer or more.
    origin: Option<Vec<u32>>,
    /// Edges that were divided, one time after the other.
    divided: Vec<DividedEdges>,
    /// For each vertex that was put in the edge on which it lies, and where, 0 to 1.
    inserted: Vec<([u32; 2], f64)>,
    /// Edges that motions take to others.
    pub(super) pairs: Option<Pairs>,
}

/// The figures of the input, and the changed surface. `weld`: how far boundaries may be apart that are joined, caller's units.
pub(super) fn preprocess(given: &TriMesh, weld: Option<f64>, token: &Token) -> Result<Preprocessed, Stopped> {
    let Connected { mesh: mut changed, mut adjacency, stitched_vertices, divided } = Connected::of(given, weld, token)?;
    let (mut origin, divided) = divided.map_or((None, None), |(origin, edges)| (Some(origin), Some(edges)));
    let mut coincident_facets = 0;
    if adjacency.inconsistent_edges + adjacency.non_manifold_edges > 0
        && let Some((single, kept)) = duplicates::remove(changed.as_ref().unwrap_or(given), token)?
    {
        coincident_facets = changed.as_ref().unwrap_or(given).facets().len() - kept.len();
        origin = Some(origin.map_or(kept.clone(), |origin| kept.iter().map(|&f| origin[f as usize]).collect()));
        adjacency = Adjacency::unless(&single, token)?;
        changed = Some(single);
    }
    token.check()?;
    let mut figures = InputFigures::with(changed.as_ref().unwrap_or(given), &adjacency, token)?;
    if adjacency.inconsistent_edges > 0
        && let Some((consistent, flipped)) = make_consistent(changed.as_ref().unwrap_or(given), token)?
    {
        figures.reoriented_facets = flipped;
        changed = Some(consistent);
    }
    if adjacency.boundary_edges > 0 {
        connect::gaps((given, changed.as_ref().unwrap_or(given)), &adjacency, &mut figures, token)?;
    }
    figures.stitched_vertices = stitched_vertices;
    figures.coincident_facets = coincident_facets;
    figures.divided_edges = divided.as_ref().map_or(0, DividedEdges::len);
    let divided = divided.into_iter().collect();
    Ok(Preprocessed { figures, changed, origin, divided, inserted: Vec::new(), pairs: None })
}

/// Edge length that the options ask for; `None` where seeds are given, or where it is not known yet.
fn target_edge(clean: &TriMesh, components: usize, options: &RemeshOptions) -> Option<f64> {
    let (low, high) = clean.bounds();
    match (&options.seeds, &options.density) {
        (Seeds::Given(_), _) => None,
        (Seeds::Sample { points, .. }, _) => Some(uniform_edge(clean, *points)),
        (_, DensityOptions { source: DensitySource::Sizes(sizes), .. }) => {
            Some(sizes.iter().copied().fold(0.0, f64::max).min((high - low).length()))
        }
        // Edges may be long in one direction.
        (_, DensityOptions { source: DensitySource::Metric(_), .. }) => {
            Some(uniform_edge(clean, POINTS_PER_COMPONENT * components))
        }
        (_, density) => density.edge_length,
    }
}

/// Edge length of a uniform triangulation: equilateral triangles, two for each vertex.
fn uniform_edge(clean: &TriMesh, points: usize) -> f64 {
    (2.0 / 3f64.sqrt() * clean.area() / points.max(1) as f64).sqrt()
}

/// The surface whose sheets are apart, and the options for it.
pub(super) struct Separated {
    pub(super) apart: Option<Apart>,
    /// Where vertices or edges of the input have others now.
    pub(super) options: Option<RemeshOptions>,
    /// Of the sheets: what the result is to have.
    pub(super) topology: Topology,
    /// The same once pieces of sheets are joined again, if there are any.
    pub(super) joined: Option<Topology>,
    /// Where they met.
    pub(super) seams: Option<Arc<Seams>>,
    /// The edges that stay, if they have other vertices now.
    pub(super) rims: Option<Vec<[u32; 2]>>,
    /// The vertices that stay, if others are in their places too now.
    pub(super) vertices: Option<Vec<u32>>,
    /// Those of the input, with what was found out when its sheets were moved apart.
    pub(super) figures: InputFigures,
}

impl Preprocessed {
    pub(super) fn mesh<'a>(&'a self, given: &'a TriMesh) -> &'a TriMesh {
        self.changed.as_ref().unwrap_or(given)
    }

    /// Finds the boundaries that motions take to others, and gives both the same vertices.
    pub(super) fn pair(&mut self, given: &TriMesh, motions: &[Motion], token: &Token) -> Result<()> {
        let reach = match_reach(given);
        if let Some(Divided { mesh, origin, edges, inserted }) =
            pairs::complete(self.mesh(given), motions, reach, token)?
        {
            self.origin = Some(match &self.origin {
                Some(before) => origin.iter().map(|&f| before[f as usize]).collect(),
                None => origin,
            });
            self.changed = Some(mesh);
            self.divided.push(edges);
            self.inserted = inserted;
        }
        let pairs = Pairs::of(self.mesh(given), motions, reach, token)?;
        for (&motion, k) in motions.iter().zip(0..) {
            if !pairs.all.iter().any(|pair| pair.motion == k) {
                return Err(RemeshError::NotPeriodic { motion, reach });
            }
        }
        self.pairs = Some(pairs);
        Ok(())
    }

    /// Moves the sheets apart, so that no cell reaches from one to another. Sheets stay where they are if seeds are given, since
    /// no seed's sheet is known, and where points are too few for each sheet.
    pub(super) fn separate(
        &self,
        given: &TriMesh,
        (options, held): (&RemeshOptions, Held<'_>),
        creases: &[[u32; 2]],
        token: &Token,
    ) -> Result<Separated, RemeshError> {
        let topology = self.figures.topology;
        let touching = topology.non_manifold_edges + topology.non_manifold_vertices > 0;
        let surface = self.figures.kind != InputKind::Volume;
        let clean = self.changed.as_ref().unwrap_or(given);
        let mut separated = Separated {
            apart: None,
            options: None,
            topology,
            joined: None,
            seams: None,
            rims: None,
            vertices: None,
            figures: self.figures.clone(),
        };
        let (mut seams, mut joined) = (Vec::new(), Vec::new());
        let several = topology.components > 1 || touching && surface || !creases.is_empty();
        if let Some(edge) = target_edge(clean, topology.components, options).filter(|_| several) {
            // Smaller ones are noise, and get no vertices of their own.
            let least = POINTS_PER_COMPONENT as f64 * (3f64.sqrt() / 2.0) * edge * edge;
            let go_on = !options.keep_non_manifold;
            let mut sheets = Sheets::of(clean, if touching { least } else { 0.0 }, go_on, token)?;
            let (low, high) = clean.bounds();
            let gap = SEPARATION_EDGES * edge + SEPARATION_DIAGONAL * (high - low).length();
            let suffices = |sheets: &Sheets| edge <= uniform_edge(clean, POINTS_PER_COMPONENT * sheets.whole);
            let moved = |sheets: &Sheets| if suffices(sheets) { Apart::of(clean, sheets, gap) } else { None };
            // The pieces of a sheet meet in boundaries, whose vertices stay.
            let may_divide = options.keep_boundaries && !matches!(options.density.source, DensitySource::Metric(_));
            // Plane pieces that lie on each other have no thickness.
            let thick = self.figures.back_to_back_facets == 0;
            let least_plane = if thick { least / POINTS_PER_COMPONENT as f64 } else { least };
            let division = PieceOptions { least, least_plane, go_on, crease: crease_angle(options) };
            if touching
                && surface
                && may_divide
                && let Some(pieces) = sheets.in_pieces(clean, division, token)?
            {
                separated.apart = moved(&pieces);
                sheets = if separated.apart.is_some() { pieces } else { sheets };
            }
            if !creases.is_empty() {
                let patches = sheets.in_patches(clean, creases, go_on, token)?;
                // Patches share the vertices of their curves, and need none of their own.
                let apart = Apart::of(clean, &patches, gap);
                if apart.is_some() {
                    (separated.apart, sheets) = (apart, patches);
                }
            }
            if separated.apart.is_none() {
                separated.apart = moved(&sheets);
            }
            if sheets.count > topology.components
                && let Some(apart) = &mut separated.apart
            {
                separated.figures.sheets = sheets.whole;
                // Facets that are now neighbours had others between them.
                if let Some((consistent, flipped)) = make_consistent(&apart.mesh, token)? {
                    separated.figures.reoriented_facets += flipped;
                    apart.mesh = consistent;
                }
                separated.topology = topology_unless(&apart.mesh, &Adjacency::unless(&apart.mesh, token)?, token)?;
            } else if touching && surface && sheets.whole > topology.components && !suffices(&sheets) {
                separated.figures.points_for_sheets = POINTS_PER_COMPONENT * sheets.whole;
            }
            (seams, joined) = (sheets.seams, sheets.joined);
        }
        if let (Some(apart), true) = (&separated.apart, touching || !seams.is_empty()) {
            let (class, now) = places_before(clean, apart, token)?;
            let in_metric = matches!(options.density.source, DensitySource::Metric(_));
            let touching = if touching && !in_metric {
                touching_in_places((&class, &now), &seams, &apart.mesh)
            } else {
                HashSet::new()
            };
            let joints = match options.keep_non_manifold {
                true => Joints::All,
                false => joints_of(&joined, (&class, &now), &apart.mesh),
            };
            if let (Joints::Pieces { vertices, .. }, false) = (&joints, joined.is_empty()) {
                let adjacency = Adjacency::with(&apart.mesh, vertices.clone(), token)?;
                separated.joined = Some(topology_unless(&apart.mesh, &adjacency, token)?);
            }
            separated.seams =
                Some(Arc::new(Seams::new((class, clean.positions()), &seams, joints).with_touching(touching)));
        }
        if let Some(pairs) = &self.pairs {
            let seams = match separated.seams.take().map(Arc::unwrap_or_clone) {
                Some(seams) => seams,
                None => {
                    let class = match &separated.apart {
                        Some(apart) => places_before(clean, apart, token)?.0,
                        None => weld_unless(clean, token)?,
                    };
                    Seams::new((class, clean.positions()), &[], Joints::All)
                }
            };
            separated.seams = Some(Arc::new(seams.with_periods(Periods::new(pairs, &options.periodic))));
        }
        if let Some(apart) = separated.apart.as_ref().filter(|apart| !apart.copied.is_empty())
            && !(held.rims.is_empty() && held.vertices.is_empty())
        {
            let class = weld_unless(clean, token)?;
            separated.rims = Some(edges_of_sheets(held.rims, &class, apart));
            let places: HashSet<u32> = held.vertices.iter().map(|&v| class[v as usize]).collect();
            let all = 0..apart.mesh.positions().len() as u32;
            separated.vertices = Some(all.filter(|&v| places.contains(&class[apart.before(v) as usize])).collect());
        }
        let apart = separated.apart.as_ref().map(|apart| (apart, &seams[..]));
        separated.options = self.adapted(clean, options, apart, token)?;
        Ok(separated)
    }

    /// The options with what they say of vertices and edges, said of the present ones.
    fn adapted(
        &self,
        clean: &TriMesh,
        options: &RemeshOptions,
        apart: Option<(&Apart, &[[u32; 2]])>,
        token: &Token,
    ) -> Result<Option<RemeshOptions>, RemeshError> {
        let touching = apart.filter(|(apart, seams)| !(apart.copied.is_empty() && seams.is_empty()));
        let (apart, seams) = touching.map_or((None, &[][..]), |(apart, seams)| (Some(apart), seams));
        let regions = options.attributes.as_ref().and_then(Attributes::regions);
        let has_creases = !(options.creases.is_empty() || self.divided.is_empty());
        let by_facets = |zone: &Zone| matches!(zone.part, Part::Region(_) | Part::Facets(_));
        let has_zones = options.density.zones.iter().any(by_facets);
        if apart.is_none() && regions.is_none() && !has_creases && !has_zones && self.inserted.is_empty() {
            return Ok(None);
        }
        let mut adapted = options.clone();
        if has_zones {
            for zone in &mut adapted.density.zones {
                self.part_of(clean, regions, &mut zone.part)?;
            }
        }
        if !(options.creases.is_empty() && seams.is_empty() && regions.is_none()) {
            let class = weld_unless(clean, token)?;
            for divided in &self.divided {
                adapted.creases = divided.pieces(&adapted.creases, &class);
            }
            // Where sheets meet, each has a curve, so that all have vertices in the same places.
            adapted.creases.extend(seams);
            if let Some(regions) = regions {
                adapted.creases.extend(regions.of(self.origin.as_deref()).borders(clean.facets(), &class));
            }
            if let Some(apart) = apart {
                adapted.creases = edges_of_sheets(&adapted.creases, &class, apart);
            }
        }
        if let DensitySource::Sizes(values) | DensitySource::Weights(values) = &mut adapted.density.source {
            for &([a, b], share) in &self.inserted {
                let ends = [a, b].map(|v| values.get(v as usize).copied());
                let [Some(start), Some(end)] = ends else { break };
                values.push(start + share * (end - start));
            }
        }
        if let Some(Apart { copied, .. }) = apart {
            fn extend<T: Copy>(values: &mut Vec<T>, copied: &[u32]) {
                let of_copies: Vec<T> = copied.iter().filter_map(|&v| values.get(v as usize).copied()).collect();
                values.extend(of_copies);
            }
            match &mut adapted.density.source {
                DensitySource::Sizes(values) | DensitySource::Weights(values) => extend(values, copied),
                DensitySource::Metric(tensors) => extend(tensors, copied),
                _ => {}
            }
            // No facet of the input has a vertex that was put in.
            let given = (clean.positions().len() - self.inserted.len()) as u32;
            let own = (0..given).chain(self.inserted.iter().map(|_| 0));
            let all: Vec<u32> = own.chain(copied.iter().map(|&v| if v < given { v } else { 0 })).collect();
            adapted.attributes = options.attributes.as_ref().map(|attributes| attributes.of_vertices(&all));
        }
        Ok(Some(adapted))
    }

    /// A region as its facets, and facets of the input as those that there are of them now.
    fn part_of(&self, clean: &TriMesh, regions: Option<&Regions>, part: &mut Part) -> Result<(), RemeshError> {
        let now = 0..clean.facets().len() as u32;
        match part {
            Part::Region(_) => {
                let regions = regions.map(|regions| regions.of(self.origin.as_deref()));
                let within = part.facets((clean, regions.as_deref()), Inclusion::Within)?;
                *part = Part::Facets(now.filter(|&f| within[f as usize]).collect());
            }
            Part::Facets(facets) => {
                if let Some(origin) = &self.origin {
                    *facets = now.filter(|&f| facets.contains(origin[f as usize])).collect();
                }
            }
            Part::Box { .. } | Part::Sphere { .. } | Part::Vertices(_) => {}
        }
        Ok(())
    }

    /// The input's facets, where the sheets are apart.
    pub(super) fn given_apart(&self, given: &TriMesh, apart: &Apart) -> Result<TriMesh, MeshError> {
        let mut facets = given.facets().to_vec();
        if !apart.copied.is_empty() {
            for (k, present) in apart.mesh.facets().iter().enumerate() {
                let f = self.origin.as_ref().map_or(k, |origin| origin[k] as usize);
                for (corner, &v) in facets[f].iter_mut().zip(&given.facets()[f]) {
                    if let Some(&own) = present.iter().find(|&&own| apart.before(own) == v) {
                        *corner = own;
                    }
                }
            }
        }
        TriMesh::new(apart.mesh.positions().to_vec(), facets)
    }
}

impl Separated {
    /// The surface: `clean`, with its sheets apart if they are.
    pub(super) fn mesh<'a>(&'a self, clean: &'a TriMesh) -> &'a TriMesh {
        self.apart.as_ref().map_or(clean, |apart| &apart.mesh)
    }

    /// `options` for it.
    pub(super) fn options<'a>(&'a self, options: &'a RemeshOptions) -> &'a RemeshOptions {
        self.options.as_ref().unwrap_or(options)
    }

    /// Whether the surface or what is said of it is another one.
    pub(super) fn is_changed(&self) -> bool {
        self.apart.is_some() || self.options.is_some() || self.seams.is_some()
    }

    /// What was asked for, of the sheets apart.
    pub(super) fn asked<'a>(&'a self, asked: Asked<'a>) -> Asked<'a> {
        let rims = self.rims.as_deref().unwrap_or(asked.held.rims);
        let vertices = self.vertices.as_deref().unwrap_or(asked.held.vertices);
        let held = Held { seams: self.seams.as_ref(), rims, vertices, ..asked.held };
        Asked { apart: self.apart.as_ref(), held, ..asked }
    }
}

/// For each vertex of sheets that are apart, the lowest one that was in its place before, and the lowest one that is there now.
fn places_before(clean: &TriMesh, apart: &Apart, token: &Token) -> Result<(Vec<u32>, Vec<u32>), Stopped> {
    let class = weld_unless(clean, token)?;
    let now = weld_unless(&apart.mesh, token)?;
    // Of facets: other vertices do not move, and a sheet may have come to where one is.
    let mut of_place = vec![u32::MAX; now.len()];
    for &v in apart.mesh.facets().iter().flatten() {
        of_place[now[v as usize] as usize] = class[apart.before(v) as usize];
    }
    Ok((now.iter().map(|&place| of_place[place as usize]).collect(), now))
}

/// The angle between facets, radians, from which a sheet may be divided.
fn crease_angle(options: &RemeshOptions) -> f64 {
    let asked = options.crease_angle_deg;
    (if asked > 0.0 { asked } else { RemeshOptions::CREASE_ANGLE_DEG }).to_radians()
}

/// Places in which sheets meet other edges than others do, or none, by the lowest vertices there. `class` has the lowest vertex in the place
/// of each before sheets were moved, `now` that in its place since.
fn touching_in_places((class, now): (&[u32], &[u32]), seams: &[[u32; 2]], apart: &TriMesh) -> HashSet<u32> {
    let seams: HashSet<[u32; 2]> = seams.iter().copied().map(undirected).collect();
    // For a vertex of a sheet, the other ends of the edges in which it meets others.
    let mut met: HashMap<u32, BTreeSet<u32>> = HashMap::new();
    for [a, b] in apart.facets().iter().flat_map(|&facet| sides(facet)).map(|edge| edge.map(|v| v as usize)) {
        if seams.contains(&undirected([class[a], class[b]])) {
            met.entry(now[a]).or_default().insert(class[b]);
            met.entry(now[b]).or_default().insert(class[a]);
        }
    }
    let mut first: HashMap<u32, u32> = HashMap::new();
    let mut touching = HashSet::new();
    for v in apart.facets().iter().flatten().map(|&v| v as usize) {
        let other = *first.entry(class[v]).or_insert(now[v]);
        if other != now[v] && (met.get(&other) != met.get(&now[v]) || !met.contains_key(&other)) {
            touching.insert(class[v]);
        }
    }
    touching
}

/// Which copies of vertices and edges are one where facets go on in each other. `class` and `now` as above.
fn joints_of(joined: &[([u32; 2], Link)], (class, now): (&[u32], &[u32]), apart: &TriMesh) -> Joints {
    let mut vertices = DisjointSets::new(now.len());
    now.iter().enumerate().for_each(|(v, &first)| vertices.join(v, first as usize));
    let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
    let mut same = DisjointSets::new(2 * joined.len());
    for (ends, link) in joined {
        let of = |f: u32, place: u32| {
            let corner = apart.facets()[f as usize].into_iter().find(|&v| class[v as usize] == place)?;
            Some(now[corner as usize])
        };
        let copies = link.map(|f| ends.map(|place| of(f, place)));
        let [[Some(a), Some(b)], [Some(c), Some(d)]] = copies else { continue };
        vertices.join(a as usize, c as usize);
        vertices.join(b as usize, d as usize);
        let [one, other] = [[a, b], [c, d]].map(|edge| {
            let next = edges.len() as u32;
            *edges.entry(undirected(edge)).or_insert(next)
        });
        same.join(one as usize, other as usize);
    }
    edges.values_mut().for_each(|edge| *edge = same.root(*edge as usize) as u32);
    let vertices = (0..now.len()).map(|v| vertices.root(v) as u32).collect();
    Joints::Pieces { vertices, edges }
}

/// What `edges` are in each sheet. Those that are none stay as they are, to be refused. `class` has the lowest vertex in the place
/// of each, before the sheets were moved.
fn edges_of_sheets(edges: &[[u32; 2]], class: &[u32], apart: &Apart) -> Vec<[u32; 2]> {
    let welded = |[a, b]: [u32; 2]| undirected([a, b].map(|v| class.get(v as usize).copied().unwrap_or(v)));
    let mut found: HashMap<[u32; 2], Vec<[u32; 2]>> = edges.iter().map(|&edge| (welded(edge), Vec::new())).collect();
    for now in apart.mesh.facets().iter().flat_map(|&facet| sides(facet)) {
        if let Some(of_sheets) = found.get_mut(&welded(now.map(|v| apart.before(v)))) {
            of_sheets.push(undirected(now));
        }
    }
    let mut all = Vec::with_capacity(edges.len());
    for edge in edges {
        match found.get_mut(&welded(*edge)) {
            Some(of_sheets) if !of_sheets.is_empty() => {
                of_sheets.sort_unstable();
                of_sheets.dedup();
                all.append(&mut of_sheets.clone());
            }
            _ => all.push(*edge),
        }
    }
    all
}

/// How near a vertex is to a mirror plane, or a boundary to the image of another, to be in it; caller's units.
pub(super) fn match_reach(mesh: &TriMesh) -> f64 {
    let (low, high) = mesh.bounds();
    MATCH_DIAGONAL * (high - low).length()
}
