// Each step, each change of the gradient and the gradient itself (the workgroup's y), times the new step,
// the new change and the gradient: all dot products that the two-loop recursion needs.

#import shared/motion

@group(0) @binding(0) var<uniform> motion: Motion;
@group(0) @binding(1) var<storage, read> steps: array<f32>;
@group(0) @binding(2) var<storage, read> changes: array<f32>;
@group(0) @binding(3) var<storage, read> gradient: array<f32>;
@group(0) @binding(4) var<storage, read_write> partials: array<f32>;

#import shared/dot

@compute @workgroup_size(64)
fn main(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let which = group.y;
    let length = 3u * motion.seeds;
    let slot = length * motion.slot;
    var own = vec3f(0.0);
    for (var e = id.x; e < length; e += motion.groups * 64u) {
        var v = gradient[e];
        if which < PAIRS {
            v = steps[which * length + e];
        } else if which < 2u * PAIRS {
            v = changes[(which - PAIRS) * length + e];
        }
        own += v * vec3f(steps[slot + e], changes[slot + e], gradient[e]);
    }
    let sum = add_lanes(lane, own);
    if lane == 0u {
        for (var k = 0u; k < 3u; k += 1u) {
            partials[(which * 3u + k) * motion.groups + group.x] = sum[k];
        }
    }
}
