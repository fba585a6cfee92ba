// The part of the search direction that is a seed's.

fn direction_of(i: u32) -> Point {
    let at = COORDINATES * i;
#if 1 - LIFTED
    return vec3f(direction[at], direction[at + 1u], direction[at + 2u]);
#end
#if LIFTED
    return Point(
        vec3f(direction[at], direction[at + 1u], direction[at + 2u]),
        vec3f(direction[at + 3u], direction[at + 4u], direction[at + 5u]),
    );
#end
}
