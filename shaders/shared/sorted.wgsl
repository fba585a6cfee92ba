// A seed in the order of the grid.
struct Sorted {
    hi: vec3f,
    seed: u32,
    lo: vec3f,
    // The earliest seed at the same place.
    first: u32,
#if LIFTED
    lift_hi: vec3f,
    lift_lo: vec3f,
#end
}

// The record of seed `index`, whose cell or earliest twin is `first`.
fn sorted_of(seed: Seed, index: u32, first: u32) -> Sorted {
#if 1 - LIFTED
    return Sorted(seed.hi, index, seed.lo, first);
#end
#if LIFTED
    return Sorted(seed.hi, index, seed.lo, first, seed.lift_hi, seed.lift_lo);
#end
}

// From one of them to another.
fn to_sorted(start: Sorted, to: Sorted) -> Point {
#if 1 - LIFTED
    return (to.hi - start.hi) + (to.lo - start.lo);
#end
#if LIFTED
    return Point(
        (to.hi - start.hi) + (to.lo - start.lo),
        (to.lift_hi - start.lift_hi) + (to.lift_lo - start.lift_lo),
    );
#end
}

// From a seed to one of them.
fn seed_to_sorted(start: Seed, to: Sorted) -> Point {
#if 1 - LIFTED
    return (to.hi - start.hi) + (to.lo - start.lo);
#end
#if LIFTED
    return Point(
        (to.hi - start.hi) + (to.lo - start.lo),
        (to.lift_hi - start.lift_hi) + (to.lift_lo - start.lift_lo),
    );
#end
}
