//! Memory that all streams share: what was uploaded, and what waits to be sent.
//!
//! Purpose: [`Budget`] counts bytes, [`Share`] is what one holder has of them. Invariant: an upload takes memory for
//! what has arrived, never for what was announced, and is refused where nothing is left. Results are counted without
//! being refused, since their work is done; while they wait, uploads have less. A share is given back when dropped.
//! Must not know: what the bytes are.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use super::rejection::Rejection;

#[derive(Clone, Debug)]
pub struct Budget {
    /// Below 0 where results took more than was left.
    left: Arc<AtomicI64>,
    held: Arc<AtomicI64>,
}

impl Budget {
    pub fn new(bytes: u64) -> Self {
        Self::told(bytes, Arc::default())
    }

    /// As [`Self::new`]; `held` is kept at the bytes that are taken.
    pub fn told(bytes: u64, held: Arc<AtomicI64>) -> Self {
        Self { left: Arc::new(AtomicI64::new(signed(bytes))), held }
    }

    /// An empty share, which grows.
    pub fn share(&self) -> Share {
        Share { budget: self.clone(), taken: 0 }
    }

    pub fn has(&self, bytes: u64) -> bool {
        self.left.load(Ordering::Acquire) >= signed(bytes)
    }

    /// Whether no more than `slack` bytes too many are taken.
    pub fn has_within(&self, slack: u64) -> bool {
        self.left.load(Ordering::Acquire) >= -signed(slack)
    }

    /// Counts bytes that are there already.
    pub fn charge(&self, bytes: u64) {
        self.left.fetch_sub(signed(bytes), Ordering::AcqRel);
        self.held.fetch_add(signed(bytes), Ordering::AcqRel);
    }

    /// Gives back what was charged.
    pub fn release(&self, bytes: u64) {
        self.left.fetch_add(signed(bytes), Ordering::AcqRel);
        self.held.fetch_sub(signed(bytes), Ordering::AcqRel);
    }
}

#[derive(Debug)]
pub struct Share {
    budget: Budget,
    taken: u64,
}

impl Share {
    /// Takes `bytes` more, if they are left.
    pub fn grow(&mut self, bytes: u64) -> Result<(), Rejection> {
        let take = |left: i64| left.checked_sub(signed(bytes)).filter(|left| *left >= 0);
        self.budget.left.fetch_update(Ordering::AcqRel, Ordering::Acquire, take).map_err(|left| {
            let left_bytes = u64::try_from(left).unwrap_or(0);
            Rejection::Memory { needed_bytes: bytes, left_bytes }
        })?;
        self.budget.held.fetch_add(signed(bytes), Ordering::AcqRel);
        self.taken += bytes;
        Ok(())
    }

    /// From now on the holder has this many bytes, whatever it had before.
    pub fn hold(&mut self, bytes: u64) {
        self.budget.charge(bytes);
        self.budget.release(self.taken);
        self.taken = bytes;
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.budget.release(self.taken);
    }
}

fn signed(bytes: u64) -> i64 {
    i64::try_from(bytes).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_given_back() {
        let budget = Budget::new(100);
        let mut one = budget.share();
        one.grow(60).unwrap();
        let mut two = budget.share();
        assert!(matches!(two.grow(50), Err(Rejection::Memory { left_bytes: 40, .. })));
        drop(one);
        two.grow(100).unwrap();
    }

    #[test]
    fn results_are_counted_though_nothing_is_left() {
        let budget = Budget::new(100);
        let mut result = budget.share();
        result.grow(30).unwrap();
        result.hold(150);
        assert!(!budget.has(1));
        assert!(matches!(budget.share().grow(1), Err(Rejection::Memory { left_bytes: 0, .. })));
        drop(result);
        assert!(budget.has(100) && !budget.has(101));
        assert_eq!(budget.held.load(Ordering::Acquire), 0);
    }
}
