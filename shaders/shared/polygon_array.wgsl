// The polygon in an indexed array of $SLOTS slots: slow, for the few pairs that need many. The
// arithmetic is that of polygon_registers, operation by operation.

var<private> count: u32;
var<private> points: array<vec2f, $SLOTS>;
var<private> edges: array<u32, $SLOTS>;
var<private> distances: array<f32, $SLOTS>;
var<private> new_points: array<vec2f, $SLOTS>;
var<private> new_edges: array<u32, $SLOTS>;

fn polygon_start(a: vec2f, b: vec2f, c: vec2f) {
    count = 3u;
    points[0] = a;
    points[1] = b;
    points[2] = c;
    edges[0] = FACET_EDGE;
    edges[1] = FACET_EDGE - 1u;
    edges[2] = FACET_EDGE - 2u;
}

fn polygon_radius2() -> f32 {
    var r = 0.0;
    for (var k = 0u; k < count; k += 1u) {
        r = max(r, dot(points[k], points[k]));
    }
    return r;
}

fn polygon_vertex(k: u32) -> vec2f {
    return points[k];
}

fn polygon_move(k: u32, p: vec2f) {
    points[k] = p;
}

fn polygon_edge(k: u32) -> u32 {
    return edges[k];
}

fn polygon_inside(k: u32, ties: bool) -> bool {
    return distances[k] > 0.0 || (ties && distances[k] == 0.0);
}

fn polygon_push(size: u32, p: vec2f, edge: u32) {
    if size < $(SLOTS)u {
        new_points[size] = p;
        new_edges[size] = edge;
    }
}

// Keeps where c - g.p > 0, or = 0 if `ties`. The new edge gets label j.
fn polygon_cut(c: f32, g: vec2f, j: u32, ties: bool) -> u32 {
    var kept = 0u;
    for (var k = 0u; k < count; k += 1u) {
        distances[k] = c - (g.x * points[k].x + g.y * points[k].y);
        kept += select(0u, 1u, polygon_inside(k, ties));
    }
    if kept == count {
        return UNCUT;
    }
    if kept == 0u {
        count = 0u;
        return EMPTY;
    }
    var size = 0u;
    var crossings = 0u;
    for (var k = 0u; k < count; k += 1u) {
        let m = select(k + 1u, 0u, k + 1u == count);
        let here = vec3f(points[k], distances[k]);
        let next = vec3f(points[m], distances[m]);
        let here_in = polygon_inside(k, ties);
        let next_in = polygon_inside(m, ties);
        if here_in {
            polygon_push(size, points[k], edges[k]);
            size += 1u;
        }
        if here_in && !next_in {
            polygon_push(size, cut_point(here, next), j);
            size += 1u;
            crossings += 1u;
        }
        if !here_in && next_in {
            polygon_push(size, cut_point(next, here), edges[k]);
            size += 1u;
            crossings += 1u;
        }
    }
    if crossings != 2u {
        return BROKEN;
    }
    if size > $(SLOTS)u {
        return OVERFLOW;
    }
    for (var k = 0u; k < size; k += 1u) {
        points[k] = new_points[k];
        edges[k] = new_edges[k];
    }
    count = size;
    return CUT;
}
