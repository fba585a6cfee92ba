//! Upkeep of a store: what is over, and what was orphaned.
//!
//! Purpose: [`expire`] and [`recover`], which look for jobs by the indexes and change each as any other operation does.
//! Invariant: doing it again is harmless. Must not know: files, threads, clocks.

use std::ops::ControlFlow;
use std::time::Duration;

use super::{StoreResult, change, delete, head, id_of, line_key, spec, state_key, time_key};
use crate::blob::{Digest, Owner};
use crate::record::event::Log;
use crate::record::state::State;
use crate::record::{Cause, Change, JobId, Outcome, Status, Time};
use crate::store::tables::{Live, Order, Table, TablesMut};
use crate::store::{Orphans, Recovered, Retention, Swept, rules};

pub(crate) fn expire(
    tables: &mut dyn TablesMut,
    live: &mut Live,
    now: Time,
    keep: Retention,
    most: usize,
) -> StoreResult<Swept> {
    let mut swept = Swept::default();
    let end = time_key(Time(now.0.saturating_add(1)), JobId([0; 16]));
    let mut due = Vec::new();
    tables.visit(Table::Due, (&[], &end), Order::Up, &mut |key, _| {
        swept.more = due.len() >= most;
        if swept.more {
            return Ok(ControlFlow::Break(()));
        }
        due.push(id_of(Table::Due, key)?);
        Ok(ControlFlow::Continue(()))
    })?;
    let mut over = Vec::new();
    let old = |time: u64, kept: Duration| Time(time).after(kept) <= now;
    tables.visit(Table::Ended, (&[], &end), Order::Up, &mut |key, value| {
        let time = key.first_chunk().map_or(0, |bytes| u64::from_be_bytes(*bytes));
        let is_result = value.first() == Some(&1);
        if !old(time, keep.results.min(keep.records)) {
            return Ok(ControlFlow::Break(()));
        }
        if old(time, if is_result { keep.results } else { keep.records }) {
            if due.len() + over.len() >= most {
                swept.more = true;
                return Ok(ControlFlow::Break(()));
            }
            over.push((id_of(Table::Ended, key)?, is_result));
        }
        Ok(ControlFlow::Continue(()))
    })?;
    for id in due {
        let cause = rules::due_cause(head(tables, id)?.status.state);
        change(tables, live, (id, None), Change::Expire(cause), now)?;
        swept.expired.push(id);
    }
    for (id, is_result) in over {
        if is_result {
            change(tables, live, (id, None), Change::Expire(Cause::Kept), now)?;
            swept.expired.push(id);
        } else {
            delete(tables, live, id)?;
            swept.deleted.push(id);
        }
    }
    Ok(swept)
}

fn in_state(tables: &dyn TablesMut, state: State) -> StoreResult<Vec<JobId>> {
    let (from, to) = (state_key(state, JobId([0; 16])), state_key(state, JobId([0xff; 16])));
    let mut found = Vec::new();
    tables.visit(Table::States, (&from, &to), Order::Up, &mut |key, _| {
        found.push(id_of(Table::States, key)?);
        Ok(ControlFlow::Continue(()))
    })?;
    Ok(found)
}

pub(crate) fn recover(
    tables: &mut dyn TablesMut,
    live: &mut Live,
    now: Time,
    orphans: Orphans,
    (max_crashes, had_others): (u32, bool),
) -> StoreResult<Recovered> {
    let mut recovered = Recovered::default();
    let (mut orphaned, mut holders) = (Vec::new(), Vec::new());
    let holder_of = |status: &Status| status.holder.as_ref().map(|holder| holder.name.clone());
    for id in in_state(tables, State::Running)? {
        let status = head(tables, id)?.status;
        holders.push(holder_of(&status));
        if orphans == Orphans::All || status.holder.as_ref().is_none_or(|holder| holder.until <= now) {
            orphaned.push((id, status));
        }
    }
    for (id, status) in orphaned {
        // Of several pieces of work any one may be the cause: each job is tried once more, alone.
        let is_alone = !had_others && holders.iter().filter(|name| **name == holder_of(&status)).count() == 1;
        let log = live.jobs.get(&id).map_or_else(Log::default, |entry| entry.log.clone());
        let orphaned = rules::orphaned(&status, &log, is_alone, max_crashes);
        let ids = if orphaned == Change::Orphan { &mut recovered.requeued } else { &mut recovered.failed };
        ids.push(id);
        change(tables, live, (id, None), orphaned, now)?;
    }
    if orphans == Orphans::All {
        recovered.queued = in_state(tables, State::Queued)?;
        // Journals of earlier releases have no line.
        for id in &recovered.queued {
            let spec = spec(tables, *id)?;
            let key = line_key(&spec, *id);
            if tables.get(Table::Line, &key)?.is_none() {
                tables.put(Table::Line, &key, &[])?;
            }
        }
        recovered.pinned = pin_again(tables, live, &recovered.queued)?;
    }
    Ok(recovered)
}

/// Pins the input of all jobs that wait, and all results. Gives the blobs by owner.
fn pin_again(tables: &dyn TablesMut, live: &Live, queued: &[JobId]) -> StoreResult<Vec<(Owner, Vec<Digest>)>> {
    let mut pinned = Vec::new();
    let mut pin = |id, state, tenant: &str, digests: Vec<Digest>| {
        let owner = Owner::of(tenant);
        live.pins.recover(id, state, owner, &digests);
        pinned.push((owner, digests));
    };
    for id in in_state(tables, State::Succeeded)? {
        let head = head(tables, id)?;
        if let Some(Outcome::Succeeded(result)) = &head.status.outcome {
            pin(id, State::Succeeded, &head.tenant, result.blobs.values().copied().collect());
        }
    }
    for id in queued {
        let spec = spec(tables, *id)?;
        pin(*id, State::Queued, &spec.tenant, spec.task().blobs());
    }
    Ok(pinned)
}
