// Takes the next pairs of the list, and writes the sizes of two dispatches: the one that clips them, and the one that makes
// longer rows for pairs that failed before. The latter is empty if no pair failed, since a driver on a CPU goes through all
// of a shader's code for lanes that have nothing to do.

struct Arguments {
    x: u32,
    y: u32,
    z: u32,
    lengthen_x: u32,
    lengthen_y: u32,
    lengthen_z: u32,
}

fn take_pairs(most: u32) {
    let length = min(atomicLoad(&state.length), params.list_capacity);
    let begin = state.head;
    var end = min(begin + most, length);
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
    let open = atomicLoad(&state.failures) != atomicLoad(&state.requeued);
    arguments.lengthen_x = select(0u, $(LENGTHENERS)u, open);
    arguments.lengthen_y = 1u;
    arguments.lengthen_z = 1u;
}
