//! Symmetric tensors of a metric.
//!
//! Purpose: [`Tensor`] measures lengths: a vector e has the length √(eᵀ M e). Logarithm and exponential are for means of tensors:
//! the exponential of a mean of logarithms is a metric again (Arsigny, Fillard, Pennec and Ayache 2006).
//! Invariant: the six numbers are m11, m12, m22, m13, m23, m33, as Medit writes them. Must not know: surfaces, files.

use glam::DVec3;

/// A symmetric matrix: m11, m12, m22, m13, m23, m33.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tensor(pub [f64; 6]);

/// Sweeps of Jacobi's method. Three or four are enough for double precision.
const MAX_SWEEPS: usize = 12;

impl Tensor {
    /// Numbers of one tensor.
    pub const NUMBERS: usize = 6;

    /// The same length in every direction.
    pub fn of_length(length: f64) -> Self {
        Self::diagonal([(length * length).recip(); 3])
    }

    fn diagonal([x, y, z]: [f64; 3]) -> Self {
        Self([x, 0.0, y, 0.0, 0.0, z])
    }

    /// The tensor with these edge lengths along three orthonormal axes.
    pub fn of_lengths(axes: [DVec3; 3], lengths: [f64; 3]) -> Self {
        Self::of_eigen(axes, lengths.map(|h| (h * h).recip()))
    }

    fn of_eigen(axes: [DVec3; 3], values: [f64; 3]) -> Self {
        axes.iter().zip(values).fold(Self::default(), |sum, (a, value)| {
            sum + Self([a.x * a.x, a.x * a.y, a.y * a.y, a.x * a.z, a.y * a.z, a.z * a.z]) * value
        })
    }

    /// The product M e.
    fn times(&self, e: DVec3) -> DVec3 {
        let [xx, xy, yy, xz, yz, zz] = self.0;
        DVec3::new(xx * e.x + xy * e.y + xz * e.z, xy * e.x + yy * e.y + yz * e.z, xz * e.x + yz * e.y + zz * e.z)
    }

    /// The product eᵀ M f.
    pub fn product(&self, e: DVec3, f: DVec3) -> f64 {
        e.dot(self.times(f))
    }

    /// The length √(eᵀ M e).
    pub fn length(&self, e: DVec3) -> f64 {
        self.product(e, e).max(0.0).sqrt()
    }

    /// Area of the parallelogram of two vectors, in the metric.
    pub fn parallelogram(&self, e: DVec3, f: DVec3) -> f64 {
        let (ee, ef, ff) = (self.product(e, e), self.product(e, f), self.product(f, f));
        (ee * ff - ef * ef).max(0.0).sqrt()
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.0.iter().all(|m| m.is_finite())
    }

    /// Eigenvalues, and the unit vectors of their directions, by Jacobi's rotations.
    pub fn eigen(&self) -> ([f64; 3], [DVec3; 3]) {
        let [xx, xy, yy, xz, yz, zz] = self.0;
        let mut m = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        let mut axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for _ in 0..MAX_SWEEPS {
            let mut turned = false;
            for (p, q) in [(0, 1), (0, 2), (1, 2)] {
                let off = m[p][q];
                // Small beside both, it changes neither.
                if off.abs() <= f64::EPSILON * 0.01 * m[p][p].abs().sqrt() * m[q][q].abs().sqrt() {
                    continue;
                }
                turned = true;
                let theta = (m[q][q] - m[p][p]) / (2.0 * off);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let t = if theta == 0.0 { 1.0 } else { t };
                let c = (t * t + 1.0).sqrt().recip();
                let s = t * c;
                let r = 3 - p - q;
                let (mrp, mrq) = (m[r][p], m[r][q]);
                m[p][p] -= t * off;
                m[q][q] += t * off;
                (m[p][q], m[q][p]) = (0.0, 0.0);
                m[r][p] = c * mrp - s * mrq;
                m[p][r] = m[r][p];
                m[r][q] = s * mrp + c * mrq;
                m[q][r] = m[r][q];
                for axis in &mut axes {
                    let (ap, aq) = (axis[p], axis[q]);
                    axis[p] = c * ap - s * aq;
                    axis[q] = s * ap + c * aq;
                }
            }
            if !turned {
                break;
            }
        }
        let column = |k: usize| DVec3::new(axes[0][k], axes[1][k], axes[2][k]);
        ([m[0][0], m[1][1], m[2][2]], [column(0), column(1), column(2)])
    }

    /// The least eigenvalue, if the tensor is not positive definite.
    pub fn not_positive(&self) -> Option<f64> {
        /// Less than this share of the largest one is the rounding of six numbers.
        const ROUNDING: f64 = 1e-14;
        let (values, _) = self.eigen();
        let [least, most] = [f64::min, f64::max].map(|of| values.into_iter().reduce(of).unwrap_or(f64::NAN));
        // A NaN is not positive.
        let positive = values.iter().all(|value| value.is_finite()) && least > ROUNDING * most;
        (!positive).then_some(least)
    }

    /// The logarithm of a positive definite tensor.
    pub fn ln(&self) -> Self {
        let (values, axes) = self.eigen();
        Self::of_eigen(axes, values.map(|value| value.max(f64::MIN_POSITIVE).ln()))
    }

    /// The tensor of which this is the logarithm.
    pub fn exp(&self) -> Self {
        let (values, axes) = self.eigen();
        Self::of_eigen(axes, values.map(f64::exp))
    }

    /// With a number added to each eigenvalue.
    pub fn shifted(&self, by: f64) -> Self {
        *self + Self::diagonal([by; 3])
    }
}

impl std::ops::Add for Tensor {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] + other.0[k]))
    }
}

impl std::ops::Mul<f64> for Tensor {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self(self.0.map(|m| m * factor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes(k: u32) -> [DVec3; 3] {
        let turn = |by: f64| (by * f64::from(k)).sin();
        let x = DVec3::new(turn(1.3), turn(2.1), turn(0.7) + 0.1).normalize();
        let (y, z) = x.any_orthonormal_pair();
        [x, y, z]
    }

    #[test]
    fn a_unit_vector_along_an_axis_has_the_inverse_of_its_length() {
        for k in 0..200 {
            // The numbers of a tensor have 16 digits of the largest: squares of lengths at most 10^8 apart leave eight.
            let (axes, lengths) = (axes(k), [0.1f64.powi(k as i32 % 4), 3.0, 0.25]);
            let tensor = Tensor::of_lengths(axes, lengths);
            for (axis, length) in axes.into_iter().zip(lengths) {
                assert!((tensor.length(axis * length) - 1.0).abs() < 1e-6, "{k}");
            }
            let area = tensor.parallelogram(axes[1] * 3.0, axes[2] * 0.25);
            assert!((area - 1.0).abs() < 1e-6, "{k}: {area}");
        }
    }

    /// Eigenvalues far apart, equal ones, and directions that are axes of the coordinates.
    #[test]
    fn the_exponential_undoes_the_logarithm() {
        let near = |a: Tensor, b: Tensor| {
            let scale = a.0.iter().fold(0.0f64, |most, m| most.max(m.abs()));
            a.0.iter().zip(b.0).all(|(a, b)| (a - b).abs() <= 1e-11 * scale)
        };
        for k in 0..200 {
            for ratio in [1.0, 20.0, 1e4] {
                let tensor = Tensor::of_lengths(axes(k), [1.0, ratio, f64::from(k + 1).sqrt()]);
                assert!(near(tensor, tensor.ln().exp()), "{k}, {ratio}: {:?} {:?}", tensor, tensor.ln().exp());
                // A number added to the logarithm is a factor.
                assert!(near(tensor * 4.0, tensor.ln().shifted(4f64.ln()).exp()), "{k}, {ratio}");
            }
        }
        assert_eq!(Tensor::of_length(0.5), Tensor::diagonal([4.0; 3]));
        assert_eq!(Tensor::of_length(1.0).ln(), Tensor::default());
    }

    #[test]
    fn a_tensor_that_is_no_metric_is_known() {
        let positive = Tensor::of_lengths(axes(3), [1.0, 20.0, 0.5]);
        assert!(positive.not_positive().is_none());
        for bad in [
            Tensor::default(),
            positive * -1.0,
            Tensor([1.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
            Tensor([1.0, 2.0, 1.0, 0.0, 0.0, 1.0]),
        ] {
            assert!(bad.not_positive().is_some(), "{bad:?}");
        }
        assert!(!Tensor([f64::NAN, 0.0, 1.0, 0.0, 0.0, 1.0]).is_finite());
    }
}
