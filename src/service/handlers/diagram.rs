//! `ComputeRvd`: a diagram, batch by batch.
//!
//! Invariant: the device works at most one batch ahead of what the client has taken, and is free
//! while the client does not read.

use std::sync::Arc;

use super::*;
use crate::job::diagram::{Diagram, RvdReport, WorldSums};
use crate::job::spec::Prepared;
use crate::job::{Pending, Place, Retry, Timed, Turn};
use crate::rvd::PieceBatch;
use crate::wire::cells::{CELLS_VERTEX_BYTES, cells_chunks};
use crate::wire::chunks::number_chunks;
use crate::wire::proto::compute_rvd_response as response;
use crate::wire::proto::{ArrayKind, ComputeRvdRequest, ComputeRvdResponse, RvdDone};

fn wrap(message: response::Message) -> ComputeRvdResponse {
    ComputeRvdResponse { message: Some(message) }
}

fn wrap_chunk(chunk: Chunk) -> ComputeRvdResponse {
    wrap(response::Message::Chunk(chunk))
}

/// One stream.
pub(super) async fn handle(
    shared: Arc<Shared>,
    tenant: String,
    mut inbox: Inbox<ComputeRvdRequest>,
    outbox: Outbox<ComputeRvdResponse>,
) -> Result<(), RequestError> {
    let Admitted { header, received, ticket, ask } = upload(&shared, &tenant, &mut inbox).await?;
    let (wish, outputs) = (codec::backend(header.backend)?, codec::outputs(&header.outputs)?);
    let by = shared.engine.backend(wish)?;
    let token = shared.engine.token();
    let (prepared, _share) = prepare(&shared, received, None, Prepared::new, &token).await?;
    let for_device = Arc::clone(&prepared);
    let mut pending =
        shared.engine.submit_as(token.clone(), Place::Kept(ask), Retry::Anew, move |backends, turn| {
            turn.token.check()?;
            let mut diagram = Diagram::open(&for_device, backends.choose(wish)?.as_ref())?;
            let sums = match outputs.centroids || outputs.sums {
                true => diagram.sums(&turn.token)?,
                false => WorldSums::default(),
            };
            Ok((diagram, sums))
        })?;
    drop(ticket);
    outbox.send(wrap(response::Message::Accepted(accepted(pending.position, &by)))).await?;
    let Timed { value: (mut diagram, sums), queue_ms, compute_ms } = pending.wait().await?;
    let mut clock = Clock { queue_ms, compute_ms };
    let _held =
        outbox.holding(24 * sums.centroids.len() + 8 * (sums.masses.len() + sums.areas.len() + sums.energies.len()));
    if outputs.cells {
        diagram = send_cells(&shared, &outbox, (&token, diagram), &mut clock).await?;
    }
    let report = diagram.report(&prepared, &by);
    shared.engine.dispose(diagram);
    if prepared.random_seed.is_some() {
        send_seeds(&outbox, &prepared.seeds, wrap_chunk).await?;
    }
    if outputs.centroids {
        send_all(&outbox, point_chunks(ArrayKind::Centroids, &sums.centroids), wrap_chunk).await?;
    }
    if outputs.sums {
        for (kind, numbers) in
            [(ArrayKind::Masses, &sums.masses), (ArrayKind::Areas, &sums.areas), (ArrayKind::Energies, &sums.energies)]
        {
            send_all(&outbox, number_chunks(kind, numbers), wrap_chunk).await?;
        }
    }
    clock.note("ComputeRvd", &by);
    let report_json = send_report(&outbox, &report, wrap_chunk).await?;
    let done = done(&report, report_json, &by, clock);
    outbox.send(wrap(response::Message::Done(done))).await
}

type Batch = (Diagram, Option<PieceBatch>);

/// Queues the next batch; it goes before new jobs, since its own has had its turn.
fn next(shared: &Shared, token: &Token, diagram: Diagram) -> Result<Pending<Batch>, JobError> {
    let mut state = Some(diagram);
    shared.engine.submit_as(token.clone(), Place::Continuation, Retry::Never, move |_, turn: &Turn| {
        let mut diagram = state.take().ok_or(JobError::WorkerGone)?;
        let batch = diagram.batch(&turn.token)?;
        Ok((diagram, batch))
    })
}

async fn send_cells(
    shared: &Shared,
    outbox: &Outbox<ComputeRvdResponse>,
    (token, diagram): (&Token, Diagram),
    clock: &mut Clock,
) -> Result<Diagram, RequestError> {
    let mut pending = next(shared, token, diagram)?;
    loop {
        let Timed { value: (diagram, batch), queue_ms, compute_ms } = pending.wait().await?;
        clock.add(queue_ms, compute_ms);
        let Some(batch) = batch else { return Ok(diagram) };
        let (done, total) = diagram.progress();
        pending = next(shared, token, diagram)?;
        let _held = outbox.holding(12 * batch.facet.len() + CELLS_VERTEX_BYTES * batch.position.len());
        for cells in cells_chunks(&batch) {
            outbox.send(wrap(response::Message::Cells(cells))).await?;
        }
        outbox.send(wrap(response::Message::Progress(clock.progress("diagram", done, total)))).await?;
    }
}

fn done(report: &RvdReport, report_json: String, by: &BackendInfo, clock: Clock) -> RvdDone {
    RvdDone {
        backend: by.kind.name().to_owned(),
        adapter: by.adapter.clone().unwrap_or_default(),
        timing: Some(clock.timing()),
        figures: Some(codec::figures(&report.rvd)),
        seeds: report.seeds as u64,
        report_json,
    }
}
