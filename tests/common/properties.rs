//! What holds of any bytes: the properties that the fuzz targets and `tests/fuzz_short.rs` share.
//!
//! Invariant: the same bytes give the same answer. A property says whether the bytes made a case at all, or what does not hold.
//! Must not know: who made the bytes (libFuzzer, a shrinking test runner, a committed file).
#![allow(dead_code)]

#[path = "cases.rs"]
pub mod cases;
#[path = "gpu.rs"]
pub mod gpu;
#[path = "gpu_cases.rs"]
mod gpu_cases;
#[path = "readers.rs"]
pub mod readers;
#[path = "uploads.rs"]
mod uploads;

use std::sync::OnceLock;

use ::gpu::diagram::Gpu;
use tessera::mesh::io::Format;
use tessera::rvd::Parallel;

/// Whether the bytes made a case of which the property holds, or what is wrong with it.
pub type Held = Result<bool, String>;

/// The bytes as a small surface with seeds: every CPU backend and the whole pipeline (`cases`).
pub fn diagram(bytes: &[u8]) -> Held {
    static PARALLEL: OnceLock<Parallel> = OnceLock::new();
    // Two threads: enough to share tasks out, few enough to leave the cores to other cases.
    let parallel = PARALLEL.get_or_init(|| Parallel::new(Some(2)).unwrap());
    let Some(case) = cases::Case::from_bytes(bytes) else { return Ok(false) };
    cases::check(&case, parallel).map(|()| true)
}

/// The bytes as a small surface with seeds, on the GPU against the reference (`gpu_cases`). No case without an adapter;
/// `TESSERA_TEST_GPU` says whether that is a failure.
pub fn diagram_on_the_gpu(bytes: &[u8]) -> Held {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    let gpu = GPU.get_or_init(|| self::gpu::device().map(|device| Gpu::new(device, Some(1)).unwrap()));
    let (Some(gpu), Some(case)) = (gpu, cases::Case::from_bytes(bytes)) else { return Ok(false) };
    gpu_cases::check(&case, gpu).map(|()| true)
}

/// The bytes as a file (`readers`).
pub fn file(format: Format, bytes: &[u8]) -> Held {
    readers::check(format, bytes).map(|()| true)
}

/// The bytes as the upload of a stream (`uploads`). A case is an upload that is taken.
pub fn upload(bytes: &[u8]) -> Held {
    uploads::check(bytes)
}

/// The property whose inputs are in this folder of `tests/fuzz/corpus`.
///
/// # Errors
/// The name, if there is none.
pub fn of_corpus(folder: &str, bytes: &[u8]) -> Held {
    match (Format::from_extension(folder), folder) {
        (Some(format), _) => file(format, bytes),
        (None, "upload") => upload(bytes),
        (None, "rvd") => diagram(bytes),
        (None, other) => Err(format!("no property has a corpus {other}")),
    }
}
