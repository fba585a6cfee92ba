// Takes the next pairs of the list and writes the size of the dispatch that clips them.

#import shared/types
#import shared/state

struct Arguments {
    x: u32,
    y: u32,
    z: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> state: State;
@group(0) @binding(2) var<storage, read_write> arguments: Arguments;

@compute @workgroup_size(1)
fn main() {
    let length = min(atomicLoad(&state.length), params.list_capacity);
    let begin = state.head;
    var end = min(begin + params.batch, length);
    // What comes after an overflow would be thrown away.
    if atomicLoad(&state.list_overflow) + atomicLoad(&state.cells_overflow) != 0u {
        end = begin;
    }
    state.begin = begin;
    state.end = end;
    state.head = end;
    state.rounds += select(0u, 1u, end > begin);
    arguments.x = (end - begin + 63u) / 64u;
    arguments.y = 1u;
    arguments.z = 1u;
}
