// Clips the pairs that `indirect_arguments` took, adds the pieces to their cells' sums, and appends the cells across the
// pieces' bisectors to the list ([HYWZ17], Algorithm 1).

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> facets: array<Facet>;
@group(0) @binding(3) var<storage, read> table: array<u32>;
@group(0) @binding(4) var<storage, read_write> slots: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> list: array<vec2u>;
#if WIDE
@group(0) @binding(6) var<storage, read_write> sums: array<atomic<u64>>;
#end
#if 1 - WIDE
@group(0) @binding(6) var<storage, read_write> sums: array<atomic<u32>>;
#end
@group(0) @binding(7) var<storage, read_write> failures: array<vec2u>;
@group(0) @binding(8) var<storage, read_write> state: State;

#import shared/clip_pair
#import shared/fixed
#import shared/append
#import shared/cell_set
#import shared/accumulate

// The piece's integrals in units, fanned from its first vertex. The weight is linear, so with
// W = sum of the corner weights: mass |T| W / 3, moment |T| / 12 sum (W + w_a) p_a,
// energy |T| / 30 sum over a <= b of (W + w_a + w_b) p_a.p_b.
fn piece_sums(facet: Facet) -> PieceSums {
    let weighted = params.uniform_weights == 0u;
    let a = polygon_vertex(0u);
    let wa = select(1.0, weight_at(facet, a), weighted);
    var b = polygon_vertex(1u);
    var wb = select(1.0, weight_at(facet, b), weighted);
    var mass = 0.0;
    var moment = vec2f(0.0);
    var energy = 0.0;
    var area = 0.0;
    var k = 2u;
    loop {
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
        k += 1u;
        if k >= count {
            break;
        }
    }
    energy += foot_energy(mass);
    let m = scaled(from_seed(facet, moment, mass), params.moment_scale);
    return PieceSums(
        select(0.0, mass * params.mass_scale, weighted),
        m,
        energy * params.energy_scale,
        area * params.area_scale,
    );
}

#if 1 - LIFTED
// Whether the seed at `b` from the present one is farther from the facet's centroid than it, beyond
// what rounding could have done. A strict order of the cells, which `verify` needs: distances to the
// centroid in the facet's rounded frame are one fixed function of the seed.
fn is_farther(facet: Facet, b: vec3f) -> bool {
    let c = vec3f(
        corner0.x + (facet.corner1_u + facet.corner2_u) * (1.0 / 3.0),
        corner0.y + facet.corner2_v * (1.0 / 3.0),
        height,
    );
    let d = c - vec3f(dot(facet.e1, b), dot(facet.e2, b), dot(facet.n, b));
    let extent = abs(corner0.x) + abs(corner0.y) + abs(height) + facet.corner1_u + facet.corner2_v + length(b);
    return dot(c, c) + 4e-6 * (extent + abs(facet.corner2_u)) * (length(c) + length(d)) < dot(d, d);
}
#end

// A piece's cell and sums, or nothing.
struct Piece {
    exists: bool,
    seed: u32,
    sums: PieceSums,
}

// Clips one pair and appends what it leads to.
fn process(index: u32) -> Piece {
    let pair = list[index];
    let f = pair.x & INDEX;
    let i = pair.y & INDEX;
    let facet = facets[f - params.facet_first];
    let by_cell = (facet.slot_mask & BY_CELL) != 0u;
    var status = clip_pair(facet, i);
    // The first cell of a facet holds its centroid. If rounding says otherwise nothing would
    // lead to the facet's other cells, so the host takes over.
    if status == DONE && count == 0u && (pair.y & ROOT) != 0u {
        status = FINISH;
    }
    if status != DONE {
        append_failure(f, pair.y, status);
        return Piece();
    }
    if count == 0u {
        return Piece();
    }
    atomicAdd(&state.pieces, 1u);
    if by_cell {
        list[index].x = f | PIECE;
    }
    var full = false;
    let seed = seeds[i];
    var k = 0u;
    loop {
        let j = polygon_edge(k);
        if j < FACET_EDGE - 2u {
            var named = 0u;
#if 1 - LIFTED
            if by_cell && is_farther(facet, to_seed(seed, seeds[j])) {
                named = NAMED;
            }
#end
            let outcome = insert_cell(facet.slot_begin, facet.slot_mask & ~BY_CELL, j, named);
            if outcome == INSERTED {
                append_pair(f, j);
            }
            full = full || outcome == FULL;
        }
        k += 1u;
        if k >= count {
            break;
        }
    }
    if full {
        atomicAdd(&state.cells_overflow, 1u);
        append_failure(f, i, 0u);
    }
    return Piece(true, i, piece_sums(facet));
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(local_invocation_index) lane: u32) {
    let index = state.begin + id.x;
    var piece = Piece();
    if index < state.end {
        piece = process(index);
    }
#if SHARED
    add_shared(lane, piece.exists, piece.seed, piece.sums);
#end
#if 1 - SHARED
    if piece.exists && params.accumulate != NOWHERE {
        add_direct(piece.seed, piece.sums);
    }
#end
}
