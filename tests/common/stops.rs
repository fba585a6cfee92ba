//! Jobs of the adversary that are told to stop, and how long they go on.
//!
//! Invariant: the same number gives the same job; only times differ.
#![allow(dead_code)]

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use tessera::remesh::{Observer, remesh};
use tessera::rvd::Backend;
use tessera::token::{Silence, Token};

#[path = "adversary.rs"]
pub mod adversary;

struct Quiet;
impl Observer for Quiet {}

/// What came of a job.
pub struct Outcome {
    pub name: String,
    /// From being told to stop to the end; nothing if it had ended before.
    pub late: Option<Duration>,
    pub took: Duration,
    pub silence: Silence,
    pub result: String,
}

impl Outcome {
    /// What is wrong, if it went on for longer than `bound` or did not ask for so long.
    pub fn over(&self, bound: Duration) -> Option<String> {
        let Self { name, late, silence, .. } = self;
        let over = late.is_some_and(|late| late > bound) || silence.time > bound;
        over.then(|| format!("{name}: {late:?} late, {silence:?}"))
    }
}

/// Does the job of this number, of at most so many facets, and tells it to stop after `moment`.
pub fn stop_after(number: u64, size: usize, moment: Duration, backend: &dyn Backend) -> Outcome {
    let job = adversary::job(number, size);
    let token = Token::default();
    let begin = Instant::now();
    let watcher = token.clone();
    let (ended, end) = channel::<()>();
    let (result, late) = std::thread::scope(|scope| {
        let stopper = scope.spawn(move || {
            let timed_out = end.recv_timeout(moment) == Err(RecvTimeoutError::Timeout);
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

/// Any bytes as the number of a job and the moment of its end (at most half a second, mostly early); bytes that are
/// missing read as 0.
///
/// # Errors
/// What went on for longer than `bound`.
pub fn check(data: &[u8], size: usize, bound: Duration, backend: &dyn Backend) -> Result<(), String> {
    let mut bytes = [0; 10];
    let length = data.len().min(bytes.len());
    bytes[..length].copy_from_slice(&data[..length]);
    let share = f64::from(u16::from_le_bytes([bytes[0], bytes[1]])) / f64::from(u16::MAX);
    let number = bytes[2..].iter().fold(0, |number, &byte| number << 8 | u64::from(byte));
    let outcome = stop_after(number, size, Duration::from_secs_f64(0.5 * share * share), backend);
    outcome.over(bound).map_or(Ok(()), Err)
}
