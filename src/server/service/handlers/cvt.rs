//! `Cvt`: an interactive session.
//!
//! Invariant: while the client thinks, its state lies here and the device serves others. A draining
//! server ends sessions that wait for a command, and lets a command end.

use std::sync::Arc;
use std::time::Duration;

use super::*;
pub(super) use ::jobs::Timed;
use ::jobs::blob::put_of;
use ::jobs::executor::prepared::Prepared;
pub(super) use ::jobs::executor::session::CvtSession;
use wire::WireError;
use wire::options::within;
use wire::proto::{CvtDone, CvtEdit, CvtEdited, CvtRequest, CvtResponse, CvtStep, SeedsWanted};
use wire::proto::{cvt_request as request, cvt_response as response};

wraps!(CvtResponse);

/// How long it may take to keep the seeds of a session that ends with the server.
const LEAVE: Duration = Duration::from_secs(2);

pub(super) async fn handle(
    shared: Arc<Shared>,
    tenant: String,
    mut inbox: Inbox<CvtRequest>,
    outbox: Outbox<CvtResponse>,
) -> Result<(), RequestError> {
    let _place = shared.gate.admit_session(&tenant)?;
    let admitted = upload::<_, CvtHeader>(&shared, &tenant, &mut inbox).await?;
    let (wish, options) = (admitted.header.backend, admitted.header.options.options);
    let token = shared.engine.token();
    let make = |input, _, token: &Token| Prepared::for_steps(input, token).map(Arc::new);
    let Ready { value: prepared, place, share: _share } = admitted.read((&shared, &tenant), &token, make).await?;
    let mut pending = CvtSession::open(&shared.engine, Arc::clone(&prepared), wish, options, place)?;
    let position = pending.position;
    let Timed { value, queue_ms, compute_ms } = pending.wait().await?;
    let mut talk = Talk {
        limits: shared.limits,
        outbox,
        session: CvtSession::new(shared.engine.clone(), value),
        clock: Clock { queue_ms, compute_ms },
        iterations: 0,
    };
    drop(prepared);
    let accepted = accepted(position, talk.session.by());
    talk.outbox.send(wrap(response::Message::Accepted(accepted))).await?;
    loop {
        let message = tokio::select! {
            message = inbox.next(shared.limits.session_idle) => message?,
            () = shared.leaves() => return Err(talk.leave(&shared, &tenant).await),
        };
        match message.map(|m| m.message) {
            Some(Some(request::Message::Step(step))) => talk.step(step).await?,
            Some(Some(request::Message::Edit(edit))) => talk.edit(edit).await?,
            Some(Some(request::Message::Finish(_))) | None => break,
            Some(_) => {
                return Err(WireError::Order("an open session takes step, edit and finish").into());
            }
        }
    }
    talk.end().await
}

struct Talk {
    limits: Limits,
    outbox: Outbox<CvtResponse>,
    session: CvtSession,
    clock: Clock,
    iterations: u64,
}

impl Talk {
    async fn step(&mut self, step: CvtStep) -> Result<(), RequestError> {
        let read = || {
            within("iterations", step.iterations.into(), 1, self.limits.max_iterations.into())?;
            Ok((codec::step_kind(step.kind)?, codec::seeds_wanted(step.seeds)?))
        };
        let (kind, wanted) = read().map_err(|error: WireError| error.under("step"))?;
        let total = step.iterations as usize;
        let mut left = total;
        while left > 0 {
            let Timed { value: steps, queue_ms, compute_ms } = self.session.step(left, kind, wanted).await?;
            self.clock.add(queue_ms, compute_ms);
            left = left.saturating_sub(steps.len());
            for (iteration, seeds) in steps {
                self.iterations += 1;
                let message = codec::iteration(&iteration, total, queue_ms);
                self.outbox.send(wrap(response::Message::Iteration(message))).await?;
                if let Some(seeds) = seeds {
                    send_seeds(&self.outbox, &seeds, wrap_chunk).await?;
                }
            }
        }
        Ok(())
    }

    async fn edit(&mut self, edit: CvtEdit) -> Result<(), RequestError> {
        let read = || Ok((codec::edits(&edit.edits)?, codec::seeds_wanted(edit.seeds)?));
        let (edits, wanted) = read().map_err(|error: WireError| error.under("edit"))?;
        let timed = self.session.edit(edits).await?;
        self.clock.add(timed.queue_ms, timed.compute_ms);
        let edited = CvtEdited { seeds: self.session.seed_count() as u64 };
        self.outbox.send(wrap(response::Message::Edited(edited))).await?;
        if wanted != SeedsWanted::Never {
            let seeds = self.session.seeds().await?;
            self.clock.add(seeds.queue_ms, seeds.compute_ms);
            send_seeds(&self.outbox, &seeds.value, wrap_chunk).await?;
        }
        Ok(())
    }

    /// Keeps the seeds, so that a session elsewhere can begin with them.
    async fn leave(mut self, shared: &Shared, tenant: &str) -> RequestError {
        let Some(jobs) = &shared.jobs else { return RequestError::Draining };
        let kept = async {
            let seeds = self.session.seeds().await.ok()?.value;
            let bytes: Vec<u8> = seeds.iter().flat_map(|seed| seed.to_array()).flat_map(f64::to_le_bytes).collect();
            put_of(&*jobs.blobs, tenant, None, bytes.into()).await.ok()
        };
        // Within the time that a shutdown has.
        match tokio::time::timeout(LEAVE, kept).await {
            Ok(Some(info)) => RequestError::SessionEnded { seeds: info.digest },
            _ => RequestError::Draining,
        }
    }

    async fn end(mut self) -> Result<(), RequestError> {
        let seeds = self.session.seeds().await?;
        self.clock.add(seeds.queue_ms, seeds.compute_ms);
        send_seeds(&self.outbox, &seeds.value, wrap_chunk).await?;
        let by = self.session.by();
        self.clock.note("Cvt", by);
        let done = CvtDone {
            backend: by.kind.name().to_owned(),
            adapter: by.adapter.clone().unwrap_or_default(),
            timing: Some(self.clock.timing()),
            iterations: self.iterations,
            seeds: self.session.seed_count() as u64,
        };
        self.outbox.send(wrap(response::Message::Done(done))).await
    }
}
