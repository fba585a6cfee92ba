//! A bound on the memory of lists that are made of a file.
//!
//! Purpose: [`Room`] lets lists grow in proportion to the bytes that they are read from. Text can list elements with fewer bytes
//! than they take in memory: `{},` is a node of a glTF. Invariant: lists with one room take no more than it had.
//! Must not know: formats.

use super::DataError;

/// Bytes of lists for each byte of the file. A node of a glTF with a mesh and a matrix takes less than 3; empty nodes take more
/// and are refused in large numbers.
const RATIO: usize = 4;

/// See the module's head.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Room {
    all: usize,
    left: usize,
}

impl Room {
    /// For lists of a file of `bytes`.
    pub(super) fn of(bytes: usize) -> Self {
        let all = bytes.saturating_mul(RATIO).saturating_add(1 << 20);
        Self { all, left: all }
    }

    /// Bytes that lists take.
    pub(super) fn taken(&self) -> usize {
        self.all - self.left
    }

    /// Takes bytes.
    ///
    /// # Errors
    /// `Header` if fewer are left.
    pub(super) fn take(&mut self, bytes: usize) -> Result<(), DataError> {
        self.left = self.left.checked_sub(bytes).ok_or_else(|| {
            DataError::Header("it lists more elements than a file of this size may; write .ply or .obj".to_owned())
        })?;
        Ok(())
    }

    /// Adds to a list, which grows by half if it is full.
    pub(super) fn push<T>(&mut self, list: &mut Vec<T>, value: T) -> Result<(), DataError> {
        if list.len() == list.capacity() {
            let more = (list.len() / 2).max(4);
            self.take(more.saturating_mul(size_of::<T>()))?;
            list.reserve_exact(more);
        }
        list.push(value);
        Ok(())
    }
}
