// A seed that has gone by `delta`: the upper part is again a multiple of 2^-12, as the host splits it.
fn moved(seed: Seed, delta: vec3f) -> Seed {
    let s = seed.lo + delta;
    let whole = round(s * 4096.0) / 4096.0;
    let lo = round((s - whole) * 4503599627370496.0) / 4503599627370496.0;
    return Seed(seed.hi + whole, 0u, lo, 0u);
}
