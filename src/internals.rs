//! What this crate's own tests and fuzzers see of its inside.
//!
//! No part of the interface: anything here may change or go with any release, without a word.
//! Invariant: nothing is made here. Must not know: who looks.

/// Content-addressed storage.
#[cfg(feature = "service")]
pub mod blob {
    pub use crate::blob::{
        BlobError, BlobInfo, BlobOptions, BlobRead, BlobStore, ByteStream, Chunk, Digest, DigestError, MAX_CHUNK_BYTES,
        ObjectBlobs, Owner, READ_BYTES, UploadId, UploadStatus, Usage, put,
    };
}

/// The command line.
#[cfg(feature = "cli")]
pub mod cli {
    pub use crate::cli::main;
}

/// What a server may be told.
#[cfg(feature = "service")]
pub mod config {
    pub use crate::config::{Limits, TlsFiles, Transport};
}

/// Densities as the pipeline takes them.
pub mod cvt {
    pub use crate::cvt::density::{Net, Outline, Plan, plan};
}

/// The device.
#[cfg(feature = "gpu")]
pub mod gpu {
    pub use crate::gpu::device::adapters;
    pub use crate::gpu::{Device, DeviceOptions, GpuError, buffers, device, dispatch, limits, shader};
}

/// The HTTP door.
#[cfg(feature = "service")]
pub mod http {
    #[cfg(feature = "ui")]
    pub use crate::http::door_with_page;
    pub use crate::http::{OPENAPI, ROUTES, Route, door};
}

/// The queue, the threads that do the work, and jobs as data.
#[cfg(feature = "service")]
pub mod job {
    pub use crate::job::{
        AdmissionRequest, Backends, Bytes, Ceilings, Engine, EngineOptions, JobError, LossPolicy, PoolFactory, Weights,
    };
    pub use crate::job::{BlobRoom, Executor, ExecutorOptions, JobBounds, Stores};
    pub use crate::job::{api, event, record, state, store};
}

/// How work gets into the queue.
#[cfg(feature = "service")]
pub mod job_queue {
    pub use crate::job::{Admission, Retry};
}

/// Keys of callers.
#[cfg(feature = "service")]
pub mod keys {
    pub use crate::keys::{Key, KeyFile, KeyLimits, KeySet, KeysError, NewKey, Role, Secret, is_name, now};
}

/// Neighbours of seeds.
pub mod knn {
    pub use crate::knn::{NeighbourRow, SeedIndex};
}

/// Adjacency and features of surfaces.
pub mod mesh {
    /// Edges and their facets.
    pub mod adjacency {
        pub use crate::mesh::adjacency::{Adjacency, EdgeKind};
    }

    /// Curves that a remesh keeps.
    pub mod features {
        pub use crate::mesh::features::{Curve, CurveKind, FeatureError, FeatureOptions, Features};
    }
}

/// Parts of the pipeline.
pub mod remesh {
    pub use crate::remesh::attributes::{carry, provenance};
}

/// Parts of the diagram.
pub mod rvd {
    pub use crate::rvd::cells::FACET_EDGE;
    #[cfg(feature = "gpu")]
    pub use crate::rvd::gpu::{Found, Gpu, layout, plan, shaders};
    pub use crate::rvd::surface::snap;
}

/// The server.
#[cfg(feature = "service")]
pub mod service {
    pub use crate::metrics::{Format, Metrics};
    pub use crate::readiness::{Readiness, Reason};
    pub use crate::service::{
        About, Access, AccessOptions, BLOB_SERVICE_NAME, Door, JOB_SERVICE_NAME, Jobs, Parts, SERVER_SERVICE_NAME,
        SERVICE_NAME, ServeError, Tls, TlsError, replay, run,
    };
}
