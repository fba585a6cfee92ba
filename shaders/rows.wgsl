// Turns the counts of the grid's cells into where they begin: each row of cells takes as many entries
// of the sorted seeds as it has. Which row comes first changes from run to run, and no result with it.
// And what the search is to do: by then all seeds have been looked at. Rows are the same whichever it is.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> cells: array<u32>;
@group(0) @binding(2) var<storage, read_write> state: State;
@group(0) @binding(3) var<storage, read_write> keep: Keep;
// Workgroups (x, y, z) of each part of `recall`, which writes those of `search`.
@group(0) @binding(4) var<storage, read_write> arguments: array<u32>;

#import shared/keep

// Below, a row may be all that there is.
const FEWEST: u32 = 64u;
// One open row of so many, and lists are made anew.
const OPEN: u32 = 6u;

// Leaves in `made` what it will be.
fn choose() -> u32 {
    let slow = atomicLoad(&keep.fast) * MANY <= params.seeds;
    let served = slow && atomicLoad(&keep.open) * OPEN <= params.seeds;
    if atomicLoad(&state.halt) != 0u {
        return NOTHING;
    }
    if params.kept == 0u || params.seeds < FEWEST || keep.made == 0u || (keep.made < 3u && !slow) {
        keep.made = 1u;
        return ANEW;
    }
    if keep.made > 1u && served {
        keep.made += 1u;
        return RECALL;
    }
    keep.made = 2u;
    return LISTS;
}

fn decide() {
    let mode = choose();
    keep.mode = mode;
    atomicStore(&keep.open, 0u);
    for (var k = 0u; k < parts(); k += 1u) {
        let groups = (min(params.seeds - k * PART, PART) + 63u) / 64u;
        arguments[3u * k] = select(0u, groups, mode == RECALL);
        arguments[3u * k + 1u] = 1u;
        arguments[3u * k + 2u] = 1u;
        for (var lists = 0u; lists < 2u; lists += 1u) {
            let at = (lists * parts() + k) * 3u;
            atomicStore(&keep.words[at], select(0u, groups, mode == select(ANEW, LISTS, lists == 1u)));
            atomicStore(&keep.words[at + 1u], 1u);
            atomicStore(&keep.words[at + 2u], 1u);
        }
    }
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let row = id.x + id.y * groups.x * 64u;
    if row == 0u {
        decide();
    }
    if row >= params.side * params.side {
        return;
    }
    let first = row * (params.side + 1u);
    var count = 0u;
    for (var x = 0u; x < params.side; x += 1u) {
        count += cells[first + x];
    }
    var begin = 0u;
    if count > 0u {
        begin = atomicAdd(&state.cursor, count);
    }
    for (var x = 0u; x < params.side; x += 1u) {
        let here = cells[first + x];
        cells[first + x] = begin;
        begin += here;
    }
    cells[first + params.side] = begin;
}
