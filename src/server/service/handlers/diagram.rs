//! `ComputeRvd`: a diagram, batch by batch.
//!
//! Invariant: the device works at most one batch ahead of what the client has taken, and is free
//! while the client does not read. A client that reads slowly costs the batch that it reads: nothing is computed ahead for it, and
//! the session is given up in between.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use super::*;
pub(super) use ::jobs::executor::diagram::{Diagram, RvdReport, WorldSums};
use ::jobs::executor::prepared::Prepared;
pub(super) use ::jobs::{Admission, Pending, Retry, Timed, WorkContext};
use geometry::rvd::{BackendChoice, PieceBatch};
use wire::cells::{CELLS_VERTEX_BYTES, cells_chunks};
use wire::chunks::number_chunks;
use wire::proto::compute_rvd_response as response;
use wire::proto::{ArrayKind, ComputeRvdRequest, ComputeRvdResponse, RvdDone};

wraps!(ComputeRvdResponse);

pub(super) async fn handle(
    shared: Arc<Shared>,
    tenant: String,
    mut inbox: Inbox<ComputeRvdRequest>,
    outbox: Outbox<ComputeRvdResponse>,
) -> Result<(), RequestError> {
    let Admitted { header, received, reservation, request } = upload(&shared, &tenant, &mut inbox).await?;
    let (choice, outputs) = (header.backend, header.options.outputs);
    let by = shared.engine.backend(choice)?;
    let token = shared.engine.token();
    let (prepared, _share) = prepare(&shared, received, header.options, Prepared::new, &token).await?;
    let for_device = Arc::clone(&prepared);
    let mut pending = shared.engine.submit_as(
        token.clone(),
        Admission::Reserved(request),
        Retry::Restart,
        move |backends, context| {
            context.token.check()?;
            let backend = backends.choose(choice)?;
            let mut diagram = Diagram::open(&for_device, backend.as_ref())?;
            let sums = match outputs.centroids || outputs.sums {
                true => diagram.sums(backend.as_ref(), &context.token)?,
                false => WorldSums::default(),
            };
            Ok((Box::new(diagram), sums))
        },
    )?;
    drop(reservation);
    outbox.send(wrap(response::Message::Accepted(accepted(pending.position, &by)))).await?;
    let Timed { value: (mut diagram, sums), queue_ms, compute_ms } = pending.wait().await?;
    let mut clock = Clock { queue_ms, compute_ms };
    let _held =
        outbox.holding(24 * sums.centroids.len() + 8 * (sums.masses.len() + sums.areas.len() + sums.energies.len()));
    if outputs.cells {
        diagram = send_cells(&shared, &outbox, (&token, choice), diagram, &mut clock).await?;
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

type Batch = (Box<Diagram>, Option<PieceBatch>);

/// A client that takes longer than this for a batch reads slowly: 1.5 MB/s or less.
const BRISK: Duration = Duration::from_secs(1);

/// Queues the next batch; it goes before new jobs, since its own has had its turn.
fn next(
    shared: &Shared,
    (token, choice): (&Token, BackendChoice),
    diagram: Box<Diagram>,
) -> Result<Pending<Batch>, JobError> {
    let mut state = Some(diagram);
    shared.engine.submit_as(
        token.clone(),
        Admission::Continuation,
        Retry::Never,
        move |backends, context: &WorkContext| {
            let mut diagram = state.take().ok_or(JobError::WorkerGone)?;
            let batch = diagram.batch(backends.choose(choice)?.as_ref(), &context.token)?;
            Ok((diagram, batch))
        },
    )
}

/// What comes after the batch that is being sent.
enum Ahead {
    /// At work, or waiting for it.
    Asked(Pending<Batch>),
    /// Computed, for a client that has become slow since.
    Ready(Timed<Batch>),
    /// Not asked for yet.
    Later(Box<Diagram>),
}

async fn send_cells(
    shared: &Shared,
    outbox: &Outbox<ComputeRvdResponse>,
    asks: (&Token, BackendChoice),
    diagram: Box<Diagram>,
    clock: &mut Clock,
) -> Result<Box<Diagram>, RequestError> {
    let rest = |diagram: &mut Diagram| diagram.rest().into_iter().for_each(|session| shared.engine.dispose(session));
    // Nothing is computed ahead before the client has shown how it reads.
    let (mut ahead, mut is_brisk) = (Ahead::Later(diagram), false);
    loop {
        let Timed { value: (diagram, batch), queue_ms, compute_ms } = match ahead {
            Ahead::Ready(timed) => timed,
            Ahead::Asked(mut pending) => pending.wait().await?,
            Ahead::Later(diagram) => next(shared, asks, diagram)?.wait().await?,
        };
        clock.add(queue_ms, compute_ms);
        let Some(batch) = batch else { return Ok(diagram) };
        let (done, total) = diagram.progress();
        ahead = match is_brisk {
            true => Ahead::Asked(next(shared, asks, diagram)?),
            false => Ahead::Later(diagram),
        };
        let _held = outbox.holding(12 * batch.facet.len() + CELLS_VERTEX_BYTES * batch.position.len());
        let progress = wrap(response::Message::Progress(clock.progress("diagram", done, total)));
        let mut sending = pin!(async {
            for cells in cells_chunks(&batch) {
                outbox.send(wrap(response::Message::Cells(cells))).await?;
            }
            outbox.send(progress).await
        });
        is_brisk = match tokio::time::timeout(BRISK, &mut sending).await {
            Ok(sent) => sent.map(|()| true)?,
            Err(_) => {
                ahead = match ahead {
                    Ahead::Later(mut diagram) => {
                        rest(&mut diagram);
                        Ahead::Later(diagram)
                    }
                    Ahead::Asked(mut pending) => {
                        let mut timed = pending.wait().await?;
                        rest(&mut timed.value.0);
                        Ahead::Ready(timed)
                    }
                    ready @ Ahead::Ready(_) => ready,
                };
                sending.await?;
                false
            }
        };
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
