//! Which facet lies across which edge.
//!
//! Purpose: [`Adjacency`] has the kind and the opposite of each half-edge; [`weld`] finds vertices at one point.
//! Invariant: exactly coincident vertices count as one, so that surfaces with split vertices at texture seams, and lists of
//! triangles, are connected. Facets that name a point twice after that are *collapsed*: they belong to no edge. The result
//! depends on the mesh alone, not on threads. Must not know: quality, files, seeds.

use super::edges::{EdgeGroups, Half};
use super::{TriMesh, coincident};
use crate::token::{Pace, Stopped, Token};

/// Kind of an edge, seen from one of its facets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum EdgeKind {
    /// One facet.
    Boundary,
    /// Two facets that run through it in opposite directions.
    Manifold,
    /// Two facets with opposite orientations: they traverse it in the same direction.
    Inconsistent,
    /// Three facets or more.
    NonManifold,
    /// The facet names a point twice and belongs to no edge.
    Collapsed,
}

/// Edges of a surface. Half-edge `3 * facet + e` runs from corner `e` to corner `(e + 1) % 3`.
#[derive(Clone, Debug, Default)]
pub struct Adjacency {
    representative: Vec<u32>,
    kinds: Vec<EdgeKind>,
    opposites: Vec<usize>,
    /// Different edges.
    pub edges: usize,
    /// Edges with one facet.
    pub boundary_edges: usize,
    /// Edges whose two facets traverse them in the same direction.
    pub inconsistent_edges: usize,
    /// Edges with more than two facets.
    pub non_manifold_edges: usize,
}

const NONE: usize = usize::MAX;

/// For each vertex the lowest vertex at exactly the same position (0 and -0 are the same).
pub fn weld(mesh: &TriMesh) -> Vec<u32> {
    weld_unless(mesh, &Token::default()).unwrap_or_default()
}

/// As [`weld`], unless it is stopped.
pub fn weld_unless(mesh: &TriMesh, token: &Token) -> Result<Vec<u32>, Stopped> {
    let mut representative: Vec<u32> = (0..mesh.positions().len() as u32).collect();
    for (later, earliest) in coincident::find_unless(mesh.positions(), token)? {
        representative[later as usize] = earliest;
    }
    Ok(representative)
}

impl Adjacency {
    /// Finds the edges of `mesh`.
    pub fn new(mesh: &TriMesh) -> Self {
        Self::unless(mesh, &Token::default()).unwrap_or_default()
    }

    /// As [`Self::new`], unless it is stopped.
    pub fn unless(mesh: &TriMesh, token: &Token) -> Result<Self, Stopped> {
        Self::with(mesh, weld_unless(mesh, token)?, token)
    }

    /// The same where vertices with one representative, the lowest of them, are one, and no others.
    pub fn with(mesh: &TriMesh, representative: Vec<u32>, token: &Token) -> Result<Self, Stopped> {
        let halves = 3 * mesh.facets().len();
        let welded = |corners: &[u32; 3]| corners.map(|c| representative[c as usize]);
        let facets = mesh.facets().iter().map(welded).enumerate();
        let different = facets.filter(|(_, v)| v[0] != v[1] && v[1] != v[2] && v[2] != v[0]);
        let groups = EdgeGroups::unless(representative.len(), different, token)?;
        let forward = |low: u32, half: Half| welded(&mesh.facets()[half.facet as usize])[half.side] == low;
        let number = |half: Half| 3 * half.facet as usize + half.side;
        let mut kinds = vec![EdgeKind::Collapsed; halves];
        let mut opposites = vec![NONE; halves];
        let [mut edges, mut boundary_edges, mut inconsistent_edges, mut non_manifold_edges] = [0; 4];
        let mut pace = Pace::default();
        groups.for_each(|low, edge| {
            // What is there then is not used.
            if token.is_stopped_after(1, &mut pace) || token.is_told_to_stop() {
                return;
            }
            edges += 1;
            let kind = match *edge {
                [_] => EdgeKind::Boundary,
                [a, b] => {
                    opposites[number(a)] = number(b);
                    opposites[number(b)] = number(a);
                    if forward(low, a) == forward(low, b) { EdgeKind::Inconsistent } else { EdgeKind::Manifold }
                }
                _ => EdgeKind::NonManifold,
            };
            edge.iter().for_each(|&half| kinds[number(half)] = kind);
            match kind {
                EdgeKind::Boundary => boundary_edges += 1,
                EdgeKind::Inconsistent => inconsistent_edges += 1,
                EdgeKind::NonManifold => non_manifold_edges += 1,
                EdgeKind::Manifold | EdgeKind::Collapsed => {}
            }
        });
        token.check()?;
        Ok(Self { representative, kinds, opposites, edges, boundary_edges, inconsistent_edges, non_manifold_edges })
    }

    /// The half-edge across an edge with exactly two facets, whichever way they run.
    pub fn opposite(&self, half_edge: usize) -> Option<usize> {
        Some(self.opposites[half_edge]).filter(|&opposite| opposite != NONE)
    }

    /// Kind of a half-edge's edge.
    pub fn kind(&self, half_edge: usize) -> EdgeKind {
        self.kinds[half_edge]
    }

    /// Whether `facet` names a point twice and belongs to no edge.
    pub fn is_collapsed(&self, facet: usize) -> bool {
        self.kinds[3 * facet] == EdgeKind::Collapsed
    }

    /// Both ends of a half-edge of `mesh`, each as the lowest vertex in its place.
    pub(crate) fn ends(&self, mesh: &TriMesh, half_edge: usize) -> [u32; 2] {
        let corners = mesh.facets()[half_edge / 3];
        [half_edge % 3, (half_edge + 1) % 3].map(|corner| self.representative[corners[corner] as usize])
    }

    /// For each vertex the lowest vertex at the same position; see [`weld`].
    pub fn representative(&self) -> &[u32] {
        &self.representative
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;

    fn mesh(facets: &[[u32; 3]]) -> TriMesh {
        let points = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1., 0.], [0., 0., 1.], [-0., 0., -0.]];
        TriMesh::new(points.map(|[x, y, z]| dvec3(x, y, z)).to_vec(), facets.to_vec()).unwrap()
    }

    #[test]
    fn kinds_and_opposites() {
        let two = Adjacency::new(&mesh(&[[0, 1, 2], [2, 1, 3]]));
        assert_eq!((two.edges, two.boundary_edges), (5, 4));
        assert_eq!((two.kind(1), two.opposite(1), two.opposite(3)), (EdgeKind::Manifold, Some(3), Some(1)));
        assert_eq!((two.kind(0), two.opposite(0)), (EdgeKind::Boundary, None));

        let turned = Adjacency::new(&mesh(&[[0, 1, 2], [1, 2, 3]]));
        assert_eq!(
            (turned.inconsistent_edges, turned.kind(1), turned.opposite(1)),
            (1, EdgeKind::Inconsistent, Some(3))
        );

        let three = Adjacency::new(&mesh(&[[0, 1, 2], [2, 1, 3], [1, 2, 4]]));
        assert_eq!((three.non_manifold_edges, three.kind(1), three.opposite(1)), (1, EdgeKind::NonManifold, None));
    }

    #[test]
    fn coincident_vertices_are_one() {
        let split = mesh(&[[0, 1, 2], [5, 2, 4], [0, 5, 1]]);
        assert_eq!(weld(&split), [0, 1, 2, 3, 4, 0]);
        let adjacency = Adjacency::new(&split);
        assert_eq!(adjacency.opposite(2), Some(3));
        assert!(adjacency.is_collapsed(2) && !adjacency.is_collapsed(0));
        assert_eq!(adjacency.edges, 5);
    }
}
