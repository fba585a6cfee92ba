// The direction as a combination of steps, and of changes and the gradient divided by masses, and its slope: the first
// dot product.

#import shared/motion

@group(0) @binding(0) var<uniform> motion: Motion;
@group(0) @binding(1) var<storage, read> steps: array<f32>;
@group(0) @binding(2) var<storage, read> changes: array<f32>;
@group(0) @binding(3) var<storage, read> gradient: array<f32>;
@group(0) @binding(4) var<storage, read_write> direction: array<f32>;
@group(0) @binding(5) var<storage, read_write> partials: array<f32>;
@group(0) @binding(6) var<storage, read> sums: array<u32>;

#import shared/dot
#import shared/ease

@compute @workgroup_size(64)
fn main(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let length = 3u * motion.seeds;
    var own = 0.0;
    for (var e = id.x; e < length; e += motion.groups * 64u) {
        let g = gradient[e];
        var d = motion.coefficients[4].x * g;
        var steps_part = 0.0;
        for (var k = 0u; k < PAIRS; k += 1u) {
            let s = motion.coefficients[k / 4u][k % 4u];
            let y = motion.coefficients[2u + k / 4u][k % 4u];
            // A slot that is not in use holds no numbers.
            if s != 0.0 {
                steps_part += s * steps[k * length + e];
            }
            if y != 0.0 {
                d += y * changes[k * length + e];
            }
        }
        d = d * ease(e / 3u) + steps_part;
        direction[e] = d;
        own += g * d;
    }
    let sum = add_lanes(lane, vec3f(own));
    if lane == 0u {
        partials[group.x] = sum.x;
    }
}
