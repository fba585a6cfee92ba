//! (being built)
use super::*;
/// The f64 reference, one thread.
#[derive(Clone, Copy, Debug, Default)]
pub struct Serial;
impl Backend for Serial {
    fn kind(&self) -> BackendKind {
        BackendKind::Serial
    }
    fn threads(&self) -> usize {
        1
    }
    fn session(&self, _s: Arc<Surface>, _o: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        todo!()
    }
}
