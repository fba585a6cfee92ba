//! Boundaries that motions take to others.
//!
//! Purpose: [`Pairs::of`] finds the boundary edges of a surface that a motion takes to others. Where one side lacks a vertex of the other it
//! is put in, so that both have the same edges.
//! Invariant: vertices stay where they are; new ones are behind all others. Must not know: the use of the pairs.

use std::collections::{BTreeSet, HashMap};

use glam::DVec3;
use rstar::RTree;
use rstar::primitives::GeomWithData;

use super::TriMesh;
use super::adjacency::{Adjacency, EdgeKind};
use super::csr::ascending;
use super::edges::undirected;
use super::hanging::{self, Divided};
use super::motion::Motion;
use crate::token::{Stopped, Token};

/// Rounds in which vertices are put in, at most: one that is put in at one side may be lacking at a third.
const MOST_ROUNDS: usize = 8;

/// An edge that a motion takes to another. Ends are the lowest vertices in their places, and in corresponding order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Pair {
    pub motion: u32,
    pub from: [u32; 2],
    pub to: [u32; 2],
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Pairs {
    pub all: Vec<Pair>,
    /// All boundary edges, by the lowest vertices in the places of their ends.
    pub boundary: BTreeSet<[u32; 2]>,
    /// Boundary edges both of whose ends come to boundary vertices that have no edge.
    pub unpaired: usize,
}

/// Places, to be searched for the nearest one.
pub(crate) struct Places(RTree<GeomWithData<[f64; 3], u32>>);

impl Places {
    pub(crate) fn new(vertices: &[u32], positions: &[DVec3]) -> Self {
        let at = |&v: &u32| GeomWithData::new(positions[v as usize].to_array(), v);
        Self(RTree::bulk_load(vertices.iter().map(at).collect()))
    }

    /// The vertex nearest to a place, within `reach` of it.
    pub(crate) fn nearest(&self, p: DVec3, reach: f64) -> Option<u32> {
        let mut near = self.0.nearest_neighbor_iter_with_distance_2(p.to_array());
        let (first, least) = near.next().filter(|(_, squared)| *squared <= reach * reach)?;
        // Of several that are as near, the first.
        Some(near.take_while(|(_, squared)| *squared == least).fold(first.data, |lowest, (v, _)| lowest.min(v.data)))
    }
}

/// The boundary edges, and their ends.
pub(crate) fn boundary_of(mesh: &TriMesh, adjacency: &Adjacency) -> (BTreeSet<[u32; 2]>, Vec<u32>) {
    let halves = (0..3 * mesh.facets().len()).filter(|&h| adjacency.kind(h) == EdgeKind::Boundary);
    let edges: BTreeSet<[u32; 2]> = halves.map(|half| undirected(adjacency.ends(mesh, half))).collect();
    let vertices = ascending(edges.iter().flatten().copied());
    (edges, vertices)
}

/// `mesh` with the vertices that its boundaries lack, those that motions bring there from others; `None` if none is lacking.
pub(crate) fn complete(
    mesh: &TriMesh,
    motions: &[Motion],
    reach: f64,
    token: &Token,
) -> Result<Option<Divided>, Stopped> {
    let mut done: Option<Divided> = None;
    for _ in 0..MOST_ROUNDS {
        let present = done.as_ref().map_or(mesh, |done| &done.mesh);
        let adjacency = Adjacency::unless(present, token)?;
        let (_, vertices) = boundary_of(present, &adjacency);
        let places = Places::new(&vertices, present.positions());
        let mut lacking = Vec::new();
        for motion in motions {
            for (k, &v) in vertices.iter().enumerate() {
                token.check_at(k)?;
                let p = present.positions()[v as usize];
                let images = [motion.apply(p), motion.undo(p)];
                lacking.extend(images.into_iter().filter(|&image| places.nearest(image, reach).is_none()));
            }
        }
        // From several motions the same place.
        lacking.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z)));
        lacking.dedup();
        let Some(next) = hanging::insert(present, &adjacency, &lacking, reach, token)? else { break };
        done = Some(match done {
            None => next,
            Some(before) => before.then(next),
        });
    }
    Ok(done)
}

impl Pairs {
    /// The pairs of a surface whose boundaries lack no vertices.
    pub(crate) fn of(mesh: &TriMesh, motions: &[Motion], reach: f64, token: &Token) -> Result<Self, Stopped> {
        let adjacency = Adjacency::unless(mesh, token)?;
        let (boundary, vertices) = boundary_of(mesh, &adjacency);
        let places = Places::new(&vertices, mesh.positions());
        let mut found = Self { boundary, ..Self::default() };
        let mut missed: BTreeSet<[u32; 2]> = BTreeSet::new();
        for (motion, k) in motions.iter().zip(0..) {
            let mut image: HashMap<u32, u32> = HashMap::new();
            for (at, &v) in vertices.iter().enumerate() {
                token.check_at(at)?;
                let there = places.nearest(motion.apply(mesh.positions()[v as usize]), reach);
                there.map(|there| image.insert(v, there));
            }
            for &edge in &found.boundary {
                let [Some(&a), Some(&b)] = edge.map(|v| image.get(&v)) else { continue };
                // An edge on the axis of a rotation stays.
                if a == b || undirected([a, b]) == edge {
                    continue;
                }
                if found.boundary.contains(&undirected([a, b])) {
                    found.all.push(Pair { motion: k, from: edge, to: [a, b] });
                } else {
                    missed.insert(edge);
                }
            }
        }
        let paired: BTreeSet<[u32; 2]> = found.all.iter().flat_map(|pair| [pair.from, undirected(pair.to)]).collect();
        found.unpaired = missed.difference(&paired).count();
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// A strip from 0 to 1, with these heights at its left and right.
    fn strip(left: &[f64], right: &[f64]) -> TriMesh {
        let mut positions: Vec<DVec3> = left.iter().map(|&y| DVec3::new(0.0, y, 0.0)).collect();
        positions.extend(right.iter().map(|&y| DVec3::new(1.0, y, 0.0)));
        let (n, m) = (left.len() as u32, right.len() as u32);
        let mut facets: Vec<[u32; 3]> = (1..m).map(|k| [0, n + k - 1, n + k]).collect();
        facets.extend((1..n).map(|k| [k - 1, n + m - 1, k]));
        TriMesh::new(positions, facets).unwrap()
    }

    fn pairs(mesh: &TriMesh, motion: &str) -> (Pairs, TriMesh) {
        let motions = [motion.parse().unwrap()];
        let done = complete(mesh, &motions, 1e-6, &Token::default()).unwrap();
        let mesh = done.map_or_else(|| mesh.clone(), |done| done.mesh);
        (Pairs::of(&mesh, &motions, 1e-6, &Token::default()).unwrap(), mesh)
    }

    #[test]
    fn both_sides_get_the_vertices_of_both() {
        let (left, right) = ([0.0, 0.3, 0.6, 1.0], [0.0, 0.25, 0.5, 0.6, 1.0]);
        let mesh = strip(&left, &right);
        let (found, divided) = pairs(&mesh, "translate:1,0,0");
        assert_eq!((found.all.len(), found.unpaired, divided.positions().len()), (5, 0, 12));
        assert!((divided.area() - mesh.area()).abs() < 1e-12);
        for Pair { from, to, .. } in &found.all {
            for (&a, &b) in from.iter().zip(to) {
                let [a, b] = [a, b].map(|v| divided.positions()[v as usize]);
                assert!((a + DVec3::X).distance(b) < 1e-6);
            }
        }
        let (other_way, _) = pairs(&mesh, "translate:-1,0,0");
        assert_eq!(other_way.all.len(), 5);
    }

    #[test]
    fn what_does_not_come_to_a_boundary_has_no_pairs() {
        let mesh = strip(&[0.0, 1.0], &[0.0, 1.0]);
        for motion in ["translate:2,0,0", "translate:1,1.5,0", "translate:1,0,0.001"] {
            assert!(pairs(&mesh, motion).0.all.is_empty(), "{motion}");
        }
        assert_eq!(pairs(&mesh, "translate:1,0,0").0.all.len(), 1);
        // Half of a side.
        assert_eq!(pairs(&mesh, "translate:1,0.5,0").0.all.len(), 1);
        assert_eq!(pairs(&mesh, "rotate:180,0,0,1,0.5,0.5,0").0.all.len(), 4);
    }
}
