// Enters candidates into the facets' sets of cells and, where they are new, into the list of pairs. Candidates are every
// facet's first cell ([HYWZ17], Algorithm 1: the seed nearest to it), and the neighbours of pairs that the host finished.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> facets: array<Facet>;
@group(0) @binding(2) var<storage, read> candidates: array<vec2u>;
@group(0) @binding(3) var<storage, read_write> slots: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read_write> list: array<vec2u>;
@group(0) @binding(5) var<storage, read_write> failures: array<vec2u>;
@group(0) @binding(6) var<storage, read_write> state: State;

#import shared/append
#import shared/cell_set

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let index = params.part_first + id.x + id.y * groups.x * 64u;
    if index >= params.enqueue_count || atomicLoad(&state.halt) != 0u {
        return;
    }
    let pair = candidates[params.enqueue_begin + index];
    let facet = pair.x;
    let seed = pair.y;
    if seed == NONE {
        return;
    }
    let at = facet - params.facet_first;
    let outcome = insert_cell(facets[at].slot_begin, facets[at].slot_mask & ~BY_CELL, seed, 0u);
    if outcome == INSERTED {
        append_pair(facet, seed | params.enqueue_root);
    } else if outcome == FULL {
        atomicAdd(&state.cells_overflow, 1u);
        append_failure(facet, seed, 0u);
    }
}
