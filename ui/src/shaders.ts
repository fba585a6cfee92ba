// What the graphics card runs.
//
// Purpose: one program for surfaces with values and edges, one for surfaces with cells. Invariant: corners come three after
// three, so that a vertex's number says its facet and its corner. Must not know: where values come from.

/** Light and shade of a facet: brighter where it looks at the viewer. */
const SHADE = `
vec3 shade(vec3 colour, vec3 place) {
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  float ahead = abs(normal.z);
  float above = normal.y * 0.5 + 0.5;
  vec3 lit = colour * (0.42 + 0.50 * ahead + 0.16 * above);
  return gl_FrontFacing ? lit : mix(lit, back, 0.45);
}
`;

export const SURFACE_VERTEX = `
precision highp float;
uniform mat4 modelViewMatrix;
uniform mat4 projectionMatrix;
in vec3 position;
in float value;
out vec3 place;
out vec3 corner;
out float amount;
void main() {
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  int i = gl_VertexID % 3;
  corner = vec3(i == 0, i == 1, i == 2);
  place = seen.xyz;
  amount = value;
  gl_Position = projectionMatrix * seen;
}
`;

export const SURFACE_FRAGMENT = `
precision highp float;
uniform vec3 base;
uniform vec3 back;
uniform vec3 line;
uniform bool coloured;
uniform bool edges;
uniform vec2 range;
uniform sampler2D scale;
in vec3 place;
in vec3 corner;
in float amount;
out vec4 colour;
${SHADE}
void main() {
  vec3 plain = base;
  if (coloured) {
    float t = clamp((amount - range.x) / (range.y - range.x), 0.0, 1.0);
    plain = texture(scale, vec2((t * 8.0 + 0.5) / 9.0, 0.5)).rgb;
  }
  vec3 lit = shade(plain, place);
  if (edges) {
    vec3 width = fwidth(corner);
    vec3 near = smoothstep(vec3(0.0), 1.3 * width, corner);
    float drawn = 1.0 - min(near.x, min(near.y, near.z));
    // Facets of few pixels would be lines alone.
    float room = 1.0 - smoothstep(0.12, 0.55, max(width.x, max(width.y, width.z)));
    lit = mix(lit, line, drawn * mix(0.12, 0.8, room));
  }
  colour = vec4(lit, 1.0);
}
`;

export const CELLS_VERTEX = `
precision highp float;
uniform mat4 modelViewMatrix;
uniform mat4 projectionMatrix;
in vec3 position;
out vec3 place;
out vec3 onSurface;
flat out int facet;
void main() {
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  place = seen.xyz;
  onSurface = position;
  facet = gl_VertexID / 3;
  gl_Position = projectionMatrix * seen;
}
`;

export const CELLS_FRAGMENT = `
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
uniform vec3 back;
uniform vec3 line;
uniform vec3 dot_;
uniform vec3 tintA;
uniform vec3 tintB;
uniform vec3 tintC;
uniform sampler2D seeds;
uniform usampler2D nearest;
uniform int texelsOfFacet;
in vec3 place;
in vec3 onSurface;
flat in int facet;
out vec4 colour;
${SHADE}
vec3 seedAt(uint seed) {
  int width = textureSize(seeds, 0).x;
  return texelFetch(seeds, ivec2(int(seed) % width, int(seed) / width), 0).xyz;
}

uint mixed(uint x) {
  x ^= x >> 16; x *= 0x7feb352du; x ^= x >> 15; x *= 0x846ca68bu; x ^= x >> 16;
  return x;
}

void main() {
  int width = textureSize(nearest, 0).x;
  float first = 1e30;
  float second = 1e30;
  uint owner = 0u;
  vec3 own = vec3(0.0);
  vec3 other = vec3(0.0);
  for (int i = 0; i < texelsOfFacet; i++) {
    int at = facet * texelsOfFacet + i;
    uvec4 four = texelFetch(nearest, ivec2(at % width, at / width), 0);
    for (int j = 0; j < 4; j++) {
      vec3 seed = seedAt(four[j]);
      vec3 away = seed - onSurface;
      float square = dot(away, away);
      if (square < first) {
        second = first; other = own;
        first = square; owner = four[j]; own = seed;
      } else if (square < second && four[j] != owner) {
        second = square; other = seed;
      }
    }
  }
  float pixel = length(fwidth(onSurface)) * 0.6;
  float between = max(length(other - own), 1e-9);
  // How far the plane between the two seeds is.
  float border = (second - first) / (2.0 * between);
  uint hash = mixed(owner);
  float a = float(hash & 1023u) / 1023.0;
  float b = float((hash >> 10) & 1023u) / 1023.0;
  vec3 tint = a < 0.5 ? mix(tintA, tintB, 2.0 * a) : mix(tintB, tintC, 2.0 * a - 1.0);
  vec3 lit = shade(tint * (0.86 + 0.22 * b), place);
  float room = smoothstep(2.0, 9.0, between / pixel);
  lit = mix(lit, line, room * (1.0 - smoothstep(0.45, 1.35, border / pixel)));
  float dots = smoothstep(9.0, 16.0, between / pixel);
  lit = mix(lit, dot_, dots * (1.0 - smoothstep(1.1, 2.1, sqrt(first) / pixel)));
  colour = vec4(lit, 1.0);
}
`;
