//! Finer facets where the density changes fast, or is high.
//!
//! Purpose: the diagram takes weights as linear in a facet, and h⁻⁴ between two lengths that differ by a factor
//! of two is far from that. [`refine`] halves edges until lengths change little along each; and such as are long beside the
//! cells there, since a facet costs by the pairs of cells that meet at it. A needle is cut across, not into thinner ones.
//! Invariant: the same surface, without T-junctions: an edge is halved by what its two ends are, so all its
//! facets, and coincident edges of a seam, agree. The first vertices are the mesh's. Must not know: weights.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use super::net::Net;
use crate::mesh::adjacency::weld;
use crate::mesh::edges::undirected;
use crate::mesh::{TriMesh, duplicates};
use crate::token::{Pace, Stopped, Token};

/// Lengths at the ends of an edge may differ by this factor: half-way, linear w is then 1.32 times that of
/// linear h, 7 % in edge length, and less elsewhere. With 1.6 nefertiti by curvature has a twentieth more facets instead of
/// a fifth, and lengths come out as well, but its mean quality falls from .870 to .866 and rocker-arm's least from .61 to .51.
const STEP: f64 = 1.4;
/// An edge shorter than this many target lengths is not halved: within a cell only the mean density counts.
const SHORT: f64 = 0.5;
/// A longer edge, in target lengths, is halved: nefertiti by curvature has 6 % more facets and takes a seventh less time.
const LONG: f64 = 3.0;
/// In a uniform density they are where facets with such an edge are more than this share of the area: a Lloyd step of a cube of
/// 12 facets with 10,000 points then takes an eighth. Where they are few there is little to be had: steps of nefertiti with
/// 50,000 points take 14 ms instead of 18, but what comes after them has more facets to look at, and the whole takes 2.35 s instead of
/// 2.54. Results are as near to the input either way (.088 and .086 % of the diagonal, over 24 seeds).
const MOSTLY: f64 = 0.5;
/// Each round halves the edges that need it; a ratio of a thousand is spent after a dozen.
const ROUNDS: usize = 40;
/// Halvings of one edge, one within the other.
const DEPTH: usize = 60;

/// A finer mesh and a value a vertex, if any facet was divided.
type Finer = Result<Option<(TriMesh, Vec<f64>)>, Stopped>;

/// Splits facets of `mesh` in which `sizes` (caller's units, one a vertex) change too fast for weights that are
/// linear in a facet, or that are long beside them; nothing if there is none. Stops before there are more than `most` facets.
pub(super) fn refine(mesh: &TriMesh, net: &Net, sizes: &[f64], most: usize, token: &Token) -> Finer {
    let mut draft = Draft::new(mesh, net.low, net.outline.extent, sizes, token);
    // What is wanted for the sake of time comes last, so that it takes nothing from what the density needs.
    let steep = draft.split_all(Draft::is_steep, most)?;
    let long = draft.split_long(most)?;
    Ok(if steep || long { draft.mesh().map(|mesh| (mesh, draft.sizes)) } else { None })
}

/// Splits facets of `mesh` that are long beside `sizes` and nothing else; `values`, one a vertex if there are any, stay
/// linear. Nothing unless these are most of the area, or if facets lie on one another, and as [`refine`] otherwise.
pub(super) fn shorten(mesh: &TriMesh, sizes: &[f64], values: &[f64], most: usize, token: &Token) -> Finer {
    let (low, high) = mesh.bounds();
    let mut draft = Draft::new(mesh, low, (high - low).max_element(), sizes, token);
    draft.values = values.to_vec();
    // Facets on one another would have the edges between their parts in common too: two sides would become one.
    if draft.is_mostly_long(mesh) && !duplicates::any(mesh) && draft.split_long(most)? {
        return Ok(draft.mesh().map(|mesh| (mesh, draft.values)));
    }
    Ok(None)
}

/// A finer mesh and two values a vertex, if any facet was divided.
type Resolved = Result<Option<(TriMesh, [Vec<f64>; 2])>, Stopped>;

/// Splits facets of `mesh` until edges that `is_wanted` names, by the places of their ends, are halved. Values, one a vertex where there
/// are any, stay linear. Nothing if there is none.
pub(super) fn resolve(
    mesh: &TriMesh,
    [values, others]: &[Vec<f64>; 2],
    is_wanted: impl Fn(DVec3, DVec3) -> bool,
    most: usize,
    token: &Token,
) -> Resolved {
    let (low, high) = mesh.bounds();
    let mut draft = Draft::new(mesh, low, (high - low).max_element(), values, token);
    draft.values = others.clone();
    let is_wanted = |draft: &Draft, a: usize, b: usize| is_wanted(draft.positions[a], draft.positions[b]);
    let any = draft.split_all(is_wanted, most)?;
    Ok(if any { draft.mesh().map(|mesh| (mesh, [draft.sizes, draft.values])) } else { None })
}

struct Draft {
    positions: Vec<DVec3>,
    /// Positions in the box of side 1.
    units: Vec<DVec3>,
    sizes: Vec<f64>,
    /// What else is linear in each facet, or nothing.
    values: Vec<f64>,
    facets: Vec<[u32; 3]>,
    extent: f64,
    /// More vertices than these are of no use.
    most_vertices: usize,
    token: Token,
    pace: Pace,
}

impl Draft {
    /// With the corner of the mesh's box, and the longest side of that.
    fn new(mesh: &TriMesh, low: DVec3, extent: f64, sizes: &[f64], token: &Token) -> Self {
        Self {
            positions: mesh.positions().to_vec(),
            units: mesh.positions().iter().map(|&p| (p - low) / extent).collect(),
            sizes: sizes.to_vec(),
            values: Vec::new(),
            facets: mesh.facets().to_vec(),
            extent,
            most_vertices: usize::MAX,
            token: token.clone(),
            pace: Pace::default(),
        }
    }

    fn mesh(&mut self) -> Option<TriMesh> {
        TriMesh::new(std::mem::take(&mut self.positions), std::mem::take(&mut self.facets)).ok()
    }

    /// Halves edges that `is_wanted` names until none is left or facets would be over `most`. Returns whether any was.
    fn split_all(&mut self, is_wanted: impl Fn(&Self, usize, usize) -> bool, most: usize) -> Result<bool, Stopped> {
        for round in 0..ROUNDS {
            self.token.check()?;
            let halved = self.halved(&is_wanted)?;
            if halved.is_empty() || self.facets.len() + 3 * halved.len() > most {
                return Ok(round > 0);
            }
            self.split(&halved)?;
        }
        Ok(true)
    }

    /// In order, each once.
    fn halved(&self, is_wanted: impl Fn(&Self, usize, usize) -> bool) -> Result<Vec<[u32; 2]>, Stopped> {
        let mut found = Vec::new();
        for (f, v) in self.facets.iter().enumerate() {
            self.token.check_at(f)?;
            for e in 0..3 {
                let (a, b) = (v[e].min(v[(e + 1) % 3]), v[e].max(v[(e + 1) % 3]));
                if is_wanted(self, a as usize, b as usize) {
                    found.push([a, b]);
                }
            }
        }
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }

    fn is_steep(&self, a: usize, b: usize) -> bool {
        let (low, high) = (self.sizes[a].min(self.sizes[b]), self.sizes[a].max(self.sizes[b]));
        high > STEP * low && (self.units[a] - self.units[b]).length() * self.extent > SHORT * low
    }

    fn is_long(&self, a: usize, b: usize) -> bool {
        (self.units[a] - self.units[b]).length() * self.extent > LONG * self.sizes[a].min(self.sizes[b])
    }

    /// Whether facets with a long edge are most of the area.
    fn is_mostly_long(&self, mesh: &TriMesh) -> bool {
        let (mut long, mut all) = (0.0, 0.0);
        for t in mesh.facets() {
            let [a, b, c] = t.map(|v| v as usize);
            let area = (self.units[b] - self.units[a]).cross(self.units[c] - self.units[a]).length();
            all += area;
            long += if self.is_long(a, b) || self.is_long(b, c) || self.is_long(c, a) { area } else { 0.0 };
        }
        long > MOSTLY * all
    }

    fn split(&mut self, halved: &[[u32; 2]]) -> Result<(), Stopped> {
        let first = self.positions.len() as u32;
        halved.iter().for_each(|&ends| _ = self.add_middle(ends));
        let middle = |a: u32, b: u32| halved.binary_search(&[a.min(b), a.max(b)]).ok().map(|i| first + i as u32);
        let mut facets = Vec::with_capacity(self.facets.len() + 2 * halved.len());
        for (f, &[a, b, c]) in self.facets.iter().enumerate() {
            self.token.check_at(f)?;
            match [middle(a, b), middle(b, c), middle(c, a)] {
                [None, None, None] => facets.push([a, b, c]),
                [Some(m), None, None] => facets.extend([[a, m, c], [m, b, c]]),
                [None, Some(m), None] => facets.extend([[b, m, a], [m, c, a]]),
                [None, None, Some(m)] => facets.extend([[c, m, b], [m, a, b]]),
                [Some(m), Some(n), None] => self.two([a, m, b, n, c], &mut facets),
                [None, Some(m), Some(n)] => self.two([b, m, c, n, a], &mut facets),
                [Some(n), None, Some(m)] => self.two([c, m, a, n, b], &mut facets),
                [Some(m), Some(n), Some(k)] => facets.extend([[a, m, k], [m, b, n], [k, n, c], [m, n, k]]),
            }
        }
        self.facets = facets;
        Ok(())
    }

    /// Puts a vertex into the middle of an edge.
    fn add_middle(&mut self, ends: [u32; 2]) -> u32 {
        let [a, b] = ends.map(|v| v as usize);
        // Halves first, and the same sum whichever end is named first: seams stay closed.
        self.positions.push(self.positions[a] * 0.5 + self.positions[b] * 0.5);
        self.units.push(self.units[a] * 0.5 + self.units[b] * 0.5);
        self.sizes.push(self.sizes[a] * 0.5 + self.sizes[b] * 0.5);
        if !self.values.is_empty() {
            self.values.push(self.values[a] * 0.5 + self.values[b] * 0.5);
        }
        self.positions.len() as u32 - 1
    }

    /// Halves edges until none is long. Returns whether any was; nothing changes if there would be more than `most` facets.
    fn split_long(&mut self, most: usize) -> Result<bool, Stopped> {
        let vertices = self.positions.len();
        // Each new vertex is a corner of a facet that is new too. With more vertices than facets are allowed the division
        // fails, so that an edge of any length is done with by then.
        self.most_vertices = vertices.saturating_add(most);
        let mut done = Vec::with_capacity(self.facets.len());
        let mut middles = HashMap::new();
        let mut open = Vec::new();
        for f in 0..self.facets.len() {
            open.push(self.facets[f]);
            while let Some(facet) = open.pop() {
                self.token.check_after(1, &mut self.pace)?;
                let turned = |k: usize| [0, 1, 2].map(|i| facet[(i + k) % 3]);
                let is_long = [0, 1, 2].map(|e| self.is_long(facet[e] as usize, facet[(e + 1) % 3] as usize));
                match is_long {
                    [false, false, false] => done.push(facet),
                    [true, true, true] => {
                        let [a, b, c] = facet;
                        let [m, n, k] = [[a, b], [b, c], [c, a]].map(|ends| self.middle(ends, &mut middles));
                        open.extend([[a, m, k], [m, b, n], [k, n, c], [m, n, k]]);
                    }
                    [true, false, false] => self.halve(turned(0), &mut middles, &mut open),
                    [false, true, false] => self.halve(turned(1), &mut middles, &mut open),
                    [false, false, true] => self.halve(turned(2), &mut middles, &mut open),
                    // Beginning at the tip between the two long ones.
                    [true, false, true] => self.cut(turned(0), &mut middles, &mut open),
                    [true, true, false] => self.cut(turned(1), &mut middles, &mut open),
                    [false, true, true] => self.cut(turned(2), &mut middles, &mut open),
                }
                if done.len() + open.len() > most || self.positions.len() > self.most_vertices {
                    self.positions.truncate(vertices);
                    self.units.truncate(vertices);
                    self.sizes.truncate(vertices);
                    self.values.truncate(vertices);
                    return Ok(false);
                }
            }
        }
        self.facets = done;
        Ok(self.positions.len() > vertices)
    }

    /// The vertex in the middle of an edge, made where there was none.
    fn middle(&mut self, [a, b]: [u32; 2], middles: &mut HashMap<[u32; 2], u32>) -> u32 {
        let ends = [a.min(b), a.max(b)];
        *middles.entry(ends).or_insert_with(|| self.add_middle(ends))
    }

    /// A facet of which the first edge is long.
    fn halve(&mut self, [a, b, c]: [u32; 3], middles: &mut HashMap<[u32; 2], u32>, open: &mut Vec<[u32; 3]>) {
        let m = self.middle([a, b], middles);
        open.extend([[a, m, c], [m, b, c]]);
    }

    /// A facet of which the edges that meet at `a` are long and the other one is not: across, as often as they are halved.
    /// Halving it as a whole would make three of it each time, as slender as it was.
    fn cut(&mut self, [a, b, c]: [u32; 3], middles: &mut HashMap<[u32; 2], u32>, open: &mut Vec<[u32; 3]>) {
        let (mut left, mut right) = (vec![a], vec![a]);
        self.halve_edge([a, b], middles, &mut left);
        self.halve_edge([a, c], middles, &mut right);
        let apart = |p: u32, q: u32| self.units[p as usize].distance_squared(self.units[q as usize]);
        let (mut i, mut j) = (1, 1);
        open.push([a, left[1], right[1]]);
        while i + 1 < left.len() || j + 1 < right.len() {
            let down_left = left.get(i + 1).map_or(f64::INFINITY, |&p| apart(p, right[j]));
            let down_right = right.get(j + 1).map_or(f64::INFINITY, |&q| apart(left[i], q));
            if down_left <= down_right {
                open.push([left[i], left[i + 1], right[j]]);
                i += 1;
            } else {
                open.push([left[i], right[j + 1], right[j]]);
                j += 1;
            }
        }
    }

    /// Appends the vertices of an edge after its first, halved until no part is long.
    fn halve_edge(&mut self, [a, b]: [u32; 2], middles: &mut HashMap<[u32; 2], u32>, out: &mut Vec<u32>) {
        let mut ends = vec![b];
        let mut from = a;
        while let Some(&to) = ends.last() {
            // An edge without length is not halved, nor is one after a stop.
            let is_stopped = self.token.is_stopped_after(1, &mut self.pace) || self.token.is_told_to_stop();
            let has_room = ends.len() < DEPTH && self.positions.len() <= self.most_vertices;
            if !is_stopped && has_room && self.is_long(from as usize, to as usize) {
                ends.push(self.middle([from, to], middles));
            } else {
                out.push(to);
                from = to;
                ends.pop();
            }
        }
    }

    /// Facet a b c with m between a and b and n between b and c; the shorter diagonal of the rest.
    fn two(&self, [a, m, b, n, c]: [u32; 5], out: &mut Vec<[u32; 3]>) {
        let length = |p: u32, q: u32| (self.units[p as usize] - self.units[q as usize]).length_squared();
        out.push([m, b, n]);
        if length(a, n) <= length(m, c) {
            out.extend([[a, m, n], [a, n, c]]);
        } else {
            out.extend([[a, m, c], [m, n, c]]);
        }
    }
}

/// The edges of a finer mesh that make up `edges` of the mesh it was made of.
pub(super) fn divided(mesh: &TriMesh, edges: &[[u32; 2]], token: &Token) -> Result<Vec<[u32; 2]>, Stopped> {
    if edges.is_empty() {
        return Ok(Vec::new());
    }
    let class = weld(mesh);
    let key = |p: DVec3| p.to_array().map(|x| (x + 0.0).to_bits());
    let there: HashSet<[u32; 2]> = mesh
        .facets()
        .iter()
        .map(|t| t.map(|v| class[v as usize]))
        .flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]].map(undirected))
        .collect();
    let at: HashMap<[u64; 3], u32> = mesh.positions().iter().zip(&class).map(|(&p, &v)| (key(p), v)).collect();
    let mut stack: Vec<[u32; 2]> = edges.iter().rev().map(|e| e.map(|v| class[v as usize])).collect();
    let mut found = Vec::new();
    while let Some([a, b]) = stack.pop() {
        token.check_at(found.len())?;
        let middle = mesh.positions()[a as usize] * 0.5 + mesh.positions()[b as usize] * 0.5;
        match at.get(&key(middle)) {
            Some(&m) if !there.contains(&undirected([a, b])) && m != a && m != b => stack.extend([[m, b], [a, m]]),
            _ => found.push([a, b]),
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::measure::topology;
    use crate::mesh::shapes::Shape;

    #[test]
    fn the_surface_stays_and_steps_become_small() {
        for shape in [Shape::Square, Shape::Plane, Shape::Torus, Shape::Sheets, Shape::Slivers] {
            let mesh = shape.build(200);
            let net = Net::new(&mesh, &Token::default()).unwrap();
            let (low, high) = mesh.bounds();
            let size = |p: DVec3| 0.01 * (1.0 + 19.0 * (p.x - low.x) / (high.x - low.x));
            let sizes: Vec<f64> = mesh.positions().iter().map(|&p| size(p)).collect();
            let (fine, fine_sizes) = refine(&mesh, &net, &sizes, 1_000_000, &Token::default()).unwrap().unwrap();
            assert_eq!(fine.positions()[..mesh.positions().len()], mesh.positions()[..]);
            assert!((fine.area() / mesh.area() - 1.0).abs() < 1e-12, "{shape}");
            assert_eq!(topology(&fine).euler, topology(&mesh).euler, "{shape}");
            assert_eq!(topology(&fine).boundary_loops, topology(&mesh).boundary_loops, "{shape}");
            for (p, h) in fine.positions().iter().zip(&fine_sizes) {
                assert!((h / size(*p) - 1.0).abs() < 1e-9, "{shape}: linear stays linear");
            }
            for v in fine.facets().iter().map(|f| f.map(|v| v as usize)) {
                for (a, b) in [(v[0], v[1]), (v[1], v[2]), (v[2], v[0])] {
                    let (least, most) = (fine_sizes[a].min(fine_sizes[b]), fine_sizes[a].max(fine_sizes[b]));
                    let short = fine.positions()[a].distance(fine.positions()[b]) <= 0.5 * least * (1.0 + 1e-12);
                    assert!(short || most <= 1.4 * least, "{shape}");
                }
            }
        }
    }

    #[test]
    fn a_seam_stays_closed_and_a_budget_is_kept() {
        let points = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X, DVec3::Y, DVec3::new(1.0, 1.0, 0.0)];
        let mesh = TriMesh::new(points.to_vec(), vec![[0, 1, 2], [3, 5, 4]]).unwrap();
        let net = Net::new(&mesh, &Token::default()).unwrap();
        let sizes = vec![0.4, 0.01, 0.3, 0.01, 0.3, 0.4];
        let (fine, _) = refine(&mesh, &net, &sizes, 100_000, &Token::default()).unwrap().unwrap();
        let after = topology(&fine);
        assert_eq!((after.euler, after.boundary_loops, after.components), (1, 1, 1));
        let (some, _) = refine(&mesh, &net, &sizes, 30, &Token::default()).unwrap().unwrap();
        assert!(some.facets().len() <= 30);
        assert!(refine(&mesh, &net, &[1.0; 6], 100_000, &Token::default()).unwrap().is_none());
    }

    #[test]
    fn long_edges_become_short_and_values_stay_linear() {
        for shape in [Shape::Block, Shape::Torus, Shape::Genus(1)] {
            let mesh = shape.build(12);
            let value = |p: DVec3| 1.0 + p.x - 2.0 * p.y + 0.5 * p.z;
            let values: Vec<f64> = mesh.positions().iter().map(|&p| value(p)).collect();
            let sizes = vec![0.01; values.len()];
            let (fine, fine_values) = shorten(&mesh, &sizes, &values, 1_000_000, &Token::default()).unwrap().unwrap();
            assert_eq!(fine.positions()[..mesh.positions().len()], mesh.positions()[..]);
            assert!((fine.area() / mesh.area() - 1.0).abs() < 1e-12, "{shape}");
            assert_eq!(topology(&fine).euler, topology(&mesh).euler, "{shape}");
            let linear = fine.positions().iter().zip(&fine_values).all(|(p, v)| (v - value(*p)).abs() < 1e-9);
            assert!(linear, "{shape}");
            let corners = (0..fine.facets().len()).map(|f| fine.corners(f));
            let longest =
                corners.flat_map(|[a, b, c]| [a.distance(b), b.distance(c), c.distance(a)]).fold(0.0, f64::max);
            assert!(longest <= LONG * 0.01 * (1.0 + 1e-12), "{shape}: {longest}");
            assert!(
                shorten(&mesh, &vec![100.0; values.len()], &values, 1_000_000, &Token::default()).unwrap().is_none()
            );
        }
    }

    /// A slender facet becomes as many pieces as it has lengths, and its neighbours have the same vertices.
    #[test]
    fn needles_are_cut_across() {
        let at = DVec3::new;
        let points =
            vec![at(0.0, 0.0, 0.0), at(100.0, 0.0, 0.0), at(100.0, 0.3, 0.0), at(0.0, 0.3, 0.0), at(50.0, -30.0, 0.0)];
        let mesh = TriMesh::new(points, vec![[0, 1, 2], [0, 2, 3], [1, 0, 4]]).unwrap();
        let (fine, _) = shorten(&mesh, &[0.3; 5], &[], 1_000_000, &Token::default()).unwrap().unwrap();
        let (before, after) = (topology(&mesh), topology(&fine));
        assert_eq!((after.euler, after.boundary_loops), (before.euler, before.boundary_loops));
        assert!((fine.area() / mesh.area() - 1.0).abs() < 1e-12);
        let needles = |f: &usize| fine.corners(*f).iter().all(|p| p.y >= 0.0);
        let count = (0..fine.facets().len()).filter(needles).count();
        // 128 parts of each long edge, .78 long; two needles of them.
        assert_eq!(count, 2 * (2 * 128 - 1));
        let corners = (0..fine.facets().len()).map(|f| fine.corners(f));
        let longest = corners.flat_map(|[a, b, c]| [a.distance(b), b.distance(c), c.distance(a)]).fold(0.0, f64::max);
        assert!(longest <= LONG * 0.3, "{longest}");
        let (whole, sizes) = (
            shorten(&mesh, &[0.3; 5], &[], 300, &Token::default()).unwrap(),
            shorten(&mesh, &[1e-300, 1.0, 1.0, 1.0, 1.0], &[], 10_000, &Token::default()).unwrap(),
        );
        assert!(whole.is_none() && sizes.is_none_or(|(mesh, _)| mesh.facets().len() <= 10_000));
    }

    #[test]
    fn two_sides_of_one_facet_stay_apart() {
        let at = DVec3::new;
        let points = vec![DVec3::ZERO, DVec3::X, DVec3::Y, at(1.0, 1.0, 0.0), DVec3::ZERO, DVec3::X, DVec3::Y];
        // Back to back, of the same vertices or of others in their places.
        for back in [[0, 2, 1], [4, 6, 5]] {
            let mesh = TriMesh::new(points.clone(), vec![[0, 1, 2], back, [1, 3, 2]]).unwrap();
            assert!(shorten(&mesh, &[0.1; 7], &[], 100_000, &Token::default()).unwrap().is_none());
            let two = TriMesh::new(points.clone(), vec![[0, 1, 2], back]).unwrap();
            assert!(
                duplicates::any(&two) && shorten(&two, &[0.1; 7], &[], 100_000, &Token::default()).unwrap().is_none()
            );
        }
    }
}
