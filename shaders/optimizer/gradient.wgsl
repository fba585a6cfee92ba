// The gradient of every seed from its cell's sums: -2 times the moment about the seed. And each workgroup's part of the
// totals.

#import shared/optimizer_params

@group(0) @binding(0) var<uniform> params: OptimizerParams;
@group(0) @binding(1) var<storage, read> sums: array<u32>;
@group(0) @binding(2) var<storage, read> held: array<u32>;
@group(0) @binding(3) var<storage, read> direction: array<f32>;
@group(0) @binding(4) var<storage, read_write> gradient: array<f32>;
@group(0) @binding(5) var<storage, read_write> partial_totals: array<Totals>;

#import shared/direction_of
#import shared/from_fixed
#import shared/reduce

@compute @workgroup_size(64)
fn main(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    var own = Totals();
    for (var i = id.x; i < params.seeds; i += params.groups * 64u) {
        var g: Point;
        if held[i] == 0u {
            g = scaled(moment_of(i), params.gradient_unit);
        }
#repeat C in 0..3 + 3 * LIFTED
        gradient[COORDINATES * i + $(C)u] = coordinate(g, $(C)u);
#end
        var slope = 0.0;
        if params.directed != 0u {
            slope = inner(g, direction_of(i));
        }
        let energy = limbs(i, ENERGY);
        let area = limbs(i, AREA);
        // Nothing, or less by a rounding.
        let empty = (area.y & 0x80000000u) != 0u || (area.x | area.y) == 0u;
        own = add_totals(own, Totals(energy.x, energy.y, area.x, area.y, select(0u, 1u, empty), inner(g, g), slope, 0u));
    }
    reduce(lane, own);
    if lane == 0u {
        partial_totals[group.x] = part[0];
    }
}
