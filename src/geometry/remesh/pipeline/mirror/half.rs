//! The half of a surface on one side of a plane.
//!
//! Purpose: [`Half::of`] cuts a surface along a plane and keeps the side that the plane's normal points to; [`Half::options`] says of it what
//! a caller says of the whole. Invariant: cut vertices lie in the plane, and so do vertices that were as near as rounding; facets in one place
//! on both sides of an edge are cut in the same place. Must not know: how a surface is remeshed.

use std::collections::HashMap;

use glam::DVec3;

use crate::cvt::density::{DensityError, DensitySource};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{AttributeError, Attributes};
use crate::mesh::edges::{sides, undirected};
use crate::mesh::parts::Part;
use crate::mesh::plane::Plane;
use crate::remesh::pipeline::preprocess::match_reach;
use crate::remesh::{Anisotropy, RemeshError, RemeshOptions, Result, Tolerance};
use crate::rvd::RvdError;
use crate::token::Token;

pub(super) struct Half {
    pub(super) mesh: TriMesh,
    /// The facet that each facet is of.
    origin: Vec<u32>,
    /// The edge of the whole on which each vertex lies, and where, 0 to 1.
    from: Vec<([u32; 2], f64)>,
    /// Edges in the plane with facets on one side.
    pub(super) seam: Vec<[u32; 2]>,
    /// Edges in the plane that facets of this half meet at.
    inner: Vec<[u32; 2]>,
    /// For each vertex whether it is in the plane.
    in_plane: Vec<bool>,
    /// What is left of each edge, by the lowest vertices in the places of its ends.
    pieces: HashMap<[u32; 2], [u32; 2]>,
}

/// Makes the vertices of a half.
struct Cutter<'a> {
    given: &'a TriMesh,
    class: &'a [u32],
    plane: Plane,
    /// Of each vertex above the plane; 0 in it.
    height: Vec<f64>,
    places: Vec<DVec3>,
    from: Vec<([u32; 2], f64)>,
    /// By the edge that is cut, or the vertex, twice.
    known: HashMap<[u32; 2], u32>,
}

impl Cutter<'_> {
    fn vertex(&mut self, v: u32) -> u32 {
        self.own([v, v])
    }

    /// Where the edge between two vertices on different sides meets the plane.
    fn own(&mut self, ends: [u32; 2]) -> u32 {
        let Self { given, class, plane, height, places, from, known } = self;
        *known.entry(undirected(ends)).or_insert_with(|| {
            // The same for all copies of the edge.
            let [a, b] = if class[ends[0] as usize] <= class[ends[1] as usize] { ends } else { [ends[1], ends[0]] };
            let [start, end] = [a, b].map(|v| given.positions()[v as usize]);
            let [low, high] = [a, b].map(|v| height[v as usize]);
            let share = if a == b { 0.0 } else { low / (low - high) };
            let place = start.lerp(end, share);
            let in_plane = a != b || low == 0.0;
            places.push(if in_plane { plane.project(place) } else { start });
            from.push(([a, b], share));
            places.len() as u32 - 1
        })
    }

    /// What is left of a facet: its corners and cuts in order.
    fn clip(&mut self, corners: [u32; 3]) -> Vec<u32> {
        let mut left = Vec::with_capacity(4);
        for [a, b] in sides(corners) {
            let [from, to] = [a, b].map(|v| self.height[v as usize]);
            if from >= 0.0 {
                left.push(self.vertex(a));
            }
            if from < 0.0 && to > 0.0 || from > 0.0 && to < 0.0 {
                left.push(self.own([a, b]));
            }
        }
        left
    }
}

impl Half {
    /// `class` has the lowest vertex in the place of each.
    pub(super) fn of(given: &TriMesh, plane: Plane, class: &[u32], token: &Token) -> Result<Self> {
        let reach = match_reach(given);
        let height = |&p: &DVec3| Some(plane.height(p)).filter(|height| height.abs() > reach).unwrap_or(0.0);
        let height = given.positions().iter().map(height).collect();
        let (places, from, known) = (Vec::new(), Vec::new(), HashMap::new());
        let mut cutter = Cutter { given, class, plane, height, places, from, known };
        let (mut facets, mut origin, mut flat, mut pieces) = (Vec::new(), Vec::new(), 0, HashMap::new());
        for (f, &corners) in given.facets().iter().enumerate() {
            token.check_at(f)?;
            let heights = corners.map(|v| cutter.height[v as usize]);
            if !heights.iter().any(|&height| height > 0.0) {
                flat += usize::from(heights == [0.0; 3] && !given.is_degenerate(f));
                continue;
            }
            let left = cutter.clip(corners);
            for edge in sides(corners) {
                let above = edge.map(|v| cutter.height[v as usize]);
                let piece = match above.map(|height| height < 0.0) {
                    [false, false] => edge.map(|v| cutter.vertex(v)),
                    [false, true] if above[0] > 0.0 => [cutter.vertex(edge[0]), cutter.own(edge)],
                    [true, false] if above[1] > 0.0 => [cutter.own(edge), cutter.vertex(edge[1])],
                    _ => continue,
                };
                pieces.insert(undirected(edge.map(|v| class[v as usize])), piece);
            }
            match left[..] {
                [a, b, c] => facets.push([a, b, c]),
                [a, b, c, d] => {
                    let [one, other] = [[a, c], [b, d]]
                        .map(|[v, w]| cutter.places[v as usize].distance_squared(cutter.places[w as usize]));
                    facets.extend(if one <= other { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] });
                }
                _ => {}
            }
            origin.resize(facets.len(), f as u32);
        }
        if flat > 0 {
            return Err(RemeshError::FacetsInPlane { facets: flat, plane });
        }
        let Cutter { places, from, height, .. } = cutter;
        let in_plane: Vec<bool> = from.iter().map(|&([a, b], _)| a != b || height[a as usize] == 0.0).collect();
        let place = |v: u32| class_of(&from, class, v);
        let mut edges: Vec<([u32; 4], [u32; 2])> = Vec::new();
        for edge in
            facets.iter().flat_map(|&facet| sides(facet)).filter(|edge| edge.iter().all(|&v| in_plane[v as usize]))
        {
            let [a, b] = edge.map(place);
            let key = if a <= b { [a[0], a[1], b[0], b[1]] } else { [b[0], b[1], a[0], a[1]] };
            edges.push((key, edge));
        }
        edges.sort_unstable();
        let (mut seam, mut inner) = (Vec::new(), Vec::new());
        for group in edges.chunk_by(|a, b| a.0 == b.0) {
            if group.len() == 1 { &mut seam } else { &mut inner }.push(group[0].1);
        }
        let mesh = TriMesh::new(places, facets).map_err(|_| RemeshError::NothingOnSide { plane })?;
        Ok(Self { mesh, origin, from, seam, inner, in_plane, pieces })
    }

    /// This half and its mirror image: what a result is to be like.
    pub(super) fn doubled(&self, plane: Plane) -> Result<TriMesh> {
        let mut places = self.mesh.positions().to_vec();
        let mut image: Vec<u32> = (0..places.len() as u32).collect();
        for (v, &p) in self.mesh.positions().iter().enumerate().filter(|(v, _)| !self.in_plane[*v]) {
            image[v] = places.len() as u32;
            places.push(plane.reflect(p));
        }
        let facets = self.mesh.facets();
        let reflected = facets.iter().map(|&[a, b, c]| [a, c, b].map(|v| image[v as usize]));
        let broken = |e| RvdError::Internal(format!("a surface was valid before it was doubled: {e}"));
        Ok(TriMesh::new(places, facets.iter().copied().chain(reflected).collect()).map_err(broken)?)
    }

    /// The length of the curves along which both halves meet.
    pub(super) fn seam_length(&self) -> f64 {
        let place = |v: u32| self.mesh.positions()[v as usize];
        self.seam.iter().map(|&[a, b]| place(a).distance(place(b))).sum()
    }

    /// What `options` say of `given`, said of this half. `class` as for [`Self::of`].
    pub(super) fn options(&self, (given, class): (&TriMesh, &[u32]), options: &RemeshOptions) -> Result<RemeshOptions> {
        let mut own = options.clone();
        (own.mirror, own.measure, own.source_map) = (None, false, false);
        own.weld = own.weld.map(|weld| Tolerance::Length(weld.length(given)));
        if let Anisotropy::Share(share) = &mut own.anisotropy {
            let diagonal = |mesh: &TriMesh| {
                let (low, high) = mesh.bounds();
                (high - low).length()
            };
            *share *= diagonal(given) / diagonal(&self.mesh);
        }
        // The other half carries something too, so that the whole gets its attributes from the whole.
        let regions = options.attributes.as_ref().and_then(Attributes::regions);
        own.attributes = regions
            .map(|regions| -> Result<_, AttributeError> {
                let mut attributes = Attributes::new(&self.mesh);
                attributes.set_regions(regions.of(Some(&self.origin)).into_owned())?;
                Ok(attributes)
            })
            .transpose()?;
        let vertices = given.positions().len();
        match &mut own.density.source {
            DensitySource::Sizes(values) | DensitySource::Weights(values) if values.len() != vertices => {
                return Err(DensityError::SizeCount { given: values.len(), vertices }.into());
            }
            DensitySource::Sizes(values) | DensitySource::Weights(values) => {
                let at = |&([a, b], share): &([u32; 2], f64)| {
                    let [start, end] = [a, b].map(|v| values[v as usize]);
                    start + share * (end - start)
                };
                *values = self.from.iter().map(at).collect();
            }
            _ => {}
        }
        for zone in &mut own.density.zones {
            if let Part::Facets(facets) = &mut zone.part {
                *facets = (0..).zip(&self.origin).filter(|(_, f)| facets.contains(**f)).map(|(own, _)| own).collect();
            }
        }
        let piece = |edge: &[u32; 2]| self.pieces.get(&undirected(edge.map(|v| class[v as usize]))).copied();
        own.creases = options.creases.iter().filter_map(piece).collect();
        own.creases.extend(&self.inner);
        Ok(own)
    }
}

/// What is the same for all copies of a vertex of a half.
fn class_of(from: &[([u32; 2], f64)], class: &[u32], v: u32) -> [u32; 2] {
    undirected(from[v as usize].0.map(|end| class[end as usize]))
}
