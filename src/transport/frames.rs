//! Frames of HTTP/2 that carry neither a request nor its bytes: pings, settings, resets, windows.
//!
//! Purpose: [`Meter`] counts control frames and ends a connection that sends too many. Each takes time to read, and many
//! need an answer, even without a request. Invariant: the frames that a client needs to read answers are free: written
//! bytes earn frames. Must not know: requests, HTTP/2 beyond the head of a frame.

use std::io;
use std::sync::Arc;
use std::task::Poll;
use std::time::Instant;

use super::lines::Lines;
use super::socket::{Tap, Traffic};

const PREFACE: &[u8; 24] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// The head of a frame, bytes: length (3), type, flags, stream (4). RFC 9113, section 4.1.
const HEAD: usize = 9;

/// Types of frames, and the flag that ends a stream (RFC 9113, section 6).
const DATA: u8 = 0;
const HEADERS: u8 = 1;
const END_STREAM: u8 = 1;

/// Length of a burst, seconds of the rate.
const BURST: f64 = 10.0;

/// Written bytes that earn a frame: more than the answer to a ping or to settings, so that such answers do not earn the next
/// one.
const BYTES_A_FRAME: f64 = 64.0;

/// Finds the heads of frames in a stream of arbitrary pieces.
#[derive(Debug)]
struct Heads {
    /// Received bytes of the preface; `None` for HTTP/1.1, which has no frames.
    greeted: Option<usize>,
    /// Bytes until the next head.
    skip: usize,
    head: [u8; HEAD],
    filled: usize,
}

impl Heads {
    fn new() -> Self {
        Self { greeted: Some(0), skip: 0, head: [0; HEAD], filled: 0 }
    }

    /// Whether the connection speaks HTTP/1.1.
    fn are_none(&self) -> bool {
        self.greeted.is_none()
    }

    /// How many frames that carry nothing begin in `bytes`.
    fn idle_frames(&mut self, mut bytes: &[u8]) -> usize {
        let mut count = 0;
        let Some(greeted) = &mut self.greeted else { return 0 };
        let (preface, rest) = bytes.split_at(bytes.len().min(PREFACE.len() - *greeted));
        if !PREFACE[*greeted..].starts_with(preface) {
            self.greeted = None;
            return 0;
        }
        *greeted += preface.len();
        bytes = rest;
        while !bytes.is_empty() {
            let skipped = self.skip.min(bytes.len());
            self.skip -= skipped;
            bytes = &bytes[skipped..];
            let taken = (HEAD - self.filled).min(bytes.len());
            self.head[self.filled..self.filled + taken].copy_from_slice(&bytes[..taken]);
            self.filled += taken;
            bytes = &bytes[taken..];
            if self.filled == HEAD {
                let [a, b, c, kind, flags, ..] = self.head;
                (self.skip, self.filled) = (u32::from_be_bytes([0, a, b, c]) as usize, 0);
                // The end of a stream has often no bytes; requests are limited by number, keys and resets.
                let useful = kind == HEADERS || kind == DATA && (self.skip > 0 || flags & END_STREAM != 0);
                count += usize::from(!useful);
            }
        }
        count
    }
}

/// The number of frames that may still arrive.
#[derive(Debug)]
struct Allowance {
    /// Frames a second.
    rate: f64,
    left: f64,
    last: Instant,
}

impl Allowance {
    fn new(rate: u32, now: Instant) -> Self {
        let rate = f64::from(rate);
        Self { rate, left: BURST * rate, last: now }
    }

    /// Takes `count` frames; false if fewer are left.
    fn take(&mut self, count: usize, now: Instant) -> bool {
        self.earn(self.rate * (now - self.last).as_secs_f64());
        self.last = now;
        self.left -= count as f64;
        self.left >= 0.0
    }

    fn earn(&mut self, frames: f64) {
        self.left = (self.left + frames).min(BURST * self.rate);
    }
}

pub(super) struct Meter {
    heads: Heads,
    allowance: Allowance,
    traffic: Arc<Traffic>,
    lines: Lines,
}

impl Meter {
    /// Allows `rate` control frames a second.
    pub(super) fn new(rate: u32, traffic: Arc<Traffic>) -> Self {
        Self { heads: Heads::new(), allowance: Allowance::new(rate, Instant::now()), traffic, lines: Lines::default() }
    }
}

impl Tap for Meter {
    fn read(&mut self, bytes: &[u8]) -> io::Result<()> {
        let count = self.heads.idle_frames(bytes);
        if count > 0 && !self.allowance.take(count, Instant::now()) {
            self.traffic.flooded.set();
            return Err(io::Error::other("too many frames that carry nothing"));
        }
        if self.heads.are_none() && !self.lines.are_whole(bytes) {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "a line ends by a line feed alone"));
        }
        Ok(())
    }

    fn wrote(&mut self, outcome: &Poll<io::Result<usize>>) {
        if let Poll::Ready(Ok(bytes)) = outcome {
            self.allowance.earn(*bytes as f64 / BYTES_A_FRAME);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use proptest::prelude::*;

    use super::*;

    fn frame(kind: u8, flags: u8, length: usize) -> Vec<u8> {
        let [_, a, b, c] = (length as u32).to_be_bytes();
        let mut bytes = vec![a, b, c, kind, flags, 0, 0, 0, 1];
        bytes.resize(HEAD + length, 0xff);
        bytes
    }

    proptest! {
        /// However the bytes are cut, each frame is seen once.
        #[test]
        fn frames_are_counted_in_any_pieces(
            frames in prop::collection::vec((0u8..12, 0u8..3, 0usize..70), 0..40),
            cuts in prop::collection::vec(1usize..50, 1..40),
        ) {
            let mut bytes = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec();
            let mut expected = 0;
            for (kind, flags, length) in frames {
                bytes.extend(frame(kind, flags, length));
                let useful = match kind {
                    0 => length > 0 || flags & 1 != 0,
                    kind => kind == 1,
                };
                expected += usize::from(!useful);
            }
            let (mut heads, mut found, mut rest) = (Heads::new(), 0, &bytes[..]);
            for cut in cuts.iter().cycle() {
                let (piece, more) = rest.split_at((*cut).min(rest.len()));
                found += heads.idle_frames(piece);
                rest = more;
                if rest.is_empty() {
                    break;
                }
            }
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn an_allowance_comes_back_with_time_and_with_what_is_written() {
        let start = Instant::now();
        let mut allowance = Allowance::new(100, start);
        assert!(allowance.take(1000, start), "ten seconds' worth at once");
        assert!(!allowance.take(1, start));
        assert!(allowance.take(100, start + Duration::from_millis(1011)));
        allowance.earn(500.0);
        assert!(allowance.take(500, start + Duration::from_millis(1011)));
        // It does not grow without end.
        allowance.earn(1e12);
        let later = start + Duration::from_secs(1 << 20);
        assert!(allowance.take(1000, later) && !allowance.take(1, later));
    }

    #[test]
    fn answers_to_pings_do_not_earn_the_next() {
        // Ten seconds of pings as fast as they are answered, 17 bytes each.
        let start = Instant::now();
        let mut allowance = Allowance::new(1000, start);
        let lasted = (0..100_000u32).take_while(|i| {
            allowance.earn(17.0 / BYTES_A_FRAME);
            allowance.take(1, start + Duration::from_micros(100) * *i)
        });
        assert!((10_000..20_000).contains(&lasted.count()));
    }
}
