// Adds the workgroups' parts of dot products up, each product in one lane.

#import shared/optimizer_params

@group(0) @binding(0) var<uniform> params: OptimizerParams;
@group(0) @binding(1) var<storage, read> partials: array<f32>;
@group(0) @binding(2) var<storage, read_write> dots: array<f32, $DOTS>;

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) lane: u32) {
    for (var d = lane; d < $(DOTS)u; d += 64u) {
        var sum = 0.0;
        for (var k = 0u; k < params.groups; k += 1u) {
            sum += partials[d * params.groups + k];
        }
        dots[d] = sum;
    }
}
