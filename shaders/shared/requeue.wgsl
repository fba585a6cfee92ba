// Puts failed pairs to the end of the list of pairs again, where there are few.

// So many at most.
const MOST: u32 = $(MOST)u;

fn seed_of(entry: u32) -> u32 {
    return atomicLoad(&failures[2u * entry + 1u]) & FAILED;
}

fn is_open(entry: u32) -> bool {
    return (atomicLoad(&failures[2u * entry]) & REQUEUED) == 0u;
}

// Why it failed. Neither that nor the seed changes when it is put there.
fn code_of(entry: u32) -> u32 {
    return failure_code(atomicLoad(&failures[2u * entry]), atomicLoad(&failures[2u * entry + 1u]));
}

fn requeue(entry: u32) {
    let first = atomicLoad(&failures[2u * entry]);
    let second = atomicLoad(&failures[2u * entry + 1u]);
    append_pair(first & FAILED, (second & FAILED) | select(0u, ROOT, (second & FIRST) != 0u));
    atomicStore(&failures[2u * entry], (first & ~FAILED) | REQUEUED | state.rounds);
    atomicAdd(&state.requeued, 1u);
}
