//! What every backend of the diagram must do, as one list of tests.
//!
//! Purpose: a new backend joins with one line, `conformance!(mine, Claims::double(MyBackend::new()));`, and gets every case of the
//! list below as a test of its own: `cargo test --test rvd backends::mine`. The reference is [`Serial`], which is written to be
//! read.
//! Invariant: a case sees a backend through its trait and its [`Claims`] only; it is the same for all of them. A claim says how far
//! a figure may be off. Seeds that single precision cannot tell apart are asked of double precision alone.
//! Must not know: which backends there are, and what is inside of them.

#[path = "conformance/bits.rs"]
pub mod bits;
#[path = "conformance/degenerate.rs"]
pub mod degenerate;
#[path = "conformance/exact.rs"]
pub mod exact;
#[path = "conformance/input.rs"]
pub mod input;
#[path = "conformance/moving.rs"]
pub mod moving;
#[path = "conformance/refusals.rs"]
pub mod refusals;

use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use tessera::rvd::{Backend, BackendKind, Capacities, CellSums, Serial, Surface};

pub use crate::sessions::{everything, open, same_bits, sums, sums_with};

/// In what a backend computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// Double precision: pieces are those of the reference to the bit, sums to the rounding of their addition.
    Double,
    /// Single precision relative to the seed. Undecided cases are finished in double precision and counted.
    Single,
}

/// What a backend says of itself.
pub struct Claims {
    backend: &'static dyn Backend,
    precision: Precision,
    twins: Vec<Box<dyn Backend>>,
    relaunches: bool,
    /// One case at a time where the backend has a device: it is one thread's at a time, as in the service.
    turn: Mutex<()>,
    diagrams: OnceLock<Vec<input::Answer>>,
}

impl Claims {
    /// A backend in double precision, which these tests have for themselves.
    pub fn double(backend: impl Backend + 'static) -> Self {
        Self::of(Box::leak(Box::new(backend)), Precision::Double)
    }

    /// A backend in single precision relative to the seed.
    pub fn single(backend: &'static dyn Backend) -> Self {
        Self::of(backend, Precision::Single)
    }

    fn of(backend: &'static dyn Backend, precision: Precision) -> Self {
        Self {
            backend,
            precision,
            twins: Vec::new(),
            relaunches: false,
            turn: Mutex::new(()),
            diagrams: OnceLock::new(),
        }
    }

    /// Adds the same backend set up otherwise, such as with another number of threads: it must give the same bits.
    pub fn with_twin(mut self, twin: impl Backend + 'static) -> Self {
        self.twins.push(Box::new(twin));
        self
    }

    /// Also claims that a pass with tiny capacities relaunches pairs for each of the three of them.
    pub fn with_relaunches(mut self) -> Self {
        self.relaunches = true;
        self
    }

    pub fn backend(&self) -> &dyn Backend {
        self.backend
    }

    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// One figure or the other.
    pub fn by_precision<T>(&self, double: T, single: T) -> T {
        match self.precision {
            Precision::Double => double,
            Precision::Single => single,
        }
    }

    /// Holds the device until the case has ended.
    pub fn turn(&self) -> Option<MutexGuard<'_, ()>> {
        let has_device = self.backend.kind() == BackendKind::Gpu;
        has_device.then(|| self.turn.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// The backend's answers for all shapes and seed sets, found once and looked at by several cases.
    pub fn diagrams(&self) -> &[input::Answer] {
        self.diagrams.get_or_init(|| input::answers(self.backend()))
    }
}

/// What the reference says of all shapes and seed sets.
pub fn reference() -> &'static [input::Answer] {
    static REFERENCE: OnceLock<Vec<input::Answer>> = OnceLock::new();
    REFERENCE.get_or_init(|| input::answers(&Serial))
}

/// Capacities that make pairs run out of everything.
pub fn tiny() -> Capacities {
    Capacities::new().with_neighbours(4).with_polygon(5).with_cells(2).with_pairs_percent(10)
}

/// Every cell within `tolerance` of the reference, relative to the mean cell and to the cell.
pub fn compare(name: &str, surface: &Surface, got: &CellSums, want: &CellSums, tolerance: f64) {
    let n = want.mass.len();
    let total: f64 = want.mass.iter().sum();
    let mean = total / n as f64;
    let h = (surface.area() / n as f64).sqrt();
    let (mut worst, mut worst_moment, mut worst_energy) = (0f64, 0f64, 0f64);
    for i in 0..n {
        let scale = want.mass[i].max(mean);
        worst = worst.max((got.mass[i] - want.mass[i]).abs() / scale);
        let reach = (want.energy[i] / want.mass[i].max(1e-300)).sqrt().max(h);
        worst_moment = worst_moment.max((got.moment[i] - want.moment[i]).length() / (scale * reach));
        worst_energy = worst_energy.max((got.energy[i] - want.energy[i]).abs() / (scale * reach * reach));
    }
    let area = (got.area.iter().sum::<f64>() / surface.area() - 1.0).abs();
    eprintln!("{name}: mass {worst:.1e}, moment {worst_moment:.1e}, energy {worst_energy:.1e}, area {area:.1e}");
    assert!(worst < tolerance && worst_moment < tolerance && worst_energy < 2.0 * tolerance, "{name}");
    assert!(area < 1e-6_f64.min(tolerance), "{name}: total area off by {area:e}");
}

/// All cases as tests, in a module of the backend's name. Attributes in front of the name, such as `#[needs::needs(gpu)]`, go to
/// every test; the claims are made once.
macro_rules! conformance {
    ($(#[$attribute:meta])* $name:ident, $claims:expr) => {
        mod $name {
            #[allow(unused_imports)]
            use super::*;

            fn claims() -> &'static crate::conformance::Claims {
                static CLAIMS: std::sync::OnceLock<crate::conformance::Claims> = std::sync::OnceLock::new();
                CLAIMS.get_or_init(|| $claims)
            }

            conformance! { @cases [$(#[$attribute])*]
                exact::sums_are_those_of_the_reference
                exact::pieces_are_those_of_the_reference
                exact::diagrams_of_every_shape_are_those_of_the_reference
                exact::pieces_tile_their_facets
                exact::every_point_lies_in_the_cell_of_its_nearest_seed
                exact::mass_follows_the_weights
                exact::many_more_seeds_than_facets
                exact::a_cell_has_a_hundred_sides
                bits::another_run_and_other_capacities_change_no_bit
                bits::capacities_and_threads_change_no_diagram
                bits::tuning_changes_no_bit
                bits::a_session_takes_one_seed_set_after_another
                bits::parts_of_the_surface_make_the_whole
                bits::seeds_that_move_have_the_sums_of_new_ones
                degenerate::one_seed_and_few
                degenerate::later_duplicates_have_no_cell
                degenerate::seeds_nearly_on_each_other
                degenerate::clusters_have_the_cells_of_the_reference
                degenerate::seeds_in_lattices_and_on_circles
                degenerate::seeds_on_the_mesh_itself
                degenerate::seeds_far_from_the_surface
                degenerate::far_seeds_and_duplicates_are_those_of_the_reference
                degenerate::a_cluster_at_one_rounded_distance
                degenerate::a_first_cell_that_misses_its_facet
                degenerate::facets_that_are_slivers
                degenerate::surfaces_that_are_no_manifold
                degenerate::units_offsets_and_weights_of_any_size
                refusals::no_seeds_and_too_many
                refusals::seeds_out_of_range_are_named
                refusals::a_refusal_leaves_the_session_as_it_was
                refusals::a_stopped_token_ends_a_pass_and_no_session
                moving::the_gradient_is_that_of_the_energy
                moving::every_component_of_the_gradient_is_right
                moving::a_step_goes_to_the_centroids
                moving::energies_along_the_direction_have_the_slope_of_the_gradient
                moving::quasi_newton_steps_go_down
                moving::a_run_has_the_same_bits_twice
                moving::held_seeds_do_not_move
                moving::twins_stay_and_clusters_spread
                moving::a_seed_that_leaves_the_range_is_named_and_x_stays
                moving::steps_taken_together_are_those_taken_one_by_one
            }
        }
    };
    (@cases $attributes:tt $($room:ident :: $case:ident)*) => {
        $( conformance! { @case $attributes $room $case } )*
    };
    (@case [$($attribute:tt)*] $room:ident $case:ident) => {
        $($attribute)*
        #[test]
        fn $case() {
            let claims = claims();
            let _turn = claims.turn();
            crate::conformance::$room::$case(claims);
        }
    };
}
pub(crate) use conformance;
