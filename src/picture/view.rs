//! Where a surface is seen from: an orthographic camera that frames it.
//!
//! Purpose: caller's coordinates to pixels and depth. Invariant: the points that were framed lie in the picture, whatever their
//! size and place; depth has the unit of width and height, and grows away from the viewer. Must not know: what is drawn.

use glam::{DMat3, DVec3, dvec3};

use super::{PictureError, Size};

/// Share of the picture's width and height that stays free on each side.
const MARGIN: f64 = 0.03;

/// A direction to look in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewDirection {
    /// From the surface to the viewer, any length.
    pub toward: DVec3,
    /// What is up in the picture, any length. Where it runs along `toward`, another axis is.
    pub up: DVec3,
}

impl Default for ViewDirection {
    /// From the front, the right and a little above; y is up.
    fn default() -> Self {
        Self { toward: dvec3(0.7, 0.5, 1.0), up: DVec3::Y }
    }
}

impl ViewDirection {
    /// Rows: right, up, toward the viewer.
    fn frame(&self) -> Result<DMat3, PictureError> {
        let (toward, up) = (direction(self.toward)?, direction(self.up)?);
        let axes = [up, DVec3::Z, DVec3::X, DVec3::Y];
        // Of two unit axes at right angles at least one is 45° or more off any direction.
        let right = axes.into_iter().map(|axis| axis.cross(toward)).find(|right| right.length() > 1e-6);
        let right = right.unwrap_or(DVec3::X).normalize();
        Ok(DMat3::from_cols(right, toward.cross(right), toward).transpose())
    }
}

/// Unit vector, also of a tiny or huge one.
fn direction(v: DVec3) -> Result<DVec3, PictureError> {
    let unit = (v / v.abs().max_element()).normalize_or_zero();
    if unit.is_finite() && unit != DVec3::ZERO { Ok(unit) } else { Err(PictureError::Direction(v)) }
}

/// A camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    size: Size,
    frame: DMat3,
    /// Middle of the framed points, and the longest half side of the box around them.
    centre: DVec3,
    half: f64,
    /// Pixels per `half`.
    scale: f64,
    /// What of the turned and scaled points is the middle of the picture.
    middle: DVec3,
}

impl View {
    /// The view in which `points` (caller's units; those that are not finite do not count) fill the picture.
    pub fn framing(
        look: &ViewDirection,
        size: Size,
        points: impl IntoIterator<Item = DVec3, IntoIter: Clone>,
    ) -> Result<Self, PictureError> {
        let frame = look.frame()?;
        let points = points.into_iter().filter(|p| p.is_finite());
        let bounds = |points: &mut dyn Iterator<Item = DVec3>| {
            let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
            let (low, high) = points.fold(none, |(low, high), p| (low.min(p), high.max(p)));
            if low.x <= high.x { (low, high) } else { (DVec3::ZERO, DVec3::ZERO) }
        };
        let (low, high) = bounds(&mut points.clone());
        // Halves, so that a box as wide as the numbers go does not overflow.
        let (centre, half) = (0.5 * low + 0.5 * high, (0.5 * high - 0.5 * low).max_element());
        let half = if half > 0.0 { half } else { 1.0 };
        let mut view = Self { size, frame, centre, half, scale: 1.0, middle: DVec3::ZERO };
        let (low, high) = bounds(&mut points.map(|p| view.turned(p)));
        view.middle = 0.5 * (low + high);
        let room = (1.0 - 2.0 * MARGIN) * dvec3(f64::from(size.width), f64::from(size.height), f64::INFINITY);
        let scale = (room / (high - low)).min_element();
        view.scale = if scale.is_finite() { scale } else { f64::from(size.width.min(size.height)) };
        Ok(view)
    }

    /// Width and height of the picture.
    pub fn size(&self) -> Size {
        self.size
    }

    /// Where `p` is in the picture: pixels from the left and the top edge, and depth in pixels away from the viewer.
    /// Not finite where `p` is not, or is beyond the range of double precision from the framed points.
    pub fn place(&self, p: DVec3) -> DVec3 {
        let q = (self.turned(p) - self.middle) * self.scale;
        dvec3(0.5 * f64::from(self.size.width) + q.x, 0.5 * f64::from(self.size.height) - q.y, -q.z)
    }

    /// `p` in the framed box, turned to right, up and toward the viewer.
    pub(super) fn turned(&self, p: DVec3) -> DVec3 {
        self.frame * ((p - self.centre) / self.half)
    }

    /// A direction, turned in the same way.
    pub(super) fn turned_direction(&self, v: DVec3) -> DVec3 {
        self.frame * v
    }
}
