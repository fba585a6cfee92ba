// The trial point: seeds at x + step d. x stays.

#import shared/types
#import shared/optimizer_params

@group(0) @binding(0) var<uniform> params: OptimizerParams;
@group(0) @binding(1) var<storage, read> points: array<Seed>;
@group(0) @binding(2) var<storage, read> direction: array<f32>;
@group(0) @binding(3) var<storage, read_write> seeds: array<Seed>;

#import shared/direction_of
#import shared/moved

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let i = id.x + id.y * groups.x * 64u;
    if i >= params.seeds {
        return;
    }
    seeds[i] = moved(points[i], scaled(direction_of(i), params.step));
}
