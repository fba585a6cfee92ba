//! The keys of a running server.
//!
//! Purpose: [`Table`] finds keys, [`Pass`] is the right of one call. Invariant: a key that stays from one set to the next keeps
//! its rate and its open calls; one that goes, or whose time is over, ends them. A key that is not there costs as much to look
//! for as one that is. Must not know: requests, files.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::future::Future;
use std::num::NonZeroU32;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::task::{Context, Poll};

use governor::clock::{Clock as _, DefaultClock};
use governor::{DefaultDirectRateLimiter, Quota};
use http_body::{Frame, SizeHint};
use tokio::sync::watch;
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::Bytes;
use tonic::codegen::http::HeaderMap;

use super::Refusal;
use crate::keys::{Hash, Key, KeySet, Secret};
use crate::service::RequestError;

#[derive(Default)]
pub(super) struct Table {
    keys: HashMap<String, Arc<Entry>>,
    names: HashSet<String>,
}

struct Entry {
    key: Key,
    open: Arc<AtomicU32>,
    /// Open at other servers, as they said last.
    elsewhere: Arc<AtomicU32>,
    rate: Option<Arc<DefaultDirectRateLimiter>>,
    ended: Arc<watch::Sender<bool>>,
}

impl Table {
    /// The table of another set.
    pub(super) fn next(&self, set: &KeySet) -> Self {
        let mut next = Self::default();
        for key in set.keys() {
            let old = self.keys.get(&key.id).filter(|old| old.key.sha256 == key.sha256 && old.key.name == key.name);
            let limiter = || {
                let limit = NonZeroU32::new(key.limits.rate?)?;
                Some(Arc::new(DefaultDirectRateLimiter::direct(Quota::per_second(limit))))
            };
            let entry = Entry {
                key: key.clone(),
                open: old.map(|old| Arc::clone(&old.open)).unwrap_or_default(),
                elsewhere: old.map(|old| Arc::clone(&old.elsewhere)).unwrap_or_default(),
                rate: match old {
                    Some(old) if old.key.limits.rate == key.limits.rate => old.rate.clone(),
                    _ => limiter(),
                },
                ended: old.map(|old| Arc::clone(&old.ended)).unwrap_or_default(),
            };
            next.names.insert(key.name.clone());
            next.keys.insert(key.id.clone(), Arc::new(entry));
        }
        for (id, old) in &self.keys {
            let stays = next.keys.get(id).is_some_and(|entry| Arc::ptr_eq(&entry.ended, &old.ended));
            if !stays {
                old.ended.send_replace(true);
            }
        }
        next
    }

    /// Whether a set is another than this table's.
    pub(super) fn differs(&self, set: &KeySet) -> bool {
        let same = |key: &Key| self.keys.get(&key.id).is_some_and(|entry| entry.key == *key);
        set.keys().len() != self.keys.len() || !set.keys().iter().all(same)
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.names.contains(name)
    }

    pub(super) fn weights(&self) -> Vec<(String, f64)> {
        let of = |entry: &Arc<Entry>| Some((entry.key.name.clone(), entry.key.limits.weight?));
        let mut weights: Vec<_> = self.keys.values().filter_map(of).collect();
        // Of two keys of a name the larger one counts: it is set last.
        weights.sort_by(|a, b| a.1.total_cmp(&b.1));
        weights
    }

    /// Whether a key limits its open calls.
    pub(super) fn limits_calls(&self) -> bool {
        self.keys.values().any(|entry| entry.key.limits.in_flight.is_some())
    }

    /// Open calls here of keys that limit them.
    pub(super) fn open_calls(&self) -> BTreeMap<String, u32> {
        let limited = self.keys.iter().filter(|(_, entry)| entry.key.limits.in_flight.is_some());
        let open = limited.map(|(id, entry)| (id.clone(), entry.open.load(Ordering::Acquire)));
        open.filter(|(_, open)| *open > 0).collect()
    }

    /// Open calls of these keys at other servers; none of all others.
    pub(super) fn set_elsewhere(&self, open: &BTreeMap<String, u32>) {
        for (id, entry) in &self.keys {
            entry.elsewhere.store(open.get(id).copied().unwrap_or(0), Ordering::Release);
        }
    }

    /// Ends the calls of keys whose time is over.
    pub(super) fn end_expired(&self, now: u64) {
        for entry in self.keys.values().filter(|entry| entry.key.is_expired(now)) {
            entry.ended.send_if_modified(|ended| !std::mem::replace(ended, true));
        }
    }

    /// The key that this is the secret of. Whether its id is known or not, one hash is made and compared.
    pub(super) fn find(&self, secret: &Secret, now: u64) -> Option<Pass> {
        let entry = self.keys.get(secret.id());
        let hash = entry.map_or(Hash::OF_NONE, |entry| entry.key.sha256);
        let is_good = hash.is_of(secret);
        let entry = entry.filter(|entry| is_good & !entry.key.is_expired(now))?;
        Some(Pass { entry: Arc::clone(entry), is_open: false })
    }
}

/// The right of one call, which counts as open until this is dropped.
pub struct Pass {
    entry: Arc<Entry>,
    is_open: bool,
}

impl Pass {
    pub(super) fn key(&self) -> &Key {
        &self.entry.key
    }

    /// Takes one of the calls that the key has a second.
    pub(super) fn take_turn(&self) -> Result<(), Refusal> {
        let Some(rate) = &self.entry.rate else { return Ok(()) };
        rate.check().map_err(|not_until| Refusal::Rate {
            limit: self.entry.key.limits.rate.unwrap_or(0),
            wait: not_until.wait_time_from(DefaultClock::default().now()),
        })
    }

    /// Counts the call as open from now on.
    pub(super) fn open(mut self) -> Result<Self, Refusal> {
        let limit = self.entry.key.limits.in_flight.unwrap_or(u32::MAX);
        let elsewhere = self.entry.elsewhere.load(Ordering::Acquire);
        let more = |open: u32| (open.saturating_add(elsewhere) < limit).then(|| open + 1);
        match self.entry.open.fetch_update(Ordering::AcqRel, Ordering::Acquire, more) {
            Ok(_) => {
                self.is_open = true;
                Ok(self)
            }
            Err(_) => Err(Refusal::InFlight { limit }),
        }
    }

    /// Ready once the key is revoked or its time is over.
    pub fn ended(&self) -> impl Future<Output = ()> + Send + use<> {
        let mut ended = self.entry.ended.subscribe();
        async move {
            if ended.wait_for(|ended| *ended).await.is_err() {
                std::future::pending().await
            }
        }
    }
}

impl Drop for Pass {
    fn drop(&mut self) {
        if self.is_open {
            self.entry.open.fetch_sub(1, Ordering::AcqRel);
        }
    }
}

/// The answer to a call with a key: keeps the call's place until it has left, and ends it, with a status, if the key does.
pub(super) struct Held {
    body: Body,
    ended: Pin<Box<dyn Future<Output = ()> + Send>>,
    _pass: Pass,
    is_cut: bool,
}

impl Held {
    pub(super) fn new(body: Body, pass: Pass) -> Self {
        Self { body, ended: Box::pin(pass.ended()), _pass: pass, is_cut: false }
    }
}

impl http_body::Body for Held {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        if self.is_cut {
            return Poll::Ready(None);
        }
        if self.ended.as_mut().poll(context).is_ready() {
            self.is_cut = true;
            // The work for the answer sees that its client is gone.
            self.body = Body::empty();
            let mut trailers = HeaderMap::new();
            // A status that is no header cannot be: its text is plain.
            let _ = Status::from(RequestError::unauthenticated()).add_header(&mut trailers);
            return Poll::Ready(Some(Ok(Frame::trailers(trailers))));
        }
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.is_cut || self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        if self.is_cut { SizeHint::with_exact(0) } else { self.body.size_hint() }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::keys::{KeyLimits, NewKey, Role, now, work};

    fn set(limits: KeyLimits, lasts: Option<Duration>) -> (KeySet, Secret) {
        let mut set = KeySet::default();
        let new = NewKey { name: "a".to_owned(), role: Role::Submit, lasts, limits, is_second: false };
        let (_, secret) = set.add(new).unwrap();
        (set, secret)
    }

    #[test]
    fn an_unknown_key_costs_what_a_known_one_does() {
        let (set, good) = set(KeyLimits::default(), None);
        let (_, unknown) = self::set(KeyLimits::default(), None);
        let table = Table::default().next(&set);
        let known = Secret::parse(&good.reveal().replace(good.reveal().rsplit_once('_').unwrap().1, &"0".repeat(64)));
        let cost = |secret: &Secret, found: bool| {
            let before = work::done();
            assert_eq!(table.find(secret, now()).is_some(), found);
            work::done() - before
        };
        let costs = [cost(&good, true), cost(&known.unwrap(), false), cost(&unknown, false)];
        assert_eq!(costs, [costs[0]; 3]);
        assert!(costs[0] > 0);
    }

    #[test]
    fn limits_are_kept_and_live_on_in_the_next_table() {
        let limits = KeyLimits { rate: Some(2), in_flight: Some(1), ..KeyLimits::default() };
        let (mut set, secret) = set(limits, None);
        let table = Table::default().next(&set);
        let pass = || table.find(&secret, now()).unwrap();
        let open = pass().open().ok().unwrap();
        assert!(matches!(pass().open(), Err(Refusal::InFlight { limit: 1 })));
        assert!(pass().take_turn().is_ok() && pass().take_turn().is_ok());
        let Err(Refusal::Rate { limit: 2, wait }) = pass().take_turn() else { panic!("two a second") };
        assert!(wait > Duration::ZERO && wait <= Duration::from_millis(500), "{wait:?}");
        let (other, _) =
            set.add(NewKey { name: "b".to_owned(), role: Role::Read, lasts: None, limits, is_second: false }).unwrap();
        assert!(table.differs(&set));
        let next = table.next(&set);
        assert!(!next.differs(&set) && next.has("b"));
        assert!(matches!(next.find(&secret, now()).unwrap().open(), Err(Refusal::InFlight { .. })));
        assert!(matches!(next.find(&secret, now()).unwrap().take_turn(), Err(Refusal::Rate { .. })));
        drop(open);
        assert!(next.limits_calls() && !Table::default().limits_calls());
        assert!(next.find(&secret, now()).unwrap().open().is_ok());
        // One call at another server takes the place, until it is heard that it has ended.
        next.set_elsewhere(&BTreeMap::from([(secret.id().to_owned(), 1)]));
        assert!(matches!(next.find(&secret, now()).unwrap().open(), Err(Refusal::InFlight { limit: 1 })));
        next.set_elsewhere(&BTreeMap::new());
        let open = next.find(&secret, now()).unwrap().open().ok().unwrap();
        assert_eq!(next.open_calls(), BTreeMap::from([(secret.id().to_owned(), 1)]));
        drop(open);
        set.revoke(&other.id).unwrap();
        assert!(!next.next(&set).has("b"));
    }

    #[tokio::test]
    async fn a_key_that_goes_ends_its_calls() {
        let (mut set, secret) = set(KeyLimits::default(), Some(Duration::from_secs(100)));
        let table = Table::default().next(&set);
        let pass = table.find(&secret, now()).unwrap();
        let mut ended = Box::pin(pass.ended());
        assert!(tokio::time::timeout(Duration::from_millis(20), &mut ended).await.is_err());
        set.revoke("a").unwrap();
        let next = table.next(&set);
        ended.await;
        assert!(next.find(&secret, now()).is_none());
        let table = {
            let (set, secret) = self::set(KeyLimits::default(), Some(Duration::from_secs(100)));
            let table = Table::default().next(&set);
            let pass = table.find(&secret, now()).unwrap();
            table.end_expired(now() + 99);
            assert!(tokio::time::timeout(Duration::from_millis(20), pass.ended()).await.is_err());
            assert!(table.find(&secret, now() + 100).is_none());
            table.end_expired(now() + 100);
            pass.ended().await;
            table
        };
        table.end_expired(now() + 100);
    }
}
