// Puts seeds into their samples: of the label that is there and the new one the nearer stays.

#import distance

// Sample and seed; no sample twice.
@group(0) @binding(2) var<storage, read> planted: array<vec2u>;
// Seed + 1, or 0.
@group(0) @binding(3) var<storage, read_write> labels: array<u32>;

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
    let code = planted[own].x;
    let label = planted[own].y + 1u;
    let place = place_of(code);
    let before = labels[code];
    if before == 0u || squared(label, place) < squared(before, place) {
        labels[code] = label;
    }
}
