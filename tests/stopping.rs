//! Promise: whatever is sent, work stops soon after it is told to.
//!
//! The generator is `common/adversary.rs`. `TESSERA_STOP_CASES=1000 cargo test --release --test stopping -- --ignored --nocapture
//! long` prints one line a case and, at the end, how long work went on after it was told to stop, as JSON;
//! `TESSERA_STOP_FIRST` begins elsewhere, `TESSERA_STOP_SIZE` says how large surfaces are.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "common/adversary.rs"]
mod adversary;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::remesh::{Observer, remesh};
use tessera::rvd::Parallel;
use tessera::token::{Silence, Token};

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().unwrap_or_else(|e| panic!("{variable}={text}: {e}")))
}

struct Quiet;
impl Observer for Quiet {}

/// What came of a case.
struct Outcome {
    name: String,
    /// From being told to stop to the end; nothing if it had ended before.
    late: Option<Duration>,
    took: Duration,
    silence: Silence,
    result: String,
}

/// Does the job of this number, and tells it to stop after `moment`.
fn stop_after(number: u64, size: usize, moment: Duration, backend: &Parallel) -> Outcome {
    let job = adversary::job(number, size);
    let token = Token::default();
    let begin = Instant::now();
    let watcher = token.clone();
    let (ended, end) = std::sync::mpsc::channel::<()>();
    let (result, late) = std::thread::scope(|scope| {
        let stopper = scope.spawn(move || {
            let timed_out = end.recv_timeout(moment) == Err(std::sync::mpsc::RecvTimeoutError::Timeout);
            watcher.cancel();
            timed_out.then(Instant::now)
        });
        let done = catch_unwind(AssertUnwindSafe(|| remesh(&job.mesh, &job.options, backend, &mut Quiet, &token)));
        let at = Instant::now();
        let _ = ended.send(());
        let stopped = stopper.join().unwrap();
        (done, stopped.map(|stopped| at.saturating_duration_since(stopped)))
    });
    let result = match result {
        Ok(Ok(done)) => format!("{} facets", done.mesh.facets().len()),
        Ok(Err(error)) => error.to_string(),
        Err(_) => panic!("{}: the work panicked", job.name),
    };
    Outcome { name: job.name, late, took: begin.elapsed(), silence: token.longest_silence(), result }
}

#[test]
#[ignore = "the long run; see the head of the file"]
fn long() {
    let backend = Parallel::new(Some(number("TESSERA_STOP_THREADS", 2) as usize)).unwrap();
    let (first, cases) = (number("TESSERA_STOP_FIRST", 0), number("TESSERA_STOP_CASES", 100));
    let (size, longest) = (number("TESSERA_STOP_SIZE", 200_000) as usize, number("TESSERA_STOP_MS", 5_000));
    let mut late = Vec::new();
    for k in first..first + cases {
        let mut rng = ChaCha8Rng::seed_from_u64(k ^ 0x5109);
        let moment = Duration::from_secs_f64(longest as f64 / 1e3 * rng.random::<f64>().powi(2));
        let outcome = stop_after(k, size, moment, &backend);
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

#[test]
fn every_stage_hears() {
    let backend = Parallel::new(Some(2)).unwrap();
    let mut deaf = Vec::new();
    for k in 0..2 * adversary::SURFACES.len() as u64 {
        let mut rng = ChaCha8Rng::seed_from_u64(k);
        let moment = Duration::from_secs_f64(1.5 * rng.random::<f64>());
        let Outcome { name, late, silence, .. } = stop_after(k, 60_000, moment, &backend);
        if late.is_some_and(|late| late > BOUND) || silence.time > BOUND {
            deaf.push(format!("{name}: {late:?} late, {silence:?}"));
        }
    }
    assert!(deaf.is_empty(), "\n{}", deaf.join("\n"));
}
