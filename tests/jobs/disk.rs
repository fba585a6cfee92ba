//! A disk that can lose power: what was not synced may be there in part.

use std::io::{Error, ErrorKind, Result};
use std::sync::{Arc, Mutex};

use redb::StorageBackend;

/// A disk; clones are the same one.
#[derive(Clone, Debug, Default)]
pub struct Disk(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    /// As of the last sync.
    durable: Vec<u8>,
    /// As the process sees it.
    current: Vec<u8>,
    /// Since the last sync.
    pending: Vec<Change>,
    /// Writes and syncs until the power fails.
    fuse: Option<u32>,
    dead: bool,
}

#[derive(Clone, Debug)]
enum Change {
    Length(u64),
    Write(u64, Vec<u8>),
}

fn apply(bytes: &mut Vec<u8>, change: &Change) {
    match change {
        Change::Length(length) => bytes.resize(*length as usize, 0),
        Change::Write(offset, data) => {
            let end = *offset as usize + data.len();
            if bytes.len() < end {
                bytes.resize(end, 0);
            }
            bytes[*offset as usize..end].copy_from_slice(data);
        }
    }
}

impl Disk {
    /// The power fails after so many writes and syncs.
    pub fn arm(&self, fuse: u32) {
        self.0.lock().unwrap().fuse = Some(fuse);
    }

    /// The power fails now; nothing gets through any more.
    pub fn kill(&self) {
        self.0.lock().unwrap().dead = true;
    }

    /// What is found when the power is back: all that was synced, and of the rest what `luck` says, the last of it torn.
    pub fn after_crash(&self, mut luck: u64) -> Self {
        let state = self.0.lock().unwrap();
        let mut bytes = state.durable.clone();
        let mut draw = || {
            luck = luck.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            luck >> 33
        };
        for change in &state.pending {
            match (draw() % 4, change) {
                (0, _) => {}
                (1, Change::Write(offset, data)) => {
                    // Sectors are written whole.
                    let length = (draw() as usize % (data.len() + 1)) / 512 * 512;
                    apply(&mut bytes, &Change::Write(*offset, data[..length].to_vec()));
                }
                _ => apply(&mut bytes, change),
            }
        }
        Self(Arc::new(Mutex::new(State { durable: bytes.clone(), current: bytes, ..State::default() })))
    }

    fn change(&self, change: Option<Change>) -> Result<()> {
        let mut state = self.0.lock().unwrap();
        let was_dead = state.dead;
        match state.fuse {
            Some(0) => state.dead = true,
            Some(left) => state.fuse = Some(left - 1),
            None => {}
        }
        match change {
            // What is on its way when the power fails may get there or not.
            Some(change) if !was_dead => {
                apply(&mut state.current, &change);
                state.pending.push(change);
            }
            None if !state.dead => {
                state.durable = state.current.clone();
                state.pending.clear();
            }
            _ => {}
        }
        if state.dead { Err(Error::other("no power")) } else { Ok(()) }
    }
}

impl StorageBackend for Disk {
    fn len(&self) -> Result<u64> {
        Ok(self.0.lock().unwrap().current.len() as u64)
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> Result<()> {
        let state = self.0.lock().unwrap();
        if state.dead {
            return Err(Error::other("no power"));
        }
        let found = state.current.get(offset as usize..offset as usize + out.len());
        out.copy_from_slice(found.ok_or_else(|| Error::from(ErrorKind::UnexpectedEof))?);
        Ok(())
    }

    fn set_len(&self, len: u64) -> Result<()> {
        self.change(Some(Change::Length(len)))
    }

    fn sync_data(&self) -> Result<()> {
        self.change(None)
    }

    fn write(&self, offset: u64, data: &[u8]) -> Result<()> {
        self.change(Some(Change::Write(offset, data.to_vec())))
    }
}
