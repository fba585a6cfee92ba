//! Loops whose items are shared by the threads of the pool.
//!
//! Purpose: [`map`], [`try_map`], [`flat_map`], [`any`] and [`alone`] are what most loops need. What hands work to threads is compiled once for
//! all of them, and a loop adds its own body alone. With iterators of rayon it was a third of this crate's machine code. Invariant:
//! results are in the order of the items, on any number of threads. Must not know: what is computed.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rayon::prelude::*;

/// Runs of items for each thread: some take longer than others.
const RUNS_PER_THREAD: usize = 8;
/// Fewer items are not worth a task.
const LEAST: usize = 16;

/// What `of` makes of each number below `count`.
pub(crate) fn map<T: Default + Send>(count: usize, of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let mut all: Vec<T> = std::iter::repeat_with(T::default).take(count).collect();
    let length = run_length(count, LEAST);
    let slots: Vec<Mutex<&mut [T]>> = all.chunks_mut(length).map(Mutex::new).collect();
    runs(count, LEAST, &|k, range| held(&slots[k]).iter_mut().zip(range).for_each(|(to, item)| *to = of(item)));
    drop(slots);
    all
}

/// The same of items that may fail: the first failure that is met ends all. `begin` makes what a run of items has in common.
pub(crate) fn try_map<S, T: Default + Send, E: Send>(
    count: usize,
    begin: impl Fn() -> S + Sync,
    of: impl Fn(&mut S, usize) -> Result<T, E> + Sync,
) -> Result<Vec<T>, E> {
    let mut all: Vec<T> = std::iter::repeat_with(T::default).take(count).collect();
    let length = run_length(count, LEAST);
    let slots: Vec<Mutex<&mut [T]>> = all.chunks_mut(length).map(Mutex::new).collect();
    let (has_failed, failure) = (AtomicBool::new(false), Mutex::new(None));
    runs(count, LEAST, &|k, range| {
        let mut state = begin();
        for (to, item) in held(&slots[k]).iter_mut().zip(range) {
            if has_failed.load(Relaxed) {
                return;
            }
            match of(&mut state, item) {
                Ok(made) => *to = made,
                Err(error) => {
                    has_failed.store(true, Relaxed);
                    *held(&failure) = Some(error);
                }
            }
        }
    });
    drop(slots);
    match failure.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(error) => Err(error),
        None => Ok(all),
    }
}

/// All that `of` makes of each number below `count`, one after another.
pub(crate) fn flat_map<T: Send, L: IntoIterator<Item = T>>(count: usize, of: impl Fn(usize) -> L + Sync) -> Vec<T> {
    in_runs(count, LEAST, of)
}

/// What `of` makes of each number below `count`, where each is worth a task.
pub(crate) fn alone<T: Send>(count: usize, of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    in_runs(count, 1, |k| [of(k)])
}

fn in_runs<T: Send, L: IntoIterator<Item = T>>(count: usize, least: usize, of: impl Fn(usize) -> L + Sync) -> Vec<T> {
    let slots = (0..count.div_ceil(run_length(count, least))).map(|_| Mutex::default());
    let slots: Vec<Mutex<Vec<T>>> = slots.collect();
    runs(count, least, &|k, range| *held(&slots[k]) = range.flat_map(&of).collect());
    let parts = slots.into_iter().map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner));
    let parts: Vec<Vec<T>> = parts.collect();
    let mut all = Vec::with_capacity(parts.iter().map(Vec::len).sum());
    parts.into_iter().for_each(|mut part| all.append(&mut part));
    all
}

/// Whether any number below `count` is so.
pub(crate) fn any(count: usize, is_so: impl Fn(usize) -> bool + Sync) -> bool {
    let found = AtomicBool::new(false);
    runs(count, LEAST, &|_, mut range| {
        if range.any(|k| found.load(Relaxed) || is_so(k)) {
            found.store(true, Relaxed);
        }
    });
    found.into_inner()
}

fn run_length(count: usize, least: usize) -> usize {
    count.div_ceil(RUNS_PER_THREAD * rayon::current_num_threads()).max(least)
}

/// Calls `run` with the number of each run and with its items.
fn runs(count: usize, least: usize, run: &(dyn Fn(usize, Range<usize>) + Sync)) {
    let length = run_length(count, least);
    let items = |k: usize| k * length..count.min((k + 1) * length);
    if count <= length {
        return if count > 0 {
            run(0, items(0))
        };
    }
    (0..count.div_ceil(length)).into_par_iter().with_max_len(1).for_each(|k| run(k, items(k)));
}

/// One run alone has each of them.
fn held<T>(slot: &Mutex<T>) -> MutexGuard<'_, T> {
    slot.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn results_are_in_the_order_of_the_items() {
        for count in [0, 1, 2, 7, 15, 16, 17, 1000] {
            let expected: Vec<usize> = (0..count).collect();
            assert_eq!(map(count, |k| k), expected);
            assert_eq!(try_map(count, || (), |(), k| Ok::<_, ()>(k)), Ok(expected.clone()));
            assert_eq!(flat_map(count, |k| [2 * k, 2 * k + 1]), (0..2 * count).collect::<Vec<_>>());
            assert_eq!(flat_map(count, |k| (k % 3 == 0).then_some(k)), (0..count).step_by(3).collect::<Vec<_>>());
            assert_eq!(alone(count, |k| k), expected);
            assert!(any(count, |k| k + 1 == count) == (count > 0) && !any(count, |k| k == count));
        }
    }

    #[test]
    fn a_failure_ends_all_and_is_the_result() {
        assert_eq!(try_map(1000, || (), |(), k| if k == 700 { Err(k) } else { Ok(k) }), Err(700));
        let calls = std::sync::atomic::AtomicUsize::new(0);
        let fail = |(): &mut (), _| -> Result<u8, ()> {
            calls.fetch_add(1, Relaxed);
            Err(())
        };
        assert_eq!(try_map(1_000_000, || (), fail), Err(()));
        assert!(calls.into_inner() <= rayon::current_num_threads());
    }
}
