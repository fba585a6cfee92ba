//! **Tessera**: exact restricted Voronoi diagrams (RVD) and centroidal Voronoi remeshing of
//! triangle surfaces, on a GPU or on all cores of a CPU, as a library, a program and a gRPC service.
//!
//! The method is that of Han, Yan, Wang, Zhao, *Computing Restricted Voronoi Diagram on Graphics
//! Hardware* (Pacific Graphics 2017), cited in these docs as \[HYWZ17\].
//!
//! # The map of the house
//!
//! | module | what lives there | may use |
//! | --- | --- | --- |
//! | [`token`] | cancellation and limits, heard by every stage | nothing here |
//! | [`mesh`] | triangle surfaces: validated, read, written, sampled, measured | nothing here |
//! | [`picture`] | pictures of surfaces, drawn in software | `mesh` |
//! | [`knn`] | neighbour tables of the seeds | `mesh` |
//! | [`gpu`] | the device, buffer plans, shader sources; knows no mesh, seed or job | nothing here |
//! | [`rvd`] | the restricted Voronoi diagram: one trait, three backends, the dual | `knn`, `mesh`, `gpu` (only `rvd::gpu`) |
//! | [`cvt`] | iterations that move the seeds | `rvd`'s trait |
//! | [`remesh`] | sample, iterate, dual, repair, measure | `cvt`, `rvd::dual`, `mesh` |
//! | [`job`] | the queue, and the one thread that owns the device | `remesh` and below |
//! | [`service`] | gRPC: handlers, conversion, status codes | `job` and below |
//! | [`cli`] | one file per subcommand | everything |
//!
//! Everything may use `token`. Nothing runs back up. `tests/architecture.rs` holds these rules.

#[cfg(feature = "cli")]
pub mod cli;
#[cfg(feature = "service")]
pub mod config;
pub mod cvt;
#[cfg(feature = "gpu")]
pub mod gpu;
#[cfg(feature = "service")]
pub mod job;
pub mod knn;
pub mod mesh;
#[cfg(feature = "pictures")]
pub mod picture;
pub mod remesh;
pub mod rvd;
#[cfg(feature = "service")]
pub mod service;
#[cfg(feature = "cli")]
pub mod telemetry;
pub mod token;
