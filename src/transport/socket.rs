//! The byte stream of a connection: a TCP socket that records whether anything arrived, and since when writing is blocked, or
//! TLS on it.
//!
//! Purpose: [`open`] makes a [`Socket`], [`Traffic`] has its state. [`Line`] is one type for both streams, so that HTTP is
//! compiled once; [`Tapped`] shows the bytes of a stream to a [`Tap`], unchanged. Invariant: the system buffers at most
//! [`UNSENT_BYTES`] beyond what the peer's window takes, so that bytes written are bytes the peer has room for. Must not
//! know: HTTP, certificates.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use socket2::{SockRef, TcpKeepalive};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;

use super::exchange::Flag;
use super::lock;

/// Bytes that may wait in the system for the peer's window.
#[cfg(any(target_os = "linux", target_os = "android"))]
const UNSENT_BYTES: u32 = 64 << 10;

/// Silence after which the system asks whether the peer's host is still there, and how often and how many times.
const PROBE_AFTER: Duration = Duration::from_secs(20);
const PROBE_EVERY: Duration = Duration::from_secs(5);
#[cfg(unix)]
const PROBES: u32 = 3;

#[derive(Debug, Default)]
pub(super) struct Traffic {
    /// Set once the peer has sent anything.
    pub(super) received: Flag,
    /// Set once the peer has sent more control frames than it may.
    pub(super) flooded: Flag,
    blocked: Mutex<Option<Instant>>,
}

impl Traffic {
    /// How long bytes have waited without one being written.
    pub(super) fn blocked_for(&self) -> Duration {
        lock(&self.blocked).map_or(Duration::ZERO, |since| since.elapsed())
    }
}

impl Tap for Arc<Traffic> {
    fn read(&mut self, bytes: &[u8]) -> io::Result<()> {
        if !bytes.is_empty() {
            self.received.set();
        }
        Ok(())
    }

    fn wrote(&mut self, outcome: &Poll<io::Result<usize>>) {
        let mut blocked = lock(&self.blocked);
        match outcome {
            Poll::Pending => {
                blocked.get_or_insert_with(Instant::now);
            }
            Poll::Ready(_) => *blocked = None,
        }
    }
}

pub(super) type Socket = Tapped<TcpStream, Arc<Traffic>>;

pub(super) fn open(stream: TcpStream, traffic: Arc<Traffic>) -> io::Result<Socket> {
    stream.set_nodelay(true)?;
    let socket = SockRef::from(&stream);
    let keepalive = TcpKeepalive::new().with_time(PROBE_AFTER).with_interval(PROBE_EVERY);
    #[cfg(unix)]
    let keepalive = keepalive.with_retries(PROBES);
    socket.set_tcp_keepalive(&keepalive)?;
    #[cfg(any(target_os = "linux", target_os = "android"))]
    socket.set_tcp_notsent_lowat(UNSENT_BYTES)?;
    Ok(Tapped { stream, tap: traffic })
}

pub(super) type Line = Box<dyn Stream>;

pub(super) trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<S: AsyncRead + AsyncWrite + Send + Unpin> Stream for S {}

pub(super) trait Tap: Unpin {
    /// These bytes arrived; none if reading has to wait. An error ends the stream.
    fn read(&mut self, bytes: &[u8]) -> io::Result<()>;
    fn wrote(&mut self, outcome: &Poll<io::Result<usize>>);
}

#[derive(Debug)]
pub(super) struct Tapped<S, T> {
    pub(super) stream: S,
    pub(super) tap: T,
}

impl<S: AsyncRead + Unpin, T: Tap> AsyncRead for Tapped<S, T> {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let Self { stream, tap } = self.get_mut();
        let before = buf.filled().len();
        let outcome = Pin::new(stream).poll_read(cx, buf);
        match tap.read(&buf.filled()[before..]) {
            Ok(()) => outcome,
            Err(error) => Poll::Ready(Err(error)),
        }
    }
}

impl<S: AsyncWrite + Unpin, T: Tap> AsyncWrite for Tapped<S, T> {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let Self { stream, tap } = self.get_mut();
        let outcome = Pin::new(stream).poll_write(cx, buf);
        tap.wrote(&outcome);
        outcome
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let Self { stream, tap } = self.get_mut();
        let outcome = Pin::new(stream).poll_write_vectored(cx, bufs);
        tap.wrote(&outcome);
        outcome
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}
