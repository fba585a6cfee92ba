// Turns the counts of the grid's cells into the places where they begin. Each line of cells takes as many entries of the
// sorted seeds as it has. Which line comes first differs from run to run; no result depends on it.
// It also decides where rows of neighbours come from, since all seeds have been counted by now. The rows are the same from
// either source.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> cells: array<u32>;
@group(0) @binding(2) var<storage, read_write> state: State;
@group(0) @binding(3) var<storage, read_write> list_state: ListState;
// Workgroups (x, y, z) of each part of `from_lists`, which writes those of `search`.
@group(0) @binding(4) var<storage, read_write> arguments: array<u32>;

#import shared/list_state

// Below, a row may be all that there is.
const FEWEST: u32 = 64u;
// One open row of so many, and lists are made anew.
const OPEN: u32 = 6u;

// Leaves in `made` what it will be.
fn choose() -> u32 {
    let slow = atomicLoad(&list_state.fast) * MANY <= params.seeds;
    let served = slow && atomicLoad(&list_state.open) * OPEN <= params.seeds;
    if atomicLoad(&state.halt) != 0u {
        return NOTHING;
    }
    if params.has_lists == 0u || params.seeds < FEWEST || list_state.made == 0u || (list_state.made < 3u && !slow) {
        list_state.made = 1u;
        return FROM_GRID;
    }
    if list_state.made > 1u && served {
        list_state.made += 1u;
        return FROM_LISTS;
    }
    list_state.made = 2u;
    return FROM_GRID_WITH_LISTS;
}

fn decide() {
    let mode = choose();
    list_state.mode = mode;
    atomicStore(&list_state.open, 0u);
    for (var k = 0u; k < parts(); k += 1u) {
        let groups = (min(params.seeds - k * PART, PART) + 63u) / 64u;
        arguments[3u * k] = select(0u, groups, mode == FROM_LISTS);
        arguments[3u * k + 1u] = 1u;
        arguments[3u * k + 2u] = 1u;
        for (var lists = 0u; lists < 2u; lists += 1u) {
            let at = (lists * parts() + k) * 3u;
            atomicStore(&list_state.words[at], select(0u, groups, mode == select(FROM_GRID, FROM_GRID_WITH_LISTS, lists == 1u)));
            atomicStore(&list_state.words[at + 1u], 1u);
            atomicStore(&list_state.words[at + 2u], 1u);
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
