//! One call of a load, from its first byte to its last.
//!
//! Purpose: [`Caller::ask`] does what an [`Item`] says and tells how it went; streams and jobs are done in parts of their own.
//! Invariant: every RPC is counted, and answers are checked as they come. A call ends: by its answer, when it is cancelled,
//! when its time is over, or when the run is stopped. Must not know: when calls are made, how figures are kept.

mod job;
mod stream;

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;
use tonic::{Response, Status, Streaming};
use tonic_types::StatusExt;

use super::LoadArgs;
use super::amounts::{Item, Kind};
use super::compare::{Call, Tally};
use super::meshes::Surface;
use crate::remote::{Answered, Door, choice, is_lost};
use crate::say::plain;
use transport::status_name;
use wire::proto::server_service_client::ServerServiceClient;
use wire::proto::{DiagramOptions, GetServerInfoRequest, RemeshOptions};

pub(super) use job::{Rubbish, delete_blob, put, sweep};

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) enum Outcome {
    #[default]
    Done,
    /// It was cancelled, as the plan says.
    Cancelled,
    /// The server did not take it, and says when to come again.
    Refused {
        reason: String,
        after: Duration,
    },
    Failed {
        code: String,
        said: String,
    },
    /// The run was stopped meanwhile.
    Stopped,
}

/// Where the time went, as far as it is known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Stages {
    pub(super) upload: Option<Duration>,
    /// Waiting for a turn, as the server says.
    pub(super) queue: Option<Duration>,
    /// At work, as the server says.
    pub(super) compute: Option<Duration>,
    pub(super) download: Option<Duration>,
}

impl Stages {
    pub(super) const NAMES: [&'static str; 4] = ["upload", "queue", "compute", "download"];

    pub(super) fn all(&self) -> [Option<Duration>; 4] {
        [self.upload, self.queue, self.compute, self.download]
    }
}

/// What is known of a call that is over.
#[derive(Clone, Debug, Default)]
pub(super) struct Asked {
    pub(super) outcome: Outcome,
    pub(super) stages: Stages,
    pub(super) facets: u64,
    pub(super) seeds: u64,
    pub(super) sent_bytes: u64,
    pub(super) came_bytes: u64,
    pub(super) rubbish: Option<Rubbish>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Why {
    Cancel,
    TooLong,
    Stop,
}

#[derive(Debug)]
enum End {
    Status(Status),
    /// The answer cannot be.
    Wrong(String),
    /// The job ended without a result.
    Job(&'static str, String),
    /// From this side.
    Here(Why),
}

struct Ends {
    cancel: Option<Instant>,
    limit: Instant,
    stop: watch::Receiver<bool>,
}

impl Ends {
    async fn first(&self) -> Why {
        let mut stop = self.stop.clone();
        let stopped = async {
            if stop.wait_for(|stop| *stop).await.is_err() {
                std::future::pending::<()>().await;
            }
        };
        tokio::select! {
            biased;
            () = stopped => Why::Stop,
            () = tokio::time::sleep_until(self.cancel.unwrap_or(self.limit)), if self.cancel.is_some() => Why::Cancel,
            () = tokio::time::sleep_until(self.limit) => Why::TooLong,
        }
    }

    /// Waits for `work`, unless one of them comes before.
    async fn or<T>(&self, work: impl Future<Output = T>) -> Result<T, End> {
        tokio::select! {
            done = work => Ok(done),
            why = self.first() => Err(End::Here(why)),
        }
    }
}

pub(super) struct Caller {
    pub(super) tally: Tally,
    pub(super) surfaces: Arc<Vec<Surface>>,
    pub(super) args: Arc<LoadArgs>,
    /// The name of the run, which its jobs have as a label.
    pub(super) run: String,
    /// True once the run is to end.
    pub(super) stop: watch::Receiver<bool>,
    /// How long calls of each kind take, in microseconds, for cancelling some at a likely time.
    usual_us: [AtomicU64; Kind::ALL.len()],
    uploaded: AtomicU64,
}

/// What a call is taken to last before one has ended.
const USUAL: Duration = Duration::from_millis(200);

impl Caller {
    /// Makes calls with `surfaces` until `stop` is true.
    pub(super) fn new(args: Arc<LoadArgs>, surfaces: Vec<Surface>, run: String, stop: watch::Receiver<bool>) -> Self {
        let usual_us = std::array::from_fn(|_| AtomicU64::new(USUAL.as_micros() as u64));
        let (tally, surfaces, uploaded) = (Tally::default(), Arc::new(surfaces), AtomicU64::new(0));
        Self { tally, surfaces, args, run, stop, usual_us, uploaded }
    }

    /// Makes a call. With a `pace`, bytes a second, the answer is read slowly.
    pub(super) async fn ask(&self, door: &Door, item: Item, pace: Option<u64>) -> Asked {
        let begin = Instant::now();
        let usual = &self.usual_us[item.kind as usize];
        let cancel = item.cancel.map(|part| begin + Duration::from_micros(usual.load(Ordering::Relaxed)).mul_f64(part));
        let ends = Ends { cancel, limit: begin + self.args.timeout_s, stop: self.stop.clone() };
        let mut asked = Asked::default();
        let Some(surface) = self.surfaces.get(item.mesh) else { return asked };
        let mut pace = Pace { bytes_a_second: pace, due: None };
        let at = At { caller: self, door, surface, ends: &ends, random_seed: item.random_seed };
        if item.kind.is_work() {
            (asked.facets, asked.seeds) = (surface.facets, surface.points);
        }
        let ended = match item.kind {
            Kind::Remesh => at.remesh(&mut asked, &mut pace).await,
            Kind::Rvd => at.rvd(&mut asked, &mut pace).await,
            Kind::Cvt => at.cvt(&mut asked, &mut pace).await,
            Kind::RemeshJob | Kind::RvdJob => at.job(item.kind, &mut asked, &mut pace).await,
            Kind::Info => at.info().await,
        };
        asked.outcome = ended.map_or_else(outcome, |()| Outcome::Done);
        if asked.outcome == Outcome::Done {
            // A mean that forgets: an eighth of the last one.
            let took = begin.elapsed().as_micros() as u64;
            let _ = usual.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |us| Some(us - us / 8 + took / 8));
        }
        asked
    }
}

fn outcome(end: End) -> Outcome {
    let failed = |code: &str, said: &str| Outcome::Failed { code: code.to_owned(), said: plain(said) };
    match end {
        End::Here(Why::Cancel) => Outcome::Cancelled,
        End::Here(Why::Stop) => Outcome::Stopped,
        End::Here(Why::TooLong) => failed("TIMEOUT", "no answer within --timeout-s"),
        End::Wrong(said) => failed("WRONG_ANSWER", &said),
        End::Job(code, said) => failed(code, &said),
        End::Status(status) if is_lost(&status) => failed("CONNECTION_LOST", status.message()),
        End::Status(status) => match status.get_details_retry_info().and_then(|info| info.retry_delay) {
            Some(after) => Outcome::Refused { reason: reason(&status), after },
            None => failed(status_name(status.code() as usize), status.message()),
        },
    }
}

/// Why a call is refused: the server's words without their numbers, which differ from call to call.
fn reason(status: &Status) -> String {
    /// Longer ones say no more.
    const MOST: usize = 100;
    let mut text = String::new();
    for c in plain(status.message()).chars() {
        match c.is_ascii_digit() {
            true if text.ends_with('N') => {}
            true => text.push('N'),
            false => text.push(c),
        }
    }
    format!("{}: {}", status_name(status.code() as usize), text.chars().take(MOST).collect::<String>())
}

struct Pace {
    bytes_a_second: Option<u64>,
    due: Option<Instant>,
}

impl Pace {
    async fn read(&mut self, bytes: usize) {
        let Some(rate) = self.bytes_a_second else { return };
        let now = Instant::now();
        let due = self.due.unwrap_or(now).max(now) + Duration::from_secs_f64(bytes as f64 / rate.max(1) as f64);
        self.due = Some(due);
        tokio::time::sleep_until(due).await;
    }
}

struct At<'a> {
    caller: &'a Caller,
    door: &'a Door,
    surface: &'a Surface,
    ends: &'a Ends,
    random_seed: u64,
}

impl At<'_> {
    fn backend(&self) -> i32 {
        choice(self.caller.args.backend).into()
    }

    fn remesh_options(&self) -> RemeshOptions {
        let &LoadArgs { lloyd, newton, .. } = &*self.caller.args;
        let (points, seed) = (self.surface.points(), Some(self.random_seed));
        RemeshOptions { points, seed, lloyd, newton, ..RemeshOptions::default() }
    }

    fn diagram_options(&self) -> DiagramOptions {
        let (points, seed) = (self.surface.points(), Some(self.random_seed));
        DiagramOptions { points, seed, ..DiagramOptions::default() }
    }

    async fn info(&self) -> Result<(), End> {
        let mut client = ServerServiceClient::new(self.door.clone());
        let call = self.caller.tally.begin("tessera.v1.ServerService/GetServerInfo");
        unary(call, self.ends, client.get_server_info(GetServerInfoRequest {})).await.map(|_| ())
    }
}

/// Waits for the answer of a call that has only one.
async fn unary<T>(call: Call, ends: &Ends, answer: impl Future<Output = Answered<T>>) -> Result<T, End> {
    ends.or(counted(call, answer)).await?.map_err(End::Status)
}

/// The same, for as long as it takes.
async fn counted<T>(call: Call, answer: impl Future<Output = Answered<T>>) -> Result<T, Status> {
    let answer = answer.await;
    call.over(&answer);
    answer.map(Response::into_inner)
}

struct Answers<T> {
    call: Option<Call>,
    stream: Streaming<T>,
}

impl<T> Answers<T> {
    async fn of(call: Call, ends: &Ends, answer: impl Future<Output = Answered<Streaming<T>>>) -> Result<Self, End> {
        match ends.or(answer).await? {
            Ok(answer) => Ok(Self { call: Some(call), stream: answer.into_inner() }),
            Err(status) => {
                call.over::<T>(&Err(status.clone()));
                Err(End::Status(status))
            }
        }
    }

    /// The next one, or none after the last.
    async fn next(&mut self, ends: &Ends) -> Result<Option<T>, End> {
        let answer = ends.or(self.stream.message()).await?;
        if !matches!(answer, Ok(Some(_))) {
            self.call.take().into_iter().for_each(|call| call.over(&answer));
        }
        answer.map_err(End::Status)
    }
}

#[cfg(test)]
mod tests {
    use tonic::Code;
    use tonic_types::ErrorDetails;

    use super::*;

    #[test]
    fn a_refusal_is_no_failure() {
        let details = ErrorDetails::with_retry_info(Some(Duration::from_secs(2)));
        let full = Status::with_error_details(Code::ResourceExhausted, "the queue is full: 32 of 32 wait", details);
        assert_eq!(
            outcome(End::Status(full)),
            Outcome::Refused {
                reason: "RESOURCE_EXHAUSTED: the queue is full: N of N wait".to_owned(),
                after: Duration::from_secs(2)
            }
        );
        let never = outcome(End::Status(Status::resource_exhausted("too long")));
        assert!(matches!(never, Outcome::Failed { code, .. } if code == "RESOURCE_EXHAUSTED"));
        let lost = Status::from_error(Box::new(std::io::Error::other("broken wire")));
        assert!(matches!(outcome(End::Status(lost)), Outcome::Failed { code, .. } if code == "CONNECTION_LOST"));
    }

    #[tokio::test]
    async fn a_slow_reader_takes_its_time() {
        let (begin, mut pace) = (Instant::now(), Pace { bytes_a_second: Some(1000), due: None });
        for _ in 0..4 {
            pace.read(50).await;
        }
        assert!(begin.elapsed() >= Duration::from_millis(200));
    }
}
