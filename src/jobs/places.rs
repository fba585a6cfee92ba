//! Places that run out, shared between tenants.
//!
//! Purpose: [`may_take`] is the one rule for all kinds of places: streams, watches, sessions, the queue, counting, preparing.
//! [`Places`] are places of one kind, taken or refused at once, or waited for. Invariant: a tenant alone leaves a remainder, so
//! that another one's first request has a place at once; as soon as another one has a place, no tenant gets more than half. Of
//! those that wait, a tenant with fewer places goes first. Must not know: what a place is for.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use tokio::sync::{oneshot, watch};

use crate::lock;

/// A tenant gets more places while it has fewer than this times as many as are free: alone it takes four fifths, beside
/// another busy one four ninths each, and a small part is always free.
const OF_FREE: usize = 4;

/// Whether a tenant with `own` places may take one more, where `taken` of `most` are taken by all tenants.
pub fn may_take(own: usize, taken: usize, most: usize) -> bool {
    let free = most.saturating_sub(taken);
    let is_alone = taken <= own;
    match free {
        0 => false,
        _ if own == 0 => true,
        // Kept for the first request of another tenant.
        1 => false,
        _ => own < free.saturating_mul(OF_FREE) && (is_alone || own < most.div_ceil(2)),
    }
}

/// Places of one kind. Clones share them.
#[derive(Clone, Debug)]
pub struct Places(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    most: usize,
    state: Mutex<State>,
    taken: watch::Sender<usize>,
}

#[derive(Debug, Default)]
struct State {
    taken: usize,
    tenants: HashMap<Arc<str>, usize>,
    /// Those that wait, the first ones first.
    waiting: Vec<(Arc<str>, oneshot::Sender<Place>)>,
}

/// A place, given back when it is dropped.
#[derive(Debug)]
pub struct Place {
    shared: Arc<Shared>,
    tenant: Arc<str>,
}

impl State {
    fn own(&self, tenant: &str) -> usize {
        self.tenants.get(tenant).copied().unwrap_or(0)
    }

    fn add(&mut self, tenant: &Arc<str>) {
        self.taken += 1;
        *self.tenants.entry(Arc::clone(tenant)).or_default() += 1;
    }

    fn remove(&mut self, tenant: &str) {
        self.taken -= 1;
        if let Some(own) = self.tenants.get_mut(tenant) {
            *own -= 1;
            if *own == 0 {
                self.tenants.remove(tenant);
            }
        }
    }
}

impl Places {
    pub fn new(most: usize) -> Self {
        let shared = Shared { most, state: Mutex::default(), taken: watch::Sender::new(0) };
        Self(Arc::new(shared))
    }

    /// A place for a tenant; `None` if there is none, or none for this tenant.
    pub fn take(&self, tenant: &str) -> Option<Place> {
        let mut state = lock(&self.0.state);
        may_take(state.own(tenant), state.taken, self.0.most).then(|| self.0.give(&mut state, &tenant.into()))
    }

    /// Waits for a place.
    pub async fn wait(&self, tenant: &str) -> Place {
        loop {
            let given = {
                let mut state = lock(&self.0.state);
                if may_take(state.own(tenant), state.taken, self.0.most) {
                    return self.0.give(&mut state, &tenant.into());
                }
                let (give, given) = oneshot::channel();
                state.waiting.push((tenant.into(), give));
                given
            };
            // These places cannot go while somebody waits here; without an answer the question is asked again.
            if let Ok(place) = given.await {
                return place;
            }
        }
    }

    /// Ready once no place is taken.
    pub async fn idle(&self) {
        let _ = self.0.taken.subscribe().wait_for(|taken| *taken == 0).await;
    }
}

impl Shared {
    fn give(self: &Arc<Self>, state: &mut State, tenant: &Arc<str>) -> Place {
        state.add(tenant);
        self.taken.send_replace(state.taken);
        Place { shared: Arc::clone(self), tenant: Arc::clone(tenant) }
    }

    /// Whose turn it is, if there is a place for it.
    fn next(&self, state: &State) -> Option<usize> {
        let waiting = state.waiting.iter().enumerate();
        let able = waiting.filter(|(_, (tenant, _))| may_take(state.own(tenant), state.taken, self.most));
        able.min_by_key(|(at, (tenant, _))| (state.own(tenant), *at)).map(|(at, _)| at)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        // Places of callers that have gone; dropped when nothing is locked.
        let mut gone = Vec::new();
        let mut state = lock(&self.shared.state);
        state.remove(&self.tenant);
        while let Some(at) = self.shared.next(&state) {
            let (tenant, give) = state.waiting.remove(at);
            if !give.is_closed() {
                gone.extend(give.send(self.shared.give(&mut state, &tenant)).err());
            }
        }
        self.shared.taken.send_replace(state.taken);
        drop(state);
        drop(gone);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_tenant_alone_leaves_a_place_for_each_of_several_others() {
        for most in 2..400 {
            let places = Places::new(most);
            let all = |tenant: &str| std::iter::from_fn(|| places.take(tenant)).collect::<Vec<_>>();
            let first = all("a");
            assert!(first.len() < most && first.len() >= most / 2, "{most}: {}", first.len());
            let second = all("b");
            assert!(!second.is_empty() && second.len() <= most.div_ceil(2), "{most}");
            if most >= 16 {
                assert!(!all("c").is_empty() && first.len() * 10 >= most * 7, "{most}");
            }
            drop(first);
            let again = all("a");
            assert!(again.len() <= most.div_ceil(2), "{most}: half beside another");
        }
        let one = Places::new(1);
        let held = one.take("a");
        assert!(held.is_some() && one.take("b").is_none());
        drop(held);
        assert!(one.take("b").is_some() && Places::new(0).take("a").is_none());
    }

    #[tokio::test]
    async fn whoever_has_fewer_places_goes_first() {
        let places = Places::new(2);
        let (a, b) = (places.take("a").unwrap(), places.take("b").unwrap());
        let order = Arc::new(Mutex::new(Vec::new()));
        let mut all = tokio::task::JoinSet::new();
        for tenant in ["a", "a", "a", "c"] {
            let (places, order) = (places.clone(), Arc::clone(&order));
            all.spawn(async move {
                let place = places.wait(tenant).await;
                lock(&order).push(tenant);
                drop(place);
            });
            tokio::task::yield_now().await;
        }
        // Of a caller that has gone nothing is left.
        let gone = tokio::spawn({
            let places = places.clone();
            async move { places.wait("d").await }
        });
        tokio::task::yield_now().await;
        gone.abort();
        let _ = gone.await;
        drop(b);
        while let Some(done) = all.join_next().await {
            done.unwrap();
            if lock(&order).len() == 1 {
                break;
            }
        }
        assert_eq!(*lock(&order), ["c"], "a has one already");
        drop(a);
        while all.join_next().await.is_some() {}
        places.idle().await;
        assert_eq!(lock(&places.0.state).tenants.len(), 0);
    }
}
