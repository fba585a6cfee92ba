//! Target edge lengths: bounds, gradation, the count they imply, weights.
//!
//! Purpose: [`SizeField`], one length per mesh vertex, taken as linear in each facet.
//! Invariant: every length is finite and above 0; coincident vertices have the same one.
//! Must not know: where the lengths come from.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::DensityError;
use super::net::Net;
use super::outline::POINTS_PER_AREA;
use crate::token::{Stopped, Token};

/// Target edge length at each vertex of a mesh, caller's units.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SizeField {
    pub(super) sizes: Vec<f64>,
}

impl SizeField {
    /// Takes one length per vertex. Coincident ones get the smallest of theirs; one that no facet uses gets the median.
    pub(crate) fn new(net: &Net, sizes: Vec<f64>) -> Result<Self, DensityError> {
        let vertices = net.vertices();
        if sizes.len() != vertices {
            return Err(DensityError::SizeCount { given: sizes.len(), vertices });
        }
        if let Some(vertex) = sizes.iter().position(|&h| !(h.is_finite() && h > 0.0)) {
            return Err(DensityError::BadSize { vertex, value: sizes[vertex] });
        }
        let mut field = Self { sizes };
        for v in 0..vertices {
            let lowest = net.class[v] as usize;
            field.sizes[lowest] = field.sizes[lowest].min(field.sizes[v]);
        }
        let median = field.median(net);
        net.spread(&mut field.sizes, median);
        Ok(field)
    }

    pub(crate) fn median(&self, net: &Net) -> f64 {
        net.median(&self.sizes)
    }

    /// Weights ∝ h⁻⁴, the largest 1, for lengths that are known to be right.
    pub(super) fn weights_of(sizes: &[f64]) -> Vec<f64> {
        let least = sizes.iter().copied().fold(f64::INFINITY, f64::min);
        sizes.iter().map(|&h| (least / h).powi(4)).collect()
    }

    pub(crate) fn into_sizes(self) -> Vec<f64> {
        self.sizes
    }

    pub(crate) fn least(&self) -> f64 {
        self.sizes.iter().copied().fold(f64::INFINITY, f64::min)
    }

    pub(crate) fn largest(&self) -> f64 {
        self.sizes.iter().copied().fold(0.0, f64::max)
    }

    /// How many points these lengths imply, not rounded: n = ∫ (2/√3)/h² + ½ ∫_boundary 1/h + χ, as a vertex
    /// owns a hexagon of area (√3/2) h², one on the boundary half of it. See [`super::Outline`].
    pub(crate) fn points(&self, net: &Net) -> f64 {
        let h = |v: u32| self.sizes[v as usize] / net.outline.extent;
        let cells: f64 = net.facets.iter().map(|&(v, area)| area * mean_inverse_square(v.map(h))).sum();
        let rim = net.boundary.iter().map(|&[a, b]| {
            let length = (net.points[a as usize] - net.points[b as usize]).length();
            length * mean_inverse(h(a), h(b))
        });
        net.outline.count(POINTS_PER_AREA * cells, rim.sum())
    }

    pub(super) fn scaled(&self, factor: f64) -> Self {
        Self { sizes: self.sizes.iter().map(|h| (h * factor).clamp(f64::MIN_POSITIVE, f64::MAX)).collect() }
    }

    /// Every length becomes `median` (h / `median`)^`power`.
    pub(super) fn flatten(&mut self, median: f64, power: f64) {
        if power != 1.0 {
            self.sizes.iter_mut().for_each(|h| *h = median * (*h / median).powf(power));
        }
    }

    /// Bounds every length by `low` and `high`; says how many were outside.
    pub(super) fn clamp(&mut self, low: f64, high: f64) -> usize {
        let outside = self.sizes.iter().filter(|&&h| h < low || h > high).count();
        self.sizes.iter_mut().for_each(|h| *h = h.max(low).min(high));
        outside
    }

    /// Raises every length to its `least` one; says how many were below. Coincident vertices have the same one.
    pub(super) fn raise(&mut self, least: impl Fn(usize) -> f64) -> usize {
        let mut below = 0;
        for (v, h) in self.sizes.iter_mut().enumerate() {
            let least = least(v);
            if *h < least {
                (*h, below) = (least, below + 1);
            }
        }
        below
    }

    /// Takes other lengths where there are any, by vertex, within these factors of the present ones.
    pub(super) fn put(&mut self, others: &[f64], [low, high]: [f64; 2]) {
        for (h, &other) in self.sizes.iter_mut().zip(others).filter(|(_, other)| other.is_finite()) {
            *h = other.clamp(low * *h, high * *h);
        }
    }

    /// Lowers lengths until h(p) <= h(q) + `slope` |p - q| along every edge of the mesh, from the smallest
    /// to the largest, each vertex settled once (Dijkstra's order). Says how many were lowered.
    ///
    /// The result is the largest field below this one that keeps the bound, whatever the order of equals.
    pub(crate) fn grade(&mut self, net: &Net, slope: f64, token: &Token) -> Result<usize, Stopped> {
        if slope == f64::INFINITY {
            return Ok(0);
        }
        let before = self.sizes.clone();
        let slope = slope * net.outline.extent;
        // Positive floats are ordered as their bits are.
        let mut queue: BinaryHeap<Reverse<(u64, u32)>> =
            (0..net.vertices()).filter(|&v| net.class[v] == v as u32).map(|v| entry(self.sizes[v], v)).collect();
        let mut looked_at = 0;
        while let Some(Reverse((bits, v))) = queue.pop() {
            looked_at += 1;
            token.check_at(looked_at)?;
            let (h, v) = (f64::from_bits(bits), v as usize);
            if h > self.sizes[v] {
                continue;
            }
            for &(to, length) in net.neighbours(v) {
                let (to, bound) = (to as usize, h + slope * length);
                if bound < self.sizes[to] {
                    self.sizes[to] = bound;
                    queue.push(entry(bound, to));
                }
            }
        }
        for v in 0..self.sizes.len() {
            self.sizes[v] = self.sizes[net.class[v] as usize].min(self.sizes[v]);
        }
        Ok(before.iter().zip(&self.sizes).filter(|(before, after)| after < before).count())
    }

    /// The share of the area whose lengths are noise: vertices of a length below or above those of all neighbours that
    /// changes, in the mean of their edges, by more than `slope` per distance. No triangles have such edges.
    pub(super) fn noise(&self, net: &Net, slope: f64) -> f64 {
        let slope = slope * net.outline.extent;
        let is_noise = |v: usize| {
            let around = net.neighbours(v);
            let higher = around.iter().filter(|end| self.sizes[end.0 as usize] > self.sizes[v]).count();
            let lower = around.iter().filter(|end| self.sizes[end.0 as usize] < self.sizes[v]).count();
            let change: f64 = around.iter().map(|end| (self.sizes[end.0 as usize] - self.sizes[v]).abs()).sum();
            let distance: f64 = around.iter().map(|end| end.1).sum();
            higher.max(lower) == around.len() && change > slope * distance
        };
        let all: f64 = net.area.iter().sum();
        let noise: f64 = (0..net.vertices()).filter(|&v| net.area[v] > 0.0 && is_noise(v)).map(|v| net.area[v]).sum();
        if all > 0.0 { noise / all } else { 0.0 }
    }

    /// Evens lengths out between neighbours, once. Points per area flow, so that there are as many as before: what an edge
    /// cannot follow is averaged, and nothing else is changed much.
    pub(super) fn smooth(&mut self, net: &Net) {
        // Points per area beside those of the shortest length, so that no units overflow.
        let least = self.least();
        let of = |h: &f64| (least / h).powi(2).max(f64::MIN_POSITIVE);
        let density: Vec<f64> = self.sizes.iter().map(of).collect();
        // Half of what a vertex has goes out at most, in equal parts.
        let share = |v: usize| 0.5 * net.area[v] / net.neighbours(v).len().max(1) as f64;
        for v in (0..net.vertices()).filter(|&v| net.area[v] > 0.0) {
            let flow = |&(to, _): &(u32, f64)| share(v).min(share(to as usize)) * (density[to as usize] - density[v]);
            let flow: f64 = net.neighbours(v).iter().map(flow).sum();
            self.sizes[v] = least / (density[v] + flow / net.area[v]).sqrt();
        }
        for v in 0..self.sizes.len() {
            self.sizes[v] = self.sizes[net.class[v] as usize];
        }
    }
}

fn entry(size: f64, vertex: usize) -> Reverse<(u64, u32)> {
    Reverse((size.to_bits(), vertex as u32))
}

/// Mean of 1/h over a segment on which h is linear: ln(b/a)/(b - a).
fn mean_inverse(a: f64, b: f64) -> f64 {
    let (a, b) = (a.min(b), a.max(b));
    let x = (b - a) / a;
    (if x > 0.0 { x.ln_1p() / x } else { 1.0 }) / a
}

/// Mean of 1/h² over a triangle on which h is linear: twice the second divided difference of -ln h (Hermite and
/// Genocchi); where the values are too close for a difference, a rule of degree 2 in their place.
fn mean_inverse_square(mut h: [f64; 3]) -> f64 {
    h.sort_unstable_by(f64::total_cmp);
    let [a, b, c] = h;
    if c < 1.1 * a {
        let at = |u: f64, v: f64, w: f64| (u * a + v * b + w * c).powi(-2);
        let (near, far) = (2.0 / 3.0, 1.0 / 6.0);
        return (at(near, far, far) + at(far, near, far) + at(far, far, near)) / 3.0;
    }
    2.0 * (mean_inverse(a, b) - mean_inverse(b, c)) / (c - a)
}

#[cfg(test)]
mod tests {
    use super::super::Outline;
    use super::*;
    use crate::mesh::TriMesh;
    use crate::mesh::shapes::Shape;
    use glam::DVec3;

    #[test]
    fn means_over_facets_and_edges_are_the_integrals() {
        for h in [[1.0, 1.0, 1.0], [1.0, 1.05, 1.02], [1.0, 1.101, 1.0], [3.0, 1.0, 20.0], [1e-60, 2e-60, 2e-60]] {
            let (n, mut sum) = (400, 0.0);
            for i in 0..n {
                for j in 0..n - i {
                    for (shift, there) in [(1.0 / 3.0, true), (2.0 / 3.0, i + j + 1 < n)] {
                        let (u, v) = ((i as f64 + shift) / n as f64, (j as f64 + shift) / n as f64);
                        let value = h[0] + u * (h[1] - h[0]) + v * (h[2] - h[0]);
                        sum += if there { value.powi(-2) } else { 0.0 };
                    }
                }
            }
            let want = sum / (n * n) as f64;
            // The midpoint sum is off by the second derivative over n², below 1e-4 for 1 : 20.
            let got = mean_inverse_square(h);
            assert!((got / want - 1.0).abs() < 1e-4, "{h:?}: {got} for {want}");
        }
        assert!((mean_inverse(1.0, 20.0) - 20f64.ln() / 19.0).abs() < 1e-15);
        assert_eq!(mean_inverse(2.0, 2.0), 0.5);
    }

    #[test]
    fn a_constant_field_counts_as_its_length() {
        for shape in [Shape::Sphere, Shape::Torus, Shape::Plane, Shape::Sheets, Shape::Genus(3)] {
            let mesh = shape.build(2000);
            let (net, outline) =
                (Net::new(&mesh, &Token::default()).unwrap(), Outline::new(&mesh, &Token::default()).unwrap());
            let h = 0.05;
            let field = SizeField::new(&net, vec![h; mesh.positions().len()]).unwrap();
            let points = field.points(&net);
            assert!((points / outline.points(h) - 1.0).abs() < 1e-9, "{shape}: {points}");
            assert!((outline.edge_length(points) / h - 1.0).abs() < 1e-9, "{shape}");
            assert!(SizeField::weights_of(&field.sizes).iter().all(|&w| w == 1.0));
        }
    }

    #[test]
    fn the_slope_is_bounded_on_every_edge_and_nothing_is_lowered_in_vain() {
        for shape in Shape::ALL {
            let mesh = shape.build(1500);
            let net = Net::new(&mesh, &Token::default()).unwrap();
            let wild = |v: usize| 1e-3 * (1 + v * 7919 % 101) as f64;
            let given: Vec<f64> = (0..mesh.positions().len()).map(wild).collect();
            let mut field = SizeField::new(&net, given.clone()).unwrap();
            let lowered = field.grade(&net, 0.3, &Token::default()).unwrap();
            assert!(lowered > 0 || shape == Shape::Square, "{shape}");
            let h = &field.sizes;
            for v in 0..h.len() {
                assert!(h[v] <= given[v]);
                let mut reason = h[v] == given[v];
                for &(to, length) in net.neighbours(v) {
                    let bound = h[v] + 0.3 * length * net.outline.extent;
                    assert!(h[to as usize] <= bound * (1.0 + 1e-12), "{shape}: {v} to {to}");
                    reason |= h[v] == h[to as usize] + 0.3 * net.outline.extent * length;
                }
                assert!(reason, "{shape}: vertex {v} was lowered without a reason");
            }
        }
    }

    #[test]
    fn noise_is_evened_out_and_nothing_else() {
        for shape in [Shape::Sphere, Shape::Torus, Shape::Plane] {
            let mesh = shape.build(4000);
            let net = Net::new(&mesh, &Token::default()).unwrap();
            let field = |of: &dyn Fn(usize, DVec3) -> f64| {
                let lengths = mesh.positions().iter().enumerate().map(|(v, &p)| 0.02 * of(v, p));
                SizeField::new(&net, lengths.collect()).unwrap()
            };
            // A jump, a steep slope and a spike may be wanted.
            let jump = field(&|_, p| if p.x > 0.45 { 100.0 } else { 1.0 });
            let steep = field(&|_, p| 1.0 + 150.0 * (p.x - 0.3).abs());
            let spike = field(&|v, _| if v == 7 { 0.01 } else { 1.0 });
            for (name, field) in [("jump", jump), ("slope", steep), ("spike", spike)] {
                // Up to a fiftieth is no noise (`NOISE`); the bottom of a slope is a line of such places.
                assert!(field.noise(&net, 1.0) < 0.02, "{shape}, {name}: {}", field.noise(&net, 1.0));
            }
            let wild = |v: usize, _| 100f64.powf((v * 7919 % 101) as f64 / 101.0);
            let mut noise = field(&wild);
            assert!(noise.noise(&net, 1.0) > 0.1, "{shape}: {}", noise.noise(&net, 1.0));
            let points = |f: &SizeField| (0..net.vertices()).map(|v| net.area[v] / f.sizes[v].powi(2)).sum::<f64>();
            let before = points(&noise);
            (0..4).for_each(|_| noise.smooth(&net));
            assert!((points(&noise) / before - 1.0).abs() < 1e-9, "{shape}");
            assert!(noise.noise(&net, 1.0) < 0.02, "{shape}: {}", noise.noise(&net, 1.0));
            let mut even = field(&|_, _| 1.0);
            even.smooth(&net);
            assert!(even.sizes.iter().all(|h| (h / 0.02 - 1.0).abs() < 1e-12), "{shape}");
        }
    }

    #[test]
    fn seams_have_one_length_and_bad_ones_are_named() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X, DVec3::Y, DVec3::ONE, DVec3::splat(1e300)];
        let mesh = TriMesh::new(square.to_vec(), vec![[0, 1, 2], [3, 5, 4]]).unwrap();
        let net = Net::new(&mesh, &Token::default()).unwrap();
        let field = SizeField::new(&net, vec![1.0, 2.0, 3.0, 4.0, 0.5, 6.0, 1e-9]).unwrap();
        assert_eq!(field.sizes[..6], [1.0, 2.0, 0.5, 2.0, 0.5, 6.0]);
        assert_eq!(field.sizes[6], field.median(&net), "no facet uses it");
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut sizes = vec![1.0; 7];
            sizes[3] = bad;
            assert!(matches!(SizeField::new(&net, sizes), Err(DensityError::BadSize { vertex: 3, .. })));
        }
        let short = SizeField::new(&net, vec![1.0; 6]);
        assert!(matches!(short, Err(DensityError::SizeCount { given: 6, vertices: 7 })));
    }
}
