// Takes the pairs whose polygons did not fit into registers, from the end of the list, for the variant of `clip` with more
// slots. It takes none while other pairs are not done: their last bits would be those of that variant.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> list: array<vec2u>;
// Two words each.
@group(0) @binding(2) var<storage, read_write> failures: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> state: State;
@group(0) @binding(4) var<storage, read_write> arguments: Arguments;

#import shared/append_pair
#import shared/failure
#import shared/requeue
#import shared/take_pairs

// Lanes at work.
const LANES: u32 = 64u;

var<workgroup> few: u32;

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        let drained = state.head == atomicLoad(&state.length);
        few = select(0u, atomicLoad(&state.failures), drained);
        few = select(few, 0u, few > min(MOST, params.list_capacity));
    }
    let found = workgroupUniformLoad(&few);
    for (var entry = lane; entry < found; entry += LANES) {
        if is_open(entry) && code_of(entry) == POLYGON {
            requeue(entry);
            atomicAdd(&state.overflowed, 1u);
        }
    }
    storageBarrier();
    if lane == 0u {
        take_pairs(found);
    }
}
