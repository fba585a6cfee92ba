//! **Tessera**: exact restricted Voronoi diagrams (RVD) and centroidal Voronoi remeshing of
//! triangle surfaces, on a GPU or on all cores of a CPU, as a library, a program and a gRPC service.
//!
//! [`remesh()`] makes a surface of well-shaped triangles from any triangle surface:
//!
//! ```
//! use tessera::mesh::shapes::Shape;
//! use tessera::{RemeshOptions, Seeds, Token, auto_backend, remesh};
//!
//! // `tessera::mesh::io::read` takes a surface from a file instead.
//! let surface = Shape::Torus.build(2_000);
//! let options = RemeshOptions::new(Seeds::Sample { points: 400, seed: 1 }).with_newton(10);
//! // The GPU if there is one, else all cores of the CPU.
//! let backend = auto_backend()?;
//! let result = remesh(&surface, &options, backend.as_ref(), &mut (), &Token::default())?;
//!
//! assert_eq!(result.report.result.topology.euler, 0, "a torus it is still");
//! println!("{} triangles, on {}", result.mesh.facets().len(), result.report.backend);
//! # let file = std::env::temp_dir().join(format!("tessera-example-{}.ply", std::process::id()));
//! tessera::mesh::io::write(&file, &result.mesh)?;
//! # std::fs::remove_file(file)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! What most callers need has its name at the top of the crate; the rest is in the modules below.
//!
//! # Features
//!
//! | feature | what it brings |
//! | --- | --- |
//! | none | surfaces, files, diagrams on the CPU, iterations, remeshes |
//! | `gpu` | the GPU backend |
//! | `pictures` | [`picture`](crate#modules): pictures of surfaces |
//! | `service` | [`proto`](crate#modules): the messages of the gRPC service, generated |
//! | `s3` | blobs of the service on an S3-compatible store |
//! | `ui`, `otlp` | the page for browsers; traces to a collector |
//! | `cli` (default) | the command `tessera`, with its server |
//!
//! A program that needs the library alone says `default-features = false`.
//!
//! # The method
//!
//! That of Han, Yan, Wang, Zhao, *Computing Restricted Voronoi Diagram on Graphics
//! Hardware* (Pacific Graphics 2017), cited in these docs as \[HYWZ17\].
//!
//! # Crates
//!
//! This crate passes on what callers need, and has no code of its own. `src/` has the crates below. Cargo holds their order, and
//! each crate's `lib.rs` says what it is for and what it must not know.
//!
//! | crate | what it is for | may use |
//! | --- | --- | --- |
//! | `geometry` | surfaces, neighbours, diagrams on the CPU, CVT, remeshing | nothing here |
//! | `gpu` | the device, and the GPU backend of the diagram | `geometry` |
//! | `picture` | pictures of surfaces, and plots | `geometry` |
//! | `wire` | messages of the interface, and the library's types made of them | `geometry` |
//! | `telemetry` | logs, traces, and which trace a piece of work belongs to | nothing here |
//! | `transport` | connections of a server, TLS, limits | `telemetry` |
//! | `jobs` | blobs, the store of jobs, the queue, the engine | `geometry`, `gpu`, `telemetry` |
//! | `server` | gRPC, HTTP, the page, keys, metrics, configuration | all above but `picture` |
//! | `cli` | commands, load tester, benchmarks | all above |

#![warn(unreachable_pub)]

/// The README's program, which the tests of the documents compile and run.
#[cfg(all(doctest, feature = "cli"))]
#[doc = include_str!("../README.md")]
struct Readme;

pub mod mesh {
    //! Triangle surfaces: checked, read, written, sampled, measured.

    #[doc(inline)]
    pub use geometry::mesh::{FeatureError, MAX_ELEMENTS, MeshError, TriMesh};
    #[doc(inline)]
    pub use geometry::mesh::{
        attributes, closest_point, io, measure, metric, motion, numbers, out_of_core, parts, plane, regions, sample,
        shapes, tensor,
    };
}

pub mod rvd {
    //! The restricted Voronoi diagram: one trait, and the backends that implement it.

    #[doc(inline)]
    pub use geometry::rvd::{
        Accumulate, Backend, BackendChoice, BackendKind, CELLS_PER_FACET, Capacities, CellSums, Cells, DeviceFacts,
        DeviceWork, Diagram, Frame, Lifted, MAX_SEED_DISTANCE, PairStatus, Parallel, PassStats, PhasesMs, PieceBatch,
        Point, RvdError, Serial, Session, SessionOptions, Strategy, Surface, Together, Tuning, facet_edge,
        on_threads_of, out_of_core,
    };
    #[doc(hidden)]
    pub use geometry::rvd::{Evaluation, Resident};
    #[doc(inline)]
    pub use gpu::{BackendOptions, NoGpu, auto_backend};
}

pub mod cvt {
    //! Centroidal Voronoi tessellation: iterations that move the seeds.

    #[doc(inline)]
    pub use geometry::cvt::{
        Count, Cvt, CvtOptions, DensityError, DensityFigures, DensityOptions, DensitySource, Iteration, Projection,
        SeedEdit, StepKind,
    };
}

pub mod remesh {
    //! The remesh: sample, iterate, dual, repair, improve, measure.

    #[doc(inline)]
    pub use geometry::remesh::{
        Anisotropy, Observer, Placement, Provenance, Refine, Remesh, RemeshError, RemeshOptions, Report, Seeds, Share,
        Tolerance, Warning, remesh, report,
    };
}

pub mod token {
    //! Cancellation, deadlines and ceilings of work.

    #[doc(inline)]
    pub use geometry::token::{Pace, Silence, Stopped, Token};
}

#[doc(inline)]
pub use cvt::{Cvt, CvtOptions, DensityOptions, DensitySource, Projection};
#[doc(inline)]
pub use mesh::{MeshError, TriMesh};
#[cfg(feature = "pictures")]
#[doc(inline)]
pub use picture;
#[doc(inline)]
pub use remesh::{
    Anisotropy, Observer, Placement, Refine, Remesh, RemeshError, RemeshOptions, Report, Seeds, Share, Tolerance,
    remesh,
};
#[doc(inline)]
pub use rvd::{Backend, BackendChoice, BackendKind, BackendOptions, Cells, Diagram, RvdError, auto_backend};
#[doc(inline)]
pub use token::{Stopped, Token};
#[cfg(feature = "service")]
pub use wire::proto;
