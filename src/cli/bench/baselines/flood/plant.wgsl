// Puts seeds into their voxels: of the label that is there and the new one the nearer stays.

struct Params { n: u32, step: u32, items: u32 }

@group(0) @binding(0) var<storage, read> params: Params;
// Units of a voxel.
@group(0) @binding(1) var<storage, read> seeds: array<vec4f>;
// Voxel and seed; no voxel twice.
@group(0) @binding(2) var<storage, read> planted: array<vec2u>;
// Seed + 1, or 0.
@group(0) @binding(3) var<storage, read_write> labels: array<u32>;

fn squared(label: u32, place: vec3f) -> f32 {
    let d = seeds[label - 1u].xyz - place;
    return dot(d, d);
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
    let code = planted[own].x;
    let label = planted[own].y + 1u;
    let place = vec3f(vec3u(code % n, code / n % n, code / n / n)) + 0.5;
    let before = labels[code];
    if before == 0u || squared(label, place) < squared(before, place) {
        labels[code] = label;
    }
}
