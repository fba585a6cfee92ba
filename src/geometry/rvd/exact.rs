//! Exact decisions where rounding could decide otherwise.
//!
//! Purpose: on which side of a bisector a symbolic RVD vertex lies, in integers; and where it is,
//! when two lines are so nearly parallel that rounding would put it elsewhere.
//! Invariant: the answer depends on the vertex's identity alone (mesh vertex; mesh edge and one bisector; facet and two
//! bisectors), not on the caller or how the vertex was computed, so that all cells and facets around a vertex agree. There are
//! no ties: seed i is given the infinitesimal weight w_i of a power diagram, w_0 ≫ w_1 ≫ … > 0 (simulation of simplicity,
//! Edelsbrunner and Mücke 1990), so a point on a bisector belongs to the lower index. Must not know: polygons, neighbours.
//!
//! Positions are multiples of 2⁻⁵² ([`super::surface::snap`]), so all values are integers. In the plane of a facet with
//! corners p_a, L_l(p) = |p - x_l|² - |p - x_i|² is linear, and is known by its three corner values M_a = L_l(p_a).
//! Where bisectors with corner values J and K meet, the barycentric coordinates are J × K over their sum, so L_l has
//! the sign of det(M, J, K) · det(1, J, K) there; on the edge from corner a to b, that of (J_a M_b - J_b M_a)(J_a -
//! J_b). A weight adds δ_l = w_i - w_l to all three values; the determinants being linear in each row, the weights'
//! coefficients are the same determinants with one row replaced by ones.

use num_bigint::{BigInt, Sign};
use num_traits::ToPrimitive;

use super::{Surface, cells::facet_edge, surface::GRID};
use crate::knn::Point;

type Values = [BigInt; 3];

/// The seed and facet that are being clipped.
#[derive(Clone, Copy)]
pub(super) struct Sides<'a, P: Point> {
    pub surface: &'a Surface<P>,
    pub facet: u32,
    pub seeds: &'a [P],
    pub i: u32,
}

impl<P: Point> Sides<'_, P> {
    /// Whether the vertex between polygon edges `before` and `after` is on the side of seed i of the bisector with seed `l`.
    pub(super) fn inside(&self, before: u32, after: u32, l: u32) -> bool {
        let m = self.values(l);
        match (facet_edge(before), facet_edge(after)) {
            (Some(_), Some(corner)) => match m[corner].sign() {
                Sign::NoSign => self.i < l,
                sign => sign == Sign::Plus,
            },
            (Some(edge), None) => self.on_edge(edge, after, l, &m),
            (None, Some(edge)) => self.on_edge(edge, before, l, &m),
            (None, None) => self.in_facet(before, after, l, &m),
        }
    }

    fn on_edge(&self, edge: usize, j: u32, l: u32, m: &Values) -> bool {
        let (a, b) = (edge, (edge + 1) % 3);
        let jv = self.values(j);
        let run = &jv[a] - &jv[b];
        let slope = &m[b] - &m[a];
        let zero = &jv[a] * &m[b] - &jv[b] * &m[a];
        positive(zero, [(self.i, &run + &slope), (l, -&run), (j, -slope)], &run)
    }

    fn in_facet(&self, j: u32, k: u32, l: u32, m: &Values) -> bool {
        let (jv, kv) = (self.values(j), self.values(k));
        let one: Values = [1, 1, 1].map(BigInt::from);
        let (dl, dj, dk) = (det(&one, &jv, &kv), det(m, &one, &kv), det(m, &jv, &one));
        positive(det(m, &jv, &kv), [(self.i, &dl + &dj + &dk), (l, -&dl), (j, -dj), (k, -dk)], &dl)
    }

    /// Barycentric coordinates of the vertex between polygon edges `before` and `after`, each right
    /// to a few roundings; `None` for a mesh vertex, or for two that meet nowhere.
    pub(super) fn place(&self, before: u32, after: u32) -> Option<[f64; 3]> {
        let (edge, j) = match (facet_edge(before), facet_edge(after)) {
            (None, None) => return self.place_in_facet(before, after),
            (Some(edge), None) => (edge, after),
            (None, Some(edge)) => (edge, before),
            (Some(_), Some(_)) => return None,
        };
        let (a, b) = (edge, (edge + 1) % 3);
        let jv = self.values(j);
        let run = (&jv[a] - &jv[b]).to_f64()?;
        let mut bary = [0.0; 3];
        bary[a] = -jv[b].to_f64()? / run;
        bary[b] = jv[a].to_f64()? / run;
        bary.iter().all(|x| x.is_finite()).then_some(bary)
    }

    fn place_in_facet(&self, j: u32, k: u32) -> Option<[f64; 3]> {
        let (jv, kv) = (self.values(j), self.values(k));
        let cross: Values = [(1, 2), (2, 0), (0, 1)].map(|(p, q): (usize, usize)| &jv[p] * &kv[q] - &jv[q] * &kv[p]);
        let sum = cross.iter().sum::<BigInt>().to_f64()?;
        let [x, y, z] = cross;
        let bary = [x.to_f64()? / sum, y.to_f64()? / sum, z.to_f64()? / sum];
        bary.iter().all(|x| x.is_finite()).then_some(bary)
    }

    /// L_l at the three corners, in units of the grid squared.
    fn values(&self, l: u32) -> Values {
        let grid = |p: P| {
            let coordinates = p.coordinates();
            P::each(|c| (coordinates.as_ref()[c] * GRID) as i128)
        };
        let (xi, xl) = (grid(self.seeds[self.i as usize]), grid(self.seeds[l as usize]));
        self.surface.facets()[self.facet as usize].map(|v| {
            let p = grid(self.surface.positions()[v as usize]);
            // |p - x_l|² - |p - x_i|² = (x_i - x_l) · (2p - x_i - x_l)
            let each = xi.as_ref().iter().zip(xl.as_ref()).zip(p.as_ref());
            each.map(|((xi, xl), p)| BigInt::from(xi - xl) * BigInt::from(2 * p - xi - xl)).sum()
        })
    }
}

fn det(a: &Values, b: &Values, c: &Values) -> BigInt {
    let minor = |p: usize, q: usize| &b[p] * &c[q] - &b[q] * &c[p];
    &a[0] * minor(1, 2) + &a[1] * minor(2, 0) + &a[2] * minor(0, 1)
}

/// Whether `value` / `scale` is positive; if it is zero, the weight of the lowest seed index with a coefficient decides.
fn positive<const N: usize>(value: BigInt, mut weights: [(u32, BigInt); N], scale: &BigInt) -> bool {
    weights.sort_by_key(|w| w.0);
    let sign = std::iter::once(value.sign())
        .chain(weights.iter().map(|w| w.1.sign()))
        .find(|&s| s != Sign::NoSign)
        .unwrap_or(Sign::Plus);
    sign * scale.sign() == Sign::Plus
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriMesh;
    use crate::rvd::cells::FACET_EDGE;
    use glam::{DVec3, dvec3};

    fn surface() -> Surface {
        let corners = vec![dvec3(-0.5, -0.5, 0.), dvec3(0.5, -0.5, 0.), dvec3(0., 0.5, 0.)];
        Surface::new(&TriMesh::new(corners, vec![[0, 1, 2]]).unwrap(), None).unwrap()
    }

    #[test]
    fn four_cocircular_seeds_are_split_in_one_way() {
        let surface = surface();
        let mut seeds = [dvec3(0.125, 0., 0.), dvec3(0., 0.125, 0.), dvec3(-0.125, 0., 0.), dvec3(0., -0.125, 0.)];
        for turn in 0..4 {
            // The centre belongs to two triangles; every cell around either must agree that the
            // fourth seed is outside. One diagonal is chosen: exactly two of the four triples stand.
            let stands = |t: [u32; 3]| {
                let fourth = (0..4).find(|l| !t.contains(l)).unwrap();
                let votes: Vec<bool> = (0..3)
                    .map(|k| {
                        let sides = Sides { surface: &surface, facet: 0, seeds: &seeds, i: t[k] };
                        sides.inside(t[(k + 1) % 3], t[(k + 2) % 3], fourth)
                    })
                    .collect();
                assert!(votes.iter().all(|&v| v == votes[0]), "turn {turn}: {votes:?}");
                votes[0]
            };
            let triples = [[0, 1, 2], [1, 2, 3], [2, 3, 0], [3, 0, 1]];
            let standing: Vec<_> = triples.into_iter().filter(|&t| stands(t)).collect();
            assert_eq!(standing.len(), 2, "turn {turn}: {standing:?}");
            seeds.rotate_left(1);
        }
    }

    #[test]
    fn ties_go_to_the_lower_index() {
        let surface = surface();
        // The apex (0, 1/2) and the middle of the base are equally far from both.
        let seeds = [dvec3(0.25, 0., 0.), dvec3(-0.25, 0., 0.)];
        for (i, l) in [(0, 1), (1, 0)] {
            let sides = Sides { surface: &surface, facet: 0, seeds: &seeds, i };
            assert_eq!(sides.inside(FACET_EDGE - 1, FACET_EDGE - 2, l), i < l);
        }
    }

    #[test]
    fn agrees_with_plain_arithmetic_where_that_is_sure() {
        let surface = surface();
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            super::super::surface::snap(DVec3::splat((state >> 33) as f64 / (1u64 << 31) as f64 - 0.5)).x
        };
        let corners = [0, 1, 2].map(|v| surface.positions()[v]);
        for _ in 0..300 {
            let seeds: Vec<DVec3> = (0..4).map(|_| dvec3(random(), random(), random())).collect();
            let value = |l: usize, p: DVec3| p.distance_squared(seeds[l]) - p.distance_squared(seeds[0]);
            let sides = Sides { surface: &surface, facet: 0, seeds: &seeds, i: 0 };
            let rows = [1, 2].map(|l| DVec3::from_array(corners.map(|p| value(l, p))));
            let bary = rows[0].cross(rows[1]);
            let p = (corners[0] * bary.x + corners[1] * bary.y + corners[2] * bary.z) / bary.element_sum();
            let d = value(3, p);
            if d.is_finite() && d.abs() > 1e-6 && p.length() < 100.0 {
                assert_eq!(sides.inside(1, 2, 3), d > 0.0);
            }
            let t = value(1, corners[1]) / (value(1, corners[1]) - value(1, corners[2]));
            let d = value(3, corners[1] + t * (corners[2] - corners[1]));
            if d.is_finite() && d.abs() > 1e-6 && t.abs() < 100.0 {
                assert_eq!(sides.inside(FACET_EDGE - 1, 1, 3), d > 0.0);
            }
        }
    }
}
