//! Marks of owners beside the blobs.
//!
//! Purpose: an empty object `owners/AB/DIGEST-OWNER` for each owner of a blob, so that owners outlive the process.
//! Invariant: a mark is written before the call that makes its owner returns, and removed before the call that disowns it
//! returns. Marks of a blob go with its bytes; one that stayed after a crash is removed at the next start.
//! Must not know: the names of owners, pins.

use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt, PutPayload};

use super::changes::{Inner, Kind};
use crate::blob::error::{found, object};
use crate::blob::{BlobError, Digest, Owner};

const OWNERS: &str = "owners";

/// Marks that are written or removed at once.
const AT_ONCE: usize = 16;

/// The folder of a blob's marks, which others share.
fn folder_of(digest: &Digest) -> Path {
    Path::from_iter([OWNERS, &digest.to_string()[..2]])
}

fn path_of(digest: &Digest, owner: Owner) -> Path {
    folder_of(digest).join(format!("{digest}-{owner}"))
}

fn read(path: &Path) -> Option<(Digest, Owner)> {
    let (digest, owner) = path.filename()?.split_once('-')?;
    let (digest, owner) = (digest.parse().ok()?, owner.parse().ok()?);
    (path_of(&digest, owner) == *path).then_some((digest, owner))
}

/// The marks that an earlier process left, the oldest first.
pub(super) async fn scan(objects: &dyn ObjectStore) -> Result<Vec<(Digest, Owner)>, BlobError> {
    let mut found = Vec::new();
    let mut marks = objects.list(Some(&Path::from(OWNERS)));
    while let Some(mark) = marks.try_next().await.map_err(object("look for the owners of blobs"))? {
        match read(&mark.location) {
            Some((digest, owner)) => found.push((mark.last_modified, digest, owner)),
            None => tracing::warn!(path = %mark.location, "no mark of an owner; left alone"),
        }
    }
    found.sort_unstable();
    Ok(found.into_iter().map(|(_, digest, owner)| (digest, owner)).collect())
}

pub(super) async fn remove(objects: &dyn ObjectStore, marks: Vec<(Digest, Owner)>) -> Result<(), BlobError> {
    let removals = marks.into_iter().map(|(digest, owner)| async move {
        found("remove the mark of an owner", objects.delete(&path_of(&digest, owner)).await).map(drop)
    });
    stream::iter(removals).buffer_unordered(AT_ONCE).collect::<Vec<_>>().await.into_iter().collect()
}

impl Inner {
    /// Writes a mark. The caller changes the index.
    pub(super) async fn mark(&self, digest: &Digest, owner: Owner) -> Result<(), BlobError> {
        let put = self.objects.put(&path_of(digest, owner), PutPayload::new()).await;
        put.map(drop).map_err(object("mark the owner of a blob"))
    }

    pub(super) async fn unmark(&self, digest: Digest, owner: Owner) -> Result<(), BlobError> {
        remove(&*self.objects, vec![(digest, owner)]).await
    }

    /// Removes the marks of former owners of a blob. The caller holds the lock of its bytes.
    pub(super) async fn unmark_others(&self, digest: Digest) -> Result<(), BlobError> {
        // Whatever comes before the first mark of this blob.
        let before = folder_of(&digest).join(format!("{digest}-"));
        let begin = format!("{digest}-");
        let mut marks = self.objects.list_with_offset(Some(&folder_of(&digest)), &before);
        let mut others = Vec::new();
        while let Some(mark) = marks.try_next().await.map_err(object("look for the owners of a blob"))? {
            let is_of_blob = mark.location.filename().is_some_and(|name| name.starts_with(&begin));
            if let Some((_, owner)) = read(&mark.location).filter(|_| is_of_blob)
                && !self.index.has(owner, digest).await?
            {
                others.push((digest, owner));
            }
        }
        drop(marks);
        remove(&*self.objects, others).await
    }

    /// Whether a blob is stored and this owner has it. Another process may have made it one.
    pub(super) async fn is_owned(&self, owner: Owner, digest: Digest) -> Result<bool, BlobError> {
        if self.index.has(owner, digest).await? {
            return Ok(true);
        }
        if !matches!(self.kind, Kind::Shared) || self.has_one_index {
            return Ok(false);
        }
        // The mark first: the answer to another tenant must not depend on the blob.
        let mark = found("look for the owner of a blob", self.objects.head(&path_of(&digest, owner)).await)?;
        if mark.is_none() || self.stored(digest).await?.is_none() {
            return Ok(false);
        }
        self.give(digest, owner).await?;
        Ok(true)
    }

    /// Puts an owner whose mark is written into the index.
    pub(super) async fn give(&self, digest: Digest, owner: Owner) -> Result<(), BlobError> {
        match self.index.give(owner, digest).await? {
            Some(other) => self.unmark(digest, other).await,
            None => Ok(()),
        }
    }

    /// Gives blobs to an owner, those that are stored.
    pub(super) async fn claim(&self, owner: Owner, digests: &[Digest]) -> Result<(), BlobError> {
        for digest in digests {
            if self.is_owned(owner, *digest).await? {
                continue;
            }
            let _turn = self.lock_bytes(digest).await;
            if self.stored_in_turn(*digest).await?.is_some() {
                self.mark(digest, owner).await?;
                self.give(*digest, owner).await?;
            }
        }
        Ok(())
    }

    /// Takes a blob from its owner. Returns it if its bytes are to be removed: a caller that waited for that would learn
    /// whether others have the blob.
    pub(super) async fn disown(&self, owner: Owner, digest: Digest) -> Result<Option<super::BlobInfo>, BlobError> {
        self.is_owned(owner, digest).await?;
        let orphan = self.index.disown(owner, digest).await?;
        self.unmark(digest, owner).await?;
        Ok(orphan)
    }
}
