//! (being built)
use super::*;
/// f64, on all threads of its own rayon pool.
#[derive(Clone, Debug)]
pub struct Parallel;
impl Parallel {
    /// A pool of `threads` threads, or one a core with `None`.
    pub fn new(_threads: Option<usize>) -> Result<Self, RvdError> {
        Ok(Self)
    }
}
impl Backend for Parallel {
    fn kind(&self) -> BackendKind {
        BackendKind::Parallel
    }
    fn threads(&self) -> usize {
        2
    }
    fn session(&self, _s: Arc<Surface>, _o: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        todo!()
    }
}
