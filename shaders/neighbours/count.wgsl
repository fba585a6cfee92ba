// First stage of the search: checks every seed and counts those of each cell of the grid.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read_write> cells: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> state: State;
@group(0) @binding(4) var<storage, read> list_origins: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> list_state: ListState;
// Of each cell of the grid, how far any of its seeds is from where it was noted; the bits of a float.
@group(0) @binding(6) var<storage, read_write> drifts: array<atomic<u32>>;

#import shared/place
#import shared/list_state

// Farther out, in boxes, a float's rounding is more than neighbours are apart. So far the host searches.
const FARTHEST: f32 = 8.0;
// As rvd::MAX_SEED_DISTANCE.
const ACCEPTED: f32 = 1e6;
// The fixed-point scales hold if a seed is so near to all of the box.
const NEAR: f32 = 2.0;
// Seeds that a cell may have: all of them meet all of the neighbouring cells'.
const CELL_CAPACITY: u32 = 256u;
// A seed that has moved by such a share of what it knows around it is fast.
const FAST: f32 = 0.08;

fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let i = params.part_first + id.x + id.y * groups.x * 64u;
    // Bits that other seeds of this dispatch set are of no consequence.
    if i >= params.seeds || (atomicLoad(&state.halt) & INCOMPLETE) != 0u {
        return;
    }
    let p = seeds[i].hi + seeds[i].lo;
    let a = abs(p);
    var reach = max(max(a.x, a.y), a.z);
    var finite = is_finite(p.x) && is_finite(p.y) && is_finite(p.z);
#if LIFTED
    let lift = seeds[i].lift_hi + seeds[i].lift_lo;
    reach = max(reach, max(max(abs(lift.x), abs(lift.y)), abs(lift.z)));
    finite = finite && is_finite(lift.x) && is_finite(lift.y) && is_finite(lift.z);
#end
    if !finite || reach > ACCEPTED {
        atomicMax(&state.bad, 0xffffffffu - i);
        atomicOr(&state.halt, BAD);
        return;
    }
    if reach > FARTHEST {
        atomicOr(&state.halt, FAR);
    }
#if 1 - LIFTED
    let is_near = length(a + 0.5) <= NEAR;
#end
#if LIFTED
    // No lift of the surface is longer.
    let is_near = length(a + 0.5) <= NEAR && length(lift) <= params.longest_lift;
#end
    if is_near && atomicLoad(&state.near) == 0u {
        atomicStore(&state.near, 1u);
    }
    let cell = cell_at(place_of(p));
    let rank = atomicAdd(&cells[cell], 1u);
    if rank == CELL_CAPACITY {
        atomicOr(&state.halt, GRID_OVERFLOW);
    }
    if params.has_lists != 0u {
        let noted = list_origins[i];
        let by = length(p - noted.xyz);
        // Few are farther than all before them, so few lanes wait for each other.
        if bitcast<u32>(by) > atomicLoad(&list_state.drift) {
            atomicMax(&list_state.drift, bitcast<u32>(by));
        }
        atomicMax(&drifts[cell], bitcast<u32>(by));
        if by > FAST * noted.w && atomicLoad(&list_state.fast) * MANY <= params.seeds {
            atomicAdd(&list_state.fast, 1u);
        }
    }
    // Until `search` writes them, these two say where `scatter` puts the seed.
    seeds[i].row_begin = rank;
    seeds[i].row_length = cell;
}
