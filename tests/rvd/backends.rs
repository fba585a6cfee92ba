//! Promise: every backend passes the suite of `common/conformance.rs`. A new one is added here, in one line.

use tessera::internals::rvd::Gpu;
use tessera::rvd::{Parallel, Serial};

use crate::conformance::{Claims, conformance};

fn parallel(threads: usize) -> Parallel {
    Parallel::new(Some(threads)).unwrap()
}

/// On the one device of the tests, with so many threads of the host.
fn on_device(threads: usize) -> Gpu {
    // A driver that opens no adapter is seen too late to ignore the test.
    Gpu::new(crate::gpu::device().expect("an adapter"), Some(threads)).unwrap()
}

conformance!(serial, Claims::double(Serial));
conformance!(parallel, Claims::double(parallel(2)).with_twin(parallel(1)).with_twin(parallel(3)));
conformance!(
    #[needs::needs(gpu)]
    gpu,
    Claims::single(on_device(1)).with_twin(on_device(2)).with_relaunches()
);
