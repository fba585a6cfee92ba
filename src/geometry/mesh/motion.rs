//! Rigid motions between boundaries of a periodic surface.
//!
//! Purpose: [`Motion`] is a translation or a rotation: it moves places, forth and back. Invariant: a quarter turn around an axis of the
//! coordinates is exact. Must not know: surfaces, what is periodic.

use std::fmt;
use std::str::FromStr;

use glam::{DMat3, DVec3};

/// A translation or a rotation. As text: `translate:DX,DY,DZ`, or `rotate:DEGREES,DX,DY,DZ` around the direction `DX,DY,DZ` through the
/// origin, or through the place that three further numbers give; `x`, `y` and `z` stand for the axes.
///
/// ```
/// use tessera::mesh::motion::{Motion, MotionError};
/// let turn: Motion = "rotate:90,z".parse()?;
/// assert_eq!(turn.apply([2.0, 0.0, 1.0].into()), [0.0, 2.0, 1.0].into());
/// assert_eq!("translate:1,0,0".parse::<Motion>()?.apply([0.5, 2.0, 0.0].into()), [1.5, 2.0, 0.0].into());
/// assert!("translate:0,0,0".parse::<Motion>().is_err());
/// # Ok::<(), MotionError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// By a vector that is not 0, caller's units.
    Translation(DVec3),
    /// Around an axis.
    Rotation {
        /// The angle, degrees, no multiple of 360.
        degrees: f64,
        /// The direction of the axis, not 0. The rotation is counter-clockwise as seen from where it points to.
        axis: DVec3,
        /// A place of the axis, caller's coordinates.
        centre: DVec3,
    },
}

/// A text is no motion.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{text:?} is no motion: give translate:DX,DY,DZ that is not 0, or rotate:DEGREES,AXIS with an angle that is no full turn; AXIS is x, y, \
     z, DX,DY,DZ, or DX,DY,DZ,PX,PY,PZ for an axis through a place"
)]
pub struct MotionError {
    /// The beginning of the text.
    pub text: String,
}

/// The most characters of a text that an error shows.
const MOST_SHOWN: usize = 80;

impl Motion {
    /// Where a place goes.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        match *self {
            Self::Translation(by) => p + by,
            Self::Rotation { centre, .. } => centre + self.turn() * (p - centre),
        }
    }

    /// Where a place comes from.
    pub fn undo(&self, p: DVec3) -> DVec3 {
        match *self {
            Self::Translation(by) => p - by,
            Self::Rotation { centre, .. } => centre + self.turn().transpose() * (p - centre),
        }
    }

    /// What the motion does to directions.
    pub fn turn(&self) -> DMat3 {
        let Self::Rotation { degrees, axis, .. } = *self else { return DMat3::IDENTITY };
        // Quarter turns are exact.
        let (sin, cos) = match degrees.rem_euclid(360.0) {
            90.0 => (1.0, 0.0),
            180.0 => (0.0, -1.0),
            270.0 => (-1.0, 0.0),
            degrees => degrees.to_radians().sin_cos(),
        };
        let k = axis / axis.abs().max_element();
        let k = k.normalize();
        // Rodrigues.
        let column = |e: DVec3| cos * e + sin * k.cross(e) + (1.0 - cos) * k.dot(e) * k;
        DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z))
    }

    /// Whether all numbers are finite and the motion moves something.
    fn is_motion(&self) -> bool {
        match *self {
            Self::Translation(by) => by.is_finite() && by != DVec3::ZERO,
            Self::Rotation { degrees, axis, centre } => {
                let turns = degrees.is_finite() && degrees.rem_euclid(360.0) != 0.0;
                turns && axis.is_finite() && axis != DVec3::ZERO && centre.is_finite()
            }
        }
    }
}

impl FromStr for Motion {
    type Err = MotionError;

    fn from_str(text: &str) -> Result<Self, MotionError> {
        let number = |text: &str| text.trim().parse::<f64>().ok();
        let numbers = |list: &str| list.split(',').map(number).collect::<Option<Vec<f64>>>();
        let read = || match text.trim().split_once(':')? {
            ("translate", list) => match numbers(list)?[..] {
                [x, y, z] => Some(Self::Translation(DVec3::new(x, y, z))),
                _ => None,
            },
            ("rotate", list) => {
                let (degrees, axis) = list.split_once(',')?;
                let degrees = number(degrees)?;
                let around = |axis, centre| Self::Rotation { degrees, axis, centre };
                match axis.trim() {
                    "x" => Some(around(DVec3::X, DVec3::ZERO)),
                    "y" => Some(around(DVec3::Y, DVec3::ZERO)),
                    "z" => Some(around(DVec3::Z, DVec3::ZERO)),
                    axis => match numbers(axis)?[..] {
                        [x, y, z] => Some(around(DVec3::new(x, y, z), DVec3::ZERO)),
                        [x, y, z, px, py, pz] => Some(around(DVec3::new(x, y, z), DVec3::new(px, py, pz))),
                        _ => None,
                    },
                }
            }
            _ => None,
        };
        let read = read().filter(Self::is_motion);
        read.ok_or_else(|| MotionError { text: text.chars().take(MOST_SHOWN).collect() })
    }
}

impl fmt::Display for Motion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Translation(by) => write!(f, "translate:{},{},{}", by.x, by.y, by.z),
            Self::Rotation { degrees, axis, centre } => {
                write!(f, "rotate:{degrees},{},{},{}", axis.x, axis.y, axis.z)?;
                match centre == DVec3::ZERO {
                    true => Ok(()),
                    false => write!(f, ",{},{},{}", centre.x, centre.y, centre.z),
                }
            }
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
            ("translate:1,-2,0.5", "translate:1,-2,0.5"),
            ("rotate:60,z", "rotate:60,0,0,1"),
            ("rotate: -30 , 1,2,3", "rotate:-30,1,2,3"),
            ("rotate:60,0,0,1,5,6,7", "rotate:60,0,0,1,5,6,7"),
        ] {
            let motion: Motion = text.parse().unwrap();
            assert_eq!(motion.to_string(), written, "{text}");
            assert_eq!(written.parse::<Motion>().unwrap(), motion, "{text}");
        }
        let wrong =
            ["", "x", "translate:", "translate:0,0,0", "translate:1,2", "translate:1,2,nan", "rotate:60", "move:1,0,0"];
        for text in wrong.into_iter().chain([
            "rotate:0,z",
            "rotate:360,z",
            "rotate:60,0,0,0",
            "rotate:60,1,2,3,4",
            "rotate:nan,x",
        ]) {
            assert!(text.parse::<Motion>().is_err(), "{text}");
        }
    }

    #[test]
    fn motions_keep_distances_and_come_back() {
        let (p, q) = (DVec3::new(0.3, -1.2, 2.0), DVec3::new(1.5, 0.25, -0.75));
        for text in ["translate:3,1,-4", "rotate:37,1,2,3,0.5,0.25,4", "rotate:-90,x", "rotate:180,1,1,0"] {
            let motion: Motion = text.parse().unwrap();
            let (a, b) = (motion.apply(p), motion.apply(q));
            assert!((a.distance(b) - p.distance(q)).abs() < 1e-14, "{text}");
            assert!(motion.undo(a).distance(p) < 1e-14, "{text}");
            assert!((motion.turn() * (q - p)).distance(b - a) < 1e-14, "{text}");
        }
        let quarter: Motion = "rotate:270,y".parse().unwrap();
        assert_eq!(quarter.apply(DVec3::new(0.1, 0.2, 0.3)), DVec3::new(-0.3, 0.2, 0.1));
    }
}
