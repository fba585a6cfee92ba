//! Records in order that are more than memory holds.
//!
//! Purpose: an external merge sort. Records fill the memory, are sorted there and written as a run; then all runs are merged.
//! Invariant: records come out in the order of their bytes, whatever the memory. Must not know: what records mean.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rayon::prelude::*;

use super::file::{Scratch, WriteAt};
use super::{MeshFileError, READ};
use crate::token::Token;

/// The least that is read of a run at once.
const LEAST_READ: usize = 4096;

pub(crate) struct Sorter<'a, const N: usize> {
    scratch: &'a Scratch,
    most: usize,
    memory: usize,
    records: Vec<[u8; N]>,
    /// Bytes in the file, and the end of each run there.
    file: Option<WriteAt>,
    ends: Vec<u64>,
}

impl<'a, const N: usize> Sorter<'a, N> {
    /// Takes so many bytes of memory, and no more than `count` records need.
    pub(crate) fn new(scratch: &'a Scratch, memory: usize, count: usize) -> Self {
        let most = (memory / N).clamp(1, count.max(1));
        Self { scratch, most, memory, records: Vec::with_capacity(most), file: None, ends: Vec::new() }
    }

    pub(crate) fn push(&mut self, record: [u8; N]) -> Result<(), MeshFileError> {
        if self.records.len() == self.most {
            self.end_run()?;
        }
        self.records.push(record);
        Ok(())
    }

    fn end_run(&mut self) -> Result<(), MeshFileError> {
        self.records.par_sort_unstable();
        let mut at = self.ends.last().copied().unwrap_or(0);
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(self.scratch.file()?),
        };
        for part in self.records.chunks((READ / N).max(1)) {
            file.write(at, part.as_flattened())?;
            at += (part.len() * N) as u64;
        }
        self.ends.push(at);
        self.records.clear();
        Ok(())
    }

    /// All records in order.
    pub(crate) fn merge(mut self, token: &Token) -> Result<Merge<N>, MeshFileError> {
        token.check()?;
        if self.file.is_some() && !self.records.is_empty() {
            self.end_run()?;
        }
        let Some(file) = self.file else {
            self.records.par_sort_unstable();
            return Ok(Merge::InMemory(self.records.into_iter()));
        };
        drop(self.records);
        let runs = self.ends.len();
        let each = self.memory / runs / N * N;
        if each < LEAST_READ.next_multiple_of(N) {
            return Err(MeshFileError::DoesNotFit {
                needed_bytes: (runs * LEAST_READ.next_multiple_of(N)) as u64,
                limit_bytes: self.memory as u64,
            });
        }
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        let readers = starts.zip(&self.ends).map(|(at, &end)| Run { at, end, bytes: Vec::new(), next: 0 });
        let mut runs: Vec<Run> = readers.collect();
        let each = each.min(READ.next_multiple_of(N));
        let mut heap = BinaryHeap::with_capacity(runs.len());
        for (r, run) in runs.iter_mut().enumerate() {
            heap.extend(run.take(&file, each)?.map(|record| Reverse((record, r))));
        }
        Ok(Merge::OfRuns { file, runs, heap, each })
    }
}

/// A run that is being read.
pub(crate) struct Run {
    at: u64,
    end: u64,
    bytes: Vec<u8>,
    next: usize,
}

impl Run {
    fn take<const N: usize>(&mut self, file: &WriteAt, each: usize) -> Result<Option<[u8; N]>, MeshFileError> {
        if self.next == self.bytes.len() {
            let length = (self.end - self.at).min(each as u64);
            self.bytes.resize(length as usize, 0);
            file.read(self.at, &mut self.bytes)?;
            (self.at, self.next) = (self.at + length, 0);
        }
        let record = self.bytes[self.next..].first_chunk().copied();
        self.next += if record.is_some() { N } else { 0 };
        Ok(record)
    }
}

/// Records in order, one after the other.
pub(crate) enum Merge<const N: usize> {
    InMemory(std::vec::IntoIter<[u8; N]>),
    OfRuns { file: WriteAt, runs: Vec<Run>, heap: BinaryHeap<Reverse<([u8; N], usize)>>, each: usize },
}

impl<const N: usize> Merge<N> {
    /// The next record.
    pub(crate) fn take(&mut self) -> Result<Option<[u8; N]>, MeshFileError> {
        match self {
            Self::InMemory(records) => Ok(records.next()),
            Self::OfRuns { file, runs, heap, each } => {
                let Some(Reverse((record, r))) = heap.pop() else { return Ok(None) };
                heap.extend(runs[r].take(file, *each)?.map(|next| Reverse((next, r))));
                Ok(Some(record))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn records_come_out_in_order_whatever_the_memory() {
        let folder = tempfile::tempdir().unwrap();
        let scratch = Scratch::new(folder.path());
        // Some are equal.
        let record = |k: u64| (k.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40).to_be_bytes();
        let mut want: Vec<[u8; 8]> = (0..30_000).map(record).collect();
        want.sort_unstable();
        for memory in [1 << 16, 100_000, 1 << 20] {
            let mut sorter = Sorter::<8>::new(&scratch, memory, 30_000);
            (0..30_000).for_each(|k| sorter.push(record(k)).unwrap());
            let mut merge = sorter.merge(&Token::default()).unwrap();
            let sorted: Vec<[u8; 8]> = std::iter::from_fn(|| merge.take().unwrap()).collect();
            assert!(sorted == want, "{memory}");
        }
        let mut sorter = Sorter::<8>::new(&scratch, 512, 30_000);
        (0..30_000).for_each(|k| sorter.push(record(k)).unwrap());
        assert!(matches!(sorter.merge(&Token::default()), Err(MeshFileError::DoesNotFit { .. })));
    }
}
