//! Vertices at one place.
//!
//! Purpose: for every vertex the lowest one at exactly its place, in a scratch file, found by sorting; nothing where no two
//! vertices share a place. Invariant: 0 and -0 are the same place. Must not know: facets.

use super::file::{Scratch, WriteAt};
use super::{MeshFile, MeshFileError, READ, Sorter};
use crate::token::Token;

/// The lowest vertex at the place of each.
#[derive(Debug)]
pub struct Welds {
    file: WriteAt,
}

/// Vertices between two looks at the token.
const ASKED: usize = 1 << 16;

impl Welds {
    /// Finds them in so many bytes of memory. `None` if all places differ.
    pub fn find(
        file: &MeshFile,
        memory: usize,
        scratch: &Scratch,
        token: &Token,
    ) -> Result<Option<Self>, MeshFileError> {
        match file.number_bytes() {
            4 => Self::by_records::<16>(file, memory, scratch, token),
            _ => Self::by_records::<28>(file, memory, scratch, token),
        }
    }

    /// Records are a position and the vertex.
    fn by_records<const N: usize>(
        file: &MeshFile,
        memory: usize,
        scratch: &Scratch,
        token: &Token,
    ) -> Result<Option<Self>, MeshFileError> {
        let count = file.vertices();
        let mut by_place = Sorter::<N>::new(scratch, memory / 2, count);
        file.each_positions(0..count, token, |vertex, p| {
            let mut record = [0; N];
            for (out, x) in record[..N - 4].chunks_exact_mut((N - 4) / 3).zip(p.to_array()) {
                // Adding 0 makes -0 the same as 0.
                match N {
                    16 => out.copy_from_slice(&(x as f32 + 0.0).to_be_bytes()),
                    _ => out.copy_from_slice(&(x + 0.0).to_be_bytes()),
                }
            }
            record[N - 4..].copy_from_slice(&(vertex as u32).to_be_bytes());
            by_place.push(record)
        })?;
        let mut by_place = by_place.merge(token)?;
        let mut later: Option<Sorter<'_, 8>> = None;
        let mut first: Option<[u8; N]> = None;
        let mut done = 0;
        while let Some(record) = by_place.take()? {
            done += 1;
            if done % ASKED == 0 {
                token.check()?;
            }
            match first.filter(|first| first[..N - 4] == record[..N - 4]) {
                None => first = Some(record),
                Some(first) => {
                    let mut pair = [0; 8];
                    pair[..4].copy_from_slice(&record[N - 4..]);
                    pair[4..].copy_from_slice(&first[N - 4..]);
                    later.get_or_insert_with(|| Sorter::new(scratch, memory / 2, count)).push(pair)?;
                }
            }
        }
        drop(by_place);
        let Some(later) = later else { return Ok(None) };
        let mut later = later.merge(token)?;
        let welds = scratch.file()?;
        let mut next = later.take()?;
        let mut bytes = Vec::with_capacity(READ);
        for begin in (0..count).step_by(READ / 4) {
            token.check()?;
            bytes.clear();
            for vertex in begin as u32..count.min(begin + READ / 4) as u32 {
                let pair = next.map(u64::from_be_bytes).filter(|pair| (pair >> 32) as u32 == vertex);
                let lowest = pair.map_or(vertex, |pair| pair as u32);
                if pair.is_some() {
                    next = later.take()?;
                }
                bytes.extend_from_slice(&lowest.to_le_bytes());
            }
            welds.write(4 * begin as u64, &bytes)?;
        }
        Ok(Some(Self { file: welds }))
    }

    /// Calls `visit` with the numbers of `count` vertices from `first` on, in parts whose lengths are multiples of three.
    pub(super) fn read(&self, first: usize, count: usize, mut visit: impl FnMut(&[u32])) -> Result<(), MeshFileError> {
        const PART: usize = 3 << 16;
        let (mut bytes, mut numbers) = (Vec::new(), Vec::new());
        for begin in (first..first + count).step_by(PART) {
            let part = PART.min(first + count - begin);
            bytes.resize(4 * part, 0);
            self.file.read(4 * begin as u64, &mut bytes)?;
            numbers.clear();
            numbers.extend(bytes.as_chunks::<4>().0.iter().map(|&b| u32::from_le_bytes(b)));
            visit(&numbers);
        }
        Ok(())
    }
}
