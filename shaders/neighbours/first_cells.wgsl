// The nearest seed of every facet's centroid, where the walk over the facet's cells begins. The search starts from the last
// answer and goes through rows, or it goes through the grid. It is proved: a seed nearer to q than x_i lies within
// 2 |q - x_i| of x_i. The answer is the least in the order of neighbours, wherever the search started. A wrong one would
// lose the facet's other cells without notice, so one that is not proved is NONE and counted.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> facets: array<Facet>;
@group(0) @binding(3) var<storage, read> table: array<u32>;
@group(0) @binding(4) var<storage, read> cells: array<u32>;
@group(0) @binding(5) var<storage, read> sorted: array<Sorted>;
@group(0) @binding(6) var<storage, read_write> candidates: array<vec2u>;
@group(0) @binding(7) var<storage, read_write> state: State;

#import shared/distance
#import shared/grid

const STEPS: u32 = 64u;
const RINGS: i32 = 8;

// The centroid, in two parts as a seed.
var<private> q: Seed;

// From seed `guess` to nearer and nearer ones.
fn walk(guess: u32) -> u32 {
    var i = guess;
    var best = squared(to_seed(q, seeds[i]));
    var step = 0u;
    // Loops are left at their ends, as in `search`.
    loop {
        let seed = seeds[i];
        let end = seed.row_begin + (seed.row_length & INDEX);
        var next = i;
        var proved = (seed.row_length & COMPLETE) != 0u;
        var at = seed.row_begin;
        if at == end {
            return select(NONE, i, proved);
        }
        loop {
            let j = table[at];
            let other = seeds[j];
            if squared(to_seed(seed, other)) > 4.0004 * best {
                proved = true;
                break;
            }
            let key = squared(to_seed(q, other));
            if before(key, j, best, i) {
                next = j;
                best = key;
                break;
            }
            at += 1u;
            if at >= end {
                break;
            }
        }
        step += 1u;
        if next == i {
            return select(NONE, i, proved);
        }
        i = next;
        if step == STEPS {
            break;
        }
    }
    return NONE;
}

// Through the grid.
fn search_grid() -> u32 {
    let p = q.hi + q.lo;
    let place = place_of(p);
    let last = i32(params.side) - 1;
    var best = NOWHERE_NEAR;
    var found = NONE;
    for (var ring = 1; ring <= RINGS; ring += 1) {
        for (var z = max(place.z - ring, 0); z <= min(place.z + ring, last); z += 1) {
            for (var y = max(place.y - ring, 0); y <= min(place.y + ring, last); y += 1) {
                let range = parts_of(place, ring, y, z);
                let first = range.y - range.x;
                for (var k = 0u; k < first + range.w - range.z; k += 1u) {
                    let at = select(range.z + k - first, range.x + k, k < first);
                    let key = squared(seed_to_sorted(q, sorted[at]));
                    if before(key, sorted[at].seed, best, found) {
                        best = key;
                        found = sorted[at].seed;
                    }
                }
            }
        }
        let radius = covered(p, place, ring);
        if best < radius * radius * 0.9999 {
            return found;
        }
    }
    return NONE;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let index = params.part_first + id.x + id.y * groups.x * 64u;
    if index >= params.roots || atomicLoad(&state.halt) != 0u {
        return;
    }
    let f = candidates[index].x - params.facet_first;
    let u = (facets[f].corner1_u + facets[f].corner2_u) * (1.0 / 3.0);
    let v = facets[f].corner2_v * (1.0 / 3.0);
    let s = facets[f].lo + (u * facets[f].e1 + v * facets[f].e2);
    let whole = round(s * 4096.0) / 4096.0;
    q.hi = facets[f].hi + whole;
    q.lo = s - whole;
#if LIFTED
    let lift = facets[f].lift_lo + (u * facets[f].lift_e1 + v * facets[f].lift_e2);
    let whole_lift = round(lift * 4096.0) / 4096.0;
    q.lift_hi = facets[f].lift_hi + whole_lift;
    q.lift_lo = lift - whole_lift;
#end
    var found = NONE;
    let guess = candidates[index].y;
    if guess < params.seeds {
        found = walk(guess);
    }
    if found == NONE {
        found = search_grid();
    }
    if found == NONE {
        atomicAdd(&state.unproved, 1u);
    }
    candidates[index].y = found;
}
