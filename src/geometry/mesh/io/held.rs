//! What formats hold of a surface.
//!
//! Purpose: [`Raw`] has the attributes that a reader finds, [`Held`] those that a writer takes. [`check_single`] refuses what
//! rounding to single precision would spoil.
//! Invariant: attributes that a format cannot hold, or that cannot be used, are named. Must not know: the syntax of a format.

use std::collections::HashSet;
use std::hash::Hash;

use super::DataError;
use super::regions::{Found, RegionChoice};
use crate::mesh::attributes::{AttributeError, Attributes, Colours, Normals, PerCorner, Scalar};
use crate::mesh::csr::ascending;
use crate::mesh::regions::{MAX_REGIONS, Regions};
use crate::mesh::{TriMesh, normal};
use crate::tasks;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// The most scalars of a surface: each name is compared with all others.
const MOST_SCALARS: usize = 4096;

/// Attributes of a file, not yet checked.
#[derive(Debug, Default)]
pub(super) struct Raw {
    pub(super) normals: Option<Normals>,
    pub(super) texture: Option<PerCorner<DVec2>>,
    pub(super) colours: Option<Colours>,
    pub(super) scalars: Vec<Scalar>,
    /// Labels of facets that may be regions.
    pub(super) regions: Option<Found>,
    /// Names of arrays that can be chosen to be regions.
    pub(super) arrays: Vec<String>,
    /// Edges that the file names; some may be none of the surface's.
    pub(super) creases: Vec<[u32; 2]>,
    /// Vertices that the file names; some may be none of the surface's.
    pub(super) vertices: Vec<u32>,
    pub(super) unreadable: Vec<AttributeError>,
    /// How many more there were than are kept.
    pub(super) more: usize,
}

/// The most attributes that are reported one by one.
const MOST_UNREADABLE: usize = 1024;
/// The most labels that are told apart: a set of them takes more than the file has for them.
const MOST_LABELS: usize = MAX_REGIONS;

/// Notes a label, if there are not too many.
pub(super) fn note<T: Eq + Hash>(labels: &mut HashSet<T>, label: Option<T>) {
    labels.extend(label.filter(|_| labels.len() < MOST_LABELS));
}

impl Raw {
    pub(super) fn unreadable(&mut self, attribute: &str, message: String) {
        match self.unreadable.len() < MOST_UNREADABLE {
            true => self.unreadable.push(AttributeError::Unreadable { attribute: attribute.to_owned(), message }),
            false => self.more += 1,
        }
    }

    /// Names several kinds of facets or vertices, such as materials, that the file tells apart and the surface does not.
    pub(super) fn labels(&mut self, kinds: &str, count: usize) {
        self.labels_beside(kinds, count, "labels are not carried");
    }

    /// As [`Self::labels`], with the reason.
    pub(super) fn labels_beside(&mut self, kinds: &str, count: usize, reason: &str) {
        if count > 1 {
            let more = if count < MOST_LABELS { "" } else { " or more" };
            self.unreadable(&format!("{count}{more} {kinds}"), reason.to_owned());
        }
    }

    /// Names elements of the file that are no facets.
    pub(super) fn elements(&mut self, kinds: &str, count: usize) {
        if count > 0 {
            self.unreadable(kinds, format!("there are {count}; the surface is read alone"));
        }
    }

    /// The edges of `mesh` that the file names, each once. Others are left aside.
    pub(super) fn edges_of(&mut self, mesh: &TriMesh) -> Vec<[u32; 2]> {
        let mut edges = std::mem::take(&mut self.creases);
        let total = edges.len();
        edges.iter_mut().for_each(|edge| edge.sort_unstable());
        edges.sort_unstable();
        edges.dedup();
        let twice = total - edges.len();
        let mut is_there = vec![false; edges.len()];
        // An edge between two vertices in one place is none, and neither is that of a facet without area.
        for (index, facet) in mesh.facets().iter().enumerate().filter(|_| total > 0) {
            let [a, b, c] = mesh.corners(index);
            if a == b || b == c || c == a {
                continue;
            }
            for [a, b] in [[facet[0], facet[1]], [facet[1], facet[2]], [facet[2], facet[0]]] {
                edges.binary_search(&[a.min(b), a.max(b)]).into_iter().for_each(|at| is_there[at] = true);
            }
        }
        let mut found = is_there.iter();
        edges.retain(|_| found.next().copied().unwrap_or(false));
        let left = total - twice - edges.len();
        if left > 0 {
            self.unreadable("named edges", format!("{left} of {total} are no edges of the surface"));
        }
        edges
    }

    /// The vertices of facets of `mesh` that the file names, ascending. Others are left aside.
    pub(super) fn vertices_of(&mut self, mesh: &TriMesh) -> Vec<u32> {
        let all = ascending(std::mem::take(&mut self.vertices));
        if all.is_empty() {
            return all;
        }
        let mut of_facets = vec![false; mesh.positions().len()];
        mesh.facets().iter().flatten().for_each(|&v| of_facets[v as usize] = true);
        let is_there = |v: &u32| of_facets.get(*v as usize).copied().unwrap_or(false);
        let (found, others): (Vec<u32>, Vec<u32>) = all.into_iter().partition(is_there);
        if !others.is_empty() {
            let text = format!("{} of {} are none of a facet", others.len(), found.len() + others.len());
            self.unreadable("required vertices", text);
        }
        found
    }

    pub(super) fn is_unreadable(&self, attribute: &str) -> bool {
        self.unreadable.iter().any(|e| matches!(e, AttributeError::Unreadable { attribute: a, .. } if a == attribute))
    }

    /// What corners of facets name, list by list.
    pub(super) fn corners_mut(&mut self) -> impl Iterator<Item = &mut [[u32; 3]]> {
        let normals = self.normals.as_mut().and_then(|normals| match normals {
            Normals::PerCorner(normals) => Some(normals.corners.as_mut_slice()),
            Normals::PerVertex(_) => None,
        });
        self.texture.as_mut().map(|texture| texture.corners.as_mut_slice()).into_iter().chain(normals)
    }

    /// Checks each attribute by itself.
    pub(super) fn onto(mut self, mesh: &TriMesh, choice: &RegionChoice) -> (Attributes, Vec<AttributeError>) {
        let mut attributes = Attributes::new(mesh);
        let found = self.regions.take();
        if let Some(found) = found.as_ref().filter(|_| *choice == RegionChoice::Ignore) {
            let (kinds, count) = found.kinds();
            self.labels(kinds, count);
        }
        let regions = found.filter(|_| *choice != RegionChoice::Ignore).map(|found| found.regions(mesh));
        let mut left_aside = self.unreadable;
        if self.more > 0 {
            let message = format!("{} more cannot be read", self.more);
            left_aside.push(AttributeError::Unreadable { attribute: "attributes".to_owned(), message });
        }
        let results = [
            self.normals.map(|normals| attributes.set_normals(normals)),
            self.texture.map(|texture| attributes.set_texture(texture)),
            self.colours.map(|colours| attributes.set_colours(colours)),
        ];
        left_aside.extend(results.into_iter().flatten().filter_map(Result::err));
        if let Some(more) = self.scalars.len().checked_sub(MOST_SCALARS).filter(|&more| more > 0) {
            let message = format!("{more} are more than the {MOST_SCALARS} that a surface carries");
            left_aside.push(AttributeError::Unreadable { attribute: "scalars".to_owned(), message });
        }
        left_aside.extend(self.scalars.into_iter().take(MOST_SCALARS).filter_map(|s| attributes.add_scalar(s).err()));
        let set = |regions: Option<Regions>| regions.map_or(Ok(()), |regions| attributes.set_regions(regions));
        left_aside.extend(regions.and_then(|found| found.and_then(set).err()));
        (attributes, left_aside)
    }
}

pub(super) struct Holds {
    pub(super) normals: By,
    pub(super) texture: By,
    pub(super) colours: bool,
    pub(super) opacity: bool,
    pub(super) scalars: bool,
    pub(super) regions: Labelled,
}

/// How facets have labels.
pub(super) enum Labelled {
    None,
    /// By numbers, without names.
    Number,
    Name,
}

pub(super) enum By {
    None,
    Vertex,
    Corner,
    /// Vertices, or corners where these differ around a vertex. Texture coordinates alone.
    VertexOrCorner,
}

/// Those of some attributes that a format can hold, in the shape in which it holds them.
#[derive(Debug, Default)]
pub(super) struct Held<'a> {
    pub(super) normals: Option<Vec<DVec3>>,
    pub(super) corner_normals: Option<&'a PerCorner<DVec3>>,
    pub(super) uv: Option<Vec<DVec2>>,
    pub(super) corner_uv: Option<&'a PerCorner<DVec2>>,
    pub(super) colours: Option<&'a Colours>,
    pub(super) scalars: &'a [Scalar],
    pub(super) regions: Option<&'a Regions>,
    pub(super) left_out: Vec<String>,
}

impl<'a> Held<'a> {
    pub(super) fn of(holds: &Holds, mesh: &TriMesh, attributes: &'a Attributes) -> Self {
        let mut held = Self::default();
        let (facets, vertices) = (mesh.facets(), mesh.positions().len());
        match (attributes.normals(), &holds.normals) {
            (None, _) => {}
            (Some(_), By::None) => held.leave_out("normals"),
            (Some(Normals::PerVertex(values)), _) => held.normals = Some(values.clone()),
            (Some(Normals::PerCorner(normals)), By::Corner) => held.corner_normals = Some(normals),
            (Some(Normals::PerCorner(normals)), _) => match normals.per_vertex(facets, vertices) {
                None => held.leave_out("normals (they differ from facet to facet)"),
                normals => held.normals = normals,
            },
        }
        match (attributes.texture(), &holds.texture) {
            (None, _) => {}
            (Some(_), By::None) => held.leave_out("texture coordinates"),
            (Some(texture), By::Corner) => held.corner_uv = Some(texture),
            (Some(texture), by) => match (texture.per_vertex(facets, vertices), by) {
                (None, By::VertexOrCorner) => held.corner_uv = Some(texture),
                (None, _) => held.leave_out("texture coordinates (they have seams)"),
                (uv, _) => held.uv = uv,
            },
        }
        if let Some(colours) = attributes.colours() {
            held.colours = holds.colours.then_some(colours);
            if !holds.colours {
                held.leave_out("colours");
            } else if !holds.opacity && colours.values.iter().any(|c| c[3] != 1.0) {
                held.leave_out("opacity");
            }
        }
        match holds.scalars {
            true => held.scalars = attributes.scalars(),
            false => attributes.scalars().iter().for_each(|s| held.leave_out(&format!("scalar {}", s.name))),
        }
        match (attributes.regions(), &holds.regions) {
            (None, _) => {}
            (Some(_), Labelled::None) => held.leave_out("regions"),
            (regions @ Some(found), labelled) => {
                held.regions = regions;
                if matches!(labelled, Labelled::Number) && found.all().iter().any(|region| !region.name.is_empty()) {
                    held.leave_out("names of regions");
                }
            }
        }
        held
    }

    /// Numbers of all scalars at a vertex.
    pub(super) fn components(&self) -> usize {
        self.scalars.iter().map(|scalar| scalar.components).sum()
    }

    fn leave_out(&mut self, what: &str) {
        self.left_out.push(what.to_owned());
    }
}

/// A surface around the origin and the place that was its middle, if it lies far from the origin beside its size: there single
/// precision is coarse. The place is one of single precision, as readers hold it.
pub(super) fn centred(mesh: &TriMesh) -> Option<(TriMesh, DVec3)> {
    let (low, high) = mesh.bounds();
    let middle = (0.5 * low + 0.5 * high).as_vec3().as_dvec3();
    if middle.abs().max_element() <= (high - low).max_element() || !middle.is_finite() {
        return None;
    }
    let positions = mesh.positions().iter().map(|&p| p - middle).collect();
    TriMesh::new(positions, mesh.facets().to_vec()).ok().map(|moved| (moved, middle))
}

/// The share of an edge by which rounding may move a vertex unsaid.
const MOST_ROUNDING: f64 = 0.01;

/// What single precision loses, if that is much beside the edges.
pub(super) fn rounding(mesh: &TriMesh) -> Option<String> {
    let of_facet = |facet: usize| {
        let [a, b, c] = mesh.corners(facet);
        let edge = a.distance(b).min(b.distance(c)).min(c.distance(a));
        let moved = [a, b, c].map(|p| p.distance(p.as_vec3().as_dvec3()));
        if edge > 0.0 { moved[0].max(moved[1]).max(moved[2]) / edge } else { 0.0 }
    };
    let most = tasks::map(mesh.facets().len(), of_facet).into_iter().fold(0.0, f64::max);
    (most > MOST_ROUNDING).then(|| {
        format!("the precision of the coordinates (rounding moves vertices by up to {:.0} % of an edge)", 100.0 * most)
    })
}

/// For each element the first with the same key.
pub(super) fn firsts<K: Ord>(count: usize, key: impl Fn(usize) -> K + Sync) -> Vec<u32> {
    let mut sorted: Vec<u32> = (0..count as u32).collect();
    sorted.par_sort_unstable_by(|&a, &b| key(a as usize).cmp(&key(b as usize)).then(a.cmp(&b)));
    let mut firsts = vec![0; count];
    let mut first = 0;
    for (k, &i) in sorted.iter().enumerate() {
        if k == 0 || key(i as usize) != key(sorted[k - 1] as usize) {
            first = i;
        }
        firsts[i as usize] = first;
    }
    firsts
}

/// Numbers elements from `next` on, the equal ones alike, and hands out the first of each.
pub(super) fn numbered(mut firsts: Vec<u32>, mut next: usize, mut new: impl FnMut(usize)) -> Vec<u32> {
    for i in 0..firsts.len() {
        let first = firsts[i] as usize;
        firsts[i] = if first == i {
            new(i);
            next += 1;
            next as u32 - 1
        } else {
            firsts[first]
        };
    }
    firsts
}

pub(super) fn eight_bit(component: f64) -> u8 {
    // The cast saturates.
    (component * 255.0).round() as u8
}

/// Facets that single precision makes lines or points of may have this share of the area.
const LOSS: f64 = 1e-3;

pub(super) fn check_single(mesh: &TriMesh) -> Result<(), DataError> {
    let limit = f64::from(f32::MAX);
    if let Some(vertex) = mesh.positions().iter().position(|p| p.abs().max_element() > limit) {
        return Err(DataError::SinglePrecision { vertex, position: mesh.positions()[vertex] });
    }
    let joined = |p: DVec3, q: DVec3| p != q && p.as_vec3() == q.as_vec3();
    let collapses = |&facet: &usize| {
        let [a, b, c] = mesh.corners(facet);
        joined(a, b) || joined(b, c) || joined(c, a)
    };
    let collapsed: Vec<usize> = (0..mesh.facets().len()).filter(collapses).collect();
    if let Some(&facet) = collapsed.first() {
        // Scaled, so that no square vanishes. Slivers are no loss.
        let (low, high) = mesh.bounds();
        let extent = (high - low).max_element();
        let area = |facet: usize| normal(mesh.corners(facet).map(|p| (p - low) / extent)).length();
        let all: f64 = (0..mesh.facets().len()).map(area).sum();
        if collapsed.into_iter().map(area).sum::<f64>() > LOSS * all {
            return Err(DataError::Collapsed { facet });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_bits_come_back() {
        for k in 0..=255u8 {
            assert_eq!(eight_bit(f64::from(k) / 255.0), k);
        }
        assert_eq!((eight_bit(-1.0), eight_bit(7.0)), (0, 255));
    }
}
