//! The byte stream of a connection: a socket, or TLS on a socket.
//!
//! Purpose: [`Line`] is one type for both, so that HTTP is compiled once; [`Tapped`] shows the bytes of a stream to a [`Tap`].
//! Invariant: bytes pass unchanged. Must not know: HTTP, certificates.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

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
