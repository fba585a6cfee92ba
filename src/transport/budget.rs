//! Memory that all streams share: what was uploaded, and what waits to be sent.
//!
//! Purpose: [`Budget`] counts bytes, [`Share`] is what one stream has of them. Invariant: an upload takes memory for
//! what has arrived, never for what was announced, and is refused where nothing is left. Uploads of one holder leave an eighth
//! of all, and have half at most while another holder has some. Results are counted without
//! being refused, since their work is done; while they wait, uploads have less. A share is given back when dropped.
//! Must not know: what the bytes are, what a holder is.

use std::collections::HashMap;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex};

use super::lock;
use super::rejection::Rejection;

/// The part of the memory that the uploads of one holder leave to others.
const RESERVE: u64 = 8;

#[derive(Clone, Debug)]
pub struct Budget {
    bytes: u64,
    /// Below 0 where results took more than was left.
    left: Arc<AtomicI64>,
    held: Arc<AtomicI64>,
    uploads: Arc<Mutex<Uploads>>,
}

/// Bytes of uploads.
#[derive(Debug, Default)]
struct Uploads {
    all: u64,
    by_holder: HashMap<Arc<str>, u64>,
}

impl Uploads {
    /// What a holder may still take of `bytes` for all.
    fn room(&self, holder: &str, bytes: u64) -> u64 {
        let own = self.by_holder.get(holder).copied().unwrap_or(0);
        let most = if self.all > own { bytes / 2 } else { bytes - bytes / RESERVE };
        most.saturating_sub(own)
    }

    fn add(&mut self, holder: &Arc<str>, bytes: u64) {
        self.all += bytes;
        *self.by_holder.entry(Arc::clone(holder)).or_default() += bytes;
    }

    fn remove(&mut self, holder: &str, bytes: u64) {
        self.all -= bytes;
        if let Some(own) = self.by_holder.get_mut(holder) {
            *own -= bytes;
            if *own == 0 {
                self.by_holder.remove(holder);
            }
        }
    }
}

impl Budget {
    pub fn new(bytes: u64) -> Self {
        Self::told(bytes, Arc::default())
    }

    /// As [`Self::new`]; `held` is kept at the bytes that are taken.
    pub fn told(bytes: u64, held: Arc<AtomicI64>) -> Self {
        Self { bytes, left: Arc::new(AtomicI64::new(signed(bytes))), held, uploads: Arc::default() }
    }

    /// An empty share for an answer.
    pub fn share(&self) -> Share {
        Share { budget: self.clone(), taken: 0, upload: None }
    }

    /// An empty share for an upload of this holder.
    pub fn upload_of(&self, holder: &str) -> Share {
        Share { budget: self.clone(), taken: 0, upload: Some((holder.into(), 0)) }
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
    /// The holder of an upload, and the bytes of it that count as such.
    upload: Option<(Arc<str>, u64)>,
}

impl Share {
    /// Takes `bytes` more, if they are left, for this holder too. Errors: `Memory`; nothing is taken then.
    pub fn grow(&mut self, bytes: u64) -> Result<(), Rejection> {
        let budget = self.budget.clone();
        // Held until the bytes are taken: of two uploads at once one sees the other.
        let mut uploads = self.upload.is_some().then(|| lock(&budget.uploads));
        if let (Some(uploads), Some((holder, _))) = (&uploads, &self.upload) {
            let left_bytes = uploads.room(holder, budget.bytes);
            if left_bytes < bytes {
                return Err(Rejection::Memory { needed_bytes: bytes, left_bytes });
            }
        }
        let take = |left: i64| left.checked_sub(signed(bytes)).filter(|left| *left >= 0);
        self.budget.left.fetch_update(Ordering::AcqRel, Ordering::Acquire, take).map_err(|left| {
            let left_bytes = u64::try_from(left).unwrap_or(0);
            Rejection::Memory { needed_bytes: bytes, left_bytes }
        })?;
        self.budget.held.fetch_add(signed(bytes), Ordering::AcqRel);
        self.taken += bytes;
        if let (Some(uploads), Some((holder, own))) = (&mut uploads, &mut self.upload) {
            uploads.add(holder, bytes);
            *own += bytes;
        }
        Ok(())
    }

    /// From now on the share has this many bytes, whatever it had before. An upload that grows by this is not refused.
    pub fn hold(&mut self, bytes: u64) {
        self.budget.charge(bytes);
        self.budget.release(self.taken);
        self.taken = bytes;
        if let Some((holder, own)) = &mut self.upload {
            let mut uploads = lock(&self.budget.uploads);
            uploads.add(holder, bytes);
            uploads.remove(holder, std::mem::replace(own, bytes));
        }
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.hold(0);
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
    fn uploads_of_one_holder_leave_room_for_others() {
        let budget = Budget::new(800);
        let fill = |holder: &str| {
            let mut shares = Vec::new();
            loop {
                let mut share = budget.upload_of(holder);
                match share.grow(50) {
                    Ok(()) => shares.push(share),
                    Err(refused) => return (shares.len() as u64 * 50, shares, refused),
                }
            }
        };
        let (bytes, mut greedy, refused) = fill("greedy");
        assert_eq!((bytes, refused), (700, Rejection::Memory { needed_bytes: 50, left_bytes: 0 }));
        let (bytes, other, _) = fill("other");
        assert_eq!(bytes, 100, "what was left");
        // What becomes free goes to the other one, up to half.
        greedy.truncate(9);
        assert_eq!(fill("greedy").0, 0);
        let (bytes, more, _) = fill("other");
        assert_eq!(bytes, 250);
        drop((greedy, other, more));
        assert_eq!(fill("other").0, 700);
        assert!(lock(&budget.uploads).by_holder.is_empty() && budget.has(800));
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
