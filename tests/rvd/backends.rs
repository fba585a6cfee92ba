//! Promise: every backend passes the suite of `common/conformance.rs`. A new one is added here, in one line.

use std::sync::OnceLock;

use ::gpu::diagram::Gpu;
use tessera::rvd::{Parallel, Serial};

use crate::conformance::{Claims, conformance};

fn parallel(threads: usize) -> Parallel {
    Parallel::new(Some(threads)).unwrap()
}

/// The backend of the one device of the tests: its stages are compiled once. None where a driver opens no adapter.
pub fn on_device() -> Option<&'static Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    GPU.get_or_init(|| crate::gpu::device().map(|device| Gpu::new(device, Some(1)).unwrap())).as_ref()
}

/// The same with another number of threads of the host.
fn twin() -> Gpu {
    Gpu::new(crate::gpu::device().expect("an adapter"), Some(2)).unwrap()
}

conformance!(serial, Claims::double(Serial));
conformance!(parallel, Claims::double(parallel(2)).with_twin(parallel(1)).with_twin(parallel(3)));
conformance!(
    #[needs::needs(gpu)]
    gpu,
    Claims::single(on_device().expect("an adapter")).with_twin(twin()).with_relaunches()
);
