// Totals over the cells, added in a fixed order: 64-bit integers exactly, floats always in the same tree.

struct Totals {
    energy_low: u32,
    energy_high: u32,
    area_low: u32,
    area_high: u32,
    empty: u32,
    gradient_squared: f32,
    slope: f32,
    padding: u32,
}

fn plus(a: vec2u, b: vec2u) -> vec2u {
    let low = a.x + b.x;
    return vec2u(low, a.y + b.y + select(0u, 1u, low < a.x));
}

fn add_totals(a: Totals, b: Totals) -> Totals {
    let energy = plus(vec2u(a.energy_low, a.energy_high), vec2u(b.energy_low, b.energy_high));
    let area = plus(vec2u(a.area_low, a.area_high), vec2u(b.area_low, b.area_high));
    return Totals(
        energy.x, energy.y, area.x, area.y,
        a.empty + b.empty,
        a.gradient_squared + b.gradient_squared,
        a.slope + b.slope,
        0u,
    );
}

var<workgroup> part: array<Totals, 64>;

// The sum over the workgroup, in `part[0]`. All lanes call this together.
fn reduce(lane: u32, own: Totals) {
    part[lane] = own;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if lane < half {
            part[lane] = add_totals(part[lane], part[lane + half]);
        }
        workgroupBarrier();
    }
}
