//! Files of certificates and keys.
//!
//! Invariant: reading ends, whatever lies at the path. Must not know: what a file holds.

use std::fs::{self, File};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// All bytes of a regular file. Errors: `FileTooLarge` if it has more than `most` bytes, and those of the system.
pub fn read_regular(path: &Path, most: u64) -> Result<Vec<u8>> {
    // A pipe would be waited for.
    if !fs::metadata(path)?.is_file() {
        return Err(Error::other("it is no regular file"));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    match bytes.len() as u64 > most {
        true => Err(Error::new(ErrorKind::FileTooLarge, format!("it has more than {most} bytes"))),
        false => Ok(bytes),
    }
}
