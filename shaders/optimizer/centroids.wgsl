// Moves every seed that is not held to the centroid of its cell. The seed of an empty cell stays. No seed moves if the
// pass is not complete.

#import shared/types
#import shared/state
#import shared/optimizer_params

@group(0) @binding(0) var<uniform> params: OptimizerParams;
@group(0) @binding(1) var<storage, read> sums: array<u32>;
@group(0) @binding(2) var<storage, read> held: array<u32>;
@group(0) @binding(3) var<storage, read_write> points: array<Seed>;
@group(0) @binding(4) var<storage, read_write> state: State;

#import shared/moved
#import shared/from_fixed

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let i = id.x + id.y * groups.x * 64u;
    if i >= params.seeds || held[i] != 0u || atomicLoad(&state.halt) != 0u {
        return;
    }
    // With uniform weights mass is area.
    let mass = from_fixed(limbs(i, select(0u, AREA, params.uniform_weights != 0u)));
    if mass > 0.0 {
        points[i] = moved(points[i], over(moment_of(i), mass * params.moment_per_mass));
    }
}
