//! Random inputs of a property, and the smallest one that breaks it.
//!
//! Invariant: inputs come in blocks, each made of its own number, so that the same numbers give the same inputs on any number of
//! threads. A failure is told by its block and by the input after shrinking.
#![allow(dead_code)]

use std::fmt::Debug;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use proptest::strategy::Strategy;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestError, TestRng, TestRunner};

/// Inputs of one block.
const BLOCK: u64 = 50;

/// Tries inputs `first..first + count`, in whole blocks, on `threads` threads; gives how many made a case.
///
/// # Errors
/// One text for each block that failed, at most 20.
pub fn hold<T: Debug, S: Strategy<Value = T>>(
    [first, count]: [u64; 2],
    threads: usize,
    inputs: impl Fn() -> S + Sync,
    property: impl Fn(&T) -> Result<bool, String> + Sync,
) -> Result<u64, Vec<String>> {
    let (next, made) = (AtomicU64::new(first / BLOCK), AtomicU64::new(0));
    let failures = Mutex::new(Vec::new());
    let work = || {
        loop {
            let block = next.fetch_add(1, Ordering::Relaxed);
            if block * BLOCK >= first + count || failures.lock().unwrap().len() >= 20 {
                return;
            }
            if let Err(text) = hold_block(block, &inputs(), &property, &made) {
                failures.lock().unwrap().push(text);
            }
        }
    };
    std::thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
    let failures = failures.into_inner().unwrap();
    if failures.is_empty() { Ok(made.into_inner()) } else { Err(failures) }
}

fn hold_block<T: Debug, S: Strategy<Value = T>>(
    block: u64,
    inputs: &S,
    property: impl Fn(&T) -> Result<bool, String>,
    made: &AtomicU64,
) -> Result<(), String> {
    let mut seed = [0; 32];
    seed[..8].copy_from_slice(&block.to_le_bytes());
    let config = Config { cases: BLOCK as u32, failure_persistence: None, max_shrink_iters: 4096, ..Config::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &seed));
    let outcome = runner.run(inputs, |input| {
        let is_case = property(&input).map_err(TestCaseError::fail)?;
        made.fetch_add(u64::from(is_case), Ordering::Relaxed);
        Ok(())
    });
    outcome.map_err(|error| match error {
        TestError::Fail(reason, smallest) => format!("block {block}: {}\n  the smallest input: {smallest:?}", reason),
        TestError::Abort(reason) => format!("block {block}: given up, {reason}"),
    })
}
