// Proves that the pieces of BY_CELL facets are those that propagation from the first cell finds. Each piece but the first
// must have been named by a piece whose seed is nearer to the facet's centroid. Then a chain of nearer ones ends at the
// first cell. Pairs without that proof go to the list of failures.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> facets: array<Facet>;
@group(0) @binding(2) var<storage, read_write> slots: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> list: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> failures: array<vec2u>;
@group(0) @binding(5) var<storage, read_write> state: State;

#import shared/append
#import shared/cell_set

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let index = params.part_first + id.x + id.y * groups.x * 64u;
    if index >= params.emit_count {
        return;
    }
    let pair = list[index];
    if (pair.x & PIECE) == 0u || (pair.y & ROOT) != 0u {
        return;
    }
    let f = pair.x & INDEX;
    let facet = f - params.facet_first;
    if !is_named(facets[facet].slot_begin, facets[facet].slot_mask & ~BY_CELL, pair.y) {
        append_failure(f, pair.y, FINISH);
    }
}
