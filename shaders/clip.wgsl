// Clips the pairs that `prepare` took, adds the pieces to their cells' sums, and appends the
// cells across the pieces' bisectors to the list ([HYWZ17], Algorithm 1).

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> facets: array<Facet>;
@group(0) @binding(3) var<storage, read> table: array<u32>;
@group(0) @binding(4) var<storage, read_write> slots: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> list: array<vec2u>;
@group(0) @binding(6) var<storage, read_write> sums: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> failures: array<vec2u>;
@group(0) @binding(8) var<storage, read_write> state: State;

#import shared/clip_pair
#import shared/fixed
#import shared/append
#import shared/cell_set

// Sums per seed: mass, moment x y z, energy, area; two words each.
const SUM_WORDS: u32 = 12u;

// Adds the piece's integrals, fanned from its first vertex. The weight is linear, so with
// W = sum of the corner weights: mass |T| W / 3, moment |T| / 12 sum (W + w_a) p_a,
// energy |T| / 30 sum over a <= b of (W + w_a + w_b) p_a.p_b.
fn add_piece(facet: Facet, i: u32) {
    let weighted = params.uniform_weights == 0u;
    let a = polygon_vertex(0u);
    let wa = select(1.0, weight_at(facet, a), weighted);
    var b = polygon_vertex(1u);
    var wb = select(1.0, weight_at(facet, b), weighted);
    var mass = 0.0;
    var moment = vec2f(0.0);
    var energy = 0.0;
    var area = 0.0;
    for (var k = 2u; k < count; k += 1u) {
        let c = polygon_vertex(k);
        let wc = select(1.0, weight_at(facet, c), weighted);
        let ab = b - a;
        let ac = c - a;
        let t = 0.5 * (ab.x * ac.y - ab.y * ac.x);
        let w = wa + wb + wc;
        area += t;
        mass += t * w * (1.0 / 3.0);
        moment += (t * (1.0 / 12.0)) * ((w + wa) * a + (w + wb) * b + (w + wc) * c);
        let squares = (w + 2.0 * wa) * dot(a, a) + (w + 2.0 * wb) * dot(b, b) + (w + 2.0 * wc) * dot(c, c);
        let products = (w + wa + wb) * dot(a, b) + (w + wb + wc) * dot(b, c) + (w + wc + wa) * dot(c, a);
        energy += (t * (1.0 / 30.0)) * (squares + products);
        b = c;
        wb = wc;
    }
    energy += mass * height * height;
    let m = (moment.x * facet.e1 + moment.y * facet.e2 + (mass * height) * facet.n) * params.moment_scale;
    let at = i * SUM_WORDS;
    if weighted {
        add_fixed(at, mass * params.mass_scale);
    }
    add_fixed(at + 2u, m.x);
    add_fixed(at + 4u, m.y);
    add_fixed(at + 6u, m.z);
    add_fixed(at + 8u, energy * params.energy_scale);
    add_fixed(at + 10u, area * params.area_scale);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let index = state.begin + id.x;
    if index >= state.end {
        return;
    }
    let pair = list[index];
    let i = pair.y & INDEX;
    let facet = facets[pair.x];
    var status = clip_pair(facet, i);
    // The first cell of a facet holds its centroid. If rounding says otherwise nothing would
    // lead to the facet's other cells, so the host takes over.
    if status == DONE && count == 0u && (pair.y & ROOT) != 0u {
        status = FINISH;
    }
    if status != DONE {
        append_failure(pair.x, i, status);
        return;
    }
    if count == 0u {
        return;
    }
    atomicAdd(&state.pieces, 1u);
    add_piece(facet, i);
    var full = false;
    for (var k = 0u; k < count; k += 1u) {
        let j = polygon_edge(k);
        if j < FACET_EDGE - 2u {
            let outcome = insert_cell(facet.slot_begin, facet.slot_mask, j);
            if outcome == INSERTED {
                append_pair(pair.x, j);
            }
            full = full || outcome == FULL;
        }
    }
    if full {
        atomicAdd(&state.cells_overflow, 1u);
        append_failure(pair.x, i, 0u);
    }
}
