// Points and vectors of the space that has the cells: R^3 or, LIFTED, R^6, where a point is a place and a lift.

const COORDINATES: u32 = $(3 + 3 * LIFTED)u;

#if 1 - LIFTED
alias Point = vec3f;

fn inner(a: Point, b: Point) -> f32 {
    return dot(a, b);
}

fn scaled(p: Point, by: f32) -> Point {
    return p * by;
}

fn over(p: Point, by: f32) -> Point {
    return p / by;
}

fn place_in(p: Point) -> vec3f {
    return p;
}

fn coordinate(p: Point, c: u32) -> f32 {
    return p[c];
}

fn is_zero(p: Point) -> bool {
    return all(p == vec3f(0.0));
}
#end
#if LIFTED
struct Point {
    place: vec3f,
    lift: vec3f,
}

fn inner(a: Point, b: Point) -> f32 {
    return dot(a.place, b.place) + dot(a.lift, b.lift);
}

fn scaled(p: Point, by: f32) -> Point {
    return Point(p.place * by, p.lift * by);
}

fn over(p: Point, by: f32) -> Point {
    return Point(p.place / by, p.lift / by);
}

fn place_in(p: Point) -> vec3f {
    return p.place;
}

fn coordinate(p: Point, c: u32) -> f32 {
    if c < 3u {
        return p.place[c];
    }
    return p.lift[c - 3u];
}

fn is_zero(p: Point) -> bool {
    return all(p.place == vec3f(0.0)) && all(p.lift == vec3f(0.0));
}
#end
