//! The names of a specification as the library's own types.
//!
//! Purpose: what is done ([`Kind`]), by which backend, in which format. Invariant: every name has one meaning. Must not
//! know: how a job is done.

use super::{BackendName, CvtCommand, CvtWork, JobSpec, MeshFormat, WorkSpec};
use geometry::mesh::io::Format;
use geometry::rvd::{BackendChoice, BackendKind};

/// The kind of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A whole remesh.
    Remesh,
    /// A diagram.
    Rvd,
    /// A session.
    Cvt,
}

impl Kind {
    /// "remesh", "rvd" or "cvt".
    pub fn name(self) -> &'static str {
        match self {
            Self::Remesh => "remesh",
            Self::Rvd => "rvd",
            Self::Cvt => "cvt",
        }
    }
}

impl JobSpec {
    /// What is done.
    pub fn kind(&self) -> Kind {
        match self.work {
            WorkSpec::Remesh(_) => Kind::Remesh,
            WorkSpec::Rvd(_) => Kind::Rvd,
            WorkSpec::Cvt(_) => Kind::Cvt,
        }
    }

    /// The backend that is asked for.
    pub fn choice(&self) -> BackendChoice {
        match self.backend {
            None | Some(BackendName::Auto) => BackendChoice::Auto,
            Some(BackendName::Gpu) => BackendChoice::Only(BackendKind::Gpu),
            Some(BackendName::Parallel) => BackendChoice::Only(BackendKind::Parallel),
            Some(BackendName::Serial) => BackendChoice::Only(BackendKind::Serial),
        }
    }
}

impl From<MeshFormat> for Format {
    fn from(format: MeshFormat) -> Self {
        match format {
            MeshFormat::Ply => Self::Ply,
            MeshFormat::Obj => Self::Obj,
            MeshFormat::Stl => Self::Stl,
            MeshFormat::Off => Self::Off,
            MeshFormat::Vtk => Self::Vtk,
            MeshFormat::Vtp => Self::Vtp,
            MeshFormat::Msh => Self::Gmsh,
            MeshFormat::Mesh => Self::Medit,
            MeshFormat::Meshb => Self::MeditBinary,
            MeshFormat::Glb => Self::Glb,
            MeshFormat::Gltf => Self::Gltf,
        }
    }
}

impl From<Format> for MeshFormat {
    fn from(format: Format) -> Self {
        match format {
            Format::Ply => Self::Ply,
            Format::Obj => Self::Obj,
            Format::Stl => Self::Stl,
            Format::Off => Self::Off,
            Format::Vtk => Self::Vtk,
            Format::Vtp => Self::Vtp,
            Format::Gmsh => Self::Msh,
            Format::Medit => Self::Mesh,
            Format::MeditBinary => Self::Meshb,
            Format::Glb => Self::Glb,
            Format::Gltf => Self::Gltf,
        }
    }
}

impl CvtWork {
    /// The steps of all commands.
    pub fn steps(&self) -> u64 {
        let steps = |command: &CvtCommand| match command {
            CvtCommand::Step { iterations, .. } => u64::from(*iterations),
            CvtCommand::Edit { .. } => 0,
        };
        self.commands.iter().map(steps).sum()
    }
}
