//! Where a whole blob lies in a store of objects.
//!
//! Purpose: one name for each digest. Invariant: different digests lie in different places, not too many in one folder.
//! Must not know: what kind of store it is.

use object_store::path::Path;

use super::Digest;

pub(super) const BLOBS: &str = "blobs";

pub(super) fn path_of(digest: &Digest) -> Path {
    let name = digest.to_string();
    Path::from_iter([BLOBS, &name[..2], &name])
}
