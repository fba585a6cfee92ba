//! What waits for a host thread, and what is next.
//!
//! Purpose: a bounded queue between many callers and several workers, in two lanes. Jobs are taken by fair shares of their
//! tenants ([`schedule`](super::schedule)); short pieces of admitted work (a session's next step, a diagram's next batch)
//! have workers of their own and never wait for a whole job.
//! Invariant: at most `limit` new jobs wait or hold a reservation, shared between tenants; what was admitted always gets in. A reservation counts
//! for [`RESERVATION_TTL`], so a slow upload does not keep others out. Closing refuses what is new and keeps what waits; nothing
//! gets in once all workers have gone. Must not know: what the work is.

use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::Notify;

use crate::engine::schedule::{AdmissionRequest, Schedule, Slots, Turn};
use crate::places::may_take;
use crate::record::{Bytes, JobId};
use crate::{JobError, lock};
use geometry::token::Token;

/// How long a reservation counts against the limit. A job that is uploaded later still gets in, but others do too.
const RESERVATION_TTL: Duration = Duration::from_secs(30);

/// How a piece of work is admitted to the queue.
#[derive(Clone, Debug)]
pub enum Admission {
    /// A new job: if there is room.
    New(AdmissionRequest),
    /// A new job with a reservation, or a persistent one: always.
    Reserved(AdmissionRequest),
    /// The next command of an admitted session: at the back of the short lane, always.
    Session,
    /// More of a job whose turn it was: at the front of the short lane, always.
    Continuation,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lane {
    Jobs,
    /// Pieces of admitted work.
    Short,
}

/// What waits. Dropping an item must be harmless.
pub(crate) trait Item: Send {
    fn is_wanted(&self) -> bool;
    /// The flag that stops it while it runs.
    fn token(&self) -> &Token;
}

/// An item whose turn it is. Its number is to be given back to [`Queue::done`].
pub(crate) struct Dequeued<T> {
    pub item: T,
    pub number: u64,
    /// Whether its tenant has nothing else at work or waiting: it may have all threads.
    pub is_alone: bool,
}

pub(crate) enum Popped<T> {
    Item(Dequeued<T>),
    /// No work within the time given.
    Nothing,
    /// No work, and none will come.
    Closed,
}

pub(crate) struct Queue<T> {
    state: Mutex<State<T>>,
    ready: Condvar,
    /// An item is done: there may be a free place.
    freed: Notify,
    limit: usize,
}

struct State<T> {
    jobs: Schedule<T>,
    short: VecDeque<T>,
    reservations: BTreeMap<u64, (Instant, Arc<str>)>,
    tickets: u64,
    running: HashMap<u64, Running>,
    kept: Kept,
    closed: bool,
    /// The workers have gone: nothing that gets in now would ever be answered.
    ended: bool,
    /// Moving mean of how long a job takes, for the advice to a refused caller.
    mean_s: f64,
}

struct Running {
    token: Token,
    kept: Option<JobId>,
}

/// Jobs of a store that wait or are at work.
#[derive(Default)]
struct Kept {
    jobs: HashMap<JobId, (Arc<str>, Token)>,
    tenants: HashMap<Arc<str>, usize>,
}

impl Kept {
    fn insert(&mut self, id: JobId, tenant: Arc<str>, token: Token) {
        *self.tenants.entry(Arc::clone(&tenant)).or_default() += 1;
        self.jobs.insert(id, (tenant, token));
    }

    fn remove(&mut self, id: JobId) -> Option<Token> {
        let (tenant, token) = self.jobs.remove(&id)?;
        if let Some(count) = self.tenants.get_mut(&tenant) {
            *count -= 1;
            if *count == 0 {
                self.tenants.remove(&tenant);
            }
        }
        Some(token)
    }
}

impl<T: Item> Queue<T> {
    /// Room for `limit` new jobs besides those at work.
    pub(crate) fn new(limit: usize, slots: Slots) -> Self {
        let state = State {
            jobs: Schedule::new(slots),
            short: VecDeque::new(),
            reservations: BTreeMap::new(),
            tickets: 0,
            running: HashMap::new(),
            kept: Kept::default(),
            closed: false,
            ended: false,
            mean_s: 0.5,
        };
        Self { state: Mutex::new(state), ready: Condvar::new(), freed: Notify::new(), limit }
    }

    /// Reserves a place for a new job. The number is for [`Self::release`]. Errors: `QueueFull`, `Draining`.
    pub(crate) fn reserve(&self, tenant: &str) -> Result<u64, JobError> {
        let mut state = lock(&self.state);
        if state.closed {
            return Err(JobError::Draining);
        }
        state.make_room(self.limit, tenant)?;
        let ticket = state.number();
        state.reservations.insert(ticket, (Instant::now(), tenant.into()));
        Ok(ticket)
    }

    pub(crate) fn release(&self, ticket: u64) {
        lock(&self.state).reservations.remove(&ticket);
    }

    /// Puts an item in and says how many are ahead of it, those at work included.
    /// Errors: `QueueFull`, `Draining` (for what is new, and for all once the workers have gone).
    pub(crate) fn push(&self, admission: Admission, item: T) -> Result<usize, JobError> {
        let mut state = lock(&self.state);
        let is_new = matches!(admission, Admission::New(_) | Admission::Reserved(_));
        if state.ended || (state.closed && is_new) {
            return Err(JobError::Draining);
        }
        if let Admission::New(request) = &admission {
            state.make_room(self.limit, &request.tenant)?;
        }
        let position = match admission {
            Admission::New(request) | Admission::Reserved(request) => {
                let ahead = state.jobs.running() + state.jobs.waiting();
                if let Some(id) = request.kept {
                    state.kept.insert(id, Arc::clone(&request.tenant), item.token().clone());
                }
                state.jobs.push(request, item);
                ahead
            }
            Admission::Session => {
                state.short.push_back(item);
                state.short.len() - 1
            }
            Admission::Continuation => {
                state.short.push_front(item);
                0
            }
        };
        drop(state);
        self.ready.notify_all();
        Ok(position)
    }

    /// Waits for the next item of a lane that is still wanted, at most `patience` if given.
    pub(crate) fn pop(&self, lane: Lane, patience: Option<Duration>) -> Popped<T> {
        let mut state = lock(&self.state);
        let mut waited = false;
        loop {
            let mut unwanted = Vec::new();
            let taken = state.take(lane, &mut unwanted);
            if !unwanted.is_empty() {
                // Their destructors may free much; not under the lock.
                drop(state);
                drop(unwanted);
                state = lock(&self.state);
            }
            if let Some(taken) = taken {
                return Popped::Item(taken);
            }
            if state.is_over(lane) {
                state.ended = state.ended || state.is_over(Lane::Short);
                drop(state);
                self.ready.notify_all();
                return Popped::Closed;
            }
            if waited && patience.is_some() {
                return Popped::Nothing;
            }
            // What does not fit now may be let past others later: somebody has to look again.
            let pause = match lane {
                Lane::Jobs => [patience, state.jobs.look_again()].into_iter().flatten().min(),
                Lane::Short => patience,
            };
            state = match pause {
                // A wake-up for nothing only shortens the wait.
                Some(pause) => self.ready.wait_timeout(state, pause).unwrap_or_else(PoisonError::into_inner).0,
                None => self.ready.wait(state).unwrap_or_else(PoisonError::into_inner),
            };
            waited = true;
        }
    }

    /// An item that was taken is done, and took so long.
    pub(crate) fn done(&self, number: u64, took: Duration) {
        let mut state = lock(&self.state);
        if let Some(id) = state.running.remove(&number).and_then(|running| running.kept) {
            state.kept.remove(id);
        }
        if let Some(seconds) = state.jobs.done(number, took.as_secs_f64()) {
            state.mean_s = 0.8 * state.mean_s + 0.2 * seconds;
        }
        drop(state);
        self.ready.notify_all();
        self.freed.notify_one();
    }

    /// Whether one more job would begin at once, its memory aside.
    pub(crate) fn has_place(&self) -> bool {
        let state = lock(&self.state);
        !state.closed && state.jobs.has_place()
    }

    /// Ends once an item is done, also one since the last call. For one caller at a time.
    pub(crate) async fn freed(&self) {
        self.freed.notified().await;
    }

    /// Memory that jobs at work are planned to need.
    pub(crate) fn planned(&self) -> Bytes {
        lock(&self.state).jobs.planned()
    }

    /// The job with this token turned out to need more than was predicted.
    pub(crate) fn plan_more(&self, token: &Token, seconds: f64, memory: Bytes) {
        let mut state = lock(&self.state);
        let number = state.running.iter().find(|(_, running)| running.token.is_same(token)).map(|(&number, _)| number);
        number.into_iter().for_each(|number| state.jobs.plan_more(number, seconds, memory));
    }

    /// A job at work has threads of its own, so that it can be suspended.
    pub(crate) fn set_preemptible(&self, number: u64) {
        lock(&self.state).jobs.set_preemptible(number);
    }

    /// Items that wait, and whether one is at work.
    pub(crate) fn load(&self) -> (usize, bool) {
        let state = lock(&self.state);
        (state.jobs.waiting() + state.short.len(), !state.running.is_empty())
    }

    pub(crate) fn close(&self) {
        lock(&self.state).closed = true;
        self.ready.notify_all();
    }

    /// The workers have gone: drops what waits, so that its callers hear of it, and refuses all.
    pub(crate) fn end(&self) {
        let mut state = lock(&self.state);
        state.closed = true;
        state.ended = true;
        state.release_kept();
        // No worker is left to let them go on later.
        state.running.values().for_each(|running| running.token.go_on());
        let left = (state.jobs.drain(), std::mem::take(&mut state.short));
        drop(state);
        drop(left);
        self.ready.notify_all();
    }

    pub(crate) fn cancel_all(&self) {
        let mut state = lock(&self.state);
        state.running.values().for_each(|running| running.token.cancel());
        state.jobs.iter().map(|(item, _)| item).chain(&state.short).for_each(|item| item.token().cancel());
        state.release_kept();
    }

    /// Jobs of a store that wait or are at work: a tenant's, or all.
    pub(crate) fn kept(&self, tenant: Option<&str>) -> usize {
        let state = lock(&self.state);
        match tenant {
            Some(tenant) => state.kept.tenants.get(tenant).copied().unwrap_or(0),
            None => state.kept.jobs.len(),
        }
    }

    /// Takes a job of a store out of the line and cancels it. An unknown one is ignored.
    pub(crate) fn remove_kept(&self, id: JobId) {
        let gone = lock(&self.state).kept.remove(id);
        gone.iter().for_each(Token::cancel);
    }

    /// Cancels the jobs of the store, whether they wait or are at work.
    pub(crate) fn cancel_kept(&self) {
        lock(&self.state).kept.jobs.values().for_each(|(_, token)| token.cancel());
    }

    /// Takes the waiting jobs of the store out of the line: the store has them.
    pub(crate) fn release_kept(&self) {
        lock(&self.state).release_kept();
    }
}

impl<T: Item> State<T> {
    fn release_kept(&mut self) {
        let running: HashSet<JobId> = self.running.values().filter_map(|running| running.kept).collect();
        let waiting: Vec<JobId> = self.kept.jobs.keys().filter(|id| !running.contains(id)).copied().collect();
        waiting.into_iter().filter_map(|id| self.kept.remove(id)).for_each(|token| token.cancel());
    }

    fn number(&mut self) -> u64 {
        self.tickets += 1;
        self.tickets
    }

    /// Takes the next item of a lane. Those whose callers have gone go to `unwanted`.
    fn take(&mut self, lane: Lane, unwanted: &mut Vec<T>) -> Option<Dequeued<T>> {
        let number = self.number();
        let (item, kept, is_alone) = match lane {
            Lane::Short => loop {
                let item = self.short.pop_front()?;
                if item.is_wanted() {
                    break (item, None, false);
                }
                unwanted.push(item);
            },
            Lane::Jobs => loop {
                match self.jobs.next(number, T::is_wanted, unwanted)? {
                    Turn::Begin { item, kept, is_alone } => break (item, kept, is_alone),
                    Turn::Suspend(number) => self.running.get(&number).into_iter().for_each(|job| job.token.suspend()),
                    Turn::GoOn(number) => self.running.get(&number).into_iter().for_each(|job| job.token.go_on()),
                }
            },
        };
        self.running.insert(number, Running { token: item.token().clone(), kept });
        Some(Dequeued { item, number, is_alone })
    }

    /// Whether a worker of this lane has nothing more to do.
    fn is_over(&self, lane: Lane) -> bool {
        let no_jobs = self.jobs.waiting() == 0 && self.jobs.suspended() == 0;
        match lane {
            Lane::Jobs => self.ended || (self.closed && no_jobs),
            // What runs may have more to do.
            Lane::Short => self.ended || (self.closed && no_jobs && self.short.is_empty() && self.running.is_empty()),
        }
    }

    /// New jobs that wait, and places that are kept for others: a tenant's, and all.
    fn new_jobs(&self, tenant: &str) -> (usize, usize) {
        let waiting =
            self.jobs.iter().filter(|(_, request)| request.kept.is_none()).map(|(_, request)| &request.tenant);
        let reserved = self.reservations.values().filter(|(since, _)| since.elapsed() < RESERVATION_TTL);
        let all = waiting.chain(reserved.map(|(_, tenant)| tenant));
        all.fold((0, 0), |(own, all), other| (own + usize::from(**other == *tenant), all + 1))
    }

    /// Sees to it that there is room for one more new job of a tenant, or says that there is none.
    fn make_room(&mut self, limit: usize, tenant: &str) -> Result<(), JobError> {
        let has_room = |(own, waiting)| may_take(own, waiting, limit);
        if has_room(self.new_jobs(tenant)) {
            return Ok(());
        }
        // Jobs whose callers have gone hold a place until it is needed.
        self.jobs.retain(T::is_wanted);
        let (own, waiting) = self.new_jobs(tenant);
        if has_room((own, waiting)) {
            return Ok(());
        }
        let seconds = (self.mean_s * waiting as f64 * 0.5).clamp(0.1, 30.0);
        Err(JobError::QueueFull { waiting, retry_after: Duration::from_secs_f64(seconds) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Time;

    struct Ticket(u32, bool, Token);

    impl Item for Ticket {
        fn is_wanted(&self) -> bool {
            self.1
        }
        fn token(&self) -> &Token {
            &self.2
        }
    }

    fn queue(limit: usize) -> Queue<Ticket> {
        // One tenant leaves a place.
        Queue::new(limit + 1, Slots { regular: 1, memory: Bytes::MAX })
    }

    fn new() -> Admission {
        Admission::New(AdmissionRequest::default())
    }

    fn reservations() -> Admission {
        Admission::Reserved(AdmissionRequest::default())
    }

    fn pop(queue: &Queue<Ticket>, lane: Lane) -> Option<Ticket> {
        match queue.pop(lane, Some(Duration::from_millis(1))) {
            Popped::Item(taken) => {
                queue.done(taken.number, Duration::ZERO);
                Some(taken.item)
            }
            Popped::Nothing | Popped::Closed => None,
        }
    }

    fn ticket(id: u32, wanted: bool) -> Ticket {
        Ticket(id, wanted, Token::default())
    }

    #[test]
    fn full_refuses_what_is_new_only_and_forgets_who_has_gone() {
        let queue = queue(2);
        assert_eq!(queue.push(new(), ticket(0, true)).unwrap(), 0);
        assert_eq!(queue.push(new(), ticket(1, false)).unwrap(), 1);
        assert_eq!(queue.push(new(), ticket(2, true)).unwrap(), 1, "the one who has gone makes room");
        assert!(matches!(queue.push(new(), ticket(3, true)), Err(JobError::QueueFull { waiting: 2, .. })));
        queue.push(Admission::Session, ticket(4, true)).unwrap();
        queue.push(Admission::Continuation, ticket(5, true)).unwrap();
        queue.close();
        assert!(matches!(queue.push(new(), ticket(6, true)), Err(JobError::Draining)));
        let order = |lane| -> Vec<u32> { std::iter::from_fn(|| pop(&queue, lane)).map(|t| t.0).collect() };
        assert_eq!(order(Lane::Jobs), [0, 2], "closing keeps what waits");
        assert_eq!(order(Lane::Short), [5, 4], "and what was admitted");
        assert!(matches!(queue.push(Admission::Session, ticket(7, true)), Err(JobError::Draining)), "nobody is left");
    }

    #[test]
    fn a_place_is_kept_and_always_let_in() {
        let queue = queue(2);
        let first = queue.reserve("").unwrap();
        queue.push(new(), ticket(0, true)).unwrap();
        assert!(matches!(queue.reserve(""), Err(JobError::QueueFull { waiting: 2, .. })));
        assert!(matches!(queue.push(new(), ticket(1, true)), Err(JobError::QueueFull { .. })));
        queue.push(reservations(), ticket(2, true)).unwrap();
        queue.release(first);
        assert!(matches!(queue.reserve(""), Err(JobError::QueueFull { waiting: 2, .. })));
        assert_eq!(pop(&queue, Lane::Jobs).map(|t| t.0), Some(0));
        let slow = queue.reserve("").unwrap();
        // A slow upload keeps no other job out, and gets in all the same.
        lock(&queue.state).reservations.insert(slow, (Instant::now().checked_sub(RESERVATION_TTL).unwrap(), "".into()));
        queue.push(new(), ticket(3, true)).unwrap();
        queue.push(reservations(), ticket(4, true)).unwrap();
        // So does a job of a store, and it takes no place.
        queue
            .push(
                Admission::Reserved(AdmissionRequest {
                    kept: Some(JobId::new(Time(1), 1)),
                    ..AdmissionRequest::default()
                }),
                ticket(5, true),
            )
            .unwrap();
        queue.close();
        assert!(matches!(queue.reserve(""), Err(JobError::Draining)));
    }

    #[test]
    fn a_session_does_not_wait_for_a_job() {
        let queue = queue(2);
        queue.push(new(), ticket(0, true)).unwrap();
        let Popped::Item(job) = queue.pop(Lane::Jobs, None) else { panic!("a job waits") };
        queue.push(new(), ticket(1, true)).unwrap();
        queue.push(Admission::Session, ticket(2, true)).unwrap();
        assert!(pop(&queue, Lane::Jobs).is_none(), "there is one slot");
        assert_eq!(pop(&queue, Lane::Short).map(|t| t.0), Some(2));
        queue.close();
        assert!(matches!(queue.pop(Lane::Short, Some(Duration::ZERO)), Popped::Nothing), "what runs may have more");
        queue.done(job.number, Duration::from_secs(1));
        assert_eq!(pop(&queue, Lane::Jobs).map(|t| t.0), Some(1));
        assert!(matches!(queue.pop(Lane::Short, None), Popped::Closed));
    }

    #[test]
    fn kept_jobs_are_counted_until_they_are_done_or_removed() {
        let queue = queue(1);
        let push = |number: u32, tenant: &str| {
            let kept = Some(JobId::new(Time(1), number.into()));
            let request = AdmissionRequest { kept, tenant: tenant.into(), ..AdmissionRequest::default() };
            queue.push(Admission::Reserved(request), ticket(number, true)).unwrap();
        };
        for (number, tenant) in [(0, "a"), (1, "a"), (2, "b")] {
            push(number, tenant);
        }
        assert_eq!([queue.kept(None), queue.kept(Some("a")), queue.kept(Some("c"))], [3, 2, 0]);
        let Popped::Item(running) = queue.pop(Lane::Jobs, None) else { panic!("three wait") };
        queue.remove_kept(JobId::new(Time(1), 9));
        queue.release_kept();
        assert_eq!(queue.kept(None), 1, "the one at work");
        assert!(!running.item.2.is_stopped());
        queue.done(running.number, Duration::ZERO);
        assert_eq!(queue.kept(None), 0);
        push(3, "a");
        queue.remove_kept(JobId::new(Time(1), 3));
        assert_eq!(queue.kept(Some("a")), 0);
    }

    #[test]
    fn cancel_all_reaches_the_running_and_the_waiting() {
        let queue = queue(4);
        for id in 0..3 {
            queue.push(new(), ticket(id, true)).unwrap();
        }
        let Popped::Item(running) = queue.pop(Lane::Jobs, None) else { panic!("three wait") };
        queue.cancel_all();
        assert!(running.item.2.is_stopped());
        queue.done(running.number, Duration::ZERO);
        queue.close();
        assert!(std::iter::from_fn(|| pop(&queue, Lane::Jobs)).all(|t| t.2.is_stopped()));
    }
}
