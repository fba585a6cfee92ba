// The one block that the host reads between submissions.

struct State {
    // First pair that no dispatch has taken yet.
    head: u32,
    // The pairs of the present dispatch.
    begin: u32,
    end: u32,
    // Pairs in the list; may pass its capacity, which `list_overflow` counts too.
    length: atomic<u32>,
    // Entries in the list of failures.
    failures: atomic<u32>,
    // Non-empty pieces so far.
    pieces: atomic<u32>,
    list_overflow: atomic<u32>,
    cells_overflow: atomic<u32>,
    // Why the search did not go on; 0 if it did.
    halt: atomic<u32>,
    // 1 if a seed is near the surface's box.
    near: atomic<u32>,
    // Seeds at the place of an earlier one.
    duplicates: atomic<u32>,
    // Facets whose first cell could not be proved.
    unproved: atomic<u32>,
    // 2^32 - 1 less the first seed that is not finite or beyond the range; 0 if there is none.
    bad: atomic<u32>,
    // Entries of the sorted seeds that are given out.
    cursor: atomic<u32>,
    // Facets that `divide` left to the list of pairs.
    paired: atomic<u32>,
    // Clip dispatches that had pairs.
    rounds: u32,
    // Entries of the rows that were made longer.
    longer: atomic<u32>,
    // Failures that were put to the end of the list again.
    requeued: atomic<u32>,
    // Those of them whose polygons did not fit.
    overflowed: atomic<u32>,
}

const BAD: u32 = 1u;
const FAR: u32 = 2u;
const GRID_OVERFLOW: u32 = 4u;
// Of the pass, not of the search: it is not complete.
const INCOMPLETE: u32 = 8u;
