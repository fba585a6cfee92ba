//! Any bytes as a small surface with seeds, through every CPU backend and the whole pipeline.
#![no_main]

#[path = "../../common/cases.rs"]
mod cases;

use std::sync::OnceLock;

use tessera::rvd::Parallel;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    static PARALLEL: OnceLock<Parallel> = OnceLock::new();
    let parallel = PARALLEL.get_or_init(|| Parallel::new(Some(2)).unwrap());
    if let Some(case) = cases::Case::from_bytes(data)
        && let Err(text) = cases::check(&case, parallel)
    {
        panic!("{text}");
    }
});
