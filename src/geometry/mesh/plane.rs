//! Planes that a surface is mirrored at.
//!
//! Purpose: [`Plane`] is a plane with a side: it measures distances and reflects places. Invariant: a reflection at a plane across an axis
//! changes that one coordinate alone. Must not know: surfaces, what is mirrored.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;

/// A plane, and the side that its normal points to. As text: `x`, `-y`, `z=0.5` (across an axis at this coordinate, `-` for the side with
/// the smaller ones), or `NX,NY,NZ,D`, the places p with n·p = D.
///
/// ```
/// use tessera::mesh::plane::{Plane, PlaneError};
/// let plane: Plane = "x=0.5".parse()?;
/// assert_eq!(plane.reflect([2.0, 1.0, 0.0].into()), [-1.0, 1.0, 0.0].into());
/// assert_eq!("0,0,-2,1".parse::<Plane>()?.to_string(), "-z=-0.5");
/// assert!("0,0,0,1".parse::<Plane>().is_err());
/// # Ok::<(), PlaneError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Of length 1.
    normal: DVec3,
    /// How far along the normal, caller's units.
    offset: f64,
}

/// A text is no plane.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{text:?} is no plane: give x, y or z, -x for its other side, x=C for the coordinate C, or NX,NY,NZ,D with a normal that is not 0"
)]
pub struct PlaneError {
    /// The beginning of the text.
    pub text: String,
}

/// The names of the axes.
const AXES: [&str; 3] = ["x", "y", "z"];
/// The most characters of a text that an error shows.
const MOST_SHOWN: usize = 80;

impl Plane {
    /// The plane of the places p with `normal`·p = `offset`. `None` if the normal has no direction or a number is not finite.
    pub fn new(normal: DVec3, offset: f64) -> Option<Self> {
        // A unit normal that was written and read stays as it is.
        if (normal.length_squared() - 1.0).abs() <= 4.0 * f64::EPSILON && offset.is_finite() {
            return Some(Self { normal: normal + DVec3::ZERO, offset });
        }
        // In two steps, so that nothing overflows.
        let largest = normal.abs().max_element();
        let length = largest * (normal / largest).length();
        let plane = Self { normal: (normal / largest).normalize(), offset: offset / length };
        // 0 for -0, so that planes across axes are known by their bits.
        let plane = Self { normal: plane.normal + DVec3::ZERO, ..plane };
        (plane.normal.is_finite() && plane.offset.is_finite()).then_some(plane)
    }

    /// The unit normal. It points to the side that is remeshed.
    pub fn normal(&self) -> DVec3 {
        self.normal
    }

    /// The axis that the plane is across, if it is across one.
    fn axis(&self) -> Option<usize> {
        (0..3).find(|&axis| self.normal.abs() == DVec3::AXES[axis])
    }

    /// How far a place is from the plane, below 0 on the side behind it.
    pub fn height(&self, p: DVec3) -> f64 {
        self.normal.dot(p) - self.offset
    }

    /// The place of the plane that is nearest to `p`.
    pub fn project(&self, p: DVec3) -> DVec3 {
        match self.axis() {
            Some(axis) => {
                let mut place = p;
                place[axis] = self.normal[axis] * self.offset;
                place
            }
            None => p - self.height(p) * self.normal,
        }
    }

    /// The mirror image of a place.
    pub fn reflect(&self, p: DVec3) -> DVec3 {
        match self.axis() {
            Some(axis) => {
                let mut place = p;
                place[axis] = 2.0 * (self.normal[axis] * self.offset) - p[axis];
                place
            }
            None => p - 2.0 * self.height(p) * self.normal,
        }
    }
}

impl FromStr for Plane {
    type Err = PlaneError;

    fn from_str(text: &str) -> Result<Self, PlaneError> {
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
        let across = || {
            let (name, at) = text.split_once('=').unwrap_or((text, "0"));
            let (name, sign) = name.trim().strip_prefix('-').map_or((name.trim(), 1.0), |name| (name, -1.0));
            let axis = AXES.iter().position(|axis| *axis == name)?;
            Self::new(sign * DVec3::AXES[axis], sign * number(at)?)
        };
        let by_numbers = || {
            let all: Vec<f64> = text.split(',').map(number).collect::<Option<_>>()?;
            let [x, y, z, offset] = all.try_into().ok()?;
            Self::new(DVec3::new(x, y, z), offset)
        };
        across().or_else(by_numbers).ok_or_else(|| PlaneError { text: text.chars().take(MOST_SHOWN).collect() })
    }
}

impl fmt::Display for Plane {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { normal: n, offset } = self;
        match self.axis() {
            Some(axis) => {
                let sign = if n[axis] < 0.0 { "-" } else { "" };
                // 0 for -0.
                write!(f, "{sign}{}={}", AXES[axis], n[axis] * offset + 0.0)
            }
            None => write!(f, "{},{},{},{offset}", n.x, n.y, n.z),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn texts_are_read_and_written() {
        for (text, written) in [
            ("x", "x=0"),
            ("-y", "-y=0"),
            ("z=-0.5", "z=-0.5"),
            (" -x = 3 ", "-x=3"),
            ("0,2,0,3", "y=1.5"),
            ("0,-1e300,0,0", "-y=0"),
            ("3,0,4,10", "0.6000000000000001,0,0.8,2"),
        ] {
            let plane: Plane = text.parse().unwrap();
            assert_eq!(plane.to_string(), written, "{text}");
            assert_eq!(written.parse::<Plane>().unwrap(), plane, "{text}");
        }
        for k in 1..100 {
            let plane = Plane::new(DVec3::new(f64::from(k), f64::from(k * k % 7), -2.5), 0.3).unwrap();
            assert_eq!(plane.to_string().parse::<Plane>().unwrap(), plane);
        }
        for text in ["", "w", "x=", "x=nan", "x=inf", "0,0,0,1", "1,2,3", "1,2,3,4,5", "1,0,0,nan", "--x"] {
            assert!(text.parse::<Plane>().is_err(), "{text}");
        }
    }

    #[test]
    fn reflections_change_one_coordinate_across_an_axis_and_keep_distances() {
        let p = DVec3::new(0.1, 0.7, -0.3);
        let across: Plane = "-y=0.25".parse().unwrap();
        assert_eq!(across.reflect(p), DVec3::new(0.1, 0.5 - 0.7, -0.3));
        assert_eq!(across.project(p), DVec3::new(0.1, 0.25, -0.3));
        assert!(across.height(p) < 0.0);
        let plane: Plane = "1,2,-3,0.5".parse().unwrap();
        assert!((plane.height(plane.reflect(p)) + plane.height(p)).abs() < 1e-15);
        assert!(plane.height(plane.project(p)).abs() < 1e-15);
        assert!(plane.reflect(plane.reflect(p)).distance(p) < 1e-15);
    }
}
