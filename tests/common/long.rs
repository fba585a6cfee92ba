//! What takes long, and what of it is enough for a change.
//!
//! Purpose: many cases of one kind are all run with `TESSERA_LONG=1`, as .ci/long sets; else [`some`] of them. Invariant: these are the
//! same each time. Must not know: any test.
#![allow(dead_code)]

/// Whether all cases are run.
pub fn is_long() -> bool {
    std::env::var_os("TESSERA_LONG").is_some()
}

/// `few` of these cases, evenly spread from the first on; or all.
pub fn some<T>(few: usize, cases: impl IntoIterator<Item = T>) -> Vec<T> {
    let cases: Vec<T> = cases.into_iter().collect();
    let (all, few) = (cases.len(), if is_long() { cases.len() } else { few.min(cases.len()) });
    // Case `k` is taken where the number of those that are taken changes.
    let is_taken = |k: usize| (k * few).div_ceil(all) < ((k + 1) * few).div_ceil(all);
    cases.into_iter().enumerate().filter(|(k, _)| is_taken(*k)).map(|(_, case)| case).collect()
}
