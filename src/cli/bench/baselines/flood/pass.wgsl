// One pass of the flood: each voxel hears of the seeds of itself and its 26 neighbours at a distance.

struct Params { n: u32, step: u32, items: u32 }

@group(0) @binding(0) var<storage, read> params: Params;
// Units of a voxel.
@group(0) @binding(1) var<storage, read> seeds: array<vec4f>;
// Seed + 1, or 0.
@group(0) @binding(2) var<storage, read> labels: array<u32>;
@group(0) @binding(3) var<storage, read_write> next: array<u32>;

fn squared(label: u32, place: vec3f) -> f32 {
    let d = seeds[label - 1u].xyz - place;
    return dot(d, d);
}

// The first of the places a - step, a, a + step that is in the grid.
fn first(a: i32, step: i32) -> i32 {
    return select(a - step, a, a < step);
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
    let n = i32(params.n);
    let step = i32(params.step);
    let at = vec3i(vec3u(own % params.n, own / params.n % params.n, own / params.n / params.n));
    let last = min(at + step, vec3i(n - 1));
    let place = vec3f(at) + 0.5;
    var best = labels[own];
    var nearest = 3.0e38;
    if best != 0u {
        nearest = squared(best, place);
    }
    for (var z = first(at.z, step); z <= last.z; z += step) {
        for (var y = first(at.y, step); y <= last.y; y += step) {
            for (var x = first(at.x, step); x <= last.x; x += step) {
                let label = labels[x + n * (y + n * z)];
                // Most voxels hear of one seed alone.
                if label == best || label == 0u {
                    continue;
                }
                let found = squared(label, place);
                if found < nearest || (found == nearest && label < best) {
                    best = label;
                    nearest = found;
                }
            }
        }
    }
    next[own] = best;
}
