//! Any bytes as a job of the adversary and the moment at which it is told to stop: no job may go on.
#![no_main]

#[path = "../../common/stops.rs"]
mod stops;

use std::sync::OnceLock;
use std::time::Duration;

use tessera::rvd::Parallel;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    static PARALLEL: OnceLock<Parallel> = OnceLock::new();
    let parallel = PARALLEL.get_or_init(|| Parallel::new(Some(2)).unwrap());
    // Instrumented code on a busy machine is slower than what the long run of `tests/stopping.rs` measures.
    if let Err(text) = stops::check(data, 20_000, Duration::from_secs(2), parallel) {
        panic!("{text}");
    }
});
