//! Pieces of blobs, as a client sends and takes them.
//!
//! Purpose: [`struct@Hash`] names a blob by its bytes, [`piece`] makes a message of an upload, [`Incoming`] checks those of a download.
//! Invariant: bytes that [`Incoming::take`] let through are the next ones of the blob, and a blob that
//! [`Incoming::finish`] let through has the digest that was asked for. Must not know: files, calls.

use sha2::Digest as _;
use sha2::Sha256;

use super::WireError;
use super::proto::{ReadResponse, WriteRequest};

/// The most bytes of a piece that is sent.
pub const PIECE_BYTES: usize = 1 << 20;

/// The SHA-256 of bytes that come in order.
#[derive(Clone, Debug, Default)]
pub struct Hash {
    sha: Sha256,
    bytes: u64,
}

impl Hash {
    pub fn add(&mut self, bytes: &[u8]) {
        self.sha.update(bytes);
        self.bytes += bytes.len() as u64;
    }

    /// How many there were.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The digest as blobs are named: 64 lower-case hexadecimal digits.
    pub fn digest(&self) -> String {
        self.sha.clone().finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// A piece of an upload that begins at `offset`.
pub fn piece(offset: u64, data: Vec<u8>) -> WriteRequest {
    WriteRequest { offset, crc32c: crc32c::crc32c(&data), data: data.into(), ..WriteRequest::default() }
}

#[derive(Debug)]
pub struct Incoming {
    digest: String,
    size: Option<u64>,
    hash: Hash,
}

impl Incoming {
    pub fn new(digest: &str) -> Self {
        Self { digest: digest.to_owned(), size: None, hash: Hash::default() }
    }

    pub fn bytes(&self) -> u64 {
        self.hash.bytes()
    }

    /// How many there are, once a piece said so.
    pub fn size(&self) -> Option<u64> {
        self.size
    }

    /// Whether all have come.
    pub fn whole(&self) -> bool {
        self.size == Some(self.bytes())
    }

    /// Takes the next piece.
    ///
    /// # Errors
    /// [`WireError::Answer`] if it is not the next one, damaged, or too long.
    pub fn take(&mut self, piece: &ReadResponse) -> Result<(), WireError> {
        let wrong = |text: String| Err(WireError::Answer(text));
        let (came, size, length) = (self.bytes(), piece.size_bytes, piece.data.len() as u64);
        match self.size {
            Some(before) if before != size => return wrong(format!("the blob has {before} bytes and then {size}")),
            _ => self.size = Some(size),
        }
        if piece.offset != came {
            return wrong(format!("a piece begins at byte {}, but {came} have come", piece.offset));
        }
        if came > size || length > size - came {
            return wrong(format!("the blob has {size} bytes, but more were sent"));
        }
        if length == 0 && size > 0 {
            return wrong("a piece without bytes".to_owned());
        }
        if crc32c::crc32c(&piece.data) != piece.crc32c {
            return wrong(format!("the piece at byte {came} is damaged"));
        }
        self.hash.add(&piece.data);
        Ok(())
    }

    /// How many bytes it was.
    ///
    /// # Errors
    /// [`WireError::Answer`] if they are not all, or not those of the digest.
    pub fn finish(&self) -> Result<u64, WireError> {
        if !self.whole() {
            let (came, size) = (self.bytes(), self.size.unwrap_or_default());
            return Err(WireError::Answer(format!("of the {size} bytes of the blob only {came} were sent")));
        }
        match self.hash.digest() {
            digest if digest == self.digest => Ok(self.bytes()),
            other => Err(WireError::Answer(format!("the bytes have the digest {other}, not {}", self.digest))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(offset: u64, data: &[u8], size_bytes: u64) -> ReadResponse {
        ReadResponse { offset, data: data.to_vec().into(), crc32c: crc32c::crc32c(data), size_bytes }
    }

    fn digest(data: &[u8]) -> String {
        let mut hash = Hash::default();
        hash.add(data);
        hash.digest()
    }

    #[test]
    fn a_digest_is_the_one_that_everybody_knows() {
        assert_eq!(digest(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert_eq!(piece(0, b"123456789".to_vec()).crc32c, 0xe306_9283);
    }

    #[test]
    fn only_the_next_bytes_are_taken() {
        let mut blob = Incoming::new(&digest(b"abcdef"));
        blob.take(&answer(0, b"abc", 6)).unwrap();
        for (bad, words) in [
            (answer(0, b"abc", 6), "begins at byte 0, but 3"),
            (answer(3, b"def", 7), "6 bytes and then 7"),
            (answer(3, b"defg", 6), "more were sent"),
            (answer(3, b"", 6), "without bytes"),
            (ReadResponse { crc32c: 1, ..answer(3, b"def", 6) }, "damaged"),
        ] {
            let said = blob.take(&bad).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
        }
        assert!(blob.finish().unwrap_err().to_string().contains("only 3"));
        blob.take(&answer(3, b"def", 6)).unwrap();
        assert_eq!(blob.finish().unwrap(), 6);
        let mut other = Incoming::new(&digest(b"abcdeg"));
        other.take(&answer(0, b"abcdef", 6)).unwrap();
        assert!(other.finish().unwrap_err().to_string().contains("have the digest"));
        let mut empty = Incoming::new(&digest(b""));
        empty.take(&answer(0, b"", 0)).unwrap();
        assert_eq!(empty.finish().unwrap(), 0);
    }
}
