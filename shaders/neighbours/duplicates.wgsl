// Finds seeds at exactly the place of an earlier one. They are in the same cell of the grid.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cells: array<u32>;
@group(0) @binding(2) var<storage, read_write> sorted: array<Sorted>;
@group(0) @binding(3) var<storage, read_write> state: State;

#import shared/grid

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let own = params.part_first + id.x + id.y * groups.x * 64u;
    if own >= params.seeds || atomicLoad(&state.halt) != 0u {
        return;
    }
    let here = sorted[own];
    let seed = here.seed;
    let cell = here.first;
    var first = seed;
    for (var at = cells[cell]; at < cells[cell + 1u]; at += 1u) {
        if is_zero(to_sorted(here, sorted[at])) {
            first = min(first, sorted[at].seed);
        }
    }
    sorted[own].first = first;
    if first != seed {
        atomicAdd(&state.duplicates, 1u);
    }
}
