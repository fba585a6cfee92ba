//! Random points of a surface.
//!
//! Purpose: points with a density ∝ √w: [`sample`], independent ones, for distances and as the seeds that benches begin at,
//! and [`spread`], the first seeds of a remesh.
//! Invariant: the same mesh, weights, count and seed give the same bits on every platform and with any number of threads
//! (ChaCha8, one stream; of the floating-point functions only those that IEEE 754 rounds correctly).
//! Must not know: the use of the points.

mod spread;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::TriMesh;
use super::closest_point::SurfacePoint;
pub use spread::spread;

/// `count` random points on `mesh`, ∝ area times √weight (linear in each facet), from `seed`.
///
/// `weights` has one value a vertex; without it, or if its length is another or no value is
/// positive, points are uniform. Values that are negative or not finite count as 0.
///
/// The density is exact within a facet as well: a facet is drawn ∝ area times the root of its largest
/// weight, a point uniformly in it, and the pair is kept with probability √(w / largest), which is at
/// least 8/15 on average.
pub fn sample(mesh: &TriMesh, weights: Option<&[f64]>, count: usize, seed: u64) -> Vec<SurfacePoint> {
    let Some(masses) = Masses::weighted_or_not(mesh, weights) else { return Vec::new() };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| masses.draw(&mut rng)).collect()
}

/// Share of each facet in the points.
struct Masses<'a> {
    mesh: &'a TriMesh,
    weights: Option<Vec<f64>>,
    /// Running sums of area times the root of the largest weight. Empty facets repeat a value.
    cumulative: Vec<f64>,
    total: f64,
    /// The last facet that is not empty.
    last: usize,
}

impl<'a> Masses<'a> {
    /// Without weights if these are not valid. `None` if no facet has a mass.
    fn weighted_or_not(mesh: &'a TriMesh, weights: Option<&[f64]>) -> Option<Self> {
        weights.and_then(|given| Self::new(mesh, Some(given))).or_else(|| Self::new(mesh, None))
    }

    /// `None` if no facet has a mass.
    fn new(mesh: &'a TriMesh, weights: Option<&[f64]>) -> Option<Self> {
        if weights.is_some_and(|given| given.len() != mesh.positions().len()) {
            return None;
        }
        let valid = |w: f64| if w.is_finite() && w > 0.0 { w } else { 0.0 };
        // Only ratios matter; scaled to at most 1 they cannot overflow. Unused vertices do not count.
        let used =
            |given: &[f64]| mesh.facets().iter().flatten().map(|&v| valid(given[v as usize])).fold(0.0, f64::max);
        let largest = weights.map_or(1.0, used);
        let weights: Option<Vec<f64>> = weights.map(|given| given.iter().map(|&w| valid(w) / largest).collect());
        let (low, high) = mesh.bounds();
        let extent = (high - low).max_element();
        let mut total = 0.0;
        let mut last = None;
        let mut cumulative = Vec::with_capacity(mesh.facets().len());
        for facet in 0..mesh.facets().len() {
            let [a, b, c] = mesh.corners(facet).map(|p| (p - low) / extent);
            let area = if mesh.is_degenerate(facet) { 0.0 } else { (b - a).cross(c - a).length() };
            let of_corners = |w: &Vec<f64>| mesh.facets()[facet].iter().map(|&v| w[v as usize]).fold(0.0, f64::max);
            let top = weights.as_ref().map_or(1.0, of_corners);
            let before = total;
            total += area * top.sqrt();
            if total > before {
                last = Some(facet);
            }
            cumulative.push(total);
        }
        last.map(|last| Self { mesh, weights, cumulative, total, last })
    }

    /// Weights of a facet's corners, the largest of the mesh 1.
    fn weights(&self, facet: usize) -> Option<[f64; 3]> {
        self.weights.as_ref().map(|weights| self.mesh.facets()[facet].map(|v| weights[v as usize]))
    }

    /// Area of a facet times the root of its largest weight.
    fn most(&self, facet: usize) -> f64 {
        self.cumulative[facet] - if facet > 0 { self.cumulative[facet - 1] } else { 0.0 }
    }

    fn draw(&self, rng: &mut ChaCha8Rng) -> SurfacePoint {
        loop {
            let target = uniform(rng) * self.total;
            let facet = self.cumulative.partition_point(|&sum| sum <= target).min(self.last);
            let [u, v, w] = in_triangle(rng);
            if let Some([wa, wb, wc]) = self.weights(facet) {
                let density = u * wa + v * wb + w * wc;
                let chance = uniform(rng);
                // chance < √(density / top), without a division.
                if chance * chance * wa.max(wb).max(wc) >= density {
                    continue;
                }
            }
            return self.point(facet, [u, v, w]);
        }
    }

    fn point(&self, facet: usize, barycentric: [f64; 3]) -> SurfacePoint {
        let [a, b, c] = self.mesh.corners(facet);
        let position = a + (b - a) * barycentric[1] + (c - a) * barycentric[2];
        SurfacePoint { position, facet: facet as u32, barycentric }
    }
}

/// Barycentric coordinates of a random point of a triangle, uniform.
fn in_triangle(rng: &mut ChaCha8Rng) -> [f64; 3] {
    let (mut v, mut w) = (uniform(rng), uniform(rng));
    if v + w > 1.0 {
        (v, w) = (1.0 - v, 1.0 - w);
    }
    [(1.0 - v - w).max(0.0), v, w]
}

/// Uniform in [0, 1), 53 bits.
fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}
