// The trial point becomes the present one: its step and its change of the gradient go into the history.

#import shared/types
#import shared/optimizer_params

@group(0) @binding(0) var<uniform> params: OptimizerParams;
@group(0) @binding(1) var<storage, read> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> points: array<Seed>;
@group(0) @binding(3) var<storage, read> ahead: array<f32>;
@group(0) @binding(4) var<storage, read_write> gradient: array<f32>;
@group(0) @binding(5) var<storage, read_write> steps: array<f32>;
@group(0) @binding(6) var<storage, read_write> changes: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let i = id.x + id.y * groups.x * 64u;
    if i >= params.seeds {
        return;
    }
    let s = to_seed(points[i], seeds[i]);
    let first = COORDINATES * params.seeds * params.slot + COORDINATES * i;
    for (var k = 0u; k < COORDINATES; k += 1u) {
        let g = ahead[COORDINATES * i + k];
        steps[first + k] = coordinate(s, k);
        changes[first + k] = g - gradient[COORDINATES * i + k];
        gradient[COORDINATES * i + k] = g;
    }
}
