//! What can be done with jobs, on tables.
//!
//! Purpose: one implementation for the stores of one process. Invariant: an operation reads and decides before it writes, so
//! that one that is refused has written and pinned nothing; the indexes (`states`, `due`, `ended`, `terms`, `requests`, `same`) say the same as the heads.
//! Must not know: files, threads, clocks.

mod upkeep;

use std::ops::ControlFlow;

use serde::de::DeserializeOwned;

pub(crate) use upkeep::{expire, recover};

use super::codec::{Head, decode, encode};
use super::tables::{Entry, Live, Order, Table, Tables, TablesMut};
use super::{Created, NewJob, Offer, Page, Query, StoreError, rules};
use crate::blob::Digest;
use crate::record::event::{Event, Events, Log, Progress, What};
use crate::record::state::State;
use crate::record::{Bytes, Change, Holder, Job, JobId, Spec, Status, Time};

/// Numbers of events that are reserved at once: the most that are skipped if the process goes down.
const RESERVED: u64 = 1024;

type StoreResult<T> = Result<T, StoreError>;

fn state_term(state: State) -> [u8; 1] {
    [state as u8]
}

fn state_key(state: State, id: JobId) -> Vec<u8> {
    [&state_term(state)[..], &id.0].concat()
}

fn time_key(time: Time, id: JobId) -> Vec<u8> {
    [&time.0.to_be_bytes()[..], &id.0].concat()
}

/// Where a waiting job stands: the highest priority first, then the oldest.
fn line_key(spec: &Spec, id: JobId) -> Vec<u8> {
    let priority = spec.task().priority;
    [&[u8::try_from(100 - priority).unwrap_or(u8::MAX)], &id.0[..]].concat()
}

fn request_key(tenant: &str, request_id: &str) -> Vec<u8> {
    [tenant.as_bytes(), &[0], request_id.as_bytes()].concat()
}

fn same_key(tenant: &str, fingerprint: Digest, id: JobId) -> Vec<u8> {
    [tenant.as_bytes(), &[0], fingerprint.as_bytes(), &id.0].concat()
}

/// What a list looks for: neither labels nor tenants hold a 0.
fn label_term(key: &str, value: &str) -> Vec<u8> {
    [b"l", key.as_bytes(), &[0], value.as_bytes(), &[0]].concat()
}

fn tenant_term(tenant: &str) -> Vec<u8> {
    [b"t", tenant.as_bytes(), &[0]].concat()
}

fn terms(head: &Head, id: JobId) -> impl Iterator<Item = Vec<u8>> {
    let labels = head.labels.iter().map(|(key, value)| label_term(key, value));
    labels.chain([tenant_term(&head.tenant)]).map(move |term| [&term[..], &id.0].concat())
}

/// The job at the end of a key.
fn id_of(table: Table, key: &[u8]) -> StoreResult<JobId> {
    key.last_chunk()
        .map(|bytes| JobId(*bytes))
        .ok_or_else(|| StoreError::Damaged { path: table.name().into(), what: "a key is too short".to_owned() })
}

fn head(tables: &(impl Tables + ?Sized), id: JobId) -> StoreResult<Head> {
    let bytes = tables.get(Table::Heads, &id.0)?.ok_or(StoreError::NotFound { id })?;
    decode(&format!("heads/{id}"), &bytes)
}

/// A record of a job beside its head, and how many bytes it takes encoded.
fn record<T: DeserializeOwned>(tables: &(impl Tables + ?Sized), table: Table, id: JobId) -> StoreResult<(T, usize)> {
    let path = format!("{}/{id}", table.name());
    match tables.get(table, &id.0)? {
        Some(bytes) => Ok((decode(&path, &bytes)?, bytes.len())),
        None => Err(StoreError::Damaged { path: path.into(), what: "it is missing".to_owned() }),
    }
}

fn spec(tables: &(impl Tables + ?Sized), id: JobId) -> StoreResult<Spec> {
    Ok(record(tables, Table::Specs, id)?.0)
}

fn log(tables: &(impl Tables + ?Sized), id: JobId) -> StoreResult<Log> {
    Ok(record(tables, Table::Logs, id)?.0)
}

fn put_head(tables: &mut dyn TablesMut, id: JobId, head: &Head) -> StoreResult<()> {
    tables.put(Table::Heads, &id.0, &encode("head", head)?)
}

/// Writes where the indexes say that a job of a tenant with this status is.
fn index(tables: &mut dyn TablesMut, id: JobId, tenant: &str, status: &Status) -> StoreResult<()> {
    if let Some(fingerprint) = status.fingerprint() {
        tables.put(Table::Same, &same_key(tenant, fingerprint, id), &[])?;
    }
    tables.put(Table::States, &state_key(status.state, id), &[])?;
    if let Some(due) = status.due {
        tables.put(Table::Due, &time_key(due, id), &[])?;
    }
    if status.state.is_ended() {
        let is_result = u8::from(status.state == State::Succeeded);
        tables.put(Table::Ended, &time_key(status.changed, id), &[is_result])?;
    }
    Ok(())
}

fn unindex(tables: &mut dyn TablesMut, id: JobId, tenant: &str, status: &Status) -> StoreResult<()> {
    if let Some(fingerprint) = status.fingerprint() {
        tables.remove(Table::Same, &same_key(tenant, fingerprint, id))?;
    }
    tables.remove(Table::States, &state_key(status.state, id))?;
    if let Some(due) = status.due {
        tables.remove(Table::Due, &time_key(due, id))?;
    }
    if status.state.is_ended() {
        tables.remove(Table::Ended, &time_key(status.changed, id))?;
    }
    Ok(())
}

pub(crate) fn create(tables: &mut dyn TablesMut, live: &mut Live, new: NewJob, now: Time) -> StoreResult<Created> {
    let NewJob { random, spec: wanted, needs, cost: _ } = new;
    let id = JobId::new(now, random);
    if let Some(job) = requested(tables, &wanted)? {
        return Ok(Created::before(job));
    }
    if tables.get(Table::Heads, &id.0)?.is_some() {
        return Err(StoreError::NameTaken { id });
    }
    let (status, log) = rules::begun(&wanted, now);
    let head = Head {
        tenant: wanted.tenant.clone(),
        request_id: wanted.request_id.clone(),
        labels: wanted.message().labels.clone().into_iter().collect(),
        status,
        needs: (needs != Bytes::default()).then_some(needs),
        next_event: 2,
        reserved_events: 2,
    };
    let (spec, log) = (encode("spec", &wanted)?, encode("log", &log)?);
    live.pins.create(id, &wanted.tenant, &wanted.task().blobs())?;
    adopt(tables, id, &head, &spec, &log)?;
    tables.put(Table::Line, &line_key(&wanted, id), &[])?;
    live.touched.push(id);
    Ok(Created::new(Job { id, spec: wanted, status: head.status }))
}

/// Writes a job with all its indexes but its place in the line.
pub(crate) fn adopt(tables: &mut dyn TablesMut, id: JobId, head: &Head, spec: &[u8], log: &[u8]) -> StoreResult<()> {
    put_head(tables, id, head)?;
    tables.put(Table::Specs, &id.0, spec)?;
    tables.put(Table::Logs, &id.0, log)?;
    if !head.request_id.is_empty() {
        tables.put(Table::Requests, &request_key(&head.tenant, &head.request_id), &id.0)?;
    }
    for term in terms(head, id) {
        tables.put(Table::Terms, &term, &[])?;
    }
    index(tables, id, &head.tenant, &head.status)
}

pub(crate) fn requested(tables: &(impl Tables + ?Sized), wanted: &Spec) -> StoreResult<Option<Job>> {
    if wanted.request_id.is_empty() {
        return Ok(None);
    }
    let Some(earlier) = tables.get(Table::Requests, &request_key(&wanted.tenant, &wanted.request_id))? else {
        return Ok(None);
    };
    let job = get(tables, id_of(Table::Requests, &earlier)?)?;
    match job.spec == *wanted {
        true => Ok(Some(job)),
        false => Err(StoreError::AlreadyExists { request_id: wanted.request_id.clone(), id: job.id }),
    }
}

pub(crate) fn same(tables: &dyn Tables, tenant: &str, fingerprint: Digest) -> StoreResult<Option<Job>> {
    let key = |id| same_key(tenant, fingerprint, JobId(id));
    let mut newest = None;
    tables.visit(Table::Same, (&key([0; 16]), &key([0xff; 16])), Order::Down, &mut |key, _| {
        newest = Some(id_of(Table::Same, key)?);
        Ok(ControlFlow::Break(()))
    })?;
    newest.map(|id| get(tables, id)).transpose()
}

pub(crate) fn get(tables: &(impl Tables + ?Sized), id: JobId) -> StoreResult<Job> {
    let head = head(tables, id)?;
    Ok(Job { id, spec: spec(tables, id)?, status: head.status })
}

pub(crate) fn list(tables: &dyn Tables, query: &Query) -> StoreResult<Page> {
    let limit = query.limit();
    let low = JobId::first_of(query.since.unwrap_or_default());
    let mut high = query.before.map_or([0xff; 16], |before| JobId::first_of(before).0);
    if let Some(last) = query.token {
        high = high.min(last.0);
    }
    let mut found = Vec::new();
    let mut look = |id: JobId, head: Head| {
        let fits = query.tenant.as_ref().is_none_or(|tenant| *tenant == head.tenant)
            && (query.states.is_empty() || query.states.contains(&head.status.state))
            && query.labels.iter().all(|(key, value)| head.labels.get(key) == Some(value));
        if fits {
            found.push((id, head.status));
        }
        // One more than the page, to know whether there is another.
        if found.len() > limit { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    if low.0 < high {
        // The index that is likely to be the shortest.
        let (table, term) = match (query.labels.iter().next(), &query.states[..], &query.tenant) {
            (Some((key, value)), ..) => (Table::Terms, label_term(key, value)),
            (None, &[state], _) => (Table::States, state_term(state).to_vec()),
            (None, _, Some(tenant)) => (Table::Terms, tenant_term(tenant)),
            (None, _, None) => (Table::Heads, Vec::new()),
        };
        let (from, to) = ([&term[..], &low.0].concat(), [&term[..], &high].concat());
        tables.visit(table, (&from, &to), Order::Down, &mut |key, value| {
            let id = id_of(table, key)?;
            let head = match table {
                Table::Heads => decode(&format!("heads/{id}"), value)?,
                _ => self::head(tables, id)?,
            };
            Ok(look(id, head))
        })?;
    }
    let mut more = found.len() > limit;
    found.truncate(limit);
    let (mut jobs, mut bytes) = (Vec::new(), 0);
    for (id, status) in found {
        // At least one, so that pages come to an end.
        if bytes > rules::PAGE_BYTES {
            more = true;
            break;
        }
        let (spec, length) = record(tables, Table::Specs, id)?;
        bytes += length;
        jobs.push(Job { id, spec, status });
    }
    let next = jobs.last().filter(|_| more).map(|job| job.id);
    Ok(Page { jobs, next })
}

/// Changes the state; of a job at version `at`, if that is given.
pub(crate) fn change(
    tables: &mut dyn TablesMut,
    live: &mut Live,
    (id, at): (JobId, Option<u64>),
    change: Change,
    now: Time,
) -> StoreResult<Job> {
    let before = head(tables, id)?;
    rules::at_version(before.status.version, id, at)?;
    let spec = spec(tables, id)?;
    let status = rules::changed((id, &spec), &before.status, change, now)?;
    let mut log = log(tables, id)?;
    let mut number = before.reserved_events;
    if let Some(Entry { next, log: progress }) = live.jobs.remove(&id) {
        log = log.extended(&progress);
        number = next;
    }
    log.push(rules::state_event(&status, number, now));
    let next_event = number + 1;
    let reserved_events = if status.state == State::Running { next_event + RESERVED } else { next_event };
    if status.state == State::Running {
        live.jobs.insert(id, Entry { next: next_event, log: Log::default() });
    }
    live.touched.push(id);
    let encoded = encode("log", &log)?;
    unindex(tables, id, &before.tenant, &before.status)?;
    index(tables, id, &before.tenant, &status)?;
    match status.state {
        State::Queued => tables.put(Table::Line, &line_key(&spec, id), &[])?,
        _ if before.status.state == State::Queued => tables.remove(Table::Line, &line_key(&spec, id))?,
        _ => {}
    }
    let head = Head { status, next_event, reserved_events, ..before };
    put_head(tables, id, &head)?;
    tables.put(Table::Logs, &id.0, &encoded)?;
    live.pins.change(id, head.status.state);
    Ok(Job { id, spec, status: head.status })
}

pub(crate) fn claim_next(
    tables: &mut dyn TablesMut,
    live: &mut Live,
    offer: Offer,
    now: Time,
) -> StoreResult<Option<Job>> {
    let mut found = None;
    match offer.job {
        Some(id) => match head(tables, id) {
            Ok(head) => found = (head.status.state == State::Queued).then_some(id),
            Err(StoreError::NotFound { .. }) => {}
            Err(error) => return Err(error),
        },
        None => tables.visit(Table::Line, (&[], &[u8::MAX; 17]), Order::Up, &mut |key, _| {
            let id = id_of(Table::Line, key)?;
            let head = head(tables, id)?;
            if head.status.state != State::Queued || !head.needs.unwrap_or_default().fits(offer.room) {
                return Ok(ControlFlow::Continue(()));
            }
            found = Some(id);
            Ok(ControlFlow::Break(()))
        })?,
    }
    let Some(id) = found else { return Ok(None) };
    let holder = Holder { name: offer.holder, until: now.after(offer.lease) };
    change(tables, live, (id, None), Change::Claim(holder), now).map(Some)
}

pub(crate) fn cancel(tables: &mut dyn TablesMut, live: &mut Live, id: JobId, now: Time) -> StoreResult<Job> {
    let job = get(tables, id)?;
    match job.status.state {
        State::Cancelled => Ok(job),
        _ => change(tables, live, (id, None), Change::Cancel, now),
    }
}

pub(crate) fn renew(tables: &mut dyn TablesMut, id: JobId, at: u64, until: Time) -> StoreResult<()> {
    let mut head = running(tables, id, at)?;
    if let Some(Holder { until: old, .. }) = &mut head.status.holder {
        *old = until;
    }
    put_head(tables, id, &head)
}

/// The head of a job that runs since version `at`.
fn running(tables: &dyn TablesMut, id: JobId, at: u64) -> StoreResult<Head> {
    let head = head(tables, id)?;
    rules::at_version(head.status.version, id, Some(at))?;
    match head.status.state {
        State::Running => Ok(head),
        // The version is that of no claim.
        _ => Err(StoreError::Stale { id, expected: at, found: head.status.version }),
    }
}

pub(crate) fn progress(
    tables: &mut dyn TablesMut,
    live: &mut Live,
    (id, at): (JobId, u64),
    progress: Progress,
    now: Time,
) -> StoreResult<u64> {
    let mut head = running(tables, id, at)?;
    // Without an entry another process may have given away what is reserved.
    let entry = live.jobs.get(&id);
    let number = entry.map_or(head.reserved_events, |entry| entry.next);
    if number >= head.reserved_events {
        head.reserved_events = number + RESERVED;
        put_head(tables, id, &head)?;
    }
    let entry = live.jobs.entry(id).or_default();
    entry.next = number + 1;
    entry.log.push(Event { number, at: now, what: What::Progress(progress.finite()) });
    live.touched.push(id);
    Ok(number)
}

/// `progress` is that of the job, read before the tables.
pub(crate) fn events(
    tables: &dyn Tables,
    progress: Option<&Log>,
    id: JobId,
    after: u64,
    most: usize,
) -> StoreResult<Events> {
    let log = match (log(tables, id), progress) {
        (Err(_), _) if tables.get(Table::Heads, &id.0)?.is_none() => return Err(StoreError::NotFound { id }),
        (log, Some(progress)) => log?.extended(progress),
        (log, None) => log?,
    };
    Ok(log.after(after, most))
}

pub(crate) fn delete(tables: &mut dyn TablesMut, live: &mut Live, id: JobId) -> StoreResult<()> {
    let head = head(tables, id)?;
    let state = head.status.state;
    if !state.is_ended() {
        return Err(StoreError::NotEnded { id, state });
    }
    unindex(tables, id, &head.tenant, &head.status)?;
    if !head.request_id.is_empty() {
        tables.remove(Table::Requests, &request_key(&head.tenant, &head.request_id))?;
    }
    for term in terms(&head, id) {
        tables.remove(Table::Terms, &term)?;
    }
    for table in [Table::Heads, Table::Specs, Table::Logs] {
        tables.remove(table, &id.0)?;
    }
    live.jobs.remove(&id);
    live.touched.push(id);
    live.pins.delete(id);
    Ok(())
}
