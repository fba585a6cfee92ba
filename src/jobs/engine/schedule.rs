//! Fair shares between tenants.
//!
//! Purpose: [`Schedule`] holds the jobs that wait and says which is next: start-time fair queueing between tenants by seconds
//! of work (Goyal, Vin, Cheng, *Start-time Fair Queueing*, SIGCOMM 1996), priorities within a tenant, then the order in
//! which they came.
//!
//! - Every tenant has a virtual time, which grows by the seconds that its jobs take, divided by its weight. The tenant with
//!   the least is next. One that comes new, or comes back, begins at the virtual time of the others, and so has no debt and no savings.
//! - A job is charged what it is expected to take when it begins, and what it really took when it ends.
//! - [`Slots::regular`] jobs are at work at once. One more may be, of a tenant that has none at work: a flood of one tenant's
//!   jobs never has all slots.
//! - Jobs at work together need no more memory than there is, of the host and of the device. A job that does not fit waits;
//!   others may bypass it for [`BYPASS_LIMIT`], then nothing begins until it fits.
//! - Predictions may be wrong, and every slot taken by jobs of other tenants that take minutes. A short job then preempts the
//!   job whose tenant has had most, once that has been at work for [`QUANTUM`]. The preempted job is suspended: it keeps its
//!   memory and counts as waiting, and goes on when it is its tenant's turn.
//!
//! Invariant: pure bookkeeping; a job is waiting, running, suspended or gone. A job that needs more than there is begins once it
//! is alone. Must not know: threads, clocks but for [`BYPASS_LIMIT`] and [`QUANTUM`], what a job does.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use crate::record::Bytes;

use crate::observe::activity::Origin;
use crate::record::JobId;

/// How long others may bypass a job that does not fit.
const BYPASS_LIMIT: Duration = Duration::from_secs(10);

/// How long a job is at work before another may preempt it, and by how much more its tenant has had.
const QUANTUM: Duration = Duration::from_secs(1);
/// Predicted seconds of a job that may preempt others before it has begun.
const SHORT_S: f64 = 1.0;
/// The most jobs that are suspended at once: each holds a thread.
pub(crate) const MOST_SUSPENDED: usize = 8;
/// How often jobs that may preempt others look for one.
const LOOK_AGAIN: Duration = Duration::from_millis(100);

/// How many jobs may be at work at once, and what they may need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Slots {
    /// At least 1; one more for a tenant that has none at work.
    pub regular: usize,
    pub memory: Bytes,
}

/// The smallest weight, and the largest.
const LEAST_WEIGHT: f64 = 0.01;
const MOST_WEIGHT: f64 = 100.0;

/// Weights of tenants: how large the share of each is beside others'. Without one it is 1. Clones share one table.
#[derive(Clone, Debug, Default)]
pub struct Weights(Arc<RwLock<HashMap<String, f64>>>);

impl Weights {
    pub fn of(&self, tenant: &str) -> f64 {
        self.0.read().unwrap_or_else(PoisonError::into_inner).get(tenant).copied().unwrap_or(1.0)
    }

    /// Sets the weights of these tenants, and 1 for all others. Jobs that wait already keep theirs.
    pub fn set(&self, weights: impl IntoIterator<Item = (String, f64)>) {
        let sound = weights.into_iter().filter(|(_, weight)| weight.is_finite());
        let table = sound.map(|(tenant, weight)| (tenant, weight.clamp(LEAST_WEIGHT, MOST_WEIGHT))).collect();
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = table;
    }
}

/// A job for the scheduler: its tenant, share and priority, and its expected cost.
#[derive(Clone, Debug)]
pub struct AdmissionRequest {
    pub tenant: Arc<str>,
    /// How much of the work the tenant gets beside others, each of which has 1 if nothing else is said. Above 0.
    pub weight: f64,
    /// The higher goes first among those of its tenant.
    pub priority: i32,
    pub seconds: f64,
    pub memory: Bytes,
    /// Its name if a store keeps it. It then does not count against the queue's limit.
    pub kept: Option<JobId>,
    /// Whether later pieces of work continue what its first one makes, such as a session.
    pub has_continuations: bool,
    /// For metrics; what has none is not counted.
    pub origin: Option<Origin>,
}

impl Default for AdmissionRequest {
    fn default() -> Self {
        Self {
            tenant: "".into(),
            weight: 1.0,
            priority: 0,
            seconds: 0.5,
            memory: Bytes::default(),
            kept: None,
            has_continuations: false,
            origin: None,
        }
    }
}

struct Waiting<T> {
    item: T,
    request: AdmissionRequest,
    /// Since when others bypass it.
    bypassed: Option<Instant>,
}

/// The order within a tenant.
type Rank = (Reverse<i32>, u64);

struct Tenant<T> {
    /// Virtual time, seconds.
    time: f64,
    /// Jobs at work.
    running: usize,
    suspended: usize,
    waiting: BTreeMap<Rank, Waiting<T>>,
}

impl<T> Tenant<T> {
    fn is_idle(&self) -> bool {
        self.running == 0 && self.suspended == 0 && self.waiting.is_empty()
    }
}

/// A job that has begun.
struct Running {
    tenant: Arc<str>,
    weight: f64,
    /// Seconds that its tenant was charged for it.
    charged: f64,
    memory: Bytes,
    /// When it began or went on, or was suspended.
    since: Instant,
    /// Seconds at work before that.
    worked: f64,
    /// Seconds that it was suspended.
    rested: f64,
    suspended: bool,
    /// Whether it can be suspended.
    preemptible: bool,
}

impl Running {
    /// Seconds at work.
    fn seconds(&self) -> f64 {
        self.worked + if self.suspended { 0.0 } else { self.since.elapsed().as_secs_f64() }
    }

    /// How much its tenant has had, with what this job took beyond its prediction.
    fn time(&self, tenant: f64) -> f64 {
        tenant + (self.seconds() - self.charged).max(0.0) / self.weight
    }
}

/// What is to be done next.
#[derive(Debug, PartialEq)]
pub(crate) enum Turn<T> {
    /// A job begins.
    Begin {
        item: T,
        /// Its name if a store keeps it.
        kept: Option<JobId>,
        /// Whether its tenant has nothing else at work or waiting.
        is_alone: bool,
    },
    /// A running job is to be suspended.
    Suspend(u64),
    /// A suspended job is to go on.
    GoOn(u64),
}

pub(crate) struct Schedule<T> {
    slots: Slots,
    tenants: HashMap<Arc<str>, Tenant<T>>,
    running: HashMap<u64, Running>,
    /// Virtual time at which the last job began.
    time: f64,
    planned: Bytes,
    waiting: usize,
    came: u64,
}

impl<T> Schedule<T> {
    pub(crate) fn new(slots: Slots) -> Self {
        let slots = Slots { regular: slots.regular.max(1), ..slots };
        Self {
            slots,
            tenants: HashMap::new(),
            running: HashMap::new(),
            time: 0.0,
            planned: Bytes::default(),
            waiting: 0,
            came: 0,
        }
    }

    pub(crate) fn waiting(&self) -> usize {
        self.waiting
    }

    pub(crate) fn running(&self) -> usize {
        self.running.len()
    }

    /// Whether a regular place is free that no waiting job takes.
    pub(crate) fn has_place(&self) -> bool {
        self.waiting + self.running.len() < self.slots.regular
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (&T, &AdmissionRequest)> {
        let waiting = self.tenants.values().flat_map(|tenant| tenant.waiting.values());
        waiting.map(|waiting| (&waiting.item, &waiting.request))
    }

    pub(crate) fn push(&mut self, request: AdmissionRequest, item: T) {
        self.came += 1;
        self.waiting += 1;
        let time = self.time;
        let tenant = self.tenants.entry(Arc::clone(&request.tenant));
        let tenant = tenant.or_insert_with(|| Tenant { time, running: 0, suspended: 0, waiting: BTreeMap::new() });
        if tenant.is_idle() {
            tenant.time = tenant.time.max(time);
        }
        tenant.waiting.insert((Reverse(request.priority), self.came), Waiting { item, request, bypassed: None });
    }

    pub(crate) fn retain(&mut self, keep: impl Fn(&T) -> bool) {
        for tenant in self.tenants.values_mut() {
            tenant.waiting.retain(|_, waiting| keep(&waiting.item));
        }
        self.waiting = self.tenants.values().map(|tenant| tenant.waiting.len()).sum();
        self.forget();
    }

    pub(crate) fn drain(&mut self) -> Vec<T> {
        self.waiting = 0;
        let all = self.tenants.values_mut().flat_map(|tenant| std::mem::take(&mut tenant.waiting).into_values());
        all.map(|waiting| waiting.item).collect()
    }

    /// When to ask [`Self::next`] again though nothing has changed; `None`: there is no need.
    pub(crate) fn look_again(&self) -> Option<Duration> {
        let bypassed = self.tenants.values().filter_map(|tenant| tenant.waiting.values().next()?.bypassed);
        let preempts = self.may_preempt().next().map(|_| LOOK_AGAIN);
        bypassed
            .map(|since| BYPASS_LIMIT.saturating_sub(since.elapsed()))
            .chain(preempts)
            .min()
            .map(|left| left.max(Duration::from_millis(10)))
    }

    /// Memory that jobs that have begun are planned to need.
    pub(crate) fn planned(&self) -> Bytes {
        self.planned
    }

    /// A running job turned out to need more than was predicted. Nothing else begins that does not fit beside it.
    pub(crate) fn plan_more(&mut self, number: u64, seconds: f64, memory: Bytes) {
        let Some(job) = self.running.get_mut(&number) else { return };
        let more = memory.minus(job.memory);
        self.planned = self.planned.plus(more);
        job.memory = job.memory.plus(more);
        let charge = (seconds - job.charged).max(0.0);
        job.charged += charge;
        if let Some(tenant) = self.tenants.get_mut(&job.tenant) {
            tenant.time += charge / job.weight;
        }
    }

    pub(crate) fn suspended(&self) -> usize {
        self.running.values().filter(|job| job.suspended).count()
    }

    /// A running job can be suspended.
    pub(crate) fn set_preemptible(&mut self, number: u64) {
        if let Some(job) = self.running.get_mut(&number) {
            job.preemptible = true;
        }
    }

    /// Tenants that have nothing at work, and either a short job that may begin or a suspended one.
    fn may_preempt(&self) -> impl Iterator<Item = &Tenant<T>> {
        let may_begin = self.suspended() < MOST_SUSPENDED;
        let left = self.slots.memory.minus(self.planned);
        let is_short = move |waiting: &Waiting<T>| {
            may_begin && waiting.request.seconds <= SHORT_S && waiting.request.memory.fits(left)
        };
        self.tenants.values().filter(move |tenant| {
            tenant.running == 0 && (tenant.suspended > 0 || tenant.waiting.values().next().is_some_and(&is_short))
        })
    }

    /// The job to suspend for another tenant's.
    fn preempted(&self) -> Option<u64> {
        let least = self.may_preempt().map(|tenant| tenant.time).min_by(f64::total_cmp)?;
        let at_work =
            self.running.iter().filter(|(_, job)| job.preemptible && !job.suspended && job.since.elapsed() >= QUANTUM);
        let times = at_work.filter_map(|(&number, job)| Some((job.time(self.tenants.get(&job.tenant)?.time), number)));
        let (most, number) = times.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (most > least + QUANTUM.as_secs_f64()).then_some(number)
    }

    /// A job is suspended or goes on. Its tenant is charged what it took so far.
    fn switch(&mut self, number: u64, suspended: bool) {
        let Some(job) = self.running.get_mut(&number) else { return };
        let took = job.since.elapsed().as_secs_f64();
        *(if suspended { &mut job.worked } else { &mut job.rested }) += took;
        (job.since, job.suspended) = (Instant::now(), suspended);
        let Some(tenant) = self.tenants.get_mut(&job.tenant) else { return };
        let (one, other) = (&mut tenant.running, &mut tenant.suspended);
        let (from, to) = if suspended { (one, other) } else { (other, one) };
        (*from, *to) = (*from - 1, *to + 1);
        if suspended {
            tenant.time += (job.worked - job.charged) / job.weight;
            job.charged = job.worked;
        }
    }

    /// What is next: a job that is wanted begins, or a running one makes room for another. Unwanted jobs go to `gone`. `number`
    /// names a job that begins, for [`Self::done`].
    pub(crate) fn next(&mut self, number: u64, is_wanted: impl Fn(&T) -> bool, gone: &mut Vec<T>) -> Option<Turn<T>> {
        for tenant in self.tenants.values_mut() {
            while let Some(first) = tenant.waiting.first_entry().filter(|first| !is_wanted(&first.get().item)) {
                gone.push(first.remove().item);
                self.waiting -= 1;
            }
        }
        let at_work = self.running.len() - self.suspended();
        if at_work > self.slots.regular {
            let number = self.preempted()?;
            self.switch(number, true);
            return Some(Turn::Suspend(number));
        }
        let may_begin = self.suspended() <= MOST_SUSPENDED;
        let mut turns: Vec<(f64, u64, Arc<str>)> = Vec::new();
        for (name, tenant) in &self.tenants {
            if at_work < self.slots.regular || tenant.running == 0 {
                // One that has begun goes before those that wait.
                let first = tenant.waiting.keys().next().map(|&(_, came)| came);
                let came = if tenant.suspended > 0 { Some(0) } else { first.filter(|_| may_begin) };
                turns.extend(came.map(|came| (tenant.time, came, Arc::clone(name))));
            }
        }
        turns.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let left = self.slots.memory.minus(self.planned);
        for (time, _, name) in turns {
            let of_tenant = self.running.iter().filter(|(_, job)| job.suspended && job.tenant == name);
            if let Some(number) = of_tenant.map(|(&number, _)| number).min() {
                self.switch(number, false);
                return Some(Turn::GoOn(number));
            }
            let Some(tenant) = self.tenants.get_mut(&name) else { continue };
            let Some(mut first) = tenant.waiting.first_entry() else { continue };
            if !first.get().request.memory.fits(left) && !self.running.is_empty() {
                let since = *first.get_mut().bypassed.get_or_insert_with(Instant::now);
                if since.elapsed() >= BYPASS_LIMIT {
                    return None;
                }
                continue;
            }
            let Waiting { item, request, .. } = first.remove();
            self.waiting -= 1;
            let is_alone = tenant.is_idle();
            tenant.running += 1;
            tenant.time += request.seconds / request.weight;
            self.time = self.time.max(time);
            self.planned = self.planned.plus(request.memory);
            let AdmissionRequest { weight, seconds, memory, kept, .. } = request;
            let job = Running {
                tenant: name,
                weight,
                charged: seconds,
                memory,
                since: Instant::now(),
                worked: 0.0,
                rested: 0.0,
                suspended: false,
                preemptible: false,
            };
            self.running.insert(number, job);
            return Some(Turn::Begin { item, kept, is_alone });
        }
        None
    }

    /// A job that was taken is done, this long after it began. Returns its seconds at work, if there was such a job.
    pub(crate) fn done(&mut self, number: u64, seconds: f64) -> Option<f64> {
        let job = self.running.remove(&number)?;
        self.planned = self.planned.minus(job.memory);
        let rests = if job.suspended { job.since.elapsed().as_secs_f64() } else { 0.0 };
        let seconds = (seconds - job.rested - rests).max(0.0);
        if let Some(tenant) = self.tenants.get_mut(&job.tenant) {
            *(if job.suspended { &mut tenant.suspended } else { &mut tenant.running }) -= 1;
            tenant.time += (seconds - job.charged) / job.weight;
        }
        self.forget();
        Some(seconds)
    }

    /// Forgets tenants that are no different from new ones.
    fn forget(&mut self) {
        let now = self.time;
        self.tenants.retain(|_, tenant| !tenant.is_idle() || tenant.time > now);
        if self.running.is_empty() && self.waiting == 0 {
            // A debt counts against waiting tenants, and there are none.
            self.tenants.clear();
            self.time = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(tenant: &str, seconds: f64) -> AdmissionRequest {
        AdmissionRequest { tenant: tenant.into(), seconds, ..AdmissionRequest::default() }
    }

    fn schedule(regular: usize, host: u64) -> Schedule<&'static str> {
        Schedule::new(Slots { regular, memory: Bytes { host, device: 50 } })
    }

    fn next(schedule: &mut Schedule<&'static str>, number: u64) -> Option<&'static str> {
        match schedule.next(number, |_| true, &mut Vec::new()) {
            Some(Turn::Begin { item, .. }) => Some(item),
            turn => {
                assert_eq!(turn, None);
                None
            }
        }
    }

    /// Lets the jobs at work be there for longer.
    fn pass(schedule: &mut Schedule<&'static str>, time: Duration) {
        schedule.running.values_mut().for_each(|job| job.since = job.since.checked_sub(time).unwrap());
    }

    #[test]
    fn a_short_job_preempts_those_that_take_longer_than_was_predicted() {
        let mut schedule = schedule(1, u64::MAX);
        let turn = |schedule: &mut Schedule<_>, number| schedule.next(number, |_| true, &mut Vec::new());
        for (number, name) in [(0, "a"), (1, "b")] {
            schedule.push(request(name, 0.4), "wrong");
            assert_eq!(next(&mut schedule, number), Some("wrong"));
        }
        schedule.push(request("c", 0.1), "tiny");
        schedule.push(request("d", 30.0), "long");
        pass(&mut schedule, Duration::from_secs(9));
        assert_eq!(turn(&mut schedule, 2), None, "neither can be suspended");
        (0..2).for_each(|number| schedule.set_preemptible(number));
        schedule.running.get_mut(&1).unwrap().worked = 5.0;
        assert_eq!(turn(&mut schedule, 2), Some(Turn::Suspend(1)), "its tenant has had most");
        assert_eq!(next(&mut schedule, 2), Some("tiny"));
        assert_eq!(turn(&mut schedule, 3), None, "the other one is not short, and the suspended one has had more");
        assert_eq!(schedule.look_again(), Some(LOOK_AGAIN));
        // The next short one waits for a quantum, as it would for itself.
        assert_eq!(schedule.done(2, 0.1), Some(0.1));
        assert_eq!(next(&mut schedule, 3), Some("long"), "whose tenant has had nothing");
        pass(&mut schedule, Duration::from_secs(3));
        assert_eq!(schedule.done(0, 12.0), Some(12.0));
        assert_eq!(turn(&mut schedule, 4), Some(Turn::GoOn(1)));
        assert_eq!((schedule.suspended(), schedule.running()), (0, 2));
        // What it rested is not charged.
        pass(&mut schedule, Duration::from_secs(2));
        let seconds = schedule.done(1, 19.0).unwrap();
        assert!((15.9..=16.0).contains(&seconds), "{seconds}");
        assert!(schedule.done(3, 3.0).is_some());
        assert_eq!(schedule.tenants.len(), 0);
    }

    #[test]
    fn suspended_jobs_take_turns_and_are_bounded() {
        let mut schedule = schedule(1, u64::MAX);
        let names: Vec<String> = (0..20).map(|k| format!("t{k}")).collect();
        names.iter().for_each(|name| schedule.push(request(name, 0.4), "wrong"));
        let mut number = 0;
        let mut most = 0;
        for _ in 0..200 {
            match schedule.next(number, |_| true, &mut Vec::new()) {
                Some(Turn::Begin { .. }) => {
                    schedule.set_preemptible(number);
                    number += 1;
                }
                Some(_) => {}
                None => pass(&mut schedule, Duration::from_secs(2)),
            }
            most = most.max(schedule.suspended());
            assert!(schedule.running() - schedule.suspended() <= 2);
        }
        // One more while two take turns.
        assert_eq!((most, number), (MOST_SUSPENDED + 1, MOST_SUSPENDED as u64 + 2));
        let worked: Vec<f64> = schedule.running.values().map(Running::seconds).collect();
        assert!(worked.iter().all(|seconds| *seconds > 4.0), "each gets on: {worked:?}");
    }

    #[test]
    fn a_flood_does_not_hold_up_another_tenant() {
        let mut schedule = schedule(2, u64::MAX);
        for _ in 0..30 {
            schedule.push(request("flood", 3.0), "huge");
        }
        assert_eq!((next(&mut schedule, 0), next(&mut schedule, 1)), (Some("huge"), Some("huge")));
        assert_eq!(next(&mut schedule, 2), None, "the third slot is for another tenant");
        schedule.push(request("other", 0.1), "tiny");
        assert_eq!(next(&mut schedule, 2), Some("tiny"), "which does not wait");
        schedule.push(request("other", 0.1), "tiny");
        assert_eq!(next(&mut schedule, 3), None);
        assert!(schedule.done(0, 3.0).is_some());
        assert_eq!(next(&mut schedule, 3), None, "two are at work, one of each");
        assert!(schedule.done(2, 0.1).is_some());
        assert_eq!(next(&mut schedule, 3), Some("tiny"), "its tenant has had less");
        assert_eq!(schedule.waiting(), 28);
    }

    #[test]
    fn tenants_share_by_seconds() {
        let mut schedule = schedule(1, u64::MAX);
        for _ in 0..1000 {
            schedule.push(request("a", 1.0), "a");
            schedule.push(request("b", 4.0), "b");
        }
        let mut seconds = HashMap::from([("a", 0.0), ("b", 0.0)]);
        for number in 0..500 {
            let name = next(&mut schedule, number).unwrap();
            // Whatever was expected, what counts is what it took.
            let took = if name == "a" { 2.0 } else { 1.0 };
            *seconds.get_mut(name).unwrap() += took;
            schedule.done(number, took);
        }
        assert!((seconds["a"] / seconds["b"] - 1.0).abs() < 0.05, "{seconds:?}");
    }

    #[test]
    fn weights_share_in_their_ratio() {
        let mut schedule = schedule(1, u64::MAX);
        for _ in 0..1000 {
            schedule.push(AdmissionRequest { weight: 4.0, ..request("heavy", 1.0) }, "heavy");
            schedule.push(request("light", 1.0), "light");
        }
        let mut heavy = 0;
        for number in 0..500 {
            heavy += usize::from(next(&mut schedule, number) == Some("heavy"));
            // Whatever was expected, both take as long.
            schedule.done(number, 2.0);
        }
        assert!((398..=402).contains(&heavy), "{heavy} of 500");
    }

    #[test]
    fn who_comes_back_has_no_savings() {
        let mut schedule = schedule(1, u64::MAX);
        schedule.push(request("late", 1.0), "late");
        next(&mut schedule, 0).unwrap();
        schedule.done(0, 1.0);
        for _ in 0..100 {
            schedule.push(request("busy", 1.0), "busy");
        }
        for number in 1..50 {
            assert_eq!(next(&mut schedule, number), Some("busy"));
            schedule.done(number, 1.0);
        }
        for _ in 0..10 {
            schedule.push(request("late", 1.0), "late");
        }
        let turns: Vec<_> = (50..60)
            .map(|number| {
                let name = next(&mut schedule, number).unwrap();
                schedule.done(number, 1.0);
                name
            })
            .collect();
        assert_eq!(turns.iter().filter(|name| **name == "late").count(), 5, "{turns:?}");
    }

    #[test]
    fn priorities_go_first_within_a_tenant_only() {
        let mut schedule = schedule(8, u64::MAX);
        schedule.push(AdmissionRequest { priority: -1, ..request("a", 1.0) }, "last");
        schedule.push(request("a", 1.0), "second");
        schedule.push(request("a", 1.0), "third");
        schedule.push(AdmissionRequest { priority: 5, ..request("a", 1.0) }, "first");
        schedule.push(request("b", 1.0), "other");
        let order: Vec<_> = (0..5).map(|number| next(&mut schedule, number).unwrap()).collect();
        assert_eq!(order, ["first", "other", "second", "third", "last"]);
    }

    #[test]
    fn memory_is_shared_and_what_never_fits_with_others_runs_alone() {
        let mut schedule = schedule(4, 100);
        let of =
            |tenant: &str, host: u64| AdmissionRequest { memory: Bytes { host, device: 0 }, ..request(tenant, 1.0) };
        schedule.push(of("a", 60), "first");
        schedule.push(of("b", 60), "large");
        schedule.push(of("c", 40), "small");
        assert_eq!((next(&mut schedule, 0), next(&mut schedule, 1)), (Some("first"), Some("small")));
        assert_eq!(next(&mut schedule, 2), None);
        assert!(schedule.look_again().is_some_and(|pause| pause <= BYPASS_LIMIT));
        // Others bypass it for a limited time.
        let tenant = schedule.tenants.get_mut("b").unwrap();
        tenant.waiting.values_mut().next().unwrap().bypassed = Instant::now().checked_sub(BYPASS_LIMIT);
        schedule.push(of("d", 0), "tiny");
        assert_eq!(next(&mut schedule, 2), None);
        schedule.done(0, 1.0);
        schedule.done(1, 1.0);
        assert_eq!((next(&mut schedule, 2), next(&mut schedule, 3)), (Some("large"), Some("tiny")));
        schedule.done(2, 1.0);
        schedule.done(3, 1.0);
        schedule.push(of("e", 1000), "monster");
        assert_eq!(next(&mut schedule, 4), Some("monster"), "it is alone");
    }

    #[test]
    fn a_job_that_needs_more_is_planned_with_more() {
        let mut schedule = schedule(4, 100);
        let of =
            |tenant: &str, host: u64| AdmissionRequest { memory: Bytes { host, device: 0 }, ..request(tenant, 1.0) };
        schedule.push(of("a", 10), "first");
        schedule.push(of("b", 50), "second");
        assert_eq!(next(&mut schedule, 0), Some("first"));
        schedule.plan_more(0, 20.0, Bytes { host: 60, device: 0 });
        schedule.plan_more(0, 2.0, Bytes { host: 5, device: 0 });
        assert_eq!((schedule.planned().host, next(&mut schedule, 1)), (60, None));
        assert_eq!(schedule.tenants["a"].time, 20.0);
        schedule.done(0, 1.0);
        assert_eq!((schedule.planned().host, next(&mut schedule, 1)), (0, Some("second")));
    }

    #[test]
    fn the_device_s_memory_is_shared_too() {
        let mut schedule = schedule(4, 100);
        let of =
            |tenant: &str, device: u64| AdmissionRequest { memory: Bytes { host: 1, device }, ..request(tenant, 1.0) };
        schedule.push(of("a", 30), "first");
        schedule.push(of("b", 30), "second");
        schedule.push(of("c", 0), "on a cpu");
        assert_eq!((next(&mut schedule, 0), next(&mut schedule, 1)), (Some("first"), Some("on a cpu")));
        assert_eq!(next(&mut schedule, 2), None);
        schedule.done(0, 1.0);
        assert_eq!(next(&mut schedule, 2), Some("second"));
    }

    #[test]
    fn nothing_is_remembered_of_who_is_gone() {
        let mut schedule = schedule(1, u64::MAX);
        for number in 0..1000u64 {
            schedule.push(request(&format!("tenant {number}"), 1.0), "job");
            schedule.push(request("nobody waits", 1.0), "gone");
            let mut gone = Vec::new();
            while schedule.next(number, |item| *item != "gone", &mut gone).is_none() {}
            schedule.done(number, 0.5);
            assert!(schedule.tenants.len() <= 1, "{}", schedule.tenants.len());
            schedule.retain(|_| false);
        }
        assert_eq!((schedule.waiting(), schedule.running(), schedule.tenants.len()), (0, 0, 0));
        schedule.push(request("a", 1.0), "job");
        assert_eq!((schedule.drain().len(), schedule.waiting()), (1, 0));
    }

    #[test]
    fn who_has_none_counts_once() {
        let weights = Weights::default();
        weights.clone().set([("a".to_owned(), 4.0), ("b".to_owned(), 0.0), ("c".to_owned(), f64::NAN)]);
        assert_eq!(["a", "b", "c", "d"].map(|tenant| weights.of(tenant)), [4.0, LEAST_WEIGHT, 1.0, 1.0]);
        weights.set([]);
        assert_eq!(weights.of("a"), 1.0);
    }
}
