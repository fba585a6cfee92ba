//! The streams of `RemeshService`.
//!
//! Invariant: a result is taken to its last message, and its arrays are whole. Must not know: jobs.

use std::sync::{Arc, OnceLock};
use std::time::Duration;

use tokio::time::Instant;

use super::{Answers, Asked, At, End, Pace};
use crate::remote::surfaces;
use wire::assemble::Arrays;
use wire::proto::{self, ArrayKind, Chunk, RvdOutput, Timing};

const CVT_STEPS: u32 = 5;

/// When the last message of a request left.
type Left = Arc<OnceLock<Instant>>;

/// Messages; the moment at which the last leaves is kept.
fn told<T: Send + 'static>(messages: Vec<T>, left: &Left) -> impl tokio_stream::Stream<Item = T> + Send + 'static {
    let (left, last) = (Arc::clone(left), messages.len().saturating_sub(1));
    tokio_stream::iter(messages.into_iter().enumerate().map(move |(k, message)| {
        if k == last {
            let _ = left.set(Instant::now());
        }
        message
    }))
}

struct Flow {
    begin: Instant,
    left: Left,
    /// When the first of the result came.
    first: Option<Instant>,
    arrays: Arrays,
}

impl Flow {
    fn begin() -> Self {
        Self { begin: Instant::now(), left: Left::default(), first: None, arrays: Arrays::default() }
    }

    async fn came(&mut self, bytes: usize, asked: &mut Asked, pace: &mut Pace) {
        self.first.get_or_insert_with(Instant::now);
        asked.came_bytes += bytes as u64;
        pace.read(bytes).await;
    }

    async fn chunk(&mut self, chunk: &Chunk, asked: &mut Asked, pace: &mut Pace) -> Result<(), End> {
        self.arrays.take(chunk).map_err(wrong)?;
        self.came(chunk.data.len(), asked, pace).await;
        Ok(())
    }

    /// Where the time went. `timing` is the server's.
    fn end(&self, timing: Option<&Timing>, asked: &mut Asked) {
        let ms = |ms: f64| Duration::try_from_secs_f64(ms / 1e3).ok();
        asked.stages.upload = self.left.get().map(|left| left.saturating_duration_since(self.begin));
        asked.stages.download = self.first.map(|first| first.elapsed());
        asked.stages.queue = timing.and_then(|timing| ms(timing.queue_ms));
        asked.stages.compute = timing.and_then(|timing| ms(timing.compute_ms));
    }
}

fn wrong(what: impl std::fmt::Display) -> End {
    End::Wrong(what.to_string())
}

/// A stream: sends the surface between the header with these options and the messages `ends`, and takes the answer to its last
/// message; `on` are the messages of its own kind. Gives that last message, and the arrays that came.
macro_rules! stream {
    (
        $at:ident, $asked:ident, $pace:ident, $method:literal, $call:ident, $request:ident,
        $header:ident($options:expr), $ends:expr, on |$flow:ident| { $($own:pat => $act:expr,)* }
    ) => {{
        let (mesh, backend) = (Some($at.surface.header.clone()), $at.backend());
        let header = Ask::Header(proto::$header { mesh, seeds: 0, backend, options: Some($options) });
        let chunks = $at.surface.chunks.iter().cloned().map(Ask::Chunk);
        let all = [header].into_iter().chain(chunks).chain($ends);
        let messages = all.map(|message| proto::$request { message: Some(message) }).collect();
        $asked.sent_bytes = $at.surface.chunk_bytes();
        let (mut $flow, mut client) = (Flow::begin(), surfaces($at.door.clone()));
        let call = $at.caller.tally.begin(concat!("tessera.v1.RemeshService/", $method));
        let mut answers = Answers::of(call, $at.ends, client.$call(told(messages, &$flow.left))).await?;
        let mut done = None;
        while let Some(answer) = answers.next($at.ends).await? {
            match answer.message {
                Some(Answer::Chunk(chunk)) => $flow.chunk(&chunk, $asked, $pace).await?,
                Some(Answer::Done(end)) => done = Some(end),
                $(Some($own) => $act,)*
                _ => {}
            }
        }
        let Some(done) = done else { return Err(wrong("it ended before the work was done")) };
        $flow.end(done.timing.as_ref(), $asked);
        (done, $flow.arrays)
    }};
}

impl At<'_> {
    pub(super) async fn remesh(&self, asked: &mut Asked, pace: &mut Pace) -> Result<(), End> {
        use proto::remesh_request::Message as Ask;
        use proto::remesh_response::Message as Answer;
        let ends = [Ask::Finish(proto::Finish {})];
        let (done, arrays) = stream!(
            self,
            asked,
            pace,
            "Remesh",
            remesh,
            RemeshRequest,
            RemeshHeader(self.remesh_options()),
            ends,
            on | flow | {}
        );
        let bytes = |kind| arrays.bytes(kind).map(|bytes| bytes.len() as u64).map_err(wrong);
        let (positions, facets) = (bytes(ArrayKind::Positions)?, bytes(ArrayKind::Facets)?);
        let fits = (positions, facets) == (24 * done.vertices, 12 * done.facets) && facets > 0;
        if fits { Ok(()) } else { Err(wrong("its arrays are not as long as it says")) }
    }

    pub(super) async fn rvd(&self, asked: &mut Asked, pace: &mut Pace) -> Result<(), End> {
        use proto::compute_rvd_request::Message as Ask;
        use proto::compute_rvd_response::Message as Answer;
        let outputs = vec![RvdOutput::Cells.into(), RvdOutput::Centroids.into()];
        let options = proto::DiagramOptions { outputs, ..self.diagram_options() };
        let (mut pieces, ends) = (0, [Ask::Finish(proto::Finish {})]);
        let (done, arrays) = stream!(
            self, asked, pace, "ComputeRvd", compute_rvd, ComputeRvdRequest, ComputeRvdHeader(options), ends, on |flow| {
                Answer::Cells(cells) => {
                    pieces += u64::from(cells.pieces);
                    let indices =
                        cells.facet.len() + cells.seed.len() + cells.vertex_count.len() + cells.opposite.len();
                    flow.came(indices + cells.positions.len() + cells.weights.len(), asked, pace).await;
                },
            }
        );
        let centroids = arrays.bytes(ArrayKind::Centroids).map_err(wrong)?.len() as u64;
        let fits = centroids == 24 * done.seeds && done.seeds == self.surface.points && pieces > 0;
        if fits { Ok(()) } else { Err(wrong("its cells are not those of the seeds")) }
    }

    pub(super) async fn cvt(&self, asked: &mut Asked, pace: &mut Pace) -> Result<(), End> {
        use proto::cvt_request::Message as Ask;
        use proto::cvt_response::Message as Answer;
        let (points, seed) = (self.surface.points(), Some(self.random_seed));
        let options = proto::CvtOptions { points, seed, ..proto::CvtOptions::default() };
        let step = proto::CvtStep { iterations: CVT_STEPS, ..proto::CvtStep::default() };
        let ends = [Ask::Start(proto::CvtStart {}), Ask::Step(step), Ask::Finish(proto::Finish {})];
        let mut steps = 0;
        let (done, _) = stream!(
            self, asked, pace, "Cvt", cvt, CvtRequest, CvtHeader(options), ends, on |flow| {
                Answer::Iteration(_) => steps += 1,
            }
        );
        let fits = steps == CVT_STEPS && done.iterations == u64::from(CVT_STEPS);
        if fits { Ok(()) } else { Err(wrong("it took other steps than were asked for")) }
    }
}
