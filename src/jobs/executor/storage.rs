//! Storage that fails for a while: a full disk, a bucket that does not answer.
//!
//! Purpose: [`Storage::patiently`] repeats what a job wants of the blobs until it succeeds, so that no work is lost by a fault
//! that somebody will mend; [`Storage::watch`] tells others meanwhile.
//! Invariant: a wait ends with its token. A job that waits keeps its slot: nothing new begins that could not be stored
//! either. Must not know: which storage it is, what a job does.

use std::thread::sleep;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use crate::blob::{BlobError, BlobStore};
use crate::engine::TOKEN_POLL;
use geometry::token::{Stopped, Token};

pub(super) const RETRY_PERIOD: Duration = Duration::from_secs(1);

#[derive(Debug, Default)]
pub(super) struct Storage {
    outage: watch::Sender<Option<BlobError>>,
}

/// Why a call on the blobs did not succeed in the end.
#[derive(Debug)]
pub(super) enum StorageError {
    /// No wait would help.
    Blob(BlobError),
    Stopped(Stopped),
}

impl Storage {
    pub(super) fn watch(&self) -> watch::Receiver<Option<BlobError>> {
        self.outage.subscribe()
    }

    pub(super) fn is_down(&self) -> bool {
        self.trouble().is_some()
    }

    /// Why blobs cannot be stored now.
    pub(super) fn trouble(&self) -> Option<BlobError> {
        self.outage.borrow().clone()
    }

    /// Notes how it is, and says so in the log when that changes.
    fn note(&self, trouble: Option<BlobError>) {
        self.outage.send_if_modified(|now| {
            let changed = now.is_some() != trouble.is_some();
            match &trouble {
                Some(why) if changed => tracing::error!(%why, "blobs cannot be stored; jobs wait until they can"),
                None if changed => tracing::info!("blobs can be stored again"),
                _ => {}
            }
            let differs = *now != trouble;
            *now = trouble;
            differs
        });
    }

    pub(super) async fn check(&self, blobs: &dyn BlobStore, limit: Duration) {
        let late = || BlobError::Unavailable(format!("no answer within {} s", limit.as_secs()));
        let checked = tokio::time::timeout(limit, blobs.check()).await;
        self.note(checked.unwrap_or_else(|_| Err(late())).err());
    }

    /// Does `call` until it succeeds or fails for good, or `token` is stopped.
    pub(super) fn patiently<T>(
        &self,
        token: &Token,
        mut call: impl FnMut() -> Result<T, BlobError>,
    ) -> Result<T, StorageError> {
        loop {
            match call() {
                // An upload that another process ended, or that was lost with a crash of its index, is begun again.
                Err(
                    error @ (BlobError::StorageFull
                    | BlobError::Unavailable(_)
                    | BlobError::Database(_)
                    | BlobError::Busy { .. }
                    | BlobError::UploadNotFound { .. }),
                ) => {
                    // The others say nothing of the storage.
                    if matches!(error, BlobError::StorageFull | BlobError::Unavailable(_)) {
                        self.note(Some(error));
                    }
                    let next = Instant::now() + RETRY_PERIOD;
                    while Instant::now() < next {
                        token.check().map_err(StorageError::Stopped)?;
                        sleep(TOKEN_POLL);
                    }
                }
                done => return done.map_err(StorageError::Blob),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_is_waited_for_and_told() {
        let storage = Storage::default();
        let watch = storage.watch();
        let mut tries = 0;
        let stored = storage.patiently(&Token::default(), || {
            tries += 1;
            assert_eq!(watch.borrow().is_some(), tries > 1);
            if tries < 3 { Err(BlobError::StorageFull) } else { Ok(7) }
        });
        assert!(matches!(stored, Ok(7)));
        assert!(storage.is_down(), "until somebody looks: the next may be larger");
        let blobs = crate::blob::ObjectBlobs::in_memory(crate::blob::BlobOptions::default());
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        runtime.block_on(storage.check(&blobs, RETRY_PERIOD));
        assert!(!storage.is_down());
    }

    #[test]
    fn who_waits_hears_its_token() {
        let (storage, token) = (Storage::default(), Token::default());
        token.cancel();
        let begin = Instant::now();
        let stored: Result<(), _> = storage.patiently(&token, || Err(BlobError::Unavailable("away".to_owned())));
        assert!(matches!(stored, Err(StorageError::Stopped(Stopped::Cancelled))) && begin.elapsed() < RETRY_PERIOD);
        let missing = BlobError::NotFound { digest: crate::blob::Digest::of(b"x") };
        let stored: Result<(), _> = storage.patiently(&token, || Err(missing.clone()));
        assert!(matches!(stored, Err(StorageError::Blob(_))), "waiting would not help");
    }
}
