// Every seed's nearest seeds, nearest first. Cells of the grid are searched ring by ring, until the last seed of the row is
// nearer than anything outside could be. A row that is not proved that far ends where the proof ends, so that every row is
// the beginning of a longer one. Later duplicates are nobody's neighbours. Their own row is the first duplicate alone.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> cells: array<u32>;
@group(0) @binding(3) var<storage, read> sorted: array<Sorted>;
@group(0) @binding(4) var<storage, read_write> table: array<u32>;
@group(0) @binding(5) var<storage, read_write> state: State;
@group(0) @binding(6) var<storage, read_write> list_origins: array<vec4f>;
@group(0) @binding(7) var<storage, read> list_state: ListStateRead;
#if ROW < WIDTH
@group(0) @binding(8) var<storage, read_write> lists: array<u32>;
#end

#import shared/distance
#import shared/grid
#import shared/list_state
#import shared/rings

// As ListState, for a stage that only reads it.
struct ListStateRead {
    drift: u32,
    fast: u32,
    open: u32,
    made: u32,
    mode: u32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
    words: array<u32>,
}

// Words of a row: how long it is, then the seeds.
const STRIDE: u32 = $(ROW + 1)u;

// The nearest so far, in registers: memory that is indexed by a variable is many times slower.
#repeat T in 0..WIDTH
var<private> key_$T: f32;
var<private> seed_$T: u32;
#end

fn clear_row() {
#repeat T in 0..WIDTH
    key_$T = FREE;
    seed_$T = NONE;
#end
}

// Enters a neighbour that is before the last where it belongs; the last goes.
fn offer(key: f32, seed: u32) {
    var here = true;
#repeat T in 1..WIDTH
    let next_$T = before(key, seed, key_$(WIDTH - T - 1), seed_$(WIDTH - T - 1));
    key_$(WIDTH - T) = select(key_$(WIDTH - T), select(key, key_$(WIDTH - T - 1), next_$T), here);
    seed_$(WIDTH - T) = select(seed_$(WIDTH - T), select(seed, seed_$(WIDTH - T - 1), next_$T), here);
    here = next_$T;
#end
    key_0 = select(key_0, key, here);
    seed_0 = select(seed_0, seed, here);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    var index = params.part_first + id.x;
    let some = list_state.mode == FROM_LISTS;
    if index >= select(params.seeds, list_state.open, some) || atomicLoad(&state.halt) != 0u {
        return;
    }
    if some {
        index = list_state.words[6u * parts() + index];
    }
    let own = sorted[index];
    let row = own.seed * STRIDE + 1u;
    seeds[own.seed].row_begin = row;
    if own.first != own.seed {
        table[row - 1u] = 1u | COMPLETE;
        table[row] = own.first;
        seeds[own.seed].row_length = 1u | COMPLETE;
        return;
    }
    clear_row();
    let p = own.hi + own.lo;
    let place = place_of(p);
    let last = i32(params.side) - 1;
    var others = 0u;
    var radius = 0.0;
    // Loops are left at their ends: a driver on a CPU runs a body once more after the last lane has left at
    // the head.
    var ring = 1;
    loop {
        let width = 2 * ring + 1;
        var line = 0;
        loop {
            let range = parts_of(place, ring, place.y - ring + line % width, place.z - ring + line / width);
            let first = range.y - range.x;
            let count = first + range.w - range.z;
            var k = 0u;
            loop {
                let at = select(range.z + k - first, range.x + k, k < first);
                if k < count && at != index {
                    let key = squared(to_sorted(own, sorted[at]));
                    let other = sorted[at].seed;
                    if sorted[at].first == other {
                        others += 1u;
                        if before(key, other, key_$(WIDTH - 1), seed_$(WIDTH - 1)) {
                            offer(key, other);
                        }
                    }
                }
                k += 1u;
                if k >= count {
                    break;
                }
            }
            line += 1;
            if line >= width * width {
                break;
            }
        }
        radius = covered(p, place, ring);
        ring += 1;
        if ring > RINGS || key_$(ROW - 1) < radius * radius * 0.9999 {
            break;
        }
    }
    let proved = radius * radius * 0.9999;
    var length = 0u;
#repeat T in 0..ROW
    if key_$T < proved && seed_$T != NONE {
        table[row + $(T)u] = seed_$T;
        length = $(T + 1)u;
    }
#end
#if ROW < WIDTH
    // No seed outside the list is nearer, except for later duplicates.
    let reach = select(min(sqrt(key_$(WIDTH - 1)), radius), 0.0, atomicLoad(&state.duplicates) != 0u);
    list_origins[own.seed] = vec4f(p, reach);
#repeat T in 0..WIDTH
    lists[own.seed * $(WIDTH)u + $(T)u] = seed_$T;
#end
#end
#if 1 - (ROW < WIDTH)
    if params.has_lists != 0u && !some {
        list_origins[own.seed] = vec4f(p, min(sqrt(key_$(WIDTH - 1)), radius));
    }
#end
    let everything = radius >= NOWHERE_NEAR * 0.5;
    table[row - 1u] = select(length, length | COMPLETE, everything && others <= $(ROW)u);
    // Of `params.row` entries the stages that take pair by pair know.
    length = min(length, params.row);
    seeds[own.seed].row_length = select(length, length | COMPLETE, everything && others <= params.row);
}
