// The per-cell side ([HYWZ17]: where a facet meets many cells, the work is done by cell). Each seed looks for the BY_CELL
// facets that its cell reaches, and enters the pairs. A grid over the unit box says which facets are near. A facet is
// reached if its point nearest to the seed has no nearer seed and the seed's row is long enough to prove it. Cells that meet
// a facet only elsewhere are missed here; their neighbours name them when those are clipped.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> facets: array<Facet>;
@group(0) @binding(3) var<storage, read> table: array<u32>;
// Where the facets of each grid cell begin in this same array, then the facets.
@group(0) @binding(4) var<storage, read> near: array<u32>;
@group(0) @binding(5) var<storage, read_write> slots: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> list: array<vec2u>;
@group(0) @binding(7) var<storage, read_write> failures: array<vec2u>;
@group(0) @binding(8) var<storage, read_write> state: State;

#import shared/append
#import shared/cell_set

fn on_segment(p: vec2f, a: vec2f, b: vec2f) -> vec2f {
    let along = b - a;
    return a + clamp(dot(p - a, along) / dot(along, along), 0.0, 1.0) * along;
}

// The point of the triangle nearest to p. Corners counter-clockwise.
fn on_triangle(p: vec2f, a: vec2f, b: vec2f, c: vec2f) -> vec2f {
    var best = p;
    var distance = -1.0;
    var tail = c;
    for (var k = 0u; k < 3u; k += 1u) {
        let tip = select(select(c, b, k == 1u), a, k == 0u);
        let along = tip - tail;
        if along.x * (p.y - tail.y) - along.y * (p.x - tail.x) < 0.0 {
            let q = on_segment(p, tail, tip);
            let d = dot(p - q, p - q);
            if distance < 0.0 || d < distance {
                best = q;
                distance = d;
            }
        }
        tail = tip;
    }
    return best;
}

fn reaches(seed: Seed, facet: Facet) -> bool {
    let w = (facet.hi - seed.hi) + (facet.lo - seed.lo);
    let a = vec2f(dot(facet.e1, w), dot(facet.e2, w));
    let b = vec2f(a.x + facet.corner1_u, a.y);
    let c = vec2f(a.x + facet.corner2_u, a.y + facet.corner2_v);
    let q = on_triangle(vec2f(0.0), a, b, c);
    let v = q.x * facet.e1 + q.y * facet.e2 + dot(facet.n, w) * facet.n;
    let distance2 = dot(v, v);
    let end = seed.row_begin + (seed.row_length & INDEX);
    for (var at = seed.row_begin; at < end; at += 1u) {
        let other = seeds[table[at]];
        let x = (other.hi - seed.hi) + (other.lo - seed.lo);
        let x2 = dot(x, x);
        if x2 > 4.0 * distance2 {
            return true;
        }
        if x2 < 2.0 * dot(v, x) {
            return false;
        }
    }
    // Facets behind the seed, beyond what its row knows of, would be many and in vain.
    return (seed.row_length & COMPLETE) != 0u;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let i = params.part_first + id.x + id.y * groups.x * 64u;
    if i >= params.emit_count {
        return;
    }
    let seed = seeds[i];
    let side = f32(params.grid);
    let place = vec3u(clamp((seed.hi + 0.5) * side, vec3f(0.0), vec3f(side - 1.0)));
    let box = (place.z * params.grid + place.y) * params.grid + place.x;
    for (var at = near[box]; at < near[box + 1u]; at += 1u) {
        let f = near[at];
        let facet = facets[f - params.facet_first];
        let mask = facet.slot_mask;
        let done = params.divided != NONE && atomicLoad(&slots[params.divided + f]) != 0u;
        if done || (mask & BY_CELL) == 0u || !reaches(seed, facet) {
            continue;
        }
        let outcome = insert_cell(facet.slot_begin, mask & ~BY_CELL, i, 0u);
        if outcome == INSERTED {
            append_pair(f, i);
        } else if outcome == FULL {
            atomicAdd(&state.cells_overflow, 1u);
            append_failure(f, i, 0u);
        }
    }
}
