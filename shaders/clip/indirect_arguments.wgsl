// Takes the next pairs of the list and writes the sizes of the dispatches that follow.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> state: State;
@group(0) @binding(2) var<storage, read_write> arguments: Arguments;

#import shared/take_pairs

@compute @workgroup_size(1)
fn main() {
    take_pairs(params.batch);
}
