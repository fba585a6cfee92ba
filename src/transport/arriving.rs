//! A request's body, as the transport sees it.
//!
//! Purpose: [`Arriving`] counts the received bytes of incomplete messages. It refuses a message if the server's memory is
//! used up, or if the message is too long, compressed or not. Invariant: bytes are counted from their arrival until their
//! message is complete or the stream ends; they pass unchanged. Must not know: the content of messages.

use std::pin::Pin;
use std::task::{Context, Poll};

use http_body::{Frame, SizeHint};
use tonic::Status;
use tonic::codegen::{Body, Bytes, StdError};

use super::budget::Budget;
use super::rejection::Rejection;
use super::unpacking::{Unpacking, Wrong};

/// Bytes of the prefix of a message: a flag for compression, and the length.
const PREFIX: usize = 5;

/// Bytes of incomplete messages allowed beyond the server's memory, so that the last message of a just fitting upload is not
/// refused for its own frame.
const SLACK: u64 = 64 << 10;

pub(super) struct Arriving<B> {
    inner: B,
    budget: Budget,
    /// The service's status for a rejection.
    status: fn(Rejection) -> Status,
    /// Longest message allowed, bytes.
    most: u64,
    /// Prefix of the next message.
    prefix: [u8; PREFIX],
    /// Prefix bytes received.
    known: usize,
    /// Message bytes still expected.
    missing: u64,
    /// Bytes charged to the budget, and the part of them that decompression holds.
    charged: u64,
    unpacked: u64,
    /// Encoding of compressed messages.
    encoding: Option<Vec<u8>>,
    /// The compressed message that is being received.
    unpacking: Option<Unpacking>,
}

impl<B> Arriving<B> {
    pub(super) fn new(
        inner: B,
        budget: Budget,
        status: fn(Rejection) -> Status,
        most: u64,
        encoding: Option<Vec<u8>>,
    ) -> Self {
        let unpacking = None;
        Self {
            inner,
            budget,
            status,
            most,
            prefix: [0; PREFIX],
            known: 0,
            missing: 0,
            charged: 0,
            unpacked: 0,
            encoding,
            unpacking,
        }
    }

    /// Records received bytes.
    fn note(&mut self, mut bytes: &[u8]) -> Result<(), Rejection> {
        while !bytes.is_empty() {
            if self.missing == 0 && self.known < PREFIX {
                let (some, rest) = bytes.split_at(bytes.len().min(PREFIX - self.known));
                self.prefix[self.known..][..some.len()].copy_from_slice(some);
                self.known += some.len();
                bytes = rest;
                if self.known < PREFIX {
                    break;
                }
                let [is_compressed, length @ ..] = self.prefix;
                self.missing = u64::from(u32::from_be_bytes(length));
                if self.missing > self.most {
                    let (length, most) = (self.missing, self.most);
                    return Err(Rejection::MessageTooLong { length, most });
                }
                self.unpacking = (is_compressed == 1).then(|| Unpacking::new(self.encoding.as_deref(), self.most));
            }
            let here = (bytes.len() as u64).min(self.missing);
            self.missing -= here;
            self.charge(here);
            let (here, rest) = bytes.split_at(here as usize);
            bytes = rest;
            if let Some(unpacking) = &mut self.unpacking {
                unpacking.add(here).map_err(|wrong| match wrong {
                    Wrong::TooLong => Rejection::Unpacked { most: self.most },
                    Wrong::Damaged => Rejection::Damaged,
                })?;
                let held = unpacking.held_bytes();
                self.charge(held.saturating_sub(self.unpacked));
                self.unpacked = self.unpacked.max(held);
            }
            if self.missing == 0 {
                self.known = 0;
                self.unpacking = None;
                self.release();
            }
        }
        if self.charged > 0 && !self.budget.has_within(SLACK) {
            let needed_bytes = self.charged + self.missing;
            return Err(Rejection::Memory { needed_bytes, left_bytes: 0 });
        }
        Ok(())
    }

    fn charge(&mut self, bytes: u64) {
        self.budget.charge(bytes);
        self.charged += bytes;
    }

    fn release(&mut self) {
        self.unpacked = 0;
        self.budget.release(std::mem::take(&mut self.charged));
    }
}

impl<B> Body for Arriving<B>
where
    B: Body<Data = Bytes> + Unpin,
    B::Error: Into<StdError>,
{
    type Data = Bytes;
    type Error = StdError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        let frame = match Pin::new(&mut self.inner).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => frame,
            Poll::Ready(Some(Err(error))) => return Poll::Ready(Some(Err(error.into()))),
            Poll::Ready(None) => return Poll::Ready(None),
            Poll::Pending => return Poll::Pending,
        };
        if let Some(Err(rejection)) = frame.data_ref().map(|data| self.note(data)) {
            return Poll::Ready(Some(Err((self.status)(rejection).into())));
        }
        Poll::Ready(Some(Ok(frame)))
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

impl<B> Drop for Arriving<B> {
    fn drop(&mut self) {
        self.release();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(rejection: Rejection) -> Status {
        Status::unknown(rejection.to_string())
    }

    fn message(length: usize) -> Vec<u8> {
        let mut bytes = vec![0];
        bytes.extend((length as u32).to_be_bytes());
        bytes.resize(PREFIX + length, 7);
        bytes
    }

    #[test]
    fn what_is_unfinished_is_counted_and_what_is_whole_is_not() {
        let all = [message(1000), message(0), message(3), message(70_000)].concat();
        for step in [1, 2, 5, 7, 999, 1006, 4096, all.len()] {
            let budget = Budget::new(1 << 20);
            let mut body = Arriving::new((), budget.clone(), status, 1 << 20, None);
            let mut come = 0;
            for part in all.chunks(step) {
                body.note(part).unwrap();
                come += part.len();
                // The last message begins at 1018.
                let unfinished =
                    if come > 1018 && come < all.len() { come - 1018 - (PREFIX.min(come - 1018)) } else { 0 };
                if come > 1018 || step == all.len() {
                    assert_eq!(body.charged, unfinished as u64, "{come} in steps of {step}");
                }
            }
            assert!(budget.has(1 << 20) && body.charged == 0);
        }
    }

    #[test]
    fn a_message_that_never_ends_is_refused_once_memory_is_used_up() {
        let budget = Budget::new(1 << 20);
        let mut bodies: Vec<_> = (0..4).map(|_| Arriving::new((), budget.clone(), status, 4 << 20, None)).collect();
        let long = message(4 << 20);
        let mut refused = 0;
        for part in long[..1 << 19].chunks(1 << 14) {
            for body in &mut bodies {
                if let Err(rejection) = body.note(part) {
                    assert!(matches!(rejection, Rejection::Memory { left_bytes: 0, .. }));
                    refused += 1;
                }
            }
        }
        assert!(refused > 0);
        assert!(!budget.has(1));
        drop(bodies);
        assert!(budget.has(1 << 20), "all is given back");
    }

    #[test]
    fn a_message_that_nobody_expects_is_refused_by_its_length() {
        let mut body = Arriving::new((), Budget::new(1 << 20), status, 1000, None);
        body.note(&message(1000)).unwrap();
        let rejection = body.note(&message(1001)[..PREFIX]).unwrap_err();
        assert!(matches!(rejection, Rejection::MessageTooLong { length: 1001, most: 1000 }));
    }
}
