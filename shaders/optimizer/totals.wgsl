// Adds the workgroups' partial totals up.

#import shared/optimizer_params

@group(0) @binding(0) var<uniform> params: OptimizerParams;
@group(0) @binding(1) var<storage, read> partial_totals: array<Totals>;
@group(0) @binding(2) var<storage, read_write> totals: Totals;

#import shared/reduce

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) lane: u32) {
    var own = Totals();
    for (var k = lane; k < params.groups; k += 64u) {
        own = add_totals(own, partial_totals[k]);
    }
    reduce(lane, own);
    if lane == 0u {
        totals = part[0];
    }
}
