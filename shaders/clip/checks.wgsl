// Entry points that run one shared helper each, for tests against f64.

@group(0) @binding(0) var<storage, read> inputs: array<u32>;
#if WIDE
@group(0) @binding(1) var<storage, read_write> sums: array<atomic<u64>>;
#end
#if 1 - WIDE
@group(0) @binding(1) var<storage, read_write> sums: array<atomic<u32>>;
#end
@group(0) @binding(2) var<storage, read_write> slots: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> outcomes: array<u32>;

// Of shared/types.
const NAMED: u32 = 0x80000000u;

#import shared/fixed
#import shared/cell_set

// Adds all inputs, as floats, to one sum.
@compute @workgroup_size(64)
fn check_fixed(@builtin(global_invocation_id) id: vec3u) {
    if id.x < arrayLength(&inputs) {
        add_fixed(0u, bitcast<f32>(inputs[id.x]));
    }
}

// Inserts all inputs into one set that fills `slots`.
@compute @workgroup_size(64)
fn check_cell_set(@builtin(global_invocation_id) id: vec3u) {
    if id.x < arrayLength(&inputs) {
        outcomes[id.x] = insert_cell(0u, arrayLength(&slots) - 1u, inputs[id.x], 0u);
    }
}
