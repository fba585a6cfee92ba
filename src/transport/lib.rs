//! Connections of a server: HTTP/2 with gRPC, HTTP/1.1, TLS, and limits on all of them.
//!
//! Purpose: [`serve`] accepts connections and runs each on a task of its own, with the service's routes. Invariant: there is
//! always room for a client with a request: connections are limited in number, in all and from each peer, and silent ones go
//! first; every wait for a peer has a limit; where descriptors run out, accepting waits instead of spinning. Must not know:
//! messages, jobs, surfaces: any service can use it.

#![warn(unreachable_pub)]
// Fields and variants that their names explain; the callers are crates of this workspace.
#![allow(missing_docs)]

mod account;
mod arriving;
mod budget;
mod connection;
mod counters;
mod exchange;
mod file;
mod frames;
mod handshake;
mod limits;
mod lines;
mod places;
mod rejection;
mod socket;
mod tls;
mod unpacking;
mod unread;

use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::Router;
use futures_util::future::BoxFuture;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::http::{Request, Response};

pub use budget::{Budget, Share};
pub use counters::{Calls, Counters, Histograms, Labels, status_name};
pub use exchange::Exchange;
pub use file::read_regular;
pub use limits::ConnectionLimits;
pub use places::Peer;
pub use rejection::Rejection;
pub use tls::{Tls, TlsError, TlsFiles};
pub use unread::status as status_of_unread;

use self::connection::State;
use self::handshake::Handshakes;
use self::places::{Full, Places};
use self::socket::Line;
use telemetry::Seldom;

/// Between the last answer and the end of its connection. A connection that closes while its client still
/// acknowledges data is reset, and what the client has not read yet is lost.
const LINGER: Duration = Duration::from_millis(300);

/// For a connection that was asked to go, before the newcomer is refused.
const ROOM_TIME: Duration = Duration::from_millis(500);

/// Pauses after accepting failed: the first, and the longest.
const PAUSE: Duration = Duration::from_millis(10);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// How far the server is on its way out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    Serving,
    Draining,
    /// The grace period is over: what is left ends now.
    Cut,
    /// Nothing is left: connections close.
    Closing,
}

#[derive(Clone)]
pub enum Protocol {
    /// Services over HTTP/2.
    Grpc(Arc<Grpc>),
    /// A router over HTTP/1.1 and HTTP/2.
    Web(Router),
}

/// Services of gRPC, as connections need them.
pub struct Grpc {
    /// Answers a request.
    pub routes: Routes,
    pub calls: Calls,
    /// The start of the paths that take uploads; messages to other paths are small.
    pub uploads: &'static str,
    /// The status of a rejection.
    pub status: fn(Rejection) -> Status,
}

pub type Routes = Box<dyn Fn(Request<Body>) -> BoxFuture<'static, Response<Body>> + Send + Sync>;

/// State that all ports of a server share: connections are limited together.
#[derive(Clone)]
pub struct Shared {
    places: Arc<Places<State>>,
    limits: ConnectionLimits,
    budget: Budget,
    counters: Counters,
    tls: Option<Arc<Tls>>,
}

impl Shared {
    pub fn new(limits: ConnectionLimits, budget: Budget, counters: Counters, tls: Option<Arc<Tls>>) -> Self {
        let most = connections(limits.max_connections);
        if most < limits.max_connections {
            tracing::warn!(
                connections = most,
                wanted = limits.max_connections,
                "the limit on open files allows fewer connections; raise it (ulimit -n) for more"
            );
        }
        let places = Places::new(most, limits.max_connections_per_peer);
        Self { places, limits, budget, counters, tls }
    }
}

/// Locks a mutex whose content is never left half changed, so that it is good even after a panic.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Common {
    limits: ConnectionLimits,
    budget: Budget,
    handshakes: Option<Handshakes>,
    counters: Counters,
    /// Connections that were closed for breaking a limit.
    closed: Seldom,
}

/// Serves `protocol` on `listener` until `phase` is [`Phase::Closing`]; connections then have the time of `closing` to close.
pub async fn serve(
    listener: TcpListener,
    protocol: Protocol,
    shared: Shared,
    phase: watch::Receiver<Phase>,
    closing: watch::Receiver<Duration>,
) {
    let Shared { places, limits, budget, counters, tls } = shared;
    let is_web = matches!(protocol, Protocol::Web(_));
    let handshakes = tls.map(|tls| Handshakes::new(tls, limits, is_web));
    let common = Arc::new(Common { limits, budget, counters, handshakes, closed: Seldom::default() });
    let following = {
        let common = Arc::clone(&common);
        async move {
            match &common.handshakes {
                // One port has the files looked at, for all.
                Some(handshakes) if !is_web => Arc::clone(&handshakes.tls).follow().await,
                _ => std::future::pending().await,
            }
        }
    };
    let accepting = Accepting {
        listener,
        places: Arc::clone(&places),
        protocol,
        common,
        phase: phase.clone(),
        refused: Seldom::default(),
        evicted: Seldom::default(),
        failed: Seldom::default(),
    };
    let mut until = phase;
    tokio::select! {
        () = accepting.run() => {}
        () = following => {}
        _ = until.wait_for(|now| *now >= Phase::Closing) => {}
    }
    let time = *closing.borrow();
    if tokio::time::timeout(time, places.empty()).await.is_err() {
        tracing::warn!("closing connections whose clients still have not read everything");
        places.evict_all();
        let _ = tokio::time::timeout(ROOM_TIME, places.empty()).await;
    }
}

struct Accepting {
    listener: TcpListener,
    places: Arc<Places<State>>,
    protocol: Protocol,
    common: Arc<Common>,
    phase: watch::Receiver<Phase>,
    refused: Seldom,
    evicted: Seldom,
    failed: Seldom,
}

impl Accepting {
    async fn run(self) {
        let mut pause = PAUSE;
        loop {
            match self.listener.accept().await {
                Ok((stream, peer)) => {
                    pause = PAUSE;
                    self.admit(stream, peer).await;
                }
                Err(error) if is_the_peer_s(&error) => {}
                Err(error) => {
                    if let Some(times) = self.failed.count() {
                        tracing::error!(%error, times, "connections cannot be accepted; trying again");
                    }
                    if exhausted(&error) {
                        self.places.make_room(Full::All, None, ROOM_TIME).await;
                    }
                    tokio::time::sleep(pause).await;
                    pause = (2 * pause).min(LONGEST_PAUSE);
                }
            }
        }
    }

    /// Runs a new connection if there is a place for it.
    async fn admit(&self, stream: TcpStream, peer: SocketAddr) {
        let state = Arc::new(State::new(Peer::of(peer)));
        let place = match self.places.claim(peer, &state) {
            Ok(place) => Ok(place),
            Err(full) => {
                if self.places.make_room(full, Some(peer), ROOM_TIME).await
                    && let Some(times) = self.evicted.count()
                {
                    tracing::warn!(%peer, times, ?full, "closed silent or idle connections to make room for new ones");
                }
                self.places.claim(peer, &state)
            }
        };
        match place {
            Ok(place) => {
                let (common, phase) = (Arc::clone(&self.common), self.phase.clone());
                let protocol = self.protocol.clone();
                let open = self.common.counters.connection();
                tokio::spawn(async move {
                    let _open = open;
                    if let Some(line) = establish(stream, &state, &common, phase.clone()).await {
                        match protocol {
                            Protocol::Grpc(grpc) => connection::serve(line, state, common, grpc, phase).await,
                            Protocol::Web(router) => connection::serve_web(line, state, common, router, phase).await,
                        }
                    }
                    drop(place);
                });
            }
            Err(full) => {
                self.common.counters.refused.inc();
                if let Some(times) = self.refused.count() {
                    tracing::warn!(%peer, times, ?full, "refused connections: all that are open are in use");
                }
            }
        }
    }
}

/// Makes of a new socket what HTTP is spoken on; nothing if it came to nothing.
async fn establish(
    stream: TcpStream,
    state: &Arc<State>,
    common: &Common,
    phase: watch::Receiver<Phase>,
) -> Option<Line> {
    let socket = socket::open(stream, Arc::clone(&state.traffic)).ok()?;
    match &common.handshakes {
        None => Some(Box::new(socket)),
        Some(handshakes) => Some(Box::new(handshakes.shake(socket, state, phase).await?)),
    }
}

/// Whether accepting failed for a fault of one peer, so that the next may be accepted at once.
fn is_the_peer_s(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset, Interrupted};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset | Interrupted)
}

/// Descriptors that connections leave to everything else.
const RESERVE: usize = 64;

/// Descriptors taken as in use where they cannot be counted.
const IN_USE_IF_UNKNOWN: usize = 64;

/// Returns `wanted`, or fewer if the soft limit on open files is lower; at least 1.
fn connections(wanted: usize) -> usize {
    let Some(soft) = soft_limit() else { return wanted };
    wanted.min(soft.saturating_sub(in_use() + RESERVE)).max(1)
}

fn in_use() -> usize {
    std::fs::read_dir("/dev/fd").map_or(IN_USE_IF_UNKNOWN, Iterator::count)
}

#[cfg(unix)]
fn soft_limit() -> Option<usize> {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Nofile).current?;
    Some(usize::try_from(limit).unwrap_or(usize::MAX))
}

#[cfg(not(unix))]
fn soft_limit() -> Option<usize> {
    None
}

#[cfg(unix)]
fn exhausted(error: &io::Error) -> bool {
    use rustix::io::Errno;
    Errno::from_io_error(error).is_some_and(|errno| errno == Errno::MFILE || errno == Errno::NFILE)
}

#[cfg(not(unix))]
fn exhausted(_error: &io::Error) -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_leave_a_reserve() {
        assert_eq!(connections(1), 1);
        if let Some(soft) = soft_limit() {
            assert!(connections(usize::MAX) <= soft.saturating_sub(RESERVE).max(1));
        }
        #[cfg(unix)]
        assert!(exhausted(&rustix::io::Errno::MFILE.into()));
        assert!(!exhausted(&io::ErrorKind::ConnectionAborted.into()));
    }
}
