// Clips pairs of a finished list once more and writes the pieces themselves.

#import shared/types

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> facets: array<Facet>;
@group(0) @binding(3) var<storage, read> table: array<u32>;
@group(0) @binding(4) var<storage, read> list: array<vec2u>;
// Per pair: facet, seed, number of vertices, status.
@group(0) @binding(5) var<storage, read_write> heads: array<vec4u>;
// Per pair $SLOTS vertices: place relative to the seed's and weight, and edge labels.
@group(0) @binding(6) var<storage, read_write> vertices: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> labels: array<u32>;

#import shared/clip_pair

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.emit_count {
        return;
    }
    let pair = list[params.emit_begin + id.x];
    let i = pair.y & INDEX;
    let f = pair.x & INDEX;
    let facet = facets[f - params.facet_first];
    let status = clip_pair(facet, i);
    let size = select(0u, count, status == DONE);
    heads[id.x] = vec4u(f, i, size, status);
    let weighted = params.uniform_weights == 0u;
    for (var k = 0u; k < size; k += 1u) {
        let p = polygon_vertex(k);
        let q = place_in(from_seed(facet, p, 1.0));
        let at = id.x * $(SLOTS)u + k;
        vertices[at] = vec4f(q, select(1.0, weight_at(facet, p), weighted));
        labels[at] = polygon_edge(k);
    }
}
