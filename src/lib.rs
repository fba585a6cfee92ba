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
//! | `cli` (default) | the command `tessera`, with all of the above |
//!
//! A program that needs the library alone says `default-features = false`.
//!
//! # The method
//!
//! That of Han, Yan, Wang, Zhao, *Computing Restricted Voronoi Diagram on Graphics
//! Hardware* (Pacific Graphics 2017), cited in these docs as \[HYWZ17\].
//!
//! # The map of the house
//!
//! | module | what lives there | may use |
//! | --- | --- | --- |
//! | [`token`] | cancellation and limits, heard by every stage | nothing here |
//! | [`mesh`] | triangle surfaces: validated, read, written, sampled, measured | nothing here |
//! | `picture` | pictures of surfaces, drawn in software | `mesh` |
//! | `knn` | neighbour tables of the seeds | `mesh` |
//! | `gpu` | the device, allocation, dispatches, composition of shaders; knows no mesh, seed or job | nothing here |
//! | [`rvd`] | the restricted Voronoi diagram: one trait, three backends, the dual | `knn`, `mesh`, `gpu` (only `rvd::gpu`) |
//! | [`cvt`] | iterations that move the seeds | `rvd`'s trait |
//! | [`mod@remesh`] | sample, iterate, dual, repair, measure | `cvt`, `rvd::dual`, `mesh` |
//! | `blob` | content-addressed storage: uploads, quota, local disk and S3 | nothing here |
//! | `keys` | keys of callers: made, hashed, kept in a file | nothing here |
//! | `job` | the queue and its fair shares, the host threads that share the device, and kept jobs: records, states, the journal | `blob`, `remesh` and below |
//! | `readiness` | why the server is not ready, if it is not; health and the admin port tell it | nothing here |
//! | `lifecycle` | the steps of a server's start and end, each within its time | `metrics` |
//! | `trace` | which trace a call and its work belong to | nothing here |
//! | `metrics` | what is counted, and its text for Prometheus | `job`, `readiness`, `rvd` |
//! | `admin` | metrics and readiness over HTTP, for operators | `metrics`, `readiness` |
//! | `wire` | messages, and our types made of them and into them; server and client speak it | `remesh` and below |
//! | `service` | gRPC: handlers, streams, status codes, limits | `wire`, `job`, `blob`, `keys`, `metrics`, `readiness`, `trace` and below |
//! | `http` | the HTTP door: routes over the same jobs, blobs, keys and limits | `service` (no gRPC), `job`, `blob`, `keys`, `metrics`, `wire`'s errors |
//! | `cli` | one file per subcommand | everything, but `service` only in `cli::serve` and `gpu` only in `cli::doctor`: the client speaks `wire` |
//! | `telemetry` | logs, and traces to a collector | `config`, `trace` |
//!
//! Everything may use `token`. Nothing runs back up. `tests/architecture.rs` holds these rules. Modules without a link
//! are no part of the interface, nor is `internals`, which shows some of them to this crate's own tests.

// What is `pub` is for callers; everything else says how far it reaches.
#![warn(unreachable_pub)]

#[macro_use]
mod setters;

/// The README's program, which the tests of the documents compile and run.
#[cfg(all(doctest, feature = "cli"))]
#[doc = include_str!("../README.md")]
struct Readme;

#[cfg(feature = "cli")]
mod admin;
#[cfg(feature = "service")]
mod blob;
#[cfg(feature = "cli")]
mod cli;
#[cfg(feature = "service")]
mod config;
pub mod cvt;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "service")]
#[cfg_attr(not(feature = "cli"), allow(dead_code))] // the start is the command's
mod http;
#[doc(hidden)]
pub mod internals;
#[cfg(feature = "service")]
mod job;
#[cfg(feature = "service")]
mod keys;
mod knn;
#[cfg(feature = "service")]
#[cfg_attr(not(feature = "cli"), allow(dead_code))] // the start is the command's
mod lifecycle;
#[cfg(feature = "service")]
mod memory;
pub mod mesh;
#[cfg(feature = "service")]
mod metrics;
#[cfg(feature = "pictures")]
pub mod picture;
#[cfg(feature = "service")]
mod readiness;
pub mod remesh;
pub mod rvd;
#[cfg(feature = "service")]
mod service;
#[cfg(feature = "cli")]
mod telemetry;
pub mod token;
#[cfg(feature = "service")]
mod trace;
#[cfg(feature = "service")]
mod wire;

pub use cvt::{Cvt, CvtOptions, DensityOptions, DensitySource, Projection};
pub use mesh::{MeshError, TriMesh};
pub use remesh::{Observer, Placement, Refine, Remesh, RemeshError, RemeshOptions, Report, Seeds, remesh};
pub use rvd::{Backend, BackendChoice, BackendKind, BackendOptions, Cells, Diagram, RvdError, auto_backend};
pub use token::{Stopped, Token};
#[cfg(feature = "service")]
pub use wire::proto;
