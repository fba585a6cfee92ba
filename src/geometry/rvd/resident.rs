//! Seeds that move where they are kept.
//!
//! Purpose: [`Resident`] is what an optimiser needs of a session whose seeds, gradient and
//! quasi-Newton history never leave the device: it says what to do and hears scalars.
//! Invariant: the present point changes by [`Resident::to_centroids`], [`Resident::relax`] and [`Resident::accept`] alone;
//! every reduction has a fixed order, so that a run has the same bits every time.
//! Must not know: line searches, convergence, curves, why seeds are held.

use glam::DVec3;

use super::{CellSums, PassStats, RvdError};
use crate::knn::Point;
use crate::token::Token;

/// Pairs (s, y) that a quasi-Newton history holds (design, section 3, "Optimiser").
pub const HISTORY: usize = 7;

/// What one pass over the diagram says of a point. Unit frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evaluation {
    /// E = Σ ∫ w |p - x_i|².
    pub energy: f64,
    /// ‖∇E‖², ∇E_i = 2 m_i (x_i - c_i), 0 for held seeds.
    pub gradient_squared: f64,
    /// ∇E · d for the present direction d; 0 where there is none.
    pub slope: f64,
    /// Cells without any surface.
    pub empty_cells: usize,
    /// Area covered by all pieces.
    pub area: f64,
    /// What the pass did.
    pub stats: PassStats,
}

/// One session's seeds, moved in place. Vectors have a point's components for each seed. A stopped pass leaves the present point as it
/// was; after [`Resident::relax`] it is as after the evaluations that were added. An error of the device, such as
/// [`RvdError::DeviceLost`], changes nothing; the session must be opened again.
pub trait Resident<P: Point = DVec3> {
    /// Which seeds stay where they are, one entry a seed. Clears the history and the direction.
    fn hold(&mut self, held: &[bool]) -> Result<(), RvdError>;

    /// One pass at the present point x; its gradient g is kept. The slope is 0.
    fn evaluate(&mut self, token: &Token) -> Result<Evaluation, RvdError>;

    /// After [`Resident::evaluate`]: seeds go to their cells' centroids, if not held or of an empty cell. Clears the history.
    fn to_centroids(&mut self) -> Result<(), RvdError>;

    /// One Lloyd step at least and `steps` at most, each as [`Resident::evaluate`] and then
    /// [`Resident::to_centroids`], with the same bits; the evaluation of each is added to `evaluations`. No step is
    /// taken from a point with empty cells: its evaluation is then the last, and [`Resident::read_sums`] has its sums.
    fn relax(&mut self, steps: usize, evaluations: &mut Vec<Evaluation>, token: &Token) -> Result<(), RvdError> {
        let _one_by_one = steps;
        let evaluation = self.evaluate(token)?;
        if evaluation.empty_cells == 0 {
            self.to_centroids()?;
        }
        evaluations.push(evaluation);
        Ok(())
    }

    /// Sets `d := -H g` by the two-loop recursion over the history, with H₀ = (sᵀy / yᵀPy) P of the last pair. Without
    /// history, sets `d := -P g`, the way to the centroids. P divides each seed's part by twice the mass of its cell, as
    /// Lloyd's method does: masses differ a hundredfold on a density, and one scale for all suits none. Returns gᵀd.
    fn search_direction(&mut self) -> Result<f64, RvdError>;

    /// One pass at x + step·d; its gradient is kept beside g. The slope is that gradient along d.
    fn probe(&mut self, step: f64, token: &Token) -> Result<Evaluation, RvdError>;

    /// The point of the last probe becomes x, its gradient g; the pair (s, y) joins the history, the
    /// oldest going where there are `HISTORY`, unless sᵀy <= 1e-10 ‖s‖ ‖y‖.
    fn accept(&mut self) -> Result<(), RvdError>;

    /// Empties the history.
    fn clear_history(&mut self);

    /// The present point, unit frame, into `out`.
    fn read(&mut self, out: &mut Vec<P>) -> Result<(), RvdError>;

    /// The cells' sums of the last pass at x, into `out`.
    fn read_sums(&mut self, out: &mut CellSums<P>) -> Result<(), RvdError>;
}
