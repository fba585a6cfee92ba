//! Limits on the number of connections, and which ones are closed for new ones.
//!
//! Purpose: [`Places`] counts connections, in all and from each peer. Invariant: an open connection has a [`Place`], which
//! is given back when it is dropped. If all places are taken, silent connections are closed first, then idle ones.
//! Connections with requests stay. Must not know: sockets, HTTP.

use std::collections::HashMap;
use std::fmt;
use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::Notify;

use super::lock;

/// How long a connection must have been without a request before it may be asked to go.
const IDLE: Duration = Duration::from_secs(1);

/// Bits of an IPv6 address that one subscriber has.
const NETWORK_BITS: u32 = 64;

/// Activity of a connection so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Standing {
    Silent,
    Greeted,
    /// Had requests; none has been open for this time.
    Idle(Duration),
    Busy,
}

/// The interface of a connection for [`Places`].
pub(super) trait Guest: Send + Sync {
    fn standing(&self) -> Standing;
    fn evict(&self);
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Full {
    Peer,
    All,
}

pub(super) struct Places<G> {
    table: Mutex<Table<G>>,
    freed: Notify,
    most: usize,
    most_per_peer: usize,
}

struct Table<G> {
    next: u64,
    guests: HashMap<u64, (IpAddr, Arc<G>)>,
}

/// A connection's place; given back when dropped.
pub(super) struct Place<G> {
    places: Arc<Places<G>>,
    id: u64,
}

impl<G: Guest> Places<G> {
    pub(super) fn new(most: usize, most_per_peer: usize) -> Arc<Self> {
        let table = Mutex::new(Table { next: 0, guests: HashMap::new() });
        Arc::new(Self { table, freed: Notify::new(), most, most_per_peer })
    }

    /// A place for a new connection, or which limit it would pass.
    pub(super) fn claim(self: &Arc<Self>, peer: SocketAddr, guest: &Arc<G>) -> Result<Place<G>, Full> {
        let peer = network(peer.ip());
        let mut table = lock(&self.table);
        if table.guests.values().filter(|(of, _)| *of == peer).count() >= self.most_per_peer {
            return Err(Full::Peer);
        }
        if table.guests.len() >= self.most {
            return Err(Full::All);
        }
        let id = table.next;
        table.next += 1;
        table.guests.insert(id, (peer, Arc::clone(guest)));
        Ok(Place { places: Arc::clone(self), id })
    }

    /// Closes the least important connection: a silent or idle one, the oldest first. Waits for a free place, at most
    /// `patience`. Returns whether a connection was closed.
    pub(super) async fn make_room(&self, full: Full, peer: Option<SocketAddr>, patience: Duration) -> bool {
        let freed = self.freed.notified();
        tokio::pin!(freed);
        freed.as_mut().enable();
        let peer = peer.map(|peer| network(peer.ip()));
        let least = {
            let table = lock(&self.table);
            let candidates = table.guests.iter().filter(|(_, (of, _))| full == Full::All || Some(*of) == peer);
            let ranked = candidates.filter_map(|(id, (_, guest))| Some((rank(guest.standing())?, *id, guest)));
            ranked.min_by_key(|(rank, id, _)| (*rank, *id)).map(|(_, _, guest)| Arc::clone(guest))
        };
        let Some(least) = least else { return false };
        least.evict();
        let _ = tokio::time::timeout(patience, freed).await;
        true
    }

    /// Asks all to close at once.
    pub(super) fn evict_all(&self) {
        lock(&self.table).guests.values().for_each(|(_, guest)| guest.evict());
    }

    /// Ready when no connection is open.
    pub(super) async fn empty(&self) {
        loop {
            let freed = self.freed.notified();
            tokio::pin!(freed);
            freed.as_mut().enable();
            if lock(&self.table).guests.is_empty() {
                return;
            }
            freed.await;
        }
    }
}

impl<G> Drop for Place<G> {
    fn drop(&mut self) {
        lock(&self.places.table).guests.remove(&self.id);
        self.places.freed.notify_waiters();
    }
}

/// The address that counts as one peer, for request handlers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peer(IpAddr);

impl Peer {
    pub fn of(address: SocketAddr) -> Self {
        Self(network(address.ip()))
    }
}

impl fmt::Display for Peer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Order of closing, the lowest first; `None` if the connection stays.
fn rank(standing: Standing) -> Option<(u8, Duration)> {
    match standing {
        Standing::Silent => Some((0, Duration::ZERO)),
        Standing::Greeted => Some((1, Duration::ZERO)),
        // The longest first.
        Standing::Idle(time) if time >= IDLE => Some((2, Duration::MAX.saturating_sub(time))),
        Standing::Idle(_) | Standing::Busy => None,
    }
}

fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) => IpAddr::V6(Ipv6Addr::from_bits(v6.to_bits() & (u128::MAX << NETWORK_BITS))),
        v4 => v4,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    struct Fake(Standing, AtomicBool);

    impl Guest for Fake {
        fn standing(&self) -> Standing {
            self.0
        }
        fn evict(&self) {
            self.1.store(true, Ordering::SeqCst);
        }
    }

    fn guest(standing: Standing) -> Arc<Fake> {
        Arc::new(Fake(standing, AtomicBool::new(false)))
    }

    fn peer(text: &str) -> SocketAddr {
        text.parse().unwrap()
    }

    #[tokio::test]
    async fn the_silent_go_first_and_the_busy_stay() {
        let places = Places::new(4, 4);
        let long = Standing::Idle(9 * IDLE);
        let guests = [Standing::Busy, long, Standing::Greeted, Standing::Silent].map(guest);
        let held: Vec<_> = guests.iter().map(|g| places.claim(peer("10.0.0.1:1"), g).ok().unwrap()).collect();
        assert_eq!(places.claim(peer("10.0.0.2:1"), &guests[0]).err(), Some(Full::All));
        let mut held = held.into_iter().map(Some).collect::<Vec<_>>();
        for next in [3, 2, 1] {
            assert!(places.make_room(Full::All, None, Duration::ZERO).await);
            assert!(guests[next].1.load(Ordering::SeqCst), "{next}");
            held[next] = None;
        }
        assert!(!places.make_room(Full::All, None, Duration::ZERO).await, "who asks for something stays");
        assert!(!guests[0].1.load(Ordering::SeqCst));
        drop(held);
        places.empty().await;
    }

    #[tokio::test]
    async fn a_peer_has_its_own_limit() {
        let places = Places::new(10, 2);
        let all = [Standing::Silent; 4].map(guest);
        let _first = places.claim(peer("[2001:db8::1]:1"), &all[0]).ok().unwrap();
        let second = places.claim(peer("[2001:db8::ffff:2]:1"), &all[1]).ok().unwrap();
        assert_eq!(places.claim(peer("[2001:db8::3]:9"), &all[2]).err(), Some(Full::Peer), "one network");
        let _other = places.claim(peer("[2001:db8:0:1::1]:1"), &all[3]).ok().unwrap();
        assert!(places.make_room(Full::Peer, Some(peer("[2001:db8::3]:9")), Duration::ZERO).await);
        assert!(all[0].1.load(Ordering::SeqCst), "the oldest of the same peer");
        drop(second);
        assert!(places.claim(peer("[2001:db8::3]:9"), &all[2]).is_ok());
        assert_eq!(network("::ffff:10.0.0.1".parse().unwrap()), network("10.0.0.1".parse().unwrap()));
    }
}
