// Whether a pass left nothing for the host to do, so that a step may follow it at once. If it did, all that comes after it
// in this submission does nothing, and the host sees which pass it was.

#import shared/types
#import shared/state
#import shared/optimizer_params

@group(0) @binding(0) var<uniform> params: OptimizerParams;
@group(0) @binding(1) var<storage, read> totals: Totals;
@group(0) @binding(2) var<storage, read_write> state: State;

#import shared/reduce

// Of two 64-bit integers, low limb first, that are not negative.
fn at_most(a: vec2u, b: vec2u) -> bool {
    return a.y < b.y || (a.y == b.y && a.x <= b.x);
}

@compute @workgroup_size(1)
fn main() {
    let area = vec2u(totals.area_low, totals.area_high);
    // What is negative is larger than everything here.
    let covers = at_most(params.least_area, area) && at_most(area, params.most_area);
    let full = atomicLoad(&state.list_overflow) + atomicLoad(&state.cells_overflow) != 0u;
    let open = state.head < atomicLoad(&state.length) || atomicLoad(&state.failures) != atomicLoad(&state.requeued);
    let searched = atomicLoad(&state.near) != 0u && atomicLoad(&state.unproved) == 0u;
    if full || open || !searched || !covers || totals.empty != 0u {
        atomicOr(&state.halt, INCOMPLETE);
    }
}
