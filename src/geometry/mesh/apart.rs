//! Parts of a surface, set apart.
//!
//! Purpose: [`Apart::of`] translates the connected components of a surface until none is near another. Distances within a component
//! do not change, so that algorithms by distance treat each component alone: a seed's cell does not reach a neighbouring shell.
//! Invariant: vertices and facets keep their numbers; moving back restores places, and vertices to the bit.
//! Must not know: seeds, diagrams.

use std::collections::HashMap;

use glam::DVec3;

use super::adjacency::weld;
use super::edges::DisjointSets;
use super::{MeshError, TriMesh};

/// Most components that are moved: a surface with more is a list of triangles, or dust.
const MOST: usize = 10_000;
/// Largest growth of the whole: each doubling costs a binary digit of single precision.
const LONGEST: f64 = 8.0;

#[derive(Clone, Debug)]
pub(crate) struct Apart {
    pub mesh: TriMesh,
    /// Rows of parts, one above the other.
    rows: Vec<Row>,
    /// Half of the least gap between two components.
    margin: f64,
    /// Where vertices were, by where they are.
    places: HashMap<[u64; 3], DVec3>,
}

#[derive(Clone, Debug, Default)]
struct Row {
    /// Where it ends upward.
    top: f64,
    /// Where each part ends, and by how much it was moved.
    parts: Vec<(f64, DVec3)>,
}

type Box = (DVec3, DVec3);

fn bits(p: DVec3) -> [u64; 3] {
    // 0 and -0 are one place.
    (p + DVec3::ZERO).to_array().map(f64::to_bits)
}

impl Apart {
    /// Returns `mesh` with its components at least `gap` apart, if the boxes of any two are nearer than half of that. `None`
    /// if none are, or if there are too many components.
    pub(crate) fn of(mesh: &TriMesh, gap: f64) -> Option<Self> {
        let (part, boxes) = parts(mesh)?;
        if !(gap.is_finite() && gap > 0.0 && any_near(&boxes, 0.5 * gap)) {
            return None;
        }
        let size = |b: &Box| b.1 - b.0 + gap;
        let (low, high) = mesh.bounds();
        let floor: f64 = boxes.iter().map(|b| size(b).x * size(b).y).sum();
        let width = boxes.iter().map(|b| size(b).x).fold(floor.sqrt(), f64::max);
        let mut rows = vec![Row::default()];
        let (mut x, mut y) = (0.0, 0.0);
        let mut moved = Vec::with_capacity(boxes.len());
        for b in &boxes {
            if x > 0.0 && x + size(b).x > width {
                y = rows[rows.len() - 1].top + gap;
                x = 0.0;
                rows.push(Row::default());
            }
            let count = rows.len();
            let row = &mut rows[count - 1];
            let by = low + DVec3::new(x, y, 0.0) - b.0;
            moved.push(by);
            x += size(b).x;
            row.parts.push((x - gap, by));
            row.top = row.top.max(y + size(b).y - gap);
        }
        let longest = rows.iter().flat_map(|r| r.parts.iter().map(|p| p.0)).fold(rows[rows.len() - 1].top, f64::max);
        if longest > LONGEST * (high - low).max_element() {
            return None;
        }
        let place = |(&p, &part): (&DVec3, &u32)| moved.get(part as usize).map_or(p, |&by| p + by);
        let positions: Vec<DVec3> = mesh.positions().iter().zip(&part).map(place).collect();
        let places = positions.iter().zip(mesh.positions()).map(|(&now, &then)| (bits(now), then)).collect();
        for row in &mut rows {
            row.top += low.y;
            row.parts.iter_mut().for_each(|part| part.0 += low.x);
        }
        let mesh = TriMesh::new(positions, mesh.facets().to_vec()).ok()?;
        Some(Self { mesh, rows, margin: 0.5 * gap, places })
    }

    /// Where a place beside the surface was.
    pub(crate) fn back(&self, p: DVec3) -> DVec3 {
        if let Some(&place) = self.places.get(&bits(p)) {
            return place;
        }
        let row = self.rows.partition_point(|row| row.top + self.margin < p.y).min(self.rows.len() - 1);
        let parts = &self.rows[row].parts;
        let part = parts.partition_point(|part| part.0 + self.margin < p.x).min(parts.len() - 1);
        p - parts[part].1
    }

    /// A surface beside this one, where it was; no error if it is still valid there.
    pub(crate) fn mesh_back(&self, mesh: &TriMesh) -> Result<TriMesh, MeshError> {
        TriMesh::new(mesh.positions().iter().map(|&p| self.back(p)).collect(), mesh.facets().to_vec())
    }
}

/// The part of each vertex, `u32::MAX` where no facet has it, and the parts' boxes in the order of their first vertices.
fn parts(mesh: &TriMesh) -> Option<(Vec<u32>, Vec<Box>)> {
    let class = weld(mesh);
    let mut sets = DisjointSets::new(class.len());
    for facet in mesh.facets() {
        let [a, b, c] = facet.map(|v| class[v as usize] as usize);
        sets.join(a, b);
        sets.join(b, c);
    }
    let mut used = vec![false; class.len()];
    mesh.facets().iter().flatten().for_each(|&v| used[v as usize] = true);
    let mut number = vec![u32::MAX; class.len()];
    let mut part = vec![u32::MAX; class.len()];
    let mut boxes: Vec<Box> = Vec::new();
    for v in (0..class.len()).filter(|&v| used[v]) {
        let root = sets.root(class[v] as usize);
        if number[root] == u32::MAX {
            if boxes.len() == MOST {
                return None;
            }
            number[root] = boxes.len() as u32;
            boxes.push((DVec3::INFINITY, DVec3::NEG_INFINITY));
        }
        part[v] = number[root];
        let (low, high) = &mut boxes[number[root] as usize];
        (*low, *high) = (low.min(mesh.positions()[v]), high.max(mesh.positions()[v]));
    }
    (boxes.len() > 1).then_some((part, boxes))
}

fn any_near(boxes: &[Box], near: f64) -> bool {
    let beside = |a: &Box, b: &Box| (a.0 - near).cmple(b.1).all() && (b.0 - near).cmple(a.1).all();
    let mut sorted: Vec<&Box> = boxes.iter().collect();
    sorted.sort_by(|a, b| a.0.x.total_cmp(&b.0.x));
    let reached = |a: &Box, b: &Box| b.0.x - near <= a.1.x;
    (0..sorted.len())
        .any(|i| sorted[i + 1..].iter().take_while(|b| reached(sorted[i], b)).any(|b| beside(sorted[i], b)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::mesh::shapes::Shape;

    /// Shells around each other, and a plane through them.
    fn nested(shells: u32) -> TriMesh {
        let (mut positions, mut facets) = Shape::Plane.build(200).into_parts();
        for k in 0..shells {
            let (p, f) = Shape::Sphere.build(300).into_parts();
            let base = positions.len() as u32;
            positions.extend(p.iter().map(|&p| (1.0 + 0.01 * f64::from(k)) * p));
            facets.extend(f.iter().map(|f| f.map(|v| v + base)));
        }
        TriMesh::new(positions, facets).unwrap()
    }

    #[test]
    fn parts_keep_their_shape_and_come_back_to_the_bit() {
        let mesh = nested(10);
        let gap = 0.3;
        let apart = Apart::of(&mesh, gap).unwrap();
        let (_, boxes) = parts(&apart.mesh).unwrap();
        assert_eq!(boxes.len(), 11);
        assert!(!any_near(&boxes, 0.999 * gap));
        for f in 0..mesh.facets().len() {
            let lengths = |[a, b, c]: [DVec3; 3]| [a.distance(b), b.distance(c), c.distance(a)];
            let (then, now) = (lengths(mesh.corners(f)), lengths(apart.mesh.corners(f)));
            assert!(then.iter().zip(now).all(|(a, b)| (a - b).abs() < 1e-14));
        }
        assert_eq!(apart.mesh_back(&apart.mesh).unwrap(), mesh);
        // Points near a component move with it.
        let side = 0.45 * gap;
        for (k, (&now, &then)) in apart.mesh.positions().iter().zip(mesh.positions()).enumerate() {
            let off = side * DVec3::new((k as f64).sin(), (2.0 * k as f64).cos(), 0.3);
            assert!(apart.back(now + off).distance(then + off) < 1e-14);
        }
    }

    #[test]
    fn what_is_one_or_apart_already_stays() {
        assert!(Apart::of(&Shape::Sphere.build(300), 0.1).is_none());
        let mesh = nested(1);
        assert!(Apart::of(&mesh, f64::NAN).is_none());
        let apart = Apart::of(&mesh, 0.5).unwrap();
        assert!(Apart::of(&apart.mesh, 0.5).is_none());
    }
}
