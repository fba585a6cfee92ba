//! Surfaces whose boundaries go on in others.
//!
//! Purpose: [`settle`] moves the vertices of a result's periodic boundaries to exactly where the motions take them. Both boundaries have the
//! same seeds before, so that only rounding and the reach of the pairs are left.
//! Invariant: a vertex is the motion of its partner, to the bit; at corners of several motions one of them is. Where an edge is lacking
//! there is an error, and no result. Must not know: how seeds came about.

use std::collections::{BTreeSet, HashMap, HashSet, VecDeque};

use glam::DVec3;

use super::extract::Built;
use crate::mesh::TriMesh;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::edges::undirected;
use crate::mesh::motion::Motion;
use crate::mesh::pairs::{Pairs, Places, boundary_of};
use crate::remesh::features::KeptCurves;
use crate::remesh::features::seams::periods::Signs;
use crate::remesh::report::PeriodicFigures;
use crate::remesh::{RemeshError, Result};
use crate::rvd::RvdError;
use crate::token::Token;

/// `pairs` are those of the input, one of them at `first`; seeds are in the caller's coordinates.
pub(super) fn settle(
    built: &mut Built,
    (curves, seeds): (&KeptCurves, &[DVec3]),
    (motions, reach): (&[Motion], f64),
    (pairs, first): (&Pairs, DVec3),
    token: &Token,
) -> Result<PeriodicFigures> {
    let mesh = &built.mesh;
    let adjacency = Adjacency::unless(mesh, token)?;
    let (boundary, vertices) = boundary_of(mesh, &adjacency);
    let places = Places::new(&vertices, mesh.positions());
    // Both ends may be off by the reach.
    let image = |motion: &Motion, v: u32| places.nearest(motion.apply(mesh.positions()[v as usize]), 3.0 * reach);
    let mut next: HashMap<u32, Vec<(u32, &Motion)>> = HashMap::new();
    let mut arrived: BTreeSet<u32> = BTreeSet::new();
    // By edge, motion, and whether that ends there.
    let mut paired: HashSet<([u32; 2], u32, bool)> = HashSet::new();
    let mut edges = 0;
    for (motion, k) in motions.iter().zip(0..) {
        token.check()?;
        let images: HashMap<u32, u32> = vertices.iter().filter_map(|&v| Some((v, image(motion, v)?))).collect();
        for &edge in &boundary {
            let [Some(&a), Some(&b)] = edge.map(|v| images.get(&v)) else { continue };
            let other = undirected([a, b]);
            if a == b || other == edge || !boundary.contains(&other) {
                continue;
            }
            edges += 1;
            paired.extend([(edge, k, false), (other, k, true)]);
            for (from, to) in edge.into_iter().zip([a, b]).filter(|(from, to)| from != to) {
                let known = next.entry(from).or_default();
                if !known.contains(&(to, motion)) {
                    known.push((to, motion));
                }
                arrived.insert(to);
            }
        }
    }
    let class = |edge: [u32; 2]| undirected(edge.map(|v| adjacency.representative()[v as usize]));
    let is_lost = |(_, signs, edge): &([u32; 2], &Signs, Option<[u32; 2]>)| {
        edge.is_none_or(|edge| !signs.iter().all(|&(motion, ends)| paired.contains(&(class(edge), motion, ends))))
    };
    let mut lost = curves.periodic(&built.segments).filter(is_lost);
    if let Some(([a, b], ..)) = lost.next() {
        let place = seeds[a as usize].midpoint(seeds[b as usize]);
        return Err(RemeshError::PeriodicLost { edges: 1 + lost.count(), place });
    }
    drop(lost);
    if edges == 0 {
        return Err(RemeshError::PeriodicLost { edges: pairs.all.len(), place: first });
    }
    let mut positions = mesh.positions().to_vec();
    let mut settled: BTreeSet<u32> = BTreeSet::new();
    let (later, roots): (Vec<u32>, Vec<u32>) = vertices.iter().partition(|v| arrived.contains(v));
    // Motions may come back to where they began, as half a turn does.
    for root in roots.into_iter().chain(later) {
        if !settled.insert(root) {
            continue;
        }
        let mut open = VecDeque::from([root]);
        while let Some(v) = open.pop_front() {
            for &(to, motion) in next.get(&v).into_iter().flatten() {
                if settled.insert(to) {
                    positions[to as usize] = motion.apply(positions[v as usize]);
                    open.push_back(to);
                }
            }
        }
    }
    // Vertices in one place stay together.
    for (v, &lowest) in adjacency.representative().iter().enumerate() {
        positions[v] = positions[lowest as usize];
    }
    let broken = |e| RvdError::Internal(format!("a surface was valid before its boundaries were moved: {e}"));
    built.mesh = TriMesh::new(positions, mesh.facets().to_vec()).map_err(broken)?;
    Ok(PeriodicFigures { edges, unpaired_edges: pairs.unpaired })
}
