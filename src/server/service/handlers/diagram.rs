//! `ComputeRvd`: a diagram, batch by batch.
//!
//! Invariant: the device works at most one batch ahead of what the client has taken, and is free
//! while the client does not read. A client that reads slowly costs the batch that it reads: nothing is computed ahead for it, and
//! the session is given up in between.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use super::*;
pub(super) use ::jobs::executor::diagram::{Diagram, RvdReport};
use ::jobs::executor::prepared::Prepared;
use ::jobs::executor::streams::{Batch, StreamWork};
pub(super) use ::jobs::{Pending, Timed};
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
    let admitted = upload::<_, ComputeRvdHeader>(&shared, &tenant, &mut inbox).await?;
    let outputs = admitted.header.options.outputs;
    let work = StreamWork::new(&shared.engine, admitted.header.backend)?;
    let make = |input, _, token: &Token| Prepared::new(input, token).map(Arc::new);
    let Ready { value: prepared, place, share: _share } = admitted.read((&shared, &tenant), work.token(), make).await?;
    let mut pending = work.diagram(place, Arc::clone(&prepared), outputs.centroids || outputs.sums)?;
    outbox.send(wrap(response::Message::Accepted(accepted(pending.position, work.by())))).await?;
    let Timed { value: (mut diagram, sums), queue_ms, compute_ms } = pending.wait().await?;
    let mut clock = Clock { queue_ms, compute_ms };
    let _held =
        outbox.holding(24 * sums.centroids.len() + 8 * (sums.masses.len() + sums.areas.len() + sums.energies.len()));
    if outputs.cells {
        diagram = send_cells(&work, &outbox, diagram, &mut clock).await?;
    }
    let report = diagram.report(&prepared, work.by());
    work.dispose(diagram);
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
    clock.note("ComputeRvd", work.by());
    let report_json = send_report(&outbox, &report, wrap_chunk).await?;
    let done = done(&report, report_json, work.by(), clock);
    outbox.send(wrap(response::Message::Done(done))).await
}

/// A client that takes longer than this for a batch reads slowly: 1.5 MB/s or less.
const BRISK: Duration = Duration::from_secs(1);

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
    work: &StreamWork,
    outbox: &Outbox<ComputeRvdResponse>,
    diagram: Box<Diagram>,
    clock: &mut Clock,
) -> Result<Box<Diagram>, RequestError> {
    // Nothing is computed ahead before the client has shown how it reads.
    let (mut ahead, mut is_brisk) = (Ahead::Later(diagram), false);
    loop {
        let Timed { value: (diagram, batch), queue_ms, compute_ms } = match ahead {
            Ahead::Ready(timed) => timed,
            Ahead::Asked(mut pending) => pending.wait().await?,
            Ahead::Later(diagram) => work.batch(diagram)?.wait().await?,
        };
        clock.add(queue_ms, compute_ms);
        let Some(batch) = batch else { return Ok(diagram) };
        let (done, total) = diagram.progress();
        ahead = match is_brisk {
            true => Ahead::Asked(work.batch(diagram)?),
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
                        work.rest(&mut diagram);
                        Ahead::Later(diagram)
                    }
                    Ahead::Asked(mut pending) => {
                        let mut timed = pending.wait().await?;
                        work.rest(&mut timed.value.0);
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
