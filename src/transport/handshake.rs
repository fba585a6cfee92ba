//! TLS handshakes, limited in number.
//!
//! Purpose: [`Handshakes::shake`] performs the TLS handshake of a socket. Invariant: it ends within its time limit, ends
//! with its connection or when the server drains, and does not delay the accepting of others. A connection that sent
//! nothing takes no turn. If all turns are taken, the oldest handshake above a second is dropped, so that stalled ones
//! delay others by a second at most. Must not know: the protocol over TLS.

use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

use super::connection::State;
use super::places::Guest;
use super::socket::Socket;
use super::tls::Tls;
use super::{ConnectionLimits, Phase, lock};
use telemetry::Seldom;

/// A handshake that has had this long may be given up for a newcomer. An honest one takes a few round trips.
const FAIR: Duration = Duration::from_secs(1);

/// Limits on the bytes read and the time after a failed handshake, so that the client gets the alert.
const PART_BYTES: usize = 64 << 10;
const PART_TIME: Duration = Duration::from_secs(1);

/// Between two looks for one that can be given up.
const LOOK_EVERY: Duration = Duration::from_millis(50);

pub(super) struct Handshakes {
    pub(super) tls: Arc<Tls>,
    web: bool,
    limits: ConnectionLimits,
    turns: Arc<Semaphore>,
    open: Mutex<Open>,
    failed: Seldom,
    given_up: Seldom,
}

/// Handshakes under way, the oldest first.
#[derive(Default)]
struct Open {
    next: u64,
    all: BTreeMap<u64, (Instant, Arc<State>)>,
}

/// A turn; given back when dropped.
struct Turn<'a> {
    of: &'a Handshakes,
    id: u64,
    _permit: OwnedSemaphorePermit,
}

impl Handshakes {
    pub(super) fn new(tls: Arc<Tls>, limits: ConnectionLimits, web: bool) -> Self {
        let turns = Arc::new(Semaphore::new(limits.handshakes));
        Self { tls, web, limits, turns, open: Mutex::default(), failed: Seldom::default(), given_up: Seldom::default() }
    }

    /// Performs the handshake; `None` if it fails.
    pub(super) async fn shake(
        &self,
        socket: Socket,
        state: &Arc<State>,
        mut phase: watch::Receiver<Phase>,
    ) -> Option<TlsStream<Socket>> {
        let shaking = async {
            tokio::time::timeout(self.limits.first_byte, socket.stream.readable())
                .await
                .map_err(|_| io::Error::new(io::ErrorKind::TimedOut, "nothing came"))??;
            let turn = self.turn(state).await?;
            let shaken = TlsAcceptor::from(self.tls.current(self.web)).accept(socket).into_fallible().await;
            drop(turn);
            match shaken {
                Ok(stream) => Ok(stream),
                Err((error, socket)) => {
                    part(socket).await;
                    Err(error)
                }
            }
        };
        let error = tokio::select! {
            shaken = tokio::time::timeout(self.limits.handshake, shaking) => match shaken {
                Ok(Ok(stream)) => return Some(stream),
                Ok(Err(error)) => error,
                Err(_) => io::Error::new(io::ErrorKind::TimedOut, "the handshake took too long"),
            },
            () = state.evicted.notified() => return None,
            _ = phase.wait_for(|now| *now >= Phase::Draining) => return None,
        };
        let (peer, why) = (state.peer, reason(&error));
        tracing::debug!(%peer, why, "a TLS handshake failed");
        if let Some(times) = self.failed.count() {
            tracing::info!(times, %peer, why, "TLS handshakes failed; this is the last of them");
        }
        None
    }

    async fn turn(&self, state: &Arc<State>) -> io::Result<Turn<'_>> {
        let acquiring = Arc::clone(&self.turns).acquire_owned();
        tokio::pin!(acquiring);
        let permit = loop {
            self.give_up_oldest();
            tokio::select! {
                biased;
                permit = acquiring.as_mut() => break permit.map_err(io::Error::other)?,
                () = tokio::time::sleep(LOOK_EVERY) => {}
            }
        };
        let mut open = lock(&self.open);
        let id = open.next;
        open.next += 1;
        open.all.insert(id, (Instant::now(), Arc::clone(state)));
        Ok(Turn { of: self, id, _permit: permit })
    }

    /// Ends the oldest handshake if all turns are taken and it has had its time.
    fn give_up_oldest(&self) {
        if self.turns.available_permits() > 0 {
            return;
        }
        let mut open = lock(&self.open);
        if let Some(entry) = open.all.first_entry()
            && entry.get().0.elapsed() >= FAIR
        {
            entry.remove().1.evict();
            if let Some(times) = self.given_up.count() {
                tracing::warn!(times, "gave up TLS handshakes that stalled, to make room for new ones");
            }
        }
    }
}

fn reason(error: &io::Error) -> String {
    match error.get_ref().and_then(|inner| inner.downcast_ref::<rustls::Error>()) {
        Some(rustls::Error::InvalidMessage(_)) => "the client speaks no TLS".to_owned(),
        Some(rustls::Error::NoCertificatesPresented) => "the client shows no certificate".to_owned(),
        Some(rustls::Error::InvalidCertificate(why)) => format!("the client's certificate is refused: {why}"),
        Some(rustls::Error::AlertReceived(alert)) => format!("the client refuses the server: {alert:?}"),
        Some(rustls::Error::NoApplicationProtocol) => "the client does not speak HTTP/2".to_owned(),
        _ => error.to_string(),
    }
}

/// Ends a socket so that its client can read why. To close it while bytes of the client are unread would reset it, and the
/// reason would be lost on the way.
async fn part(mut socket: Socket) {
    let _ = socket.shutdown().await;
    let reading = async {
        let mut buffer = [0; 1024];
        let mut left = PART_BYTES;
        while let Ok(count @ 1..) = socket.read(&mut buffer).await
            && left > count
        {
            left -= count;
        }
    };
    let _ = tokio::time::timeout(PART_TIME, reading).await;
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        lock(&self.of.open).all.remove(&self.id);
    }
}
