//! Parts in memory.
//!
//! Purpose: uploads that need not outlive the process.
//! Invariant: a part never holds more than its promised size. Must not know: files.

use std::sync::Arc;
use std::time::SystemTime;

use async_trait::async_trait;
use bytes::Bytes;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};

use super::{Part, Staging};
use crate::blob::BlobError;
use crate::blob::chunk::UploadId;
use crate::blob::digest::Tally;
use crate::blob::error::{join, object};

#[derive(Debug)]
pub(in crate::blob) struct Memory(pub(in crate::blob) Arc<dyn ObjectStore>);

struct Buffer {
    objects: Arc<dyn ObjectStore>,
    size_bytes: u64,
    state: (Vec<u8>, Tally),
}

#[async_trait]
impl Staging for Memory {
    async fn scan(&self) -> Result<Vec<(UploadId, SystemTime)>, BlobError> {
        Ok(Vec::new())
    }

    async fn create(&self, id: UploadId) -> Result<Box<dyn Part>, BlobError> {
        let state = Default::default();
        Ok(Box::new(Buffer { objects: Arc::clone(&self.0), size_bytes: id.size_bytes, state }))
    }

    async fn load(&self, _: UploadId) -> Result<Option<Box<dyn Part>>, BlobError> {
        Ok(None)
    }

    async fn check(&self) -> Result<(), BlobError> {
        Ok(())
    }

    async fn discard(&self, _: UploadId) -> Result<(), BlobError> {
        Ok(())
    }
}

#[async_trait]
impl Part for Buffer {
    fn tally(&self) -> &Tally {
        &self.state.1
    }

    async fn append(&mut self, bytes: Bytes, _: u32) -> Result<(), BlobError> {
        let (mut data, mut tally) = std::mem::take(&mut self.state);
        let size = usize::try_from(self.size_bytes).map_err(|_| BlobError::StorageFull)?;
        let task = tokio::task::spawn_blocking(move || {
            // The system hands out the pages one by one as they are written.
            data.try_reserve_exact(size - data.len()).map_err(|_| BlobError::StorageFull)?;
            data.extend_from_slice(&bytes);
            tally.add(&bytes);
            Ok::<_, BlobError>((data, tally))
        });
        self.state = task.await.map_err(join)??;
        Ok(())
    }

    async fn publish(&mut self, to: &Path) -> Result<(), BlobError> {
        let (data, _) = std::mem::take(&mut self.state);
        self.objects.put(to, Bytes::from(data).into()).await.map_err(object("keep a blob in memory"))?;
        Ok(())
    }
}
