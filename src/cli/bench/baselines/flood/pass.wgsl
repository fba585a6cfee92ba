// One pass of the flood: each sample hears of the seeds of itself and its neighbours at a distance, 26 or, in one layer, 8.

#import distance

// Seed + 1, or 0.
@group(0) @binding(2) var<storage, read> labels: array<u32>;
@group(0) @binding(3) var<storage, read_write> next: array<u32>;

// The first of a - step, a, a + step that is in the grid.
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
    let size = vec3i(params.size);
    let step = i32(params.step);
    let at = vec3i(at_of(own));
    let last = min(at + step, size - 1);
    let place = place_of(own);
    var best = labels[own];
    var nearest = 3.0e38;
    if best != 0u {
        nearest = squared(best, place);
    }
    for (var z = first(at.z, step); z <= last.z; z += step) {
        for (var y = first(at.y, step); y <= last.y; y += step) {
            for (var x = first(at.x, step); x <= last.x; x += step) {
                let label = labels[x + size.x * (y + size.y * z)];
                // Most samples hear of one seed alone.
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
