// The one block that the host reads between submissions.

struct State {
    // First pair that no dispatch has taken yet.
    head: u32,
    // The pairs of the present dispatch.
    begin: u32,
    end: u32,
    // Pairs in the list; may pass its capacity, which `list_overflow` counts too.
    length: atomic<u32>,
    // Entries in the list of failures.
    failures: atomic<u32>,
    // Non-empty pieces so far.
    pieces: atomic<u32>,
    list_overflow: atomic<u32>,
    cells_overflow: atomic<u32>,
}
