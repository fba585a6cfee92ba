//! Geometry: surfaces, neighbours of seeds, restricted Voronoi diagrams on the CPU, CVT and remeshing.
//!
//! | module | what it is for | may use |
//! | --- | --- | --- |
//! | [`token`] | cancellation and limits of work | nothing here |
//! | `tasks` | loops whose items are shared by the threads | nothing here |
//! | [`mesh`] | triangle surfaces: checked, read, written, sampled, measured | nothing here |
//! | [`knn`] | neighbour tables of the seeds | `mesh` |
//! | [`rvd`] | the diagram: one trait, the backends of the CPU, the dual | `knn`, `mesh` |
//! | [`cvt`] | iterations that move the seeds | `rvd`'s trait |
//! | [`mod@remesh`] | sample, iterate, dual, repair, measure | `cvt`, `rvd`, `mesh` |
//!
//! Invariant: the same input and options give the same bits on any number of threads.
//! Must not know: async runtimes, GPUs, messages, jobs.

#![warn(unreachable_pub)]

/// Setters of options, chained: `Options::new().with_this(1).with_that(2)`. Options that may grow cannot be written as a literal by
/// other crates. `with_field(field: Type)` sets its field and nothing else; `=> value` says what the field becomes, where that is
/// not the argument.
#[macro_export]
macro_rules! setters {
    ($($set:ident($field:ident: $of:ty $(=> $value:expr)?)),+ $(,)?) => {
        $(
            #[doc = concat!("Sets [`", stringify!($field), "`](field@Self::", stringify!($field), ").")]
            #[must_use]
            pub fn $set(mut self, $field: $of) -> Self {
                self.$field = $crate::setters!(@ $field $($value)?);
                self
            }
        )+
    };
    (@ $field:ident) => { $field };
    (@ $field:ident $value:expr) => { $value };
}

pub mod cvt;
pub mod knn;
pub mod mesh;
pub mod remesh;
pub mod rvd;
mod tasks;
pub mod token;
