//! How long a compressed message will be.
//!
//! Purpose: [`Unpacking`] decompresses a message on arrival and discards the result, so that a message that expands too
//! much is refused before memory is allocated. Invariant: it holds only the compression window; accepted messages have at
//! most the given length. Must not know: messages, their readers.

use std::io::{self, Write};

use flate2::write::GzDecoder;
use zstd::stream::write::Decoder as ZstdDecoder;

/// The largest window of zstd, as a power of two: 8 MiB, which its decoders take by default.
const WINDOW_LOG: u32 = 23;

/// Approximate memory of a decoder without its window, bytes.
const DECODER_BYTES: u64 = 128 << 10;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wrong {
    TooLong,
    Damaged,
}

pub(super) enum Unpacking {
    Gzip(Box<GzDecoder<Counted>>),
    Zstd(Box<ZstdDecoder<'static, Counted>>),
    /// The encoding is unknown; the reader reports it.
    Unknown,
}

/// Counts bytes and discards them.
pub(super) struct Counted {
    most: u64,
    left: u64,
}

impl Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.left.checked_sub(bytes.len() as u64) {
            Some(left) => {
                self.left = left;
                Ok(bytes.len())
            }
            None => Err(io::ErrorKind::FileTooLarge.into()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Unpacking {
    /// A message with this encoding and at most `most` bytes.
    pub(super) fn new(encoding: Option<&[u8]>, most: u64) -> Self {
        let counted = Counted { most, left: most };
        match encoding {
            Some(b"gzip") => Self::Gzip(Box::new(GzDecoder::new(counted))),
            Some(b"zstd") => {
                let made = ZstdDecoder::new(counted).and_then(|mut decoder| {
                    decoder.window_log_max(WINDOW_LOG)?;
                    Ok(decoder)
                });
                made.map_or(Self::Unknown, |decoder| Self::Zstd(Box::new(decoder)))
            }
            _ => Self::Unknown,
        }
    }

    /// Approximate memory held: the decoder and the filled part of its window.
    pub(super) fn held_bytes(&self) -> u64 {
        match self {
            Self::Gzip(_) => DECODER_BYTES,
            Self::Zstd(decoder) => {
                let counted = decoder.get_ref();
                DECODER_BYTES + (counted.most - counted.left).min(1 << WINDOW_LOG)
            }
            Self::Unknown => 0,
        }
    }

    pub(super) fn add(&mut self, bytes: &[u8]) -> Result<(), Wrong> {
        let done = match self {
            Self::Gzip(decoder) => write(&mut **decoder, bytes),
            Self::Zstd(decoder) => write(&mut **decoder, bytes),
            Self::Unknown => Ok(()),
        };
        done.map_err(|error| match error.kind() {
            io::ErrorKind::FileTooLarge => Wrong::TooLong,
            _ => Wrong::Damaged,
        })
    }
}

/// Writes all bytes. Bytes after the end of the compressed data are ignored.
fn write(decoder: &mut impl Write, mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        match decoder.write(bytes) {
            Ok(0) => return Ok(()),
            Ok(some) => bytes = bytes.get(some..).unwrap_or_default(),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    decoder.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn what_is_as_long_as_it_may_be_goes_through_and_a_byte_more_does_not() {
        let bytes: Vec<u8> = (0..300_000u32).map(|i| (i % 251) as u8).collect();
        let packed = [(&b"gzip"[..], gzip(&bytes)), (b"zstd", zstd::encode_all(&bytes[..], 3).unwrap())];
        for (encoding, packed) in packed {
            for step in [1, 7, 1000, packed.len()] {
                let said = |most| {
                    let mut unpacking = Unpacking::new(Some(encoding), most);
                    packed.chunks(step).try_for_each(|some| unpacking.add(some))
                };
                assert_eq!(said(300_000), Ok(()), "in steps of {step}");
                assert_eq!(said(299_999), Err(Wrong::TooLong), "in steps of {step}");
            }
            let mut damaged = packed.clone();
            damaged[0] ^= 0xff;
            assert_eq!(Unpacking::new(Some(encoding), 1 << 20).add(&damaged), Err(Wrong::Damaged));
        }
        assert_eq!(Unpacking::new(Some(b"br"), 0).add(b"anything"), Ok(()));
        assert_eq!(Unpacking::new(None, 0).add(b"anything"), Ok(()));
    }

    #[test]
    fn what_a_window_holds_is_told() {
        let packed = zstd::encode_all(&vec![0; 3 << 20][..], 3).unwrap();
        let mut unpacking = Unpacking::new(Some(b"zstd"), 4 << 20);
        assert_eq!(unpacking.held_bytes(), DECODER_BYTES);
        unpacking.add(&packed).unwrap();
        assert!(packed.len() < 1000 && unpacking.held_bytes() == DECODER_BYTES + (3 << 20), "{}", packed.len());
    }

    #[test]
    fn what_comes_after_the_end_harms_nobody() {
        let packed = [gzip(b"some bytes"), vec![7; 1000]].concat();
        assert_eq!(Unpacking::new(Some(b"gzip"), 100).add(&packed), Ok(()));
        let twice = [zstd::encode_all(&[1; 60][..], 3).unwrap(), zstd::encode_all(&[1; 60][..], 3).unwrap()].concat();
        assert_eq!(Unpacking::new(Some(b"zstd"), 120).add(&twice), Ok(()));
        assert_eq!(Unpacking::new(Some(b"zstd"), 119).add(&twice), Err(Wrong::TooLong));
    }
}
