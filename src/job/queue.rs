//! A bounded queue between many callers and one worker.
//!
//! Purpose: order, a limit, and a clean end.
//! Invariant: at most `limit` new jobs wait or have a place kept for them; continuations of admitted work (a session's
//! next step, a diagram's next batch) always get in, since each admitted caller has at most one waiting, and so do jobs
//! that had a place kept. A place is kept for [`KEPT`]: a slow upload does not keep others out.
//! Closing refuses what is new and keeps what waits. Must not know: what the work is.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::JobError;
use crate::token::Token;

/// How long a place is kept for a job that is still being uploaded. Later the job gets in as well, but others do too.
const KEPT: Duration = Duration::from_secs(30);

/// Where a piece of work gets in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// A new job: at the back, if there is room.
    New,
    /// A new job for which a place was kept: at the back, always.
    Kept,
    /// The next command of an admitted session: at the back, always.
    Session,
    /// More of a job whose turn it was: at the front, always.
    Continuation,
}

/// What waits. Dropping an item must be harmless.
pub(crate) trait Item: Send {
    /// Whether somebody still waits for the answer.
    fn is_wanted(&self) -> bool;
    /// The flag that stops it while it runs.
    fn token(&self) -> &Token;
}

/// What [`Queue::pop`] found.
pub(crate) enum Popped<T> {
    /// Work.
    Item(T),
    /// No work within the time given.
    Nothing,
    /// No work, and none will come.
    Closed,
}

/// See the module's head.
pub(crate) struct Queue<T> {
    state: Mutex<State<T>>,
    ready: Condvar,
    limit: usize,
}

struct State<T> {
    waiting: VecDeque<(Place, T)>,
    /// Since when places are kept, by ticket.
    kept: BTreeMap<u64, Instant>,
    tickets: u64,
    running: Option<Token>,
    closed: bool,
    /// The worker has gone: nothing that gets in now would ever be answered.
    ended: bool,
    /// Moving mean of how long an item takes, for the advice to a refused caller.
    mean_s: f64,
}

impl<T: Item> Queue<T> {
    /// Room for `limit` new jobs besides the one at work.
    pub(crate) fn new(limit: usize) -> Self {
        let state = State {
            waiting: VecDeque::new(),
            kept: BTreeMap::new(),
            tickets: 0,
            running: None,
            closed: false,
            ended: false,
            mean_s: 0.5,
        };
        Self { state: Mutex::new(state), ready: Condvar::new(), limit }
    }

    /// Keeps a place for a new job; gives the ticket to give back.
    ///
    /// # Errors
    /// `QueueFull`, `Draining`.
    pub(crate) fn keep(&self) -> Result<u64, JobError> {
        let mut state = self.lock();
        if state.closed {
            return Err(JobError::Draining);
        }
        state.make_room(self.limit)?;
        let ticket = state.tickets;
        state.tickets += 1;
        state.kept.insert(ticket, Instant::now());
        Ok(ticket)
    }

    /// The place is needed no more.
    pub(crate) fn give_back(&self, ticket: u64) {
        self.lock().kept.remove(&ticket);
    }

    /// Puts an item in and says how many are ahead of it, the one at work included.
    ///
    /// # Errors
    /// `QueueFull`, `Draining` (for what is new, and for all once the worker has gone).
    pub(crate) fn push(&self, place: Place, item: T) -> Result<usize, JobError> {
        let mut state = self.lock();
        if state.ended || (state.closed && matches!(place, Place::New | Place::Kept)) {
            return Err(JobError::Draining);
        }
        if place == Place::New {
            state.make_room(self.limit)?;
        }
        let ahead = usize::from(state.running.is_some());
        let position = if place == Place::Continuation {
            state.waiting.push_front((place, item));
            ahead
        } else {
            state.waiting.push_back((place, item));
            ahead + state.waiting.len() - 1
        };
        drop(state);
        self.ready.notify_one();
        Ok(position)
    }

    /// Waits for the next item that is still wanted, for ever or so long.
    pub(crate) fn pop(&self, patience: Option<Duration>) -> Popped<T> {
        let mut state = self.lock();
        let mut waited = false;
        loop {
            state.running = None;
            while let Some((_, item)) = state.waiting.pop_front() {
                if item.is_wanted() {
                    state.running = Some(item.token().clone());
                    return Popped::Item(item);
                }
                // Its destructor may free much; not under the lock.
                drop(state);
                drop(item);
                state = self.lock();
            }
            if state.closed {
                state.ended = true;
                return Popped::Closed;
            }
            let Some(patience) = patience else {
                state = self.ready.wait(state).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            if waited {
                return Popped::Nothing;
            }
            // A wake-up for nothing only shortens the wait.
            state = self.ready.wait_timeout(state, patience).unwrap_or_else(PoisonError::into_inner).0;
            waited = true;
        }
    }

    /// Tells how long an item took.
    pub(crate) fn learn(&self, took: Duration) {
        let mut state = self.lock();
        state.mean_s = 0.8 * state.mean_s + 0.2 * took.as_secs_f64();
    }

    /// Items that wait, and whether one is at work.
    pub(crate) fn load(&self) -> (usize, bool) {
        let state = self.lock();
        (state.waiting.len(), state.running.is_some())
    }

    /// Refuses what is new from now on.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.ready.notify_all();
    }

    /// The worker has gone: drops what waits, so that its callers hear of it, and refuses all.
    pub(crate) fn end(&self) {
        let mut state = self.lock();
        state.closed = true;
        state.ended = true;
        state.running = None;
        let left = std::mem::take(&mut state.waiting);
        drop(state);
        drop(left);
    }

    /// Cancels what waits and what runs.
    pub(crate) fn cancel_all(&self) {
        let state = self.lock();
        state.running.iter().for_each(Token::cancel);
        state.waiting.iter().for_each(|(_, item)| item.token().cancel());
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T: Item> State<T> {
    /// New jobs that wait, and places that are kept for others.
    fn new_jobs(&self) -> usize {
        let waiting = self.waiting.iter().filter(|(place, _)| matches!(place, Place::New | Place::Kept)).count();
        waiting + self.kept.values().filter(|since| since.elapsed() < KEPT).count()
    }

    /// Sees to it that fewer than `limit` new jobs wait, or says that there is no room.
    fn make_room(&mut self, limit: usize) -> Result<(), JobError> {
        if self.new_jobs() < limit {
            return Ok(());
        }
        // Those whose callers have gone hold a place until somebody needs it.
        self.waiting.retain(|(place, item)| !matches!(place, Place::New | Place::Kept) || item.is_wanted());
        let waiting = self.new_jobs();
        if waiting < limit {
            return Ok(());
        }
        let seconds = (self.mean_s * waiting as f64 * 0.5).clamp(0.1, 30.0);
        Err(JobError::QueueFull { waiting, retry_after: Duration::from_secs_f64(seconds) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Ticket(u32, bool, Token);

    impl Item for Ticket {
        fn is_wanted(&self) -> bool {
            self.1
        }
        fn token(&self) -> &Token {
            &self.2
        }
    }

    fn pop(queue: &Queue<Ticket>) -> Option<Ticket> {
        match queue.pop(Some(Duration::from_millis(1))) {
            Popped::Item(ticket) => Some(ticket),
            Popped::Nothing | Popped::Closed => None,
        }
    }

    fn ticket(id: u32, wanted: bool) -> Ticket {
        Ticket(id, wanted, Token::default())
    }

    #[test]
    fn full_refuses_what_is_new_only_and_forgets_who_has_gone() {
        let queue = Queue::new(2);
        assert_eq!(queue.push(Place::New, ticket(0, true)).unwrap(), 0);
        assert_eq!(queue.push(Place::New, ticket(1, false)).unwrap(), 1);
        assert_eq!(queue.push(Place::New, ticket(2, true)).unwrap(), 1, "the one who has gone makes room");
        assert!(matches!(queue.push(Place::New, ticket(3, true)), Err(JobError::QueueFull { waiting: 2, .. })));
        queue.push(Place::Session, ticket(4, true)).unwrap();
        queue.push(Place::Continuation, ticket(5, true)).unwrap();
        queue.close();
        assert!(matches!(queue.push(Place::New, ticket(6, true)), Err(JobError::Draining)));
        let order: Vec<u32> = std::iter::from_fn(|| pop(&queue)).map(|t| t.0).collect();
        assert_eq!(order, [5, 0, 2, 4], "closing keeps what waits");
    }

    #[test]
    fn a_place_is_kept_and_always_let_in() {
        let queue = Queue::new(2);
        let first = queue.keep().unwrap();
        queue.push(Place::New, ticket(0, true)).unwrap();
        assert!(matches!(queue.keep(), Err(JobError::QueueFull { waiting: 2, .. })));
        assert!(matches!(queue.push(Place::New, ticket(1, true)), Err(JobError::QueueFull { .. })));
        queue.push(Place::Kept, ticket(2, true)).unwrap();
        queue.give_back(first);
        assert!(matches!(queue.keep(), Err(JobError::QueueFull { waiting: 2, .. })));
        assert_eq!(pop(&queue).map(|t| t.0), Some(0));
        let slow = queue.keep().unwrap();
        // An upload that takes its time keeps nobody out, and gets in all the same.
        queue.lock().kept.insert(slow, Instant::now().checked_sub(KEPT).unwrap());
        queue.push(Place::New, ticket(3, true)).unwrap();
        queue.push(Place::Kept, ticket(4, true)).unwrap();
        queue.close();
        assert!(matches!(queue.keep(), Err(JobError::Draining)));
    }

    #[test]
    fn cancel_all_reaches_the_running_and_the_waiting() {
        let queue = Queue::new(4);
        for id in 0..3 {
            queue.push(Place::New, ticket(id, true)).unwrap();
        }
        let running = pop(&queue).unwrap();
        queue.cancel_all();
        assert!(running.2.is_stopped());
        queue.close();
        assert!(std::iter::from_fn(|| pop(&queue)).all(|t| t.2.is_stopped()));
    }
}
