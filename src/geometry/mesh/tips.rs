//! Tips of cones, needles and pits.
//!
//! Purpose: [`Tips`] finds the vertices at the ends of what is pointed. No curve marks them.
//! Invariant: a tip is pointed at the vertex itself and over the length that the caller names, so noise has none. Depends on the mesh and
//! that length alone. Must not know: seeds, diagrams, results.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use glam::DVec3;

use super::adjacency::{Adjacency, EdgeKind};
use super::csr::Csr;
use super::edges::sides;
use super::{TriMesh, normal};
use crate::token::{Stopped, Token};

/// The angles at a tip sum to less, radians: those of a cone that is as wide as its sides are long. They are 2π times the sine of half its
/// opening.
const MOST_ANGLE: f64 = std::f64::consts::PI;
/// The middle of a circle of geodesic radius r around a tip is farther from it, share of r. It is the cosine of half the opening for a
/// cone, 0 in a plane and at the side of a needle.
const LEAST_OFFSET: f64 = 0.75;

/// The vertices of a mesh at which angles sum to little, with what is around them.
pub(crate) struct Tips<'a> {
    mesh: &'a TriMesh,
    /// Welded.
    facets: Vec<[u32; 3]>,
    rings: Csr<u32>,
    candidates: Vec<u32>,
}

impl<'a> Tips<'a> {
    /// `None` if no vertex is pointed.
    pub(crate) fn of(mesh: &'a TriMesh, token: &Token) -> Result<Option<Self>, Stopped> {
        let adjacency = Adjacency::unless(mesh, token)?;
        let class = adjacency.representative();
        let facets: Vec<[u32; 3]> = mesh.facets().iter().map(|t| t.map(|v| class[v as usize])).collect();
        let mut around = vec![0.0; mesh.positions().len()];
        for (f, t) in facets.iter().enumerate() {
            token.check_at(f)?;
            let corners = t.map(|v| mesh.positions()[v as usize]);
            for k in 0..3 {
                let [a, b, c] = [0, 1, 2].map(|step| corners[(k + step) % 3]);
                // Where the surface ends, or several sheets meet, the sum says nothing.
                let is_inside = adjacency.kind(3 * f + k) == EdgeKind::Manifold;
                around[t[k] as usize] += if is_inside { (b - a).angle_between(c - a) } else { MOST_ANGLE };
            }
        }
        let is_pointed = |v: &u32| (0.0..MOST_ANGLE).contains(&around[*v as usize]) && around[*v as usize] > 0.0;
        let mut candidates: Vec<u32> = (0..around.len() as u32).filter(is_pointed).collect();
        if candidates.is_empty() {
            return Ok(None);
        }
        candidates.sort_by(|&a, &b| around[a as usize].total_cmp(&around[b as usize]).then(a.cmp(&b)));
        let rings = Csr::one_rings(around.len(), &facets);
        Ok(Some(Self { mesh, facets, rings, candidates }))
    }

    /// The vertices that may be tips, the most pointed first.
    pub(crate) fn candidates(&self) -> &[u32] {
        &self.candidates
    }

    /// The direction out of what a vertex ends, a unit vector, if it is pointed over `reach`.
    pub(crate) fn direction(&self, v: u32, reach: f64) -> Option<DVec3> {
        let offset = self.mesh.positions()[v as usize] - self.middle_of_circle(v, reach)?;
        (offset.length() > LEAST_OFFSET * reach).then(|| offset.normalize())
    }

    /// Whether the surface is around what ends at a vertex, as around a pit. `direction` is that of [`Self::direction`].
    pub(crate) fn is_pit(&self, v: u32, direction: DVec3) -> bool {
        let area = |&f: &u32| normal(self.facets[f as usize].map(|v| self.mesh.positions()[v as usize]));
        self.rings.of(v).iter().map(area).sum::<DVec3>().dot(direction) < 0.0
    }

    /// The mean of the points at some distance from a vertex along the edges; `None` if there are none.
    fn middle_of_circle(&self, from: u32, radius: f64) -> Option<DVec3> {
        let mut nearest: HashMap<u32, f64> = HashMap::from([(from, 0.0)]);
        // Lengths are not negative, so their bits are in their order.
        let mut queue = BinaryHeap::from([Reverse((0u64, from))]);
        let (mut sum, mut count) = (DVec3::ZERO, 0.0);
        while let Some(Reverse((bits, v))) = queue.pop() {
            let distance = f64::from_bits(bits);
            if nearest[&v] < distance {
                continue;
            }
            let place = self.mesh.positions()[v as usize];
            let half_edges = self.rings.of(v).iter().flat_map(|&f| sides(self.facets[f as usize]));
            for [_, to] in half_edges.filter(|side| side[0] == v) {
                let target = self.mesh.positions()[to as usize];
                let there = distance + place.distance(target);
                if there > radius {
                    sum += place.lerp(target, (radius - distance) / (there - distance));
                    count += 1.0;
                } else if nearest.get(&to).is_none_or(|&known| there < known) {
                    nearest.insert(to, there);
                    queue.push(Reverse((there.to_bits(), to)));
                }
            }
        }
        (count > 0.0).then(|| sum / count)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use glam::DVec2;

    use super::*;
    use crate::mesh::shapes::Shape;

    /// A cone of some height over the unit circle, with a bottom; the tip is vertex 0.
    fn cone(height: f64, sides: u32) -> TriMesh {
        let at = |k: u32| DVec2::from_angle(f64::from(k) / f64::from(sides) * TAU).extend(0.0);
        let mut positions = vec![DVec3::Z * height, DVec3::ZERO];
        positions.extend((0..sides).map(at));
        let facets = (0..sides).flat_map(|k| {
            let [a, b] = [2 + k, 2 + (k + 1) % sides];
            [[0, a, b], [1, b, a]]
        });
        TriMesh::new(positions, facets.collect()).unwrap()
    }

    #[test]
    fn cones_have_a_tip_if_they_are_pointed() {
        for sides in [5, 12, 40] {
            for (height, is_pointed) in [(10.0, true), (3.0, true), (1.0, false), (0.2, false)] {
                let mesh = cone(height, sides);
                let tips = Tips::of(&mesh, &Token::default()).unwrap();
                let found = tips.as_ref().map_or(&[][..], |tips| tips.candidates());
                assert_eq!(found, if is_pointed { &[0u32][..] } else { &[] }, "{height}, {sides}");
                if let Some(tips) = &tips {
                    let direction = tips.direction(0, 0.5).unwrap();
                    assert!(direction.dot(DVec3::Z) > 0.99 && !tips.is_pit(0, direction));
                }
            }
        }
        // From the other side it is a pit.
        let mesh = cone(4.0, 12);
        let turned = mesh.facets().iter().map(|&[a, b, c]| [a, c, b]).collect();
        let mesh = TriMesh::new(mesh.positions().to_vec(), turned).unwrap();
        let tips = Tips::of(&mesh, &Token::default()).unwrap().unwrap();
        assert!(tips.is_pit(0, tips.direction(0, 0.5).unwrap()));
    }

    /// A spike of noise is pointed, but not over a length that is far larger than it is.
    #[test]
    fn noise_has_no_tip() {
        let mesh = Shape::Plane.build(2000);
        let mut positions = mesh.positions().to_vec();
        let edge = positions[mesh.facets()[0][0] as usize].distance(positions[mesh.facets()[0][1] as usize]);
        let middle = (0..positions.len()).min_by(|&a, &b| {
            let from = |k: usize| positions[k].distance(DVec3::new(0.5, 0.5, 0.0));
            from(a).total_cmp(&from(b))
        });
        let spike = middle.unwrap();
        positions[spike].z += 4.0 * edge;
        let mesh = TriMesh::new(positions, mesh.facets().to_vec()).unwrap();
        let tips = Tips::of(&mesh, &Token::default()).unwrap().unwrap();
        assert_eq!(tips.candidates(), [spike as u32]);
        assert!(tips.direction(spike as u32, 2.0 * edge).is_some());
        assert!(tips.direction(spike as u32, 20.0 * edge).is_none());
    }
}
