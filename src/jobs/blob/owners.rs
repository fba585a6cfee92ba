//! Owners of blobs.
//!
//! Purpose: [`Owner`] stands for a tenant in the names of uploads and in the marks beside blobs; [`Owners`] has the owners
//! of each blob. Pure bookkeeping, no storage. Invariant: two names give different owners, as far as SHA-256 does, and the
//! name cannot be read from an owner. An owner's bytes are the sum of the sizes of its blobs. A blob has at most [`MOST`]
//! owners. Forgetting a blob forgets all its owners. Must not know: keys, where blobs and marks lie, pins, quotas.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};

use super::Digest;
use super::digest::hex_name;

/// Owners of one blob. One more replaces an owner, which can upload the blob again: a caller that invents names fills no more
/// than this, and replaces these names: see [`Owners::add`].
pub(crate) const MOST: usize = 256;

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Owner(pub(super) [u8; 16]);

hex_name!(Owner);

impl Owner {
    #[cfg(feature = "postgres")]
    pub(crate) const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    #[cfg(feature = "postgres")]
    pub(crate) const fn as_bytes(&self) -> &[u8; 16] {
        &self.0
    }

    pub fn of(name: &str) -> Self {
        let digest = Digest::of(name.as_bytes());
        Self(std::array::from_fn(|k| digest.as_bytes()[k]))
    }
}

#[derive(Debug, Default)]
pub(super) struct Owners {
    /// Since when each owner has it: a number that rises.
    of_blob: HashMap<Digest, BTreeMap<Owner, u64>>,
    of_owner: HashMap<Owner, Held>,
    last: u64,
}

#[derive(Debug, Default)]
struct Held {
    bytes: u64,
    sizes: HashMap<Digest, u64>,
}

impl Owners {
    /// Adds an owner. Returns the one that it replaces, if any: of those that `needs` does not name the one with the fewest
    /// blobs, and of several the latest. An owner of this blob alone that came last is most likely an invented name.
    pub(super) fn add(
        &mut self,
        digest: Digest,
        size_bytes: u64,
        owner: Owner,
        needs: impl Fn(Owner) -> bool,
    ) -> Option<Owner> {
        self.last += 1;
        let owners = self.of_blob.entry(digest).or_default();
        if owners.insert(owner, self.last).is_none() {
            let held = self.of_owner.entry(owner).or_default();
            held.sizes.insert(digest, size_bytes);
            held.bytes = held.bytes.saturating_add(size_bytes);
        }
        if owners.len() <= MOST {
            return None;
        }
        let others = owners.iter().filter(|(other, _)| **other != owner && !needs(**other));
        let blobs = |owner: &Owner| self.of_owner.get(owner).map_or(0, |held| held.sizes.len());
        let (replaced, _) = others.min_by_key(|(other, since)| (blobs(other), Reverse(**since)))?;
        let replaced = *replaced;
        self.take(&digest, replaced);
        Some(replaced)
    }

    pub(super) fn has(&self, digest: &Digest, owner: Owner) -> bool {
        self.of_blob.get(digest).is_some_and(|owners| owners.contains_key(&owner))
    }

    pub(super) fn has_owner(&self, digest: &Digest) -> bool {
        self.of_blob.contains_key(digest)
    }

    pub(super) fn take(&mut self, digest: &Digest, owner: Owner) -> bool {
        let Some(owners) = self.of_blob.get_mut(digest) else { return false };
        let had = owners.remove(&owner).is_some();
        if owners.is_empty() {
            self.of_blob.remove(digest);
        }
        self.subtract(digest, owner);
        had
    }

    pub(super) fn forget(&mut self, digest: &Digest) {
        for owner in self.of_blob.remove(digest).unwrap_or_default().into_keys() {
            self.subtract(digest, owner);
        }
    }

    pub(super) fn bytes(&self, owner: Owner) -> u64 {
        self.of_owner.get(&owner).map_or(0, |held| held.bytes)
    }

    /// What the owner has, with sizes, the longest held first.
    pub(super) fn oldest(&self, owner: Owner) -> Vec<(Digest, u64)> {
        let Some(held) = self.of_owner.get(&owner) else { return Vec::new() };
        let since = |digest: &Digest| self.of_blob.get(digest).and_then(|owners| owners.get(&owner)).copied();
        let mut all: Vec<_> = held.sizes.iter().map(|(digest, size)| (since(digest), *digest, *size)).collect();
        all.sort_unstable();
        all.into_iter().map(|(_, digest, size)| (digest, size)).collect()
    }

    fn subtract(&mut self, digest: &Digest, owner: Owner) {
        let Some(held) = self.of_owner.get_mut(&owner) else { return };
        if let Some(size) = held.sizes.remove(digest) {
            held.bytes = held.bytes.saturating_sub(size);
        }
        if held.sizes.is_empty() {
            self.of_owner.remove(&owner);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn add(owners: &mut Owners, digest: Digest, size_bytes: u64, owner: Owner) -> Option<Owner> {
        owners.add(digest, size_bytes, owner, |_| false)
    }

    #[test]
    fn the_index_adds_up_and_forgets() {
        let (mut owners, a, b) = (Owners::default(), Owner::of("a"), Owner::of("b"));
        let [one, two] = [b"1", b"2"].map(|bytes| Digest::of(bytes));
        assert!(
            add(&mut owners, one, 10, a).is_none()
                && add(&mut owners, two, 5, a).is_none()
                && add(&mut owners, one, 10, b).is_none()
        );
        assert!(add(&mut owners, one, 10, b).is_none(), "twice is once");
        assert_eq!((owners.bytes(a), owners.bytes(b)), (15, 10));
        // What was taken anew is the youngest.
        add(&mut owners, one, 10, a);
        assert_eq!(owners.oldest(a), [(two, 5), (one, 10)]);
        assert!(owners.take(&one, a) && !owners.take(&one, a) && owners.has_owner(&one));
        owners.forget(&one);
        assert!(!owners.has(&one, b) && owners.bytes(b) == 0 && owners.of_owner.len() == 1);
        owners.forget(&two);
        assert!(owners.of_blob.is_empty() && owners.of_owner.is_empty());
    }

    #[test]
    fn invented_names_replace_each_other() {
        let (mut owners, digest) = (Owners::default(), Digest::of(b"1"));
        let name = |i: usize| Owner::of(&i.to_string());
        let [early, late, needed] = ["early", "late", "needed"].map(Owner::of);
        add(&mut owners, digest, 1, early);
        for i in 0..3 * MOST {
            if i == 2 * MOST {
                // One that has something else too, and one that a job needs.
                add(&mut owners, Digest::of(b"2"), 1, late);
                add(&mut owners, digest, 1, late);
                add(&mut owners, digest, 1, needed);
            }
            owners.add(digest, 1, name(i), |owner| owner == needed);
            assert!(owners.has(&digest, name(i)), "who has just sent it has it");
        }
        assert_eq!((owners.of_blob[&digest].len(), owners.of_owner.len()), (MOST, MOST));
        assert!([early, late, needed].iter().all(|owner| owners.has(&digest, *owner)));
    }
}
