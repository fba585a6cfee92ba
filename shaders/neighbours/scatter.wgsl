// Puts every seed where its cell of the grid is. Within a cell seeds have no order. Every stage that looks through cells
// takes the least of a strict order, so it does not matter. Until `duplicates` writes it, the last word is the cell: what
// another stage computes for it may differ by a rounding.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> cells: array<u32>;
@group(0) @binding(3) var<storage, read_write> sorted: array<Sorted>;
@group(0) @binding(4) var<storage, read_write> state: State;

#import shared/grid

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let i = params.part_first + id.x + id.y * groups.x * 64u;
    if i >= params.seeds || atomicLoad(&state.halt) != 0u {
        return;
    }
    let seed = seeds[i];
    sorted[cells[seed.row_length] + seed.row_begin] = sorted_of(seed, i, seed.row_length);
}
