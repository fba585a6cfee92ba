//! Geometry: surfaces, neighbours of seeds, restricted Voronoi diagrams on the CPU, CVT and remeshing.
//!
//! | module | what it is for | may use |
//! | --- | --- | --- |
//! | [`token`] | cancellation and limits of work | nothing here |
//! | [`mesh`] | triangle surfaces: checked, read, written, sampled, measured | nothing here |
//! | [`knn`] | neighbour tables of the seeds | `mesh` |
//! | [`rvd`] | the diagram: one trait, the backends of the CPU, the dual | `knn`, `mesh` |
//! | [`cvt`] | iterations that move the seeds | `rvd`'s trait |
//! | [`mod@remesh`] | sample, iterate, dual, repair, measure | `cvt`, `rvd`, `mesh` |
//!
//! Invariant: the same input and options give the same bits on any number of threads.
//! Must not know: async runtimes, GPUs, messages, jobs.

#![warn(unreachable_pub)]

#[macro_use]
mod setters;

pub mod cvt;
pub mod knn;
pub mod mesh;
pub mod remesh;
pub mod rvd;
pub mod token;
