// Records that the host writes and reads. In Rust: src/gpu/diagram/layout.rs (a test compares them). LIFTED, a point has three
// more coordinates, which have hi and lo of their own.

#import shared/point

// A seed as hi + lo, so that differences of nearby points keep their detail, and its row of the
// neighbour table. The highest bit of row_length says that no other seed can matter.
struct Seed {
    hi: vec3f,
    row_begin: u32,
    lo: vec3f,
    row_length: u32,
#if LIFTED
    lift_hi: vec3f,
    lift_lo: vec3f,
#end
}

// From a seed to another one.
fn to_seed(start: Seed, to: Seed) -> Point {
#if 1 - LIFTED
    return (to.hi - start.hi) + (to.lo - start.lo);
#end
#if LIFTED
    return Point(
        (to.hi - start.hi) + (to.lo - start.lo),
        (to.lift_hi - start.lift_hi) + (to.lift_lo - start.lift_lo),
    );
#end
}

// A facet: its first corner as hi + lo, an orthonormal frame (e1 along the first edge, n its
// normal, which there is in R^3 alone), the other corners in that frame, the weight as a linear
// function, and its slots in the hash sets of cells. The highest bit of slot_mask is BY_CELL.
struct Facet {
    hi: vec3f,
    slot_begin: u32,
    lo: vec3f,
    slot_mask: u32,
    e1: vec3f,
    corner1_u: f32,
    e2: vec3f,
    corner2_u: f32,
#if 1 - LIFTED
    n: vec3f,
#end
#if LIFTED
    lift_hi: vec3f,
#end
    corner2_v: f32,
    weight: f32,
    weight_u: f32,
    weight_v: f32,
    weight_top: f32,
#if LIFTED
    lift_lo: vec3f,
    lift_e1: vec3f,
    lift_e2: vec3f,
#end
}

// From a seed to the first corner of a facet.
fn to_corner(start: Seed, to: Facet) -> Point {
#if 1 - LIFTED
    return (to.hi - start.hi) + (to.lo - start.lo);
#end
#if LIFTED
    return Point(
        (to.hi - start.hi) + (to.lo - start.lo),
        (to.lift_hi - start.lift_hi) + (to.lift_lo - start.lift_lo),
    );
#end
}

// What is the same for all invocations of one dispatch.
struct Params {
    mass_scale: f32,
    moment_scale: f32,
    energy_scale: f32,
    area_scale: f32,
    uniform_weights: u32,
    list_capacity: u32,
    // Pairs per clip dispatch at most.
    batch: u32,
    // First candidate to enter, and how many; root is ROOT for first cells of facets and 0 otherwise.
    enqueue_begin: u32,
    enqueue_count: u32,
    enqueue_root: u32,
    // Pairs that one emit dispatch writes; pairs that `verify` looks at; seeds of `reach`.
    emit_begin: u32,
    emit_count: u32,
    // Vertices that a polygon in registers may have; at most its slots.
    polygon: u32,
    // How sums reach global memory: DIRECT, TWO_PHASE or NOWHERE.
    accumulate: u32,
    // Grid cells along each side of the unit box, for `reach`.
    grid: u32,
    // Zero, which the compiler cannot know.
    zero: u32,
    // Seeds; entries of a row as the search writes it; cells along each side of the grid of seeds;
    // facets that have a first cell.
    seeds: u32,
    row: u32,
    side: u32,
    roots: u32,
    // Where in `slots` it says which BY_CELL facets `divide` has done; NONE if it does not.
    divided: u32,
    // The facet whose record comes first in the present window of them.
    facet_first: u32,
    // The item that the present part of a dispatch begins at.
    part_first: u32,
    // 1 if there is room for Verlet lists.
    has_lists: u32,
    // Of a lifted surface.
    longest_lift: f32,
}

const COMPLETE: u32 = 0x80000000u;
const ROOT: u32 = 0x80000000u;
const INDEX: u32 = 0x7fffffffu;
const FACET_EDGE: u32 = 0xffffffffu;
// In a facet's slot_mask: cells look for this facet themselves, so its pieces are to be proved.
const BY_CELL: u32 = 0x80000000u;
// In a pair's first word: the pair is not empty and its facet is BY_CELL.
const PIECE: u32 = 0x80000000u;
// In a slot: a cell nearer to the facet's centroid has named this one as its neighbour.
const NAMED: u32 = 0x80000000u;

// A candidate that is not known.
const NONE: u32 = 0xffffffffu;

const DIRECT: u32 = 0u;
const TWO_PHASE: u32 = 1u;
const NOWHERE: u32 = 2u;

// How a pair ended. The host's names are those of rvd::PairStatus; FINISH is NonFinite, and an
// empty polygon of a facet's first cell.
const DONE: u32 = 0u;
const NEIGHBOURS: u32 = 1u;
const POLYGON: u32 = 2u;
const FINISH: u32 = 3u;
