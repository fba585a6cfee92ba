// Adds the workgroups' parts of dot products up, one product a lane.

#import shared/motion

@group(0) @binding(0) var<uniform> motion: Motion;
@group(0) @binding(1) var<storage, read> partials: array<f32>;
@group(0) @binding(2) var<storage, read_write> dots: array<f32, 51>;

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) lane: u32) {
    if lane >= 51u {
        return;
    }
    var sum = 0.0;
    for (var k = 0u; k < motion.groups; k += 1u) {
        sum += partials[lane * motion.groups + k];
    }
    dots[lane] = sum;
}
