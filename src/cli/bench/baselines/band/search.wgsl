// The nearest seed of each voxel's centre: in rings of cells about it, until no seed beyond them can be as near. NONE if it takes
// too many rings.

struct Params {
    // Voxels and cells along a side of the grid.
    n: u32,
    side: u32,
    items: u32,
}

struct Sorted {
    // Units of a voxel.
    place: vec3f,
    seed: u32,
}

@group(0) @binding(0) var<storage, read> params: Params;
@group(0) @binding(1) var<storage, read> codes: array<u32>;
// Where each cell begins among the seeds. Cells of a row along x are side by side.
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> seeds: array<Sorted>;
@group(0) @binding(4) var<storage, read_write> labels: array<u32>;

const NONE: u32 = 0xffffffffu;
// The last ring. A software adapter ends all loops of an invocation after 65,535 turns, and 20 rings take about so many.
const RINGS: i32 = 16;
// Farther than any seed of a cell with an end, and its square is a number.
const ENDLESS: f32 = 1e18;

// The voxel's centre, and the best seed for it so far.
var<private> place: vec3f;
var<private> best: u32;
var<private> nearest: f32;

// Looks at the seeds of cells `low` to `high` of one row.
fn look(low: i32, high: i32) {
    for (var k = starts[low]; k < starts[high + 1]; k += 1u) {
        let other = seeds[k];
        let d = other.place - place;
        let found = dot(d, d);
        if found < nearest || (found == nearest && other.seed < best) {
            best = other.seed;
            nearest = found;
        }
    }
}

// Every seed that is not within `ring` cells of `home` is at least so far from the centre. The outermost cells go on
// without end. What is taken off is more than the rounding of a place.
fn covered(home: vec3i, ring: i32) -> f32 {
    let width = f32(params.n) / f32(params.side);
    let last = vec3i(i32(params.side) - 1);
    let below = place - width * vec3f(home - ring);
    let above = width * (vec3f(home + ring) + 1.0) - place;
    let endless = vec3f(ENDLESS);
    let free = min(
        select(below, endless, home - ring <= vec3i(0)),
        select(above, endless, home + ring >= last),
    );
    return max(min(free.x, min(free.y, free.z)) - 1e-6 * f32(params.n), 0.0);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let own = (group.y * groups.x + group.x) * 64u + lane;
    if own >= params.items {
        return;
    }
    let n = params.n;
    let code = codes[own];
    place = vec3f(vec3u(code % n, code / n % n, code / n / n)) + 0.5;
    best = NONE;
    nearest = 3.0e38;
    let side = i32(params.side);
    let last = side - 1;
    let home = min(vec3i(place * (f32(side) / f32(n))), vec3i(last));
    var label = NONE;
    for (var ring = 0; ring <= min(last, RINGS); ring += 1) {
        let low = max(home - ring, vec3i(0));
        let high = min(home + ring, vec3i(last));
        for (var z = low.z; z <= high.z; z += 1) {
            for (var y = low.y; y <= high.y; y += 1) {
                let row = side * (y + side * z);
                if abs(z - home.z) == ring || abs(y - home.y) == ring {
                    look(row + low.x, row + high.x);
                    continue;
                }
                // Between its two ends this row was in the ring before.
                if home.x - ring >= 0 {
                    look(row + home.x - ring, row + home.x - ring);
                }
                if home.x + ring <= last {
                    look(row + home.x + ring, row + home.x + ring);
                }
            }
        }
        let free = covered(home, ring);
        if nearest < free * free {
            label = best;
            break;
        }
    }
    labels[own] = label;
}
