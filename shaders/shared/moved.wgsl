// A seed that has gone by `delta`: the upper parts are again multiples of 2^-12, as the host splits them.
fn moved(seed: Seed, delta: Point) -> Seed {
    let s = seed.lo + place_in(delta);
    let whole = round(s * 4096.0) / 4096.0;
    let lo = round((s - whole) * 4503599627370496.0) / 4503599627370496.0;
#if 1 - LIFTED
    return Seed(seed.hi + whole, 0u, lo, 0u);
#end
#if LIFTED
    let t = seed.lift_lo + delta.lift;
    let lift_whole = round(t * 4096.0) / 4096.0;
    let lift_lo = round((t - lift_whole) * 4503599627370496.0) / 4503599627370496.0;
    return Seed(seed.hi + whole, 0u, lo, 0u, seed.lift_hi + lift_whole, lift_lo);
#end
}
