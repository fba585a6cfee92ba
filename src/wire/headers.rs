//! The first messages of the three streams.
//!
//! Purpose: what each header announces, checked, and what each request is to an upload.
//! Invariant: a header that passes needs no other check but of its arrays. Must not know: what a stream does.

use super::WireError;
use super::attributes::{self, AttributeCounts};
use super::counts::{self, Bounds, MeshCounts, SeedCounts, within};
use super::proto::{ComputeRvdHeader, ComputeRvdRequest, CvtHeader, CvtRequest, RemeshHeader, RemeshRequest};
use super::proto::{compute_rvd_request, cvt_request, remesh_request};
use super::upload::{Header, Incoming};
use super::{codec, options};

impl Header for ComputeRvdHeader {
    fn backend(&self) -> i32 {
        self.backend
    }

    fn check(&self, bounds: &Bounds) -> Result<(MeshCounts, SeedCounts), WireError> {
        codec::backend(self.backend)?;
        codec::outputs(&self.outputs)?;
        Ok((counts::mesh(self.mesh.as_ref(), bounds)?, counts::seeds(self.seeds.as_ref(), bounds)?))
    }
}

impl Header for CvtHeader {
    fn backend(&self) -> i32 {
        self.backend
    }

    fn check(&self, bounds: &Bounds) -> Result<(MeshCounts, SeedCounts), WireError> {
        codec::backend(self.backend)?;
        options::of_cvt(self)?;
        let (mesh, seeds) =
            counts::with_density(self.mesh.as_ref(), self.seeds.as_ref(), self.density.as_ref(), bounds)?;
        if self.max_seeds != 0 {
            let first = match seeds {
                SeedCounts::Uploaded(count) | SeedCounts::Sampled { points: count, .. } => count,
                // As many as there turn out to be have room.
                SeedCounts::Implied { .. } => 1,
            };
            within("header.max_seeds", self.max_seeds, first, bounds.max_seeds)?;
        }
        Ok((mesh, seeds))
    }
}

impl Header for RemeshHeader {
    fn backend(&self) -> i32 {
        self.backend
    }

    fn check(&self, bounds: &Bounds) -> Result<(MeshCounts, SeedCounts), WireError> {
        codec::backend(self.backend)?;
        let density = self.density.as_ref();
        let (mut mesh, seeds) = counts::with_density(self.mesh.as_ref(), self.seeds.as_ref(), density, bounds)?;
        options::check_remesh(self, seeds, bounds)?;
        within("header.creases", self.creases, 0, 3 * mesh.facets)?;
        mesh.creases = self.creases;
        Ok((mesh, seeds))
    }

    fn attributes(&self, mesh: MeshCounts) -> Result<Vec<AttributeCounts>, WireError> {
        attributes::check(&self.attributes, mesh)
    }
}

impl From<ComputeRvdRequest> for Incoming<ComputeRvdHeader> {
    fn from(request: ComputeRvdRequest) -> Self {
        use compute_rvd_request::Message;
        match request.message {
            Some(Message::Header(header)) => Self::Header(header),
            Some(Message::Chunk(chunk)) => Self::Chunk(chunk),
            Some(Message::Finish(_)) => Self::End,
            None => Self::Other,
        }
    }
}

impl From<CvtRequest> for Incoming<CvtHeader> {
    fn from(request: CvtRequest) -> Self {
        use cvt_request::Message;
        match request.message {
            Some(Message::Header(header)) => Self::Header(header),
            Some(Message::Chunk(chunk)) => Self::Chunk(chunk),
            Some(Message::Start(_)) => Self::End,
            _ => Self::Other,
        }
    }
}

impl From<RemeshRequest> for Incoming<RemeshHeader> {
    fn from(request: RemeshRequest) -> Self {
        use remesh_request::Message;
        match request.message {
            Some(Message::Header(header)) => Self::Header(header),
            Some(Message::Chunk(chunk)) => Self::Chunk(chunk),
            Some(Message::Finish(_)) => Self::End,
            None => Self::Other,
        }
    }
}
