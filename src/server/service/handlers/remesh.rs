//! `Remesh`: one piece of work, with progress on the way and a mesh at the end.
//!
//! Invariant: the device never waits for the client; progress that the client is too slow for is
//! left out (the report has every iteration).

use std::sync::Arc;

use tokio::sync::mpsc;

use super::*;
pub(super) use ::jobs::Timed;
use ::jobs::executor::streams::StreamWork;
use ::jobs::observe::activity::Listener;
use geometry::cvt::Iteration;
use geometry::remesh::{Remesh, RemeshOptions};
use wire::attributes::AttributeCounts;
use wire::chunks::{facet_chunks, index_chunks};
use wire::proto::remesh_response as response;
use wire::proto::{ArrayKind, RemeshDone, RemeshRequest, RemeshResponse};

/// Progress that waits for the client.
const EVENTS: usize = 256;

wraps!(RemeshResponse);

enum Event {
    Started(f64),
    Stage(&'static str),
    Iteration(Box<Iteration>, usize),
}

struct Reporter(mpsc::Sender<Event>);

impl Listener for Reporter {
    fn stage(&self, name: &'static str, _: u64, _: u64) {
        let _ = self.0.try_send(Event::Stage(name));
    }

    fn iteration(&self, iteration: &Iteration, total: usize) {
        let _ = self.0.try_send(Event::Iteration(Box::new(*iteration), total));
    }
}

pub(super) async fn handle(
    shared: Arc<Shared>,
    tenant: String,
    mut inbox: Inbox<RemeshRequest>,
    outbox: Outbox<RemeshResponse>,
) -> Result<(), RequestError> {
    let admitted = upload::<_, RemeshHeader>(&shared, &tenant, &mut inbox).await?;
    let announced = admitted.header.attributes.clone();
    let work = StreamWork::new(&shared.engine, admitted.header.backend)?;
    let make = |input, options, _: &Token| {
        let Input { mesh, density, seeds, creases, attributes } = input;
        Ok((mesh, RemeshOptions { density, seeds, creases, attributes, ..options }))
    };
    let ready = admitted.read((&shared, &tenant), work.token(), make).await?;
    let Ready { value: (mesh, options), mut share, place } = ready;
    let (events, mut heard) = mpsc::channel(EVENTS);
    let mut pending = work.remesh(place, mesh, options, move |queue_ms| {
        let _ = events.try_send(Event::Started(queue_ms));
        Arc::new(Reporter(events.clone()))
    })?;
    outbox.send(wrap(response::Message::Accepted(accepted(pending.position, work.by())))).await?;
    let mut teller = Teller { clock: Clock::default(), start: None };
    let result = loop {
        tokio::select! {
            biased;
            Some(event) = heard.recv() => outbox.send(teller.tell(event)).await?,
            result = pending.wait() => break result?,
        }
    };
    // The surface went with the work; the result is there instead.
    share.hold(bytes(&result.value));
    while let Some(event) = heard.recv().await {
        outbox.send(teller.tell(event)).await?;
    }
    let Timed { value, queue_ms, compute_ms } = result;
    send_result(&outbox, &value, &announced, work.by(), Clock { queue_ms, compute_ms }).await
}

/// Makes messages of events.
struct Teller {
    clock: Clock,
    start: Option<std::time::Instant>,
}

impl Teller {
    fn tell(&mut self, event: Event) -> RemeshResponse {
        match event {
            Event::Started(queue_ms) => {
                self.clock.queue_ms = queue_ms;
                self.start = Some(std::time::Instant::now());
                wrap(response::Message::Progress(self.clock.progress("queued", 1, 1)))
            }
            Event::Stage(name) => {
                self.clock.compute_ms = self.start.map_or(0.0, |start| start.elapsed().as_secs_f64() * 1e3);
                wrap(response::Message::Progress(self.clock.progress(name, 0, 0)))
            }
            Event::Iteration(iteration, total) => {
                let message = codec::iteration(&iteration, total, self.clock.queue_ms);
                wrap(response::Message::Iteration(message))
            }
        }
    }
}

/// About what a result takes while it waits to be sent.
fn bytes(result: &Remesh) -> u64 {
    let points = result.mesh.positions().len() + result.seeds.len();
    let indices = 3 * result.mesh.facets().len() + 2 * result.curve_edges.len() + result.vertex_seed.len();
    (24 * points + 4 * indices) as u64
}

async fn send_result(
    outbox: &Outbox<RemeshResponse>,
    result: &Remesh,
    announced: &[AttributeCounts],
    by: &BackendInfo,
    clock: Clock,
) -> Result<(), RequestError> {
    clock.note("Remesh", by);
    let (positions, facets) = (result.mesh.positions(), result.mesh.facets());
    send_all(outbox, point_chunks(ArrayKind::Positions, positions), wrap_chunk).await?;
    send_all(outbox, facet_chunks(ArrayKind::Facets, facets), wrap_chunk).await?;
    send_all(outbox, index_chunks(ArrayKind::VertexSeeds, &result.vertex_seed), wrap_chunk).await?;
    let curve_edges = result.curve_edges.as_flattened();
    send_all(outbox, index_chunks(ArrayKind::Creases, curve_edges), wrap_chunk).await?;
    send_seeds(outbox, &result.seeds, wrap_chunk).await?;
    let mut carried = Vec::new();
    if let Some(attributes) = &result.attributes {
        carried = attributes::headers_like(attributes, announced);
        for chunks in attributes::chunks(attributes, &carried) {
            send_all(outbox, chunks, wrap_chunk).await?;
        }
    }
    let report_json = send_report(outbox, &result.report, wrap_chunk).await?;
    let done = RemeshDone {
        backend: by.kind.name().to_owned(),
        adapter: by.adapter.clone().unwrap_or_default(),
        timing: Some(clock.timing()),
        vertices: positions.len() as u64,
        facets: facets.len() as u64,
        seeds: result.seeds.len() as u64,
        converged: result.report.converged,
        figures: Some(codec::figures(&result.report.rvd)),
        report_json,
        topology_changes: result.report.topology_changes.clone(),
        refinement_end: result.report.refine.ended.map(codec::refinement_end).unwrap_or_default().into(),
        warnings: result.report.warnings.iter().map(codec::warning).collect(),
        attributes: carried,
    };
    outbox.send(wrap(response::Message::Done(done))).await
}
