//! Patches of sheets between curves.
//!
//! Purpose: [`Sheets::in_patches`] divides sheets along given edges.
//! Invariant: depends on the mesh and the edges alone. An edge with the same patch on both sides divides nothing. Must not know: why an
//! edge was given.

use std::collections::HashSet;

use super::pairing::{Pairing, ends_of};
use super::{Sheets, whole_facets};
use crate::mesh::TriMesh;
use crate::mesh::adjacency::weld_unless;
use crate::mesh::edges::{DisjointSets, EdgeGroups, undirected};
use crate::token::{Stopped, Token};

impl Sheets {
    /// The same, divided along `curves`: edges of `mesh` by any vertices in their places.
    pub(crate) fn in_patches(
        &self,
        mesh: &TriMesh,
        curves: &[[u32; 2]],
        go_on: bool,
        token: &Token,
    ) -> Result<Self, Stopped> {
        let class = weld_unless(mesh, token)?;
        let curves: HashSet<[u32; 2]> = curves.iter().map(|edge| undirected(edge.map(|v| class[v as usize]))).collect();
        let groups = EdgeGroups::unless(class.len(), whole_facets(mesh, &class), token)?;
        let pairing = Pairing::of(mesh, (&class, &groups), go_on, token)?;
        let mut sets = DisjointSets::new(mesh.facets().len());
        let mut across = Vec::new();
        groups.for_each(|low, halves| {
            let ends = ends_of((mesh, &class), low, halves);
            for [a, b] in pairing.at(ends, halves) {
                if self.of_facet[a as usize] != self.of_facet[b as usize] || curves.contains(&ends) {
                    across.push((ends, [a, b]));
                } else {
                    sets.join(a as usize, b as usize);
                }
            }
        });
        token.check()?;
        // Facets without an edge stay with a facet of their sheet that they touch.
        let mut at = std::collections::BTreeMap::new();
        let named_twice = |t: &[u32; 3]| t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
        let welded = |f: usize| mesh.facets()[f].map(|v| class[v as usize]);
        for f in (0..mesh.facets().len()).filter(|&f| !named_twice(&welded(f))) {
            for v in welded(f) {
                at.entry((self.of_facet[f], v)).or_insert(f);
            }
        }
        for f in (0..mesh.facets().len()).filter(|&f| named_twice(&welded(f))) {
            if let Some(&beside) = welded(f).iter().find_map(|&v| at.get(&(self.of_facet[f], v))) {
                sets.join(f, beside);
            }
        }
        let mut patches = Self::numbered(mesh, &class, &groups, &mut sets);
        let parted = |link: &[u32; 2]| patches.of_facet[link[0] as usize] != patches.of_facet[link[1] as usize];
        across.retain(|(_, link)| parted(link));
        (patches.joined, patches.whole) = (across, self.whole);
        Ok(patches)
    }
}
