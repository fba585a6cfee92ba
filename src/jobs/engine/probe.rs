//! Whether the backend computes what it should.
//!
//! Purpose: [`probe`] has the engine compute a diagram whose answer is known: the corners of an octahedron as seeds on it, each
//! of which has a sixth of its area. Invariant: a probe goes through the engine and the device's gate as jobs do, and stops
//! after [`PROBE_TIME`]. Must not know: when a probe is due, what follows from it.

use std::sync::Arc;
use std::time::Duration;

use glam::DVec3;

use crate::{Admission, Engine, JobError, Retry};
use geometry::mesh::TriMesh;
use geometry::rvd::{Backend, BackendChoice, CellSums, RvdError, SessionOptions, Surface};
use geometry::token::Token;

/// For one probe, which takes some milliseconds on any backend.
pub const PROBE_TIME: Duration = Duration::from_secs(10);

/// How far a cell's area may be from its value, as a part of it. Single precision with some hundred roundings stays a hundred
/// times below; a device that computes nonsense does not.
const TOLERANCE: f64 = 1e-4;

#[derive(Clone, Debug, thiserror::Error)]
pub enum ProbeError {
    #[error(transparent)]
    Job(#[from] JobError),
    #[error("the backend did not answer within {} s", PROBE_TIME.as_secs())]
    Silent,
}

pub async fn probe(engine: &Engine) -> Result<(), ProbeError> {
    let mut pending = engine.submit(Admission::Session, Retry::Never, |backends, context| {
        Ok(check(backends.choose(BackendChoice::Auto)?.as_ref(), &context.token)?)
    })?;
    match tokio::time::timeout(PROBE_TIME, pending.wait()).await {
        Ok(answer) => Ok(answer.map(drop)?),
        Err(_) => Err(ProbeError::Silent),
    }
}

fn check(backend: &dyn Backend, token: &Token) -> Result<(), RvdError> {
    let corners = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let facets = vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    let mesh = TriMesh::new(corners.to_vec(), facets).map_err(|error| RvdError::Internal(error.to_string()))?;
    let surface = Arc::new(Surface::new(&mesh, None)?);
    let seeds: Vec<DVec3> = corners.iter().map(|&corner| surface.frame().to_unit(corner)).collect();
    let mut session = backend.session(Arc::clone(&surface), SessionOptions::new(seeds.len()))?;
    session.set_seeds(&seeds)?;
    let mut sums = CellSums::default();
    session.sums(&mut sums, token)?;
    let sixth = surface.area() / 6.0;
    let is_right = |area: &f64| (area - sixth).abs() <= TOLERANCE * sixth;
    if sums.area.len() == seeds.len() && sums.area.iter().all(is_right) {
        return Ok(());
    }
    let (kind, areas) = (backend.kind().name(), &sums.area);
    Err(RvdError::Internal(format!("{kind} computes the areas {areas:?}, where each is {sixth}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::rvd::serial::Serial;
    use geometry::rvd::{BackendKind, PassStats, PieceBatch, Session};

    /// Computes areas that are wrong by a part.
    struct Wrong(f64);

    struct WrongSession(Box<dyn Session>, f64);

    impl Backend for Wrong {
        fn kind(&self) -> BackendKind {
            BackendKind::Serial
        }
        fn threads(&self) -> usize {
            1
        }
        fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
            Ok(Box::new(WrongSession(Serial.session(surface, options)?, self.0)))
        }
    }

    impl Session for WrongSession {
        fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
            self.0.set_seeds(seeds)
        }
        fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
            let stats = self.0.sums(out, token)?;
            out.area[3] *= 1.0 + self.1;
            Ok(stats)
        }
        fn pieces(&mut self, _: std::ops::Range<u32>, _: &mut PieceBatch, _: &Token) -> Result<PassStats, RvdError> {
            Err(RvdError::Internal("no pieces".to_owned()))
        }
    }

    #[test]
    fn a_backend_that_computes_right_passes() {
        assert!(check(&Serial, &Token::default()).is_ok());
        assert!(check(&Wrong(0.5 * TOLERANCE), &Token::default()).is_ok());
    }

    #[test]
    fn one_that_does_not_is_found() {
        for part in [2.0 * TOLERANCE, -0.01, f64::NAN] {
            let error = check(&Wrong(part), &Token::default()).unwrap_err();
            assert!(error.to_string().contains("areas"), "{error}");
        }
    }
}
