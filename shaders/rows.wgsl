// Turns the counts of the grid's cells into where they begin: each row of cells takes as many entries
// of the sorted seeds as it has. Which row comes first changes from run to run, and no result with it.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> cells: array<u32>;
@group(0) @binding(2) var<storage, read_write> state: State;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let row = id.x + id.y * groups.x * 64u;
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
