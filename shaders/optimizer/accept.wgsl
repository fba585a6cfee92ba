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
    let s = (seeds[i].hi - points[i].hi) + (seeds[i].lo - points[i].lo);
    let first = 3u * params.seeds * params.slot + 3u * i;
    for (var k = 0u; k < 3u; k += 1u) {
        let g = ahead[3u * i + k];
        steps[first + k] = s[k];
        changes[first + k] = g - gradient[3u * i + k];
        gradient[3u * i + k] = g;
    }
}
