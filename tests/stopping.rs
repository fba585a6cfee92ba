//! Promise: whatever is sent, work stops soon after it is told to, on every backend.
//!
//! The generator is `common/adversary.rs`. `TESSERA_STOP_CASES=1000 cargo test --release --test stopping -- --ignored --nocapture
//! long` prints one line a case and, at the end, how long work went on after it was told to stop, as JSON;
//! `TESSERA_STOP_FIRST` begins elsewhere, `TESSERA_STOP_SIZE` says how large surfaces are, and `TESSERA_STOP_BACKEND` is
//! `parallel`, `serial` or `gpu`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "common/gpu.rs"]
mod gpu;
#[path = "common/stops.rs"]
mod stops;

use std::time::Duration;

use ::gpu::diagram::Gpu;
use needs::needs;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use stops::{Outcome, adversary, stop_after};
use tessera::rvd::{Backend, Parallel, Serial};

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().unwrap_or_else(|e| panic!("{variable}={text}: {e}")))
}

/// The backend that the environment names.
fn backend() -> Box<dyn Backend> {
    let name = std::env::var("TESSERA_STOP_BACKEND").unwrap_or_else(|_| "parallel".to_owned());
    match name.as_str() {
        "parallel" => Box::new(Parallel::new(Some(number("TESSERA_STOP_THREADS", 2) as usize)).unwrap()),
        "serial" => Box::new(Serial),
        "gpu" => Box::new(Gpu::new(crate::gpu::device().expect("an adapter"), None).unwrap()),
        other => panic!("TESSERA_STOP_BACKEND={other}: say parallel, serial or gpu"),
    }
}

#[test]
#[ignore = "the long run; see the head of the file"]
fn long() {
    let backend = backend();
    let (first, cases) = (number("TESSERA_STOP_FIRST", 0), number("TESSERA_STOP_CASES", 100));
    let (size, longest) = (number("TESSERA_STOP_SIZE", 200_000) as usize, number("TESSERA_STOP_MS", 5_000));
    let mut late = Vec::new();
    for k in first..first + cases {
        let mut rng = ChaCha8Rng::seed_from_u64(k ^ 0x5109);
        let moment = Duration::from_secs_f64(longest as f64 / 1e3 * rng.random::<f64>().powi(2));
        let outcome = stop_after(k, size, moment, backend.as_ref());
        let Outcome { name, took, silence, result, .. } = outcome;
        let after = outcome.late.map_or(0.0, |l| l.as_secs_f64() * 1e3);
        if outcome.late.is_some() {
            late.push(after);
        }
        eprintln!(
            "{after:8.1} ms late, silent {:8.1} in {:10} until {}, took {:8.1} | {name} | {result}",
            silence.time.as_secs_f64() * 1e3,
            silence.stage,
            silence.until.map_or(String::new(), |at| format!("{}:{}", at.file(), at.line())),
            took.as_secs_f64() * 1e3
        );
    }
    late.sort_by(f64::total_cmp);
    let at = |share: f64| late.get((share * late.len() as f64) as usize).or(late.last()).copied().unwrap_or(0.0);
    println!(
        "{{\"cases\":{cases},\"stopped\":{},\"p50_ms\":{:.1},\"p90_ms\":{:.1},\"p99_ms\":{:.1},\"max_ms\":{:.1}}}",
        late.len(),
        at(0.5),
        at(0.9),
        at(0.99),
        at(1.0)
    );
}

/// Work that asks too seldom goes on for seconds here; the bound is far above what a busy machine adds. The long run
/// measures.
const BOUND: Duration = Duration::from_secs(3);

/// What goes on for too long, and again if it is tried again: a machine that stood still once is no fault of the work's.
fn deaf_twice(over: impl Fn() -> Option<String>) -> Option<String> {
    over().and_then(|_| over())
}

/// Asserts that jobs of every kind stop within the bound, `rounds` of each kind.
fn all_hear(rounds: u64, size: usize, longest: Duration, backend: &dyn Backend) {
    let mut deaf = Vec::new();
    for k in 0..rounds * adversary::SURFACES.len() as u64 {
        let mut rng = ChaCha8Rng::seed_from_u64(k);
        let moment = longest.mul_f64(rng.random::<f64>());
        deaf.extend(deaf_twice(|| stop_after(k, size, moment, backend).over(BOUND)));
    }
    assert!(deaf.is_empty(), "\n{}", deaf.join("\n"));
}

#[test]
fn every_stage_hears() {
    all_hear(2, 60_000, Duration::from_millis(1500), &Parallel::new(Some(2)).unwrap());
}

#[test]
fn one_thread_hears() {
    all_hear(1, 20_000, Duration::from_millis(500), &Serial);
}

#[needs(gpu)]
#[test]
fn the_gpu_hears() {
    let Some(device) = crate::gpu::device() else { return };
    all_hear(1, 20_000, Duration::from_millis(1000), &Gpu::new(device, None).unwrap());
}

/// What the fuzz target `stop` looks for, with fixed bytes.
#[test]
fn small_jobs_hear() {
    let backend = Parallel::new(Some(2)).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(26);
    let inputs: Vec<[u8; 10]> = (0..100).map(|_| rng.random()).collect();
    let over = |input: &[u8; 10]| deaf_twice(|| stops::check(input, 2_000, BOUND, &backend).err());
    let slow: Vec<_> = inputs.iter().filter_map(over).collect();
    assert!(slow.is_empty(), "\n{}", slow.join("\n"));
}
