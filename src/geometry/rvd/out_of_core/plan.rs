//! The memory that a diagram in windows takes.
//!
//! Purpose: [`Plan::new`] chooses the windows for a limit, from counts alone.
//! Invariant: the plan is known before anything is allocated, and the process takes no more. Must not know: contents of files.

use serde::Serialize;

use super::OutOfCoreError;
use crate::mesh::out_of_core::MeshFile;

/// The program itself, without work.
const PROGRAM: u64 = 24 << 20;
/// A thread: scratch memory for lists, pieces and searches, and its share of the tasks' sums.
const THREAD: u64 = 12 << 20;
/// A seed: the caller's copy, the session's with its direction, and the index.
const SEED: u64 = 24 + 24 + 24 + 24 + 1 + 88;
/// What building the index takes beside it.
const INDEXING: u64 = 60;
/// A seed's row of neighbours, beside 4 bytes a neighbour.
const ROW: u64 = 9;
/// A seed's sums, and their number's place on each thread.
const SUMS: u64 = 48;
/// A seed that moves: its gradient, and sums beside those that are asked for.
const MOVES: u64 = 24 + 48;
/// A facet in a window: corners in the unit frame, weights, numbers, vertices with weights, a seed near it.
const FACET: u64 = 250;
/// The most facets of a window: larger ones are not faster.
const MOST: usize = 1 << 20;
/// The fewest.
const FEWEST: usize = 1 << 14;
/// Facets that are added up together, at most.
const BLOCK: usize = 256;
/// The most memory for sorting: more does not save a pass over the records.
const SORT: u64 = 256 << 20;
/// The least.
const LEAST_SORT: u64 = 8 << 20;
/// Windows of the file while facets are put in order: records, corners, keys.
const READING: u64 = 12 << 20;
/// What the allocator takes for what is sorted, as a share of it: 1.13 to 1.16 was measured at 2·10⁷ facets.
const KEPT: [u64; 2] = [7, 6];

/// What a caller wants of a diagram.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// Number of seeds.
    pub seeds: usize,
    /// Whether they are drawn from the surface.
    pub drawn: bool,
    /// Whether they move.
    pub moves: bool,
    /// Neighbours of a row.
    pub neighbours: usize,
    /// Threads that work.
    pub threads: usize,
    /// Memory that the process may take.
    pub limit_bytes: u64,
}

/// Memory by what it is for, bytes, and the windows.
#[derive(Clone, Debug, Serialize, PartialEq, Eq)]
pub struct Plan {
    /// What is allowed.
    pub limit_bytes: u64,
    /// The most at one time: the program and its threads, and the larger one of preparing and passes.
    pub total_bytes: u64,
    /// The program and its threads.
    pub program_bytes: u64,
    /// Seeds and their index.
    pub seed_bytes: u64,
    /// What building the index takes beside it.
    pub indexing_bytes: u64,
    /// Rows of neighbours.
    pub row_bytes: u64,
    /// Sums of cells, and vectors of seeds that move.
    pub sum_bytes: u64,
    /// One window of facets.
    pub window_bytes: u64,
    /// Facets of a window.
    pub window_facets: usize,
    /// Windows of a pass.
    pub windows: usize,
    /// Memory for sorting facets, before the first pass.
    pub sort_bytes: u64,
    /// Memory for vertices, before the first pass.
    pub vertex_bytes: u64,
    /// Passes over the facets of the file for its vertices: 1 if they fit at once.
    pub vertex_passes: usize,
    /// All memory before the first pass, without the program.
    pub prepare_bytes: u64,
    /// The file of the surface.
    pub file_bytes: u64,
    /// Scratch files at most, on disk.
    pub scratch_bytes: u64,
}

impl Plan {
    /// Plans for a file. Errors: `DoesNotFit`.
    pub fn new(file: &MeshFile, wanted: &Wanted) -> Result<Self, OutOfCoreError> {
        let (facets, vertices, number) = (file.facets(), file.vertices(), file.number_bytes());
        let seeds = wanted.seeds as u64;
        let program_bytes = PROGRAM + THREAD * wanted.threads as u64;
        let seed_bytes = seeds * SEED;
        let row_bytes = seeds * (ROW + 4 * wanted.neighbours as u64);
        let sum_bytes = seeds * (SUMS + 4 * wanted.threads as u64 + if wanted.moves { MOVES } else { 0 });
        let indexing_bytes = seeds * INDEXING;
        let resident = seed_bytes + row_bytes + sum_bytes;
        // Seeds that move get a new index while there is a window.
        let beside = if wanted.moves { indexing_bytes } else { 0 };
        let each = FACET + record_bytes(number) as u64;
        let room = wanted.limit_bytes.saturating_sub(program_bytes + resident + beside);
        let fits = usize::try_from(room / each).unwrap_or(usize::MAX);
        // Of whole blocks, about.
        let window_facets = fits.clamp(FEWEST, MOST).min(facets.next_multiple_of(BLOCK)) / BLOCK * BLOCK;
        let window_bytes = window_facets as u64 * each;
        // Before the first pass: sorting, and vertices.
        let sorted = facets as u64 * key_bytes(number) as u64;
        let vertex = if file.is_indexed() { 3 * number as u64 + 4 } else { 0 };
        let bits = if file.is_indexed() { vertices as u64 / 8 } else { 0 };
        let drawn = if wanted.drawn { 64 * seeds } else { 0 };
        let all = vertices as u64 * vertex;
        let [kept, of] = KEPT;
        let room = (wanted.limit_bytes.saturating_sub(program_bytes) / kept * of).saturating_sub(READING);
        let sort_bytes = sorted.min(SORT).min((room / 2).max(LEAST_SORT));
        let vertex_bytes = all.min(room.saturating_sub(sort_bytes).max(LEAST_SORT));
        let welding = vertices as u64 * (3 * number as u64 + 4);
        let prepare = (sort_bytes.min(sorted) + vertex_bytes).max(vertex_bytes + drawn).max(sort_bytes.min(welding));
        let prepare_bytes = (READING + prepare.max(bits)).div_ceil(of) * kept;
        let pass = resident + (window_bytes + beside).max(indexing_bytes);
        let total_bytes = program_bytes + prepare_bytes.max(pass);
        if total_bytes > wanted.limit_bytes {
            return Err(OutOfCoreError::DoesNotFit { needed_bytes: total_bytes, limit_bytes: wanted.limit_bytes });
        }
        let vertex_passes = if vertex_bytes == 0 { 1 } else { all.div_ceil(vertex_bytes).max(1) as usize };
        let waiting = if vertex_passes > 1 { facets as u64 * (9 * number as u64 + 12) } else { 0 };
        let welds = if file.is_indexed() { 4 } else { 12 + 8 } * facets as u64;
        let runs = if sort_bytes < sorted { sorted } else { 0 };
        let scratch_bytes = welds + (facets * record_bytes(number)) as u64 + runs + waiting;
        Ok(Self {
            limit_bytes: wanted.limit_bytes,
            total_bytes,
            program_bytes,
            seed_bytes,
            indexing_bytes,
            row_bytes,
            sum_bytes,
            window_bytes,
            window_facets,
            windows: facets.div_ceil(window_facets),
            sort_bytes,
            vertex_bytes,
            vertex_passes,
            prepare_bytes,
            file_bytes: file.bytes(),
            scratch_bytes,
        })
    }
}

/// A facet with area in the scratch file: its corners, and the order of its vertices.
pub(super) fn record_bytes(number: usize) -> usize {
    9 * number + 1
}

/// The same while it is put in order: behind a place and a number.
pub(super) fn key_bytes(number: usize) -> usize {
    12 + record_bytes(number)
}
