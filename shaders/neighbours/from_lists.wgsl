// Neighbours from the Verlet list of an earlier pass: the same rows that `search` finds. A seed that is not in a list was
// no nearer than the list's reach when the list was made. It has come nearer by no more than both seeds have moved. A bound
// on that is the largest drift of all seeds, or of the seeds in the cells of the grid around. Where neither proves the
// row, `search` makes it.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> sorted: array<Sorted>;
@group(0) @binding(3) var<storage, read_write> table: array<u32>;
@group(0) @binding(4) var<storage, read> list_origins: array<vec4f>;
@group(0) @binding(5) var<storage, read> lists: array<u32>;
@group(0) @binding(6) var<storage, read_write> list_state: ListState;
@group(0) @binding(7) var<storage, read_write> state: State;
@group(0) @binding(8) var<storage, read> drifts: array<u32>;

#import shared/distance
#import shared/list_state
#import shared/place
#import shared/rings
#import shared/sorted

const STRIDE: u32 = $(ROW + 1)u;
// More than rounding changes in what two seeds have moved, where they are and what was known.
const ROUNDED: f32 = 8e-6;

#repeat T in 0..LIST
var<private> key_$T: f32;
var<private> seed_$T: u32;
#end

// Batcher's merge exchange (Knuth, The Art of Computer Programming 3, 5.2.2, Algorithm M): the same comparisons
// whatever the keys, so that no lane waits for another.
fn sort() {
#repeat P in 1..LIST
#if LIST % P < 1
#repeat Q in 0..P
#if P % (P - Q) < 1
#repeat A in 0..LIST - P + Q
#if (1 - (A < (P - Q) % P)) * ((A - (P - Q) % P) % (2 * (P - Q)) < P - Q) * (A % (2 * P) < P + Q)
    {
        let swap = before(key_$(A + P - Q), seed_$(A + P - Q), key_$A, seed_$A);
        let key = key_$A;
        let seed = seed_$A;
        key_$A = select(key, key_$(A + P - Q), swap);
        seed_$A = select(seed, seed_$(A + P - Q), swap);
        key_$(A + P - Q) = select(key_$(A + P - Q), key, swap);
        seed_$(A + P - Q) = select(seed_$(A + P - Q), seed, swap);
    }
#end
#end
#end
#end
#end
#end
}

// How far any seed is from where it was noted that is in the cells around `place`.
fn drift_around(place: vec3i) -> f32 {
    let last = vec3i(i32(params.side) - 1);
    let low = max(place - 1, vec3i(0));
    let high = min(place + 1, last);
    var most = 0u;
    for (var z = low.z; z <= high.z; z += 1) {
        for (var y = low.y; y <= high.y; y += 1) {
            let row = row_of(y, z);
            // At the wall a cell is read twice, so that no lane has fewer.
            most = max(most, drifts[row + u32(low.x)]);
            most = max(most, drifts[row + u32(place.x)]);
            most = max(most, drifts[row + u32(high.x)]);
        }
    }
    return bitcast<f32>(most);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let index = params.part_first + id.x;
    if index >= params.seeds || atomicLoad(&state.halt) != 0u {
        return;
    }
    let own = sorted[index];
    let begin = own.seed * $(LIST)u;
#repeat T in 0..LIST
    seed_$T = lists[begin + $(T)u];
    key_$T = FREE;
    if seed_$T != NONE {
        key_$T = squared((seeds[seed_$T].hi - own.hi) + (seeds[seed_$T].lo - own.lo));
    }
#end
    sort();
    let noted = list_origins[own.seed];
    let p = own.hi + own.lo;
    let reach = noted.w - length(p - noted.xyz);
    // No farther than what `search` would prove, wherever in its cell the seed is.
    let rings = f32(RINGS) / f32(params.side);
    var proved = max(min(reach - bitcast<f32>(atomicLoad(&list_state.drift)), rings) * 0.99999 - ROUNDED, 0.0);
    if key_$(ROW - 1) >= proved * proved {
        let place = place_of(p);
        let near = min(reach - drift_around(place), covered(p, place, 1));
        proved = max(near * 0.99999 - ROUNDED, 0.0);
    }
    // Later duplicates are in no list.
    if key_$(ROW - 1) < proved * proved && atomicLoad(&state.duplicates) == 0u {
        let row = own.seed * STRIDE + 1u;
        table[row - 1u] = $(ROW)u;
#repeat T in 0..ROW
        table[row + $(T)u] = seed_$T;
#end
        seeds[own.seed].row_begin = row;
        seeds[own.seed].row_length = min($(ROW)u, params.row);
    } else {
        let at = atomicAdd(&list_state.open, 1u);
        atomicStore(&list_state.words[6u * parts() + at], index);
        let part = at / PART;
        atomicMax(&list_state.words[part * 3u], (at - part * PART) / 64u + 1u);
    }
}
