// Each change of the gradient (the workgroup's y), divided by the masses of cells, times every change and the
// gradient: what the first guess of the two-loop recursion needs. Behind those of `products`.

#import shared/motion

@group(0) @binding(0) var<uniform> motion: Motion;
@group(0) @binding(1) var<storage, read> sums: array<u32>;
@group(0) @binding(2) var<storage, read> changes: array<f32>;
@group(0) @binding(3) var<storage, read> gradient: array<f32>;
@group(0) @binding(4) var<storage, read_write> partials: array<f32>;

#import shared/dot
#import shared/ease

const FIRST: u32 = 51u;

fn change(slot: u32, e: u32, length: u32) -> f32 {
    // A slot that is not in use holds no numbers.
    if ((motion.used >> slot) & 1u) == 0u {
        return 0.0;
    }
    return changes[slot * length + e];
}

@compute @workgroup_size(64)
fn main(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let which = group.y;
    let length = 3u * motion.seeds;
    var own = array<vec3f, 3>(vec3f(0.0), vec3f(0.0), vec3f(0.0));
    for (var e = id.x; e < length; e += motion.groups * 64u) {
        let v = change(which, e, length) * ease(e / 3u);
        for (var k = 0u; k < 3u; k += 1u) {
            var last = gradient[e];
            if k < 2u {
                last = change(3u * k + 2u, e, length);
            }
            own[k] += v * vec3f(change(3u * k, e, length), change(3u * k + 1u, e, length), last);
        }
    }
    for (var k = 0u; k < 3u; k += 1u) {
        let sum = add_lanes(lane, own[k]);
        if lane == 0u {
            for (var c = 0u; c < 3u; c += 1u) {
                partials[(FIRST + which * 9u + 3u * k + c) * motion.groups + group.x] = sum[c];
            }
        }
        // The lanes' parts of the next sum go where this one is read from.
        workgroupBarrier();
    }
}
