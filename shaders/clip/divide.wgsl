// All cells of one facet at once, without a polygon: the fast way of most facets. From the row of the seed
// nearest to the centroid, those that are nearer somewhere on the facet: |p - x_j|^2 - |p - x_i|^2 is linear
// there, so its values at the corners say it. Between two of these lies at most one segment, what the
// others leave of their bisector, and a polynomial's integral over a piece is a sum over the segments
// around it (Green's theorem), so that one segment serves both of its sides. Everything is a function of
// the values at the corners; a facet whose pieces do not close, or that has too many of them, too small
// ones, or seeds that its row may not know, goes to the list of pairs as a whole. Nothing of this depends on capacities.

#import shared/types
#import shared/state

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> seeds: array<Seed>;
@group(0) @binding(2) var<storage, read> facets: array<Facet>;
@group(0) @binding(3) var<storage, read> table: array<u32>;
@group(0) @binding(4) var<storage, read> candidates: array<vec2u>;
@group(0) @binding(5) var<storage, read_write> slots: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> list: array<vec2u>;
#if WIDE
@group(0) @binding(7) var<storage, read_write> sums: array<atomic<u64>>;
#end
#if 1 - WIDE
@group(0) @binding(7) var<storage, read_write> sums: array<atomic<u32>>;
#end
@group(0) @binding(8) var<storage, read_write> state: State;

#import shared/plane
#import shared/fixed
#import shared/accumulate
#import shared/append_pair
#import shared/cell_set

// Farther than every seed, and still far from what a float holds.
const NOBODY: f32 = 1e30;
// A piece whose sides miss each other by more than this share of the facet is not trusted; as much
// again for each time that the seeds are farther than the facet is long, where rounding is more of it.
const GAP: f32 = 2e-6;
// A piece of less than this share, likewise.
const LEAST: f32 = 2e-6;
// Words of a row as the search writes it: how long it is, then the seeds.
const STRIDE: u32 = $(ROW + 1)u;
// Members are so far apart, squared, against the farthest corner: the values at the corners round by that
// corner's distance, and their bisector moves by it over how far apart they are.
const APART2: f32 = 0.0625;
// A facet may be so many spacings of the seeds long, squared.
const LONGEST2: f32 = 16.0;
// As in shared/clip_pair.
const RANGE2: f32 = 64.0;

// The members: which, how much farther than the first one at each corner (squared), where from the
// first one in the facet's frame, and what is known of their pieces: the moments, the parts of the facet's
// edges, and how far the other sides are from making a closed line with these.
var<private> members: u32;
var<private> full: bool;
// Squared distance of the first seed's sixth neighbour, if the facet needs it.
var<private> spacing2: f32;
#repeat K in 0..MEMBERS
var<private> seed_$K: u32;
var<private> far_$K: vec3f;
var<private> foot_$K: vec3f;
var<private> m_$K: Moments;
var<private> low_$K: vec3f;
var<private> high_$K: vec3f;
var<private> gap_$K: vec2f;
#end

// Integrals over a piece of 1, wx, wy, w(x^2 + y^2) and w, where (x, y) is a place from corner 0 in the facet's
// frame and w is the weight, or 1; times what `piece_sums` divides by.
struct Moments {
    one: f32,
    first: vec2f,
    second: f32,
#if WEIGHTED
    mass: f32,
#end
}

#if WEIGHTED
// The weight at corner 0, and how it grows along the frame.
var<private> weight: f32;
var<private> growth: vec2f;
#end

// Those over the triangle from corner 0 to the side from p to q. The integral of a product of linear functions
// over a triangle is a sum of products of their values at its corners, where x and y are 0 at corner 0.
fn sides_of(p: vec2f, q: vec2f) -> Moments {
    let d = q - p;
    let cross = p.x * d.y - p.y * d.x;
#if 1 - WEIGHTED
    let sum = p + q;
    return Moments(cross, cross * sum, cross * (dot(sum, sum) - dot(p, q)));
#end
#if WEIGHTED
    let at_0 = cross * weight;
    let at_p = at_0 + cross * dot(growth, p);
    let at_q = at_0 + cross * dot(growth, q);
    let mass = at_0 + at_p + at_q;
    let once = vec2f(mass + at_p, mass + at_q);
    let twice = once + vec2f(at_p, at_q);
    let mixed = mass + mass - at_0;
    return Moments(
        cross,
        once.x * p + once.y * q,
        twice.x * dot(p, p) + twice.y * dot(q, q) + mixed * dot(p, q),
        mass,
    );
#end
}

fn plus(a: Moments, b: Moments, sign: f32) -> Moments {
    return Moments(
        a.one + sign * b.one,
        a.first + sign * b.first,
        a.second + sign * b.second,
#if WEIGHTED
        a.mass + sign * b.mass,
#end
    );
}

fn either(a: Moments, b: Moments, second: bool) -> Moments {
    return Moments(
        select(a.one, b.one, second),
        select(a.first, b.first, second),
        select(a.second, b.second, second),
#if WEIGHTED
        select(a.mass, b.mass, second),
#end
    );
}

// Where seed i is nearer than j; of two at one distance the lower index is.
fn nearer(far_i: vec3f, i: u32, far_j: vec3f, j: u32) -> vec3<bool> {
    return (far_i < far_j) | ((far_i == far_j) & vec3<bool>(i < j));
}

// Enters a seed unless another one is nearer at all corners, in the place of one that it is nearer than: of a seed or,
// as NOBODY is the farthest, behind them. Who is as near at a corner stays, if only for a piece of nothing.
fn consider(j: u32, far: vec3f, foot: vec3f) {
    var place = $(MEMBERS)u;
    var beaten = false;
#repeat K in 0..MEMBERS
    let more_$K = far - far_$(MEMBERS - 1 - K);
    beaten = beaten || min(min(more_$K.x, more_$K.y), more_$K.z) > 0.0;
    place = select(place, $(MEMBERS - 1 - K)u, max(max(more_$K.x, more_$K.y), more_$K.z) < 0.0);
#end
    if beaten {
        return;
    }
    full = place == $(MEMBERS)u;
    members = max(members, min(place + 1u, $(MEMBERS)u));
#repeat K in 0..MEMBERS
    seed_$K = select(seed_$K, j, place == $(K)u);
    far_$K = select(far_$K, far, place == $(K)u);
    foot_$K = select(foot_$K, foot, place == $(K)u);
#end
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let index = params.part_first + id.x + id.y * groups.x * 64u;
    if index >= params.enqueue_count || atomicLoad(&state.halt) != 0u {
        return;
    }
    let pair = candidates[params.enqueue_begin + index];
    if pair.y == NONE {
        return;
    }
    let f = pair.x;
    let facet = facets[f - params.facet_first];
    if divide(facet, pair.y) {
        if (facet.slot_mask & BY_CELL) != 0u {
            atomicStore(&slots[params.divided + f], 1u);
        }
        return;
    }
    // The set is empty yet.
    let mask = facet.slot_mask & ~BY_CELL;
    atomicStore(&slots[facet.slot_begin + first_slot(mask, pair.y)], pair.y + 1u);
    append_pair(f, pair.y | ROOT);
    atomicAdd(&state.paired, 1u);
}

// A seed at b from the first one, so that its distance from a corner is less by twice the product of this and the corner: in
// R^3 b in the facet's frame, LIFTED along the frame, and what of it is along the height.
fn foot_of(facet: Facet, b: Point) -> vec3f {
#if 1 - LIFTED
    return vec3f(dot(facet.e1, b), dot(facet.e2, b), dot(facet.n, b));
#end
#if LIFTED
    return vec3f(along_e1(facet, b), along_e2(facet, b), inner(height, b));
#end
}

// The row of the seed nearest to the centroid. `reach` is how far it is known; every seed nearer was considered.
fn gather(nearest: u32, own: Seed, facet: Facet, corners: mat3x3f, radius2: f32, reach_of_row: ptr<function, f32>) {
    members = 1u;
    full = false;
    spacing2 = NOBODY;
#repeat K in 0..MEMBERS
    seed_$K = NONE;
    far_$K = vec3f(NOBODY);
#end
    seed_0 = nearest;
    far_0 = vec3f(0.0);
    foot_0 = vec3f(0.0);
    let header = nearest * STRIDE;
    let length = table[header];
    let end = header + 1u + (length & INDEX);
    var known = 0.0;
    var reach = select(-1.0, NOBODY, (length & COMPLETE) != 0u);
    var at = header + 1u;
    // A driver on a CPU runs a loop's body once more after the last lane has left at its head, so this one
    // is left at its end.
    loop {
        let j = table[min(at, end - 1u)];
        let b = to_seed(own, seeds[j]);
        let b2 = inner(b, b);
        // The security radius of the whole facet ([LB12]), widened by what rounding can do to either side.
        let closed = at < end && b2 > 4.00004 * radius2;
        let open = at < end && !closed;
        let foot = foot_of(facet, b);
        let far = vec3f(b2) - 2.0 * (foot * corners);
        if open && min(min(far.x, far.y), far.z) <= 0.0 {
            consider(j, far, foot);
        }
        known = select(known, b2, open);
        spacing2 = select(spacing2, b2, open && at == header + 6u);
        reach = select(reach, NOBODY, closed);
        at += 1u;
        if !open || full {
            break;
        }
    }
    *reach_of_row = select(reach, sqrt(known) * 0.99999, reach < 0.0);
}

// The squared distances of a vertex from the first seed and from its own, added up: x is where it lies in the facet's
// plane from the first seed, p where between the corners. The distances add up to no more than the root of twice that, and
// a seed that is farther than their sum from the first one is farther from the vertex than its own.
fn squares_at(x: vec2f, p: vec2f, height2: f32, far: vec3f) -> f32 {
    let squared = dot(x, x) + height2;
    return squared + max(squared + value_at(p, far), 0.0);
}

// From corner 0, in the facet's frame.
fn in_frame(p: vec2f, side1: vec2f, side2: vec2f) -> vec2f {
    return vec2f(p.x * side1.x + p.y * side2.x, p.y * side2.y);
}

// A linear function of which the values at the corners are given.
fn value_at(p: vec2f, values: vec3f) -> f32 {
    return values.x + p.x * (values.y - values.x) + p.y * (values.z - values.x);
}

// The integrals of a piece about its own seed, in units.
fn piece_sums(m: Moments, seed: u32, foot: vec3f, facet: Facet, corner: vec3f) -> PieceSums {
    let one = m.one * (1.0 / 2.0);
#if 1 - LIFTED
    let origin = corner.xy - foot.xy;
    height = corner.z - foot.z;
#end
#if LIFTED
    let origin = set_plane(facet, to_corner(seeds[seed], facet));
#end
#if 1 - WEIGHTED
    let mass = one;
    let linear = m.first * (1.0 / 6.0);
    let squared = m.second * (1.0 / 12.0);
#end
#if WEIGHTED
    let mass = m.mass * (1.0 / 6.0);
    let linear = m.first * (1.0 / 24.0);
    let squared = m.second * (1.0 / 60.0);
#end
    let moment = mass * origin + linear;
    let energy = mass * (dot(origin, origin) + squared_height()) + 2.0 * dot(origin, linear) + squared;
    return PieceSums(
        $(WEIGHTED).0 * (mass * params.mass_scale),
        scaled(from_seed(facet, moment, mass), params.moment_scale),
        energy * params.energy_scale,
        one * params.area_scale,
    );
}

// Adds all pieces of the facet to their cells' sums, or returns false.
fn divide(facet: Facet, nearest: u32) -> bool {
    // The facet from the seed nearest to its centroid: corners in the facet's frame.
    let own = seeds[nearest];
    let first = set_plane(facet, to_corner(own, facet));
#if 1 - LIFTED
    let q = vec3f(first, height);
#end
#if LIFTED
    // What is along the height is a product with all of it.
    let q = vec3f(first, 1.0);
#end
    let side1 = vec2f(facet.corner1_u, 0.0);
    let side2 = vec2f(facet.corner2_u, facet.corner2_v);
    let corners = mat3x3f(q, vec3f(q.xy + side1, q.z), vec3f(q.xy + side2, q.z));
#if WEIGHTED
    weight = facet.weight;
    growth = vec2f(facet.weight_u, facet.weight_v);
#end
#if 1 - LIFTED
    let squares = vec3f(dot(corners[0], corners[0]), dot(corners[1], corners[1]), dot(corners[2], corners[2]));
#end
#if LIFTED
    let squares = squared_height() + vec3f(
        dot(corners[0].xy, corners[0].xy),
        dot(corners[1].xy, corners[1].xy),
        dot(corners[2].xy, corners[2].xy),
    );
#end
    let radius2 = max(max(squares.x, squares.y), squares.z);
    // Written so that NaN fails too.
    if !(radius2 <= RANGE2) {
        return false;
    }
    var reach = 0.0;
    gather(nearest, own, facet, corners, radius2, &reach);
    // Sums about the first corner of what is far from it would cancel.
    let longest2 = max(max(dot(side1, side1), dot(side2, side2)), dot(side2 - side1, side2 - side1));
    if full || longest2 > LONGEST2 * spacing2 {
        return false;
    }
    let height2 = squared_height();
    var nearest2 = far_0;
#repeat K in 1..MEMBERS
    nearest2 = min(nearest2, far_$K);
#end
    let both = squares + max(squares + nearest2, vec3f(0.0));
    var most = max(max(both.x, both.y), both.z);
    var apart = true;
#repeat K in 0..MEMBERS
    m_$K = Moments();
    low_$K = vec3f(0.0);
    high_$K = vec3f(1.0);
    gap_$K = vec2f(0.0);
#end

#repeat I in 0..MEMBERS - 1
#repeat J in I + 1..MEMBERS
    if $(J)u < members {
#if 1 - LIFTED
        let between = foot_$J - foot_$I;
#end
#if LIFTED
        let between = foot_$(J).xy - foot_$(I).xy;
#end
        apart = apart && dot(between, between) >= APART2 * radius2;
        // Which corners are in the first cell, and where the bisector crosses each edge, if it does.
        let d = far_$J - far_$I;
        let inside = nearer(far_$I, seed_$I, far_$J, seed_$J);
        let ahead = inside.yzx;
        let t = d / (d - d.yzx);
        let leaves = inside & !ahead;
        let enters = !inside & ahead;
        let crosses = leaves | enters;
        low_$I = max(low_$I, select(vec3f(0.0), t, enters));
        low_$J = max(low_$J, select(vec3f(0.0), t, leaves));
        high_$I = min(high_$I, select(select(vec3f(-1.0), vec3f(1.0), inside | ahead), t, leaves));
        high_$J = min(high_$J, select(select(vec3f(1.0), vec3f(-1.0), inside & ahead), t, enters));
        // What the others leave of it.
        let across = vec2f(1.0 - t.y, t.y);
        let p = select(across, vec2f(t.x, 0.0), crosses.x);
        let r = select(across, vec2f(0.0, 1.0 - t.z), crosses.z);
        var begin = 0.0;
        var finish = select(-1.0, 1.0, any(crosses));
#repeat K in 0..MEMBERS
#if ((K < I) + (I < K)) * ((K < J) + (J < K))
        let g_$K = far_$K - far_$I;
        let at_p_$K = value_at(p, g_$K);
        let at_r_$K = value_at(r, g_$K);
        let s_$K = at_p_$K / (at_p_$K - at_r_$K);
        begin = max(begin, select(0.0, s_$K, at_p_$K < 0.0));
        finish = min(finish, select(1.0, s_$K, at_r_$K < 0.0));
#end
#end
        if begin < finish {
            let a = p + begin * (r - p);
            let b = p + finish * (r - p);
            let sign = select(-1.0, 1.0, select(inside.y, inside.x, crosses.x));
            let end_a = in_frame(a, side1, side2);
            let end_b = in_frame(b, side1, side2);
            let side = sides_of(end_a, end_b);
            m_$I = plus(m_$I, side, sign);
            m_$J = plus(m_$J, side, -sign);
            gap_$I += sign * (b - a);
            gap_$J -= sign * (b - a);
            most = max(most, squares_at(q.xy + end_a, a, height2, far_$I));
            most = max(most, squares_at(q.xy + end_b, b, height2, far_$I));
        }
    }
#end
#end

    // How much larger the seeds' distances are than the facet.
    let twice = side1.x * side2.y;
    let ratio = 1.0 + sqrt(radius2 * longest2) / twice;
    // Where no piece can be large enough, areas may be less than what a float holds, and nobody would be missed.
    var sure = apart && sqrt(2.0 * (most + 1e-6 * radius2)) <= reach && LEAST * ratio <= 1.0;
    var pieces = 0u;
#repeat K in 0..MEMBERS
    if $(K)u < members {
        let along = max(high_$K - low_$K, vec3f(0.0));
        if along.y > 0.0 {
            let across = side2 - side1;
            m_$K = plus(m_$K, sides_of(side1 + low_$K.y * across, side1 + high_$K.y * across), 1.0);
        }
        let gap = abs(gap_$K + vec2f(along.x - along.y, along.y - along.z));
        sure = sure && max(gap.x, gap.y) <= GAP * ratio && (m_$K.one == 0.0 || m_$K.one >= LEAST * ratio * twice);
        pieces += select(0u, 1u, m_$K.one != 0.0);
    }
#end
    if !sure {
        return false;
    }
    atomicAdd(&state.pieces, pieces);
    if params.accumulate == NOWHERE {
        return true;
    }
    var k = 0u;
    loop {
        var seed = seed_0;
        var foot = foot_0;
        var m = m_0;
#repeat K in 1..MEMBERS
        seed = select(seed, seed_$K, k == $(K)u);
        foot = select(foot, foot_$K, k == $(K)u);
        m = either(m, m_$K, k == $(K)u);
#end
        if m.one != 0.0 {
            add_direct(seed, piece_sums(m, seed, foot, facet, q));
        }
        k += 1u;
        if k >= members {
            break;
        }
    }
    return true;
}
