// Each workgroup's part of the dot products that the two-loop recursion needs: of all steps, all changes of the gradient and
// the gradient with the new step, the new change and the gradient; and of all changes, divided by the masses of cells, with
// all changes and the gradient, for its first guess. Every vector is read once, the new pair twice.

#import shared/optimizer_params

@group(0) @binding(0) var<uniform> params: OptimizerParams;
@group(0) @binding(1) var<storage, read> sums: array<u32>;
@group(0) @binding(2) var<storage, read> steps: array<f32>;
@group(0) @binding(3) var<storage, read> changes: array<f32>;
@group(0) @binding(4) var<storage, read> gradient: array<f32>;
@group(0) @binding(5) var<storage, read_write> partials: array<f32>;

#import shared/precondition

// Products that the workgroup adds up together; odd, so that neither way through them is along one bank of its memory.
const TOGETHER: u32 = 45u;

var<workgroup> parts: array<f32, $(64 * 45)>;

// Adds the first `count` of each lane's parts up, one product in a lane. All lanes call this together.
fn add_lanes(lane: u32, group: u32, first: u32, count: u32) {
    workgroupBarrier();
    if lane < count {
        var sum = 0.0;
        for (var k = 0u; k < 64u; k += 1u) {
            sum += parts[k * TOGETHER + lane];
        }
        partials[(first + lane) * params.groups + group] = sum;
    }
    // What is read here is written next.
    workgroupBarrier();
}

@compute @workgroup_size(64)
fn main(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let length = COORDINATES * params.seeds;
    let newest = length * params.slot;
    var gradients = vec3f(0.0);
#repeat K in 0..PAIRS
    // A slot that is not in use holds no numbers.
    let used_$K = ((params.used >> $(K)u) & 1u) != 0u;
    var step_$K = vec3f(0.0);
    var change_$K = vec3f(0.0);
#repeat J in K..PAIRS + 1
    var preconditioned_$(K)_$J = 0.0;
#end
#end
    for (var i = id.x; i < params.seeds; i += params.groups * 64u) {
        let light = preconditioner(i);
        for (var e = COORDINATES * i; e < COORDINATES * (i + 1u); e += 1u) {
            let g = gradient[e];
            let last = vec3f(steps[newest + e], changes[newest + e], g);
            gradients += g * last;
#repeat K in 0..PAIRS
            step_$K += select(0.0, steps[$(K)u * length + e], used_$K) * last;
            let y_$K = select(0.0, changes[$(K)u * length + e], used_$K);
            change_$K += y_$K * last;
#end
            let y_$(PAIRS) = g;
#repeat K in 0..PAIRS
            let light_$K = light * y_$K;
#repeat J in K..PAIRS + 1
            preconditioned_$(K)_$J += light_$K * y_$J;
#end
#end
        }
    }
    let own = lane * TOGETHER;
#repeat C in 0..3
#repeat K in 0..PAIRS
    parts[own + $(3 * K + C)u] = step_$K[$C];
#end
#end
    add_lanes(lane, group.x, 0u, $(3 * PAIRS)u);
#repeat C in 0..3
#repeat K in 0..PAIRS
    parts[own + $(3 * K + C)u] = change_$K[$C];
#end
    parts[own + $(3 * PAIRS + C)u] = gradients[$C];
#end
    add_lanes(lane, group.x, $(3 * PAIRS)u, $(3 * PAIRS + 3)u);
    var at = own;
#repeat K in 0..PAIRS
#repeat J in K..PAIRS + 1
    parts[at] = preconditioned_$(K)_$J;
    at += 1u;
#end
#end
    add_lanes(lane, group.x, $(6 * PAIRS + 3)u, at - own);
}
