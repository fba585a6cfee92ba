// The search direction and its slope. The direction is a combination of steps, and of changes of the gradient and the
// gradient, both divided by masses. The slope is the first dot product.

#import shared/optimizer_params

@group(0) @binding(0) var<uniform> params: OptimizerParams;
@group(0) @binding(1) var<storage, read> steps: array<f32>;
@group(0) @binding(2) var<storage, read> changes: array<f32>;
@group(0) @binding(3) var<storage, read> gradient: array<f32>;
@group(0) @binding(4) var<storage, read_write> direction: array<f32>;
@group(0) @binding(5) var<storage, read_write> partials: array<f32>;
@group(0) @binding(6) var<storage, read> sums: array<u32>;

#import shared/add_lanes
#import shared/precondition

@compute @workgroup_size(64)
fn main(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let length = COORDINATES * params.seeds;
#repeat K in 0..PAIRS
    let step_$K = params.coefficients[$(K)u / 4u][$(K)u % 4u];
    let change_$K = params.coefficients[2u + $(K)u / 4u][$(K)u % 4u];
#end
    var own = 0.0;
    for (var i = id.x; i < params.seeds; i += params.groups * 64u) {
        let light = preconditioner(i);
        for (var e = COORDINATES * i; e < COORDINATES * (i + 1u); e += 1u) {
            let g = gradient[e];
            var d = params.coefficients[4].x * g;
            var steps_part = 0.0;
            // A slot that is not in use holds no numbers.
#repeat K in 0..PAIRS
            steps_part += step_$K * select(0.0, steps[$(K)u * length + e], step_$K != 0.0);
            d += change_$K * select(0.0, changes[$(K)u * length + e], change_$K != 0.0);
#end
            d = d * light + steps_part;
            direction[e] = d;
            own += g * d;
        }
    }
    let sum = add_lanes(lane, own);
    if lane == 0u {
        partials[group.x] = sum;
    }
}
