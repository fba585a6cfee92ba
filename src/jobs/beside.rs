//! Work beside the jobs of a store, counted in a file.
//!
//! Purpose: [`Beside`] counts pieces of work that are no job of the store, such as streams and looks at inputs, so that the next
//! process knows whether there were some when this one went down. Invariant: a mark is one small write without a sync: the count
//! survives the process, which is what goes down by its work. Must not know: what the work is.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

use crate::lock;

/// See the module's head. Clones share one count; the default keeps none.
#[derive(Clone, Debug, Default)]
pub struct Beside(Option<Arc<Mutex<Counted>>>);

#[derive(Debug)]
struct Counted {
    file: File,
    count: u64,
}

/// A piece of work that is under way until this is dropped.
#[derive(Debug)]
pub struct Mark(Beside);

impl Beside {
    /// The count in a file, and whether work was under way when the last process with it went down. Errors: the file cannot be
    /// read or written.
    pub(crate) fn open(path: &Path) -> std::io::Result<(Self, bool)> {
        let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        let mut text = String::new();
        // Anything but a count is damage, and no evidence.
        let had = file.read_to_string(&mut text).is_ok() && text.trim().parse::<u64>().is_ok_and(|count| count > 0);
        let mut counted = Counted { file, count: 0 };
        counted.write()?;
        Ok((Self(Some(Arc::new(Mutex::new(counted)))), had))
    }

    #[must_use]
    pub fn begin(&self) -> Mark {
        self.add(1);
        Mark(self.clone())
    }

    fn add(&self, change: i64) {
        let Some(counted) = &self.0 else { return };
        let mut counted = lock(counted);
        counted.count = counted.count.saturating_add_signed(change);
        if let Err(error) = counted.write() {
            tracing::debug!(%error, "the work beside jobs could not be marked");
        }
    }
}

impl Counted {
    fn write(&mut self) -> std::io::Result<()> {
        self.file.rewind()?;
        writeln!(self.file, "{:020}", self.count)
    }
}

impl Drop for Mark {
    fn drop(&mut self) {
        self.0.add(-1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_under_way_is_known_afterwards() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("beside");
        let (beside, had) = Beside::open(&path).unwrap();
        assert!(!had);
        let (first, second) = (beside.begin(), beside.begin());
        drop(first);
        // The process goes down: nothing is dropped.
        std::mem::forget(second);
        assert!(Beside::open(&path).unwrap().1);
        let (beside, had) = Beside::open(&path).unwrap();
        assert!(!had);
        drop(beside.begin());
        assert!(!Beside::open(&path).unwrap().1);
        std::fs::write(&path, "what").unwrap();
        assert!(!Beside::open(&path).unwrap().1);
    }
}
