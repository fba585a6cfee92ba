// State of the Verlet lists. A list has the WIDTH nearest seeds of its seed when it was made, and how far it is known to be
// complete. Positions since then tell whether a row of neighbours can be taken from it.

// What a search does.
const NOTHING: u32 = 0u;
// All rows from the grid.
const FROM_GRID: u32 = 1u;
// The same, and lists with them.
const FROM_GRID_WITH_LISTS: u32 = 2u;
// Rows from the lists, those that they do not suffice for from the grid.
const FROM_LISTS: u32 = 3u;

// Seeds that one dispatch looks at.
const PART: u32 = $(PART)u;

// One fast seed of so many is too much for lists.
const MANY: u32 = 16u;

struct ListState {
    // How far any seed is from where it was noted; the bits of a float, which are ordered as it is.
    drift: atomic<u32>,
    // Seeds that are far from there, as far as it matters how many.
    fast: atomic<u32>,
    // Rows that lists did not suffice for.
    open: atomic<u32>,
    // 0 if nothing is noted, 1 if places are, from 2 on the passes that the lists have served, and two.
    made: u32,
    mode: u32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
    // Workgroups (x, y, z) of each part of `search` without and with lists; then which of the sorted seeds are open.
    words: array<atomic<u32>>,
}

fn parts() -> u32 {
    return (params.seeds + PART - 1u) / PART;
}
