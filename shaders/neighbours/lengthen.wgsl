// Longer rows for the seeds of pairs that needed more neighbours. These pairs go to the end of the list. Where seeds are
// dense, a cell may have more of them within its security radius than a row holds. A workgroup makes a row from as many
// rings of cells as it takes, and puts it behind the others; it begins as the shorter one did. The host does a pair that
// finds the longer row too short as well, and all pairs where they are many.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> cells: array<u32>;
@group(0) @binding(3) var<storage, read> sorted: array<Sorted>;
@group(0) @binding(4) var<storage, read_write> table: array<u32>;
@group(0) @binding(5) var<storage, read_write> list: array<vec2u>;
// Two words each.
@group(0) @binding(6) var<storage, read_write> failures: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> state: State;

#import shared/append_pair
#import shared/distance
#import shared/failure
#import shared/requeue
#import shared/grid
#import shared/rings

// Words of a row as the search writes it.
const STRIDE: u32 = $(ROW + 1)u;
// Entries of a longer row at most.
const LONGER: u32 = $(LONGER)u;
// Entries that will do.
const ENOUGH: u32 = $(LONGER)u / 4u * 3u;
// Halvings in search of the distance within which there are as many seeds as a longer row holds: of the bits of its
// square, which are ordered as it is, since it may be of any magnitude.
const HALVINGS: u32 = 30u;
// Lines of cells that are looked through at the same time, and lanes for each: most hold a dozen seeds.
const LINES: i32 = 16;
const LINE_LANES: u32 = 4u;

var<workgroup> word: u32;
var<workgroup> counter: atomic<u32>;
var<workgroup> total: u32;
var<workgroup> keys: array<f32, $(LONGER)>;
var<workgroup> names: array<u32, $(LONGER)>;

// The seed whose row is made, and its cell of the grid.
var<private> own: Seed;
var<private> name: u32;
var<private> place: vec3i;

// The sum of what the lanes bring. All of them call this together.
fn all_of(lane: u32, count: u32) -> u32 {
    workgroupBarrier();
    if lane == 0u {
        atomicStore(&counter, 0u);
    }
    workgroupBarrier();
    atomicAdd(&counter, count);
    workgroupBarrier();
    if lane == 0u {
        total = atomicLoad(&counter);
    }
    return workgroupUniformLoad(&total);
}

// What lane 0 brings, to all.
fn of_first(lane: u32, value: u32) -> u32 {
    workgroupBarrier();
    if lane == 0u {
        word = value;
    }
    return workgroupUniformLoad(&word);
}

// This lane's share of the seeds nearer than the root of `limit` in the cells at most `ring` away: how many, and, if they
// are wanted, which.
fn nearer(lane: u32, ring: i32, limit: f32, wanted: bool) -> u32 {
    var count = 0u;
    let width = 2 * ring + 1;
    for (var line = i32(lane / LINE_LANES); line < width * width; line += LINES) {
        let range = row_around(place, ring, place.y - ring + line % width, place.z - ring + line / width);
        for (var at = range.x + lane % LINE_LANES; at < range.y; at += LINE_LANES) {
            let other = sorted[at].seed;
            let key = squared(seed_to_sorted(own, sorted[at]));
            // Later duplicates are nobody's neighbours.
            if key < limit && other != name && sorted[at].first == other {
                count += 1u;
                if wanted {
                    let entry = atomicAdd(&counter, 1u);
                    keys[entry] = key;
                    names[entry] = other;
                }
            }
        }
    }
    return count;
}

// Whether seed `name` has a longer row now.
fn make_row(lane: u32) -> bool {
    own = seeds[name];
    let p = own.hi + own.lo;
    place = place_of(p);
    var ring = 0;
    var limit = 0.0;
    var count = 0u;
    var everything = false;
    loop {
        ring += 1;
        let radius = covered(p, place, ring);
        limit = radius * radius * 0.9999;
        everything = radius >= NOWHERE_NEAR * 0.5;
        count = all_of(lane, nearer(lane, ring, limit, false));
        if count >= LONGER || everything || ring >= RINGS {
            break;
        }
    }
    let known = of_first(lane, own.row_length & INDEX);
    // A row may end anywhere, but it is to be longer than it was. Most of what it may be is long enough.
    if count > LONGER {
        everything = false;
        var few = 0.0;
        if known != 0u {
            few = squared(to_seed(own, seeds[table[own.row_begin + known - 1u]]));
        }
        for (var k = 0u; k < HALVINGS && (count > LONGER || count < ENOUGH); k += 1u) {
            let middle = bitcast<f32>((bitcast<u32>(few) + bitcast<u32>(limit)) / 2u);
            count = all_of(lane, nearer(lane, ring, middle, false));
            if count > LONGER {
                limit = middle;
            } else {
                few = middle;
            }
        }
        if count > LONGER || count < ENOUGH {
            count = all_of(lane, nearer(lane, ring, few, false));
        }
        limit = few;
    }
    if count <= known {
        return false;
    }
    if lane == 0u {
        word = atomicAdd(&state.longer, count);
    }
    let begin = params.seeds * STRIDE + workgroupUniformLoad(&word);
    if begin + count > arrayLength(&table) {
        return false;
    }
    if lane == 0u {
        atomicStore(&counter, 0u);
    }
    workgroupBarrier();
    _ = nearer(lane, ring, limit, true);
    workgroupBarrier();
    for (var k = lane; k < count; k += 64u) {
        var rank = 0u;
        for (var other = 0u; other < count; other += 1u) {
            rank += select(0u, 1u, before(keys[other], names[other], keys[k], names[k]));
        }
        table[begin + rank] = names[k];
    }
    if lane == 0u {
        seeds[name].row_begin = begin;
        seeds[name].row_length = select(count, count | COMPLETE, everything);
    }
    return true;
}

fn look_at(entry: u32, lane: u32) {
    let open = is_open(entry) && code_of(entry) == NEIGHBOURS;
    if of_first(lane, select(0u, 1u, open)) == 0u {
        return;
    }
    name = of_first(lane, seed_of(entry));
    // The first of a seed's pairs makes its row, the others wait for that. If it was made before, this pair has seen it.
    var siblings = 0u;
    var seen = 0u;
    for (var k = lane; k < entry; k += 64u) {
        if seed_of(k) == name && code_of(k) == NEIGHBOURS {
            siblings += 1u;
            let first = atomicLoad(&failures[2u * k]);
            seen += select(0u, 1u, (first & REQUEUED) != 0u && (first & FAILED) < state.rounds);
        }
    }
    if all_of(lane, seen) != 0u {
        return;
    }
    if all_of(lane, siblings) == 0u {
        if !make_row(lane) {
            return;
        }
    }
    if lane == 0u {
        requeue(entry);
    }
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let found = of_first(lane, atomicLoad(&state.failures));
    let halted = of_first(lane, atomicLoad(&state.halt));
    if found > min(MOST, params.list_capacity) || halted != 0u {
        return;
    }
    for (var entry = group.x; entry < found; entry += groups.x) {
        look_at(entry, lane);
    }
}
