//! A model of a store: what should be there, in the plainest words.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::time::Duration;

use jobs::blob::{BlobError, Digest};
use jobs::record::state::{State, apply};
use jobs::record::*;
use jobs::store::*;
use tessera::proto::{JobMesh, JobSpec, MeshFile, MeshFormat, job_mesh};

use super::{KEEP, message, millis};

/// The blobs of the model: inputs, then results, by body. Each has a size of its own bit, so that a sum says which.
const BODIES: u64 = 4;

pub fn blobs() -> Vec<(Digest, u64)> {
    (0..2 * BODIES).map(|k| ([k as u8 + 1; 32].into(), 1 << k)).collect()
}

fn input(body: u64) -> Digest {
    blobs()[body as usize].0
}

/// What a job of the model results in.
pub fn result(body: u64) -> ResultSet {
    let digest = blobs()[(BODIES + body) as usize].0;
    ResultSet { blobs: [("mesh".to_owned(), digest)].into(), fingerprint: fingerprint(body) }
}

/// What decides the bits of a result; some results do not say.
fn fingerprint(body: u64) -> Option<Digest> {
    (body != 2).then(|| [0x70 + body as u8; 32].into())
}

/// A job, as the model sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct Known {
    pub request: String,
    pub body: u64,
    pub state: State,
    pub version: u64,
    pub created: Time,
    pub changed: Time,
    pub attempts: u32,
    pub crashes: u32,
    pub due: Option<Time>,
    pub until: Time,
    pub cause: Option<Cause>,
    /// The states that its events tell of.
    pub states: Vec<State>,
}

/// What should be in a store.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    pub jobs: BTreeMap<JobId, Known>,
}

/// An operation, all its arguments known.
#[derive(Clone, Debug)]
pub enum Step {
    Create { random: u128, request: String, body: u64 },
    Claim { job: Option<JobId>, room: u64, lease: Duration },
    Renew { id: JobId, at: u64, lease: Duration },
    Progress { id: JobId, at: u64 },
    Change { id: JobId, at: u64, change: Change },
    Cancel(JobId),
    Delete(JobId),
    Expire { most: usize },
    Recover(Orphans),
}

/// What an operation gives, as far as the model knows.
#[derive(Clone, Debug, PartialEq)]
pub enum Gives {
    Done,
    Created(JobId, bool),
    Claimed(Option<JobId>),
    Swept(Vec<JobId>, Vec<JobId>, bool),
    Recovered(Vec<JobId>, Vec<JobId>, Vec<JobId>),
    NotFound,
    AlreadyExists,
    NameTaken,
    Stale,
    Transition,
    NotEnded,
    /// The store could not even read: nothing was done.
    Unread,
}

/// The specification of a job of the model. Some have deadlines, by body.
pub fn body(request: &str, body: u64) -> Spec {
    let (queue_deadline, run_deadline) = match body {
        1 => (millis(300), None),
        2 => (None, millis(200)),
        _ => (None, None),
    };
    let file = MeshFile { digest: input(body).to_string(), format: MeshFormat::Ply.into(), attributes: None };
    let mesh = Some(JobMesh { source: Some(job_mesh::Source::File(file)) });
    let priority = priority(body);
    let message = JobSpec { mesh, queue_deadline, run_deadline, priority, ..message(body) };
    Spec::new(message, "t".to_owned(), request.to_owned()).unwrap()
}

/// Some jobs of the model go first.
fn priority(body: u64) -> Option<i32> {
    (body == 3).then_some(5)
}

/// What a job of the model needs.
fn needs(body: u64) -> Bytes {
    Bytes { host: 10 * body, device: 0 }
}

impl Model {
    /// The sizes of the pinned blobs, added up: of jobs that wait or run their input, of jobs that run or succeeded their
    /// result.
    pub fn pinned(&self) -> u64 {
        let bits = self.jobs.values().map(|job| match job.state {
            State::Queued => 1 << job.body,
            State::Running => (1 | 1 << BODIES) << job.body,
            State::Succeeded => 1 << (BODIES + job.body),
            _ => 0,
        });
        bits.fold(0, |all, bit| all | bit)
    }

    /// Each fingerprint, with the newest job whose kept result has it.
    pub fn same(&self) -> Vec<(Digest, Option<JobId>)> {
        let newest = |body| {
            let mut jobs = self.jobs.iter().rev();
            jobs.find(|(_, job)| job.state == State::Succeeded && job.body == body).map(|(id, _)| *id)
        };
        (0..BODIES).filter_map(|body| Some((fingerprint(body)?, newest(body)))).collect()
    }

    /// Does a step at a time.
    pub fn step(&mut self, step: &Step, now: Time) -> Gives {
        match step {
            Step::Create { random, request, body } => self.create(JobId::new(now, *random), request, *body, now),
            Step::Claim { job, room, lease } => {
                let fits = |(id, known): &(&JobId, &Known)| match job {
                    Some(job) => *id == job,
                    None => needs(known.body).host <= *room,
                };
                let waiting = self.jobs.iter().filter(|(_, known)| known.state == State::Queued);
                let first =
                    waiting.filter(fits).min_by_key(|(id, known)| (Reverse(priority(known.body).unwrap_or(0)), **id));
                let first = first.map(|(id, _)| *id);
                if let Some(id) = first {
                    self.change(id, None, &Change::Claim(holder(now.after(*lease))), now);
                }
                Gives::Claimed(first)
            }
            Step::Renew { id, at, lease } => match self.jobs.get_mut(id) {
                None => Gives::NotFound,
                Some(job) if job.version != *at || job.state != State::Running => Gives::Stale,
                Some(job) => {
                    job.until = now.after(*lease);
                    Gives::Done
                }
            },
            Step::Progress { id, at } => match self.jobs.get(id) {
                None => Gives::NotFound,
                Some(job) if job.version != *at || job.state != State::Running => Gives::Stale,
                Some(_) => Gives::Done,
            },
            Step::Change { id, at, change } => self.change(*id, Some(*at), change, now),
            Step::Cancel(id) => match self.jobs.get(id) {
                Some(job) if job.state == State::Cancelled => Gives::Done,
                _ => self.change(*id, None, &Change::Cancel, now),
            },
            Step::Delete(id) => match self.jobs.get(id) {
                None => Gives::NotFound,
                Some(job) if !job.state.is_ended() => Gives::NotEnded,
                Some(_) => {
                    self.jobs.remove(id);
                    Gives::Done
                }
            },
            Step::Expire { most } => self.expire(now, *most),
            Step::Recover(orphans) => self.recover(now, *orphans),
        }
    }

    fn create(&mut self, id: JobId, request: &str, body: u64, now: Time) -> Gives {
        let earlier = self.jobs.iter().find(|(_, job)| !request.is_empty() && job.request == request);
        match earlier {
            Some((id, job)) if job.body == body => return Gives::Created(*id, true),
            Some(_) => return Gives::AlreadyExists,
            None if self.jobs.contains_key(&id) => return Gives::NameTaken,
            None => {}
        }
        let job = Known {
            request: request.to_owned(),
            body,
            state: State::Queued,
            version: 1,
            created: now,
            changed: now,
            attempts: 0,
            crashes: 0,
            due: (body == 1).then(|| Time(now.0 + 300)),
            until: Time(0),
            cause: None,
            states: vec![State::Queued],
        };
        self.jobs.insert(id, job);
        Gives::Created(id, false)
    }

    fn change(&mut self, id: JobId, at: Option<u64>, change: &Change, now: Time) -> Gives {
        let Some(job) = self.jobs.get_mut(&id) else { return Gives::NotFound };
        if at.is_some_and(|at| at != job.version) {
            return Gives::Stale;
        }
        let Ok(state) = apply(job.state, change.transition()) else { return Gives::Transition };
        job.due = match (state, job.body) {
            (State::Queued, 1) => Some(Time(now.0 + 300)),
            (State::Running, 2) => Some(Time(now.0 + 200)),
            _ => None,
        };
        match change {
            Change::Claim(holder) => {
                job.attempts += 1;
                job.until = holder.until;
            }
            Change::Orphan => job.crashes += 1,
            Change::Fail(failure) if failure.kind == FailureKind::Crashed => job.crashes += 1,
            Change::Expire(cause) => job.cause = Some(*cause),
            _ => {}
        }
        if state != State::Running {
            job.until = Time(0);
        }
        job.state = state;
        job.version += 1;
        job.changed = now;
        job.states.push(state);
        Gives::Done
    }

    fn expire(&mut self, now: Time, most: usize) -> Gives {
        let mut due: Vec<(Time, JobId)> =
            self.jobs.iter().filter_map(|(id, job)| Some((job.due.filter(|due| *due <= now)?, *id))).collect();
        due.sort();
        let mut more = due.len() > most;
        due.truncate(most);
        let passed = |job: &Known, kept: Duration| job.changed.after(kept) <= now;
        let mut over: Vec<(Time, JobId, bool)> = Vec::new();
        for (id, job) in self.jobs.iter().filter(|(_, job)| job.state.is_ended()) {
            let is_result = job.state == State::Succeeded;
            if passed(job, if is_result { KEEP.results } else { KEEP.records }) {
                over.push((job.changed, *id, is_result));
            }
        }
        over.sort();
        let room = most - due.len();
        more |= over.len() > room;
        over.truncate(room);
        let (mut expired, mut deleted) = (Vec::new(), Vec::new());
        for (_, id) in due {
            let cause = match self.jobs[&id].state {
                State::Queued => Cause::QueueDeadline,
                _ => Cause::RunDeadline,
            };
            self.change(id, None, &Change::Expire(cause), now);
            expired.push(id);
        }
        for (_, id, is_result) in over {
            if is_result {
                self.change(id, None, &Change::Expire(Cause::Kept), now);
                expired.push(id);
            } else {
                self.jobs.remove(&id);
                deleted.push(id);
            }
        }
        Gives::Swept(expired, deleted, more)
    }

    fn recover(&mut self, now: Time, orphans: Orphans) -> Gives {
        let (mut requeued, mut failed) = (Vec::new(), Vec::new());
        let ids: Vec<JobId> = self.jobs.keys().copied().collect();
        let is_orphaned = |job: &Known| job.state == State::Running && (orphans == Orphans::All || job.until <= now);
        let orphaned: Vec<JobId> = ids.iter().filter(|id| is_orphaned(&self.jobs[*id])).copied().collect();
        let running = self.jobs.values().filter(|job| job.state == State::Running).count();
        for id in &orphaned {
            // Of several of one holder any one may be the cause.
            if self.jobs[id].crashes == 0 || running > 1 {
                self.change(*id, None, &Change::Orphan, now);
                requeued.push(*id);
            } else {
                let failure = Failure { kind: FailureKind::Crashed, message: String::new() };
                self.change(*id, None, &Change::Fail(failure), now);
                failed.push(*id);
            }
        }
        let is_queued = |id: &JobId| orphans == Orphans::All && self.jobs[id].state == State::Queued;
        let queued = ids.into_iter().filter(is_queued).collect();
        Gives::Recovered(requeued, failed, queued)
    }
}

fn holder(until: Time) -> Holder {
    Holder { name: "one".to_owned(), until }
}

/// Does a step with a store. `None` where nobody knows what became of it.
pub async fn on_store(store: &dyn JobStore, step: Step) -> Option<(Gives, Option<u64>)> {
    let mut number = None;
    let done = |result: Result<Job, StoreError>| result.map(|_| Gives::Done);
    let result = match step {
        Step::Create { random, request, body: number } => {
            let spec = body(&request, number);
            let created = store.create(NewJob { random, spec, needs: needs(number), cost: Cost::default() }).await;
            created.map(|created| Gives::Created(created.job.id, created.existed))
        }
        Step::Claim { job, room, lease } => {
            let offer = Offer { job, ..Offer::new("one", lease, Bytes { host: room, device: 0 }) };
            let claimed = store.claim_next(offer).await;
            if let Ok(Some(job)) = &claimed {
                // Whoever does the job pins its result, sooner or later.
                let body = job.spec.message().labels["body"].parse().unwrap();
                let digests: Vec<_> = result(body).blobs.into_values().collect();
                match store.index().pin(None, &result_pin(job.id), &digests).await {
                    Err(BlobError::Unavailable(_) | BlobError::Database(_)) => return None,
                    pinned => drop(pinned.unwrap()),
                }
            }
            claimed.map(|claimed| Gives::Claimed(claimed.map(|job| job.id)))
        }
        Step::Renew { id, at, lease } => store.renew(id, at, lease).await.map(|()| Gives::Done),
        Step::Progress { id, at } => {
            let progress = jobs::record::event::Progress::Stage { name: "s".to_owned(), done: 0, total: 0 };
            let given = store.progress(id, at, progress).await;
            number = given.as_ref().ok().copied();
            given.map(|_| Gives::Done)
        }
        Step::Change { id, at, change } => done(store.change(id, at, change).await),
        Step::Cancel(id) => done(store.cancel(id).await),
        Step::Delete(id) => store.delete(id).await.map(|()| Gives::Done),
        Step::Expire { most } => {
            let swept = store.expire(KEEP, most).await;
            swept.map(|swept| Gives::Swept(swept.expired, swept.deleted, swept.more))
        }
        Step::Recover(orphans) => {
            let recovered = store.recover(orphans, MAX_CRASHES).await;
            recovered.map(|r| Gives::Recovered(r.requeued, r.failed, r.queued))
        }
    };
    let gives = match result {
        Ok(gives) => gives,
        Err(StoreError::NotFound { .. }) => Gives::NotFound,
        Err(StoreError::AlreadyExists { .. }) => Gives::AlreadyExists,
        Err(StoreError::NameTaken { .. }) => Gives::NameTaken,
        Err(StoreError::Stale { .. }) => Gives::Stale,
        Err(StoreError::Transition { .. }) => Gives::Transition,
        Err(StoreError::NotEnded { .. }) => Gives::NotEnded,
        Err(StoreError::Io { .. }) => Gives::Unread,
        Err(StoreError::Broken { .. } | StoreError::Closed | StoreError::Unavailable { .. }) => return None,
        Err(error) => panic!("{error}"),
    };
    Some((gives, number))
}
