// The polygon in $SLOTS named slots.
//
// Every access is at a fixed name, so the compiler keeps all of it in registers. An indexed
// private array, which lives in memory, made the clip 6 to 10 times slower.

var<private> count: u32;
#repeat K in 0..SLOTS
var<private> p_$K: vec2f;
var<private> edge_$K: u32;
#end

fn polygon_start(a: vec2f, b: vec2f, c: vec2f) {
    count = 3u;
    #repeat K in 3..SLOTS
    p_$K = vec2f(0.0);
    edge_$K = 0u;
    #end
    p_0 = a;
    p_1 = b;
    p_2 = c;
    edge_0 = FACET_EDGE;
    edge_1 = FACET_EDGE - 1u;
    edge_2 = FACET_EDGE - 2u;
}

fn polygon_radius2() -> f32 {
    var r = dot(p_0, p_0);
    #repeat K in 1..SLOTS
    r = max(r, select(0.0, dot(p_$K, p_$K), $(K)u < count));
    #end
    return r;
}

fn polygon_vertex(k: u32) -> vec2f {
    var p = p_0;
    #repeat K in 1..SLOTS
    p = select(p, p_$K, k == $(K)u);
    #end
    return p;
}

fn polygon_move(k: u32, p: vec2f) {
    #repeat K in 0..SLOTS
    p_$K = select(p_$K, p, k == $(K)u);
    #end
}

fn polygon_edge(k: u32) -> u32 {
    var edge = edge_0;
    #repeat K in 1..SLOTS
    edge = select(edge, edge_$K, k == $(K)u);
    #end
    return edge;
}

// Keeps where c - g.p > 0, or = 0 if `ties`. The new edge gets label j.
fn polygon_cut(c: f32, g: vec2f, j: u32, ties: bool) -> u32 {
    var kept = 0u;
    #repeat K in 0..SLOTS
    let d_$K = c - (g.x * p_$K.x + g.y * p_$K.y);
    let in_$K = ($(K)u < count) && (d_$K > 0.0 || (ties && d_$K == 0.0));
    kept += select(0u, 1u, in_$K);
    #end
    if kept == count {
        return UNCUT;
    }
    if kept == 0u {
        count = 0u;
        return EMPTY;
    }

    // A convex polygon is left once and entered once: both edges are found, then cut.
    var leaves = 0u;
    var enters = 0u;
    var leave_in = vec3f(0.0);
    var leave_out = vec3f(0.0);
    var enter_in = vec3f(0.0);
    var enter_out = vec3f(0.0);
    #repeat K in 0..SLOTS
    let last_$K = count == $(K + 1)u;
    let next_in_$K = select(in_$((K + 1) % SLOTS), in_0, last_$K);
    let here_$K = vec3f(p_$K, d_$K);
    let next_$K = select(
        vec3f(p_$((K + 1) % SLOTS), d_$((K + 1) % SLOTS)),
        vec3f(p_0, d_0),
        last_$K,
    );
    let leave_$K = in_$K && !next_in_$K;
    let enter_$K = !in_$K && next_in_$K && $(K)u < count;
    leaves += select(0u, 1u, leave_$K);
    enters += select(0u, 1u, enter_$K);
    leave_in = select(leave_in, here_$K, leave_$K);
    leave_out = select(leave_out, next_$K, leave_$K);
    enter_in = select(enter_in, next_$K, enter_$K);
    enter_out = select(enter_out, here_$K, enter_$K);
    #end
    if leaves != 1u || enters != 1u {
        return BROKEN;
    }
    let leave_at = cut_point(leave_in, leave_out);
    let enter_at = cut_point(enter_in, enter_out);

    var size = 0u;
    #repeat S in 0..SLOTS
    var q_$S = vec2f(0.0);
    var label_$S = 0u;
    #end
    #repeat K in 0..SLOTS
    #repeat S in 0..SLOTS
    #if S < K + 2
    q_$S = select(q_$S, p_$K, in_$K && size == $(S)u);
    label_$S = select(label_$S, edge_$K, in_$K && size == $(S)u);
    #end
    #end
    size += select(0u, 1u, in_$K);
    let crossing_$K = leave_$K || enter_$K;
    let at_$K = select(enter_at, leave_at, leave_$K);
    let new_edge_$K = select(edge_$K, j, leave_$K);
    #repeat S in 0..SLOTS
    #if S < K + 3
    q_$S = select(q_$S, at_$K, crossing_$K && size == $(S)u);
    label_$S = select(label_$S, new_edge_$K, crossing_$K && size == $(S)u);
    #end
    #end
    size += select(0u, 1u, crossing_$K);
    #end
    if size > params.polygon {
        return OVERFLOW;
    }
    #repeat S in 0..SLOTS
    p_$S = q_$S;
    edge_$S = label_$S;
    #end
    count = size;
    return CUT;
}
