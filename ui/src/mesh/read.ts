// Readers of OBJ, PLY, STL and OFF.
//
// Purpose: makes a surface of the bytes of a file, by the loaders of three.js; OFF has none. Invariant: every index is that of
// a vertex and every coordinate is finite, else the file is refused; polygons become fans; corners of OBJ and STL with equal
// coordinates are one vertex. Must not know: the page, the service. Attributes are not kept.

import { OBJLoader } from "three/examples/jsm/loaders/OBJLoader.js";
import { PLYLoader } from "three/examples/jsm/loaders/PLYLoader.js";
import { STLLoader } from "three/examples/jsm/loaders/STLLoader.js";

import type { ShownFormat } from "./formats.ts";
import type { Surface } from "./surface.ts";

/** A file that cannot be shown. Its message is for people. */
export class BadFile extends Error {}

type Numbers = ArrayLike<number>;

/** Corners of facets: three coordinates each, or indices of such. */
interface Read {
  readonly positions: Numbers;
  readonly indices: Numbers | null;
}

const readers: Record<ShownFormat, (bytes: Uint8Array<ArrayBuffer>) => Read> = { obj: readObj, ply: readPly, stl: readStl, off: readOff };

/** Corners of a loose file have vertices of their own. */
export function read(bytes: Uint8Array<ArrayBuffer>, format: ShownFormat, isLoose = false): Surface {
  const { positions, indices } = parse(bytes, format);
  for (let i = 0; i < positions.length; i++) {
    if (!Number.isFinite(positions[i])) throw new BadFile("a coordinate is no finite number, or a face names a vertex that is not there");
  }
  if ((indices ?? positions).length === 0) throw new BadFile("the file has no facets");
  const surface = indices && !isLoose ? used(positions, indices) : merged(indices ? cornersAt(positions, indices) : positions);
  if (surface.indices.length % 3 !== 0) throw new BadFile("a facet has fewer than three corners");
  return surface;
}

/** Whatever a loader trips over, the file is damaged, unless memory ended. */
function parse(bytes: Uint8Array<ArrayBuffer>, format: ShownFormat): Read {
  try {
    return readers[format](bytes);
  } catch (error) {
    const isFull = error instanceof RangeError && /memory|alloc|array length|string length/i.test(error.message);
    if (error instanceof BadFile || isFull) throw error;
    throw new BadFile(`it is no ${format.toUpperCase()} file, or it is damaged`);
  }
}

function readObj(bytes: Uint8Array): Read {
  const parts = new OBJLoader().parse(textOf(bytes)).children.flatMap((part) =>
    "isMesh" in part && "geometry" in part ? [(part.geometry as Geometry).attributes["position"]!.array] : []);
  if (parts.length === 1) return { positions: parts[0]!, indices: null };
  const positions = new Float64Array(parts.reduce((sum, part) => sum + part.length, 0));
  let length = 0;
  for (const part of parts) {
    positions.set(part, length);
    length += part.length;
  }
  return { positions, indices: null };
}

interface Geometry {
  readonly attributes: Readonly<Record<string, { readonly array: Numbers }>>;
  readonly index: { readonly array: Numbers } | null;
}

function readPly({ buffer, length }: Uint8Array<ArrayBuffer>): Read {
  const head = new TextDecoder("latin1").decode(new Uint8Array(buffer, 0, Math.min(length, 1 << 16)));
  // The loader begins what a head promises, whatever is there. Each element takes at least a byte.
  const counts = [...head.split("end_header")[0]!.matchAll(/^element\s+(\S+)\s+(\d+)/gm)].map(([, name, count]) => [name, Number(count)] as const);
  if (counts.reduce((sum, [, count]) => sum + count, 0) > length) throw new BadFile("the file is shorter than its head says");
  const { attributes, index } = new PLYLoader().parse(buffer) as unknown as Geometry;
  const indices = index?.array ?? [];
  // The loader leaves out larger polygons.
  const faces = counts.find(([name]) => name === "face")?.[1] ?? 0;
  if (indices.length < 3 * faces) throw new BadFile("the file ends early, or has faces that are neither triangles nor quadrilaterals");
  return { positions: attributes["position"]!.array, indices };
}

function readStl({ buffer }: Uint8Array<ArrayBuffer>): Read {
  const { attributes } = new STLLoader().parse(buffer) as unknown as Geometry;
  return { positions: attributes["position"]!.array, indices: null };
}

/** Text with the counts, a line for each vertex and one for each face. */
function readOff(bytes: Uint8Array): Read {
  const lines = linesOf(textOf(bytes));
  const [head, ...rest] = next(lines);
  if (!/^(ST)?C?N?OFF$/.test(head ?? "")) throw new BadFile("it is no OFF file");
  if (rest[0] === "BINARY") throw new BadFile("binary OFF files are not shown");
  const [vertices, faces] = (rest.length > 0 ? rest : next(lines)).map(Number);
  if (!(vertices! + faces! < bytes.length)) throw new BadFile("the file is shorter than its head says");
  const positions = new Float64Array(3 * vertices!);
  for (let vertex = 0; vertex < vertices!; vertex++) {
    const words = next(lines);
    for (let axis = 0; axis < 3; axis++) positions[3 * vertex + axis] = Number(words[axis]);
  }
  const indices: number[] = [];
  for (let face = 0; face < faces!; face++) {
    const [corners, ...polygon] = next(lines).map(Number);
    for (let i = 2; i < corners!; i++) indices.push(polygon[0]!, polygon[i - 1]!, polygon[i]!);
  }
  return { positions, indices };
}

/** The words of each line that has some, without comments. */
function* linesOf(text: string): Generator<string[]> {
  for (let begin = 0; begin < text.length; ) {
    const end = text.indexOf("\n", begin);
    const line = text.slice(begin, end < 0 ? text.length : end).replace(/#.*/, "").trim();
    if (line !== "") yield line.split(/\s+/);
    begin = end < 0 ? text.length : end + 1;
  }
}

function next(lines: Generator<string[]>): string[] {
  const { value, done } = lines.next();
  if (done) throw new BadFile("the file ends early");
  return value;
}

function textOf(bytes: Uint8Array): string {
  return new TextDecoder().decode(bytes);
}

/** Leaves out vertices without a facet: they are no part of the surface. */
function used(positions: Numbers, corners: Numbers): Surface {
  const count = positions.length / 3;
  const indices = Uint32Array.from(corners);
  const places = new Uint32Array(count);
  for (let corner = 0; corner < indices.length; corner++) {
    if (indices[corner] !== corners[corner] || indices[corner]! >= count) throw new BadFile(`a face names vertex ${corners[corner]}, and the file has ${count}`);
    places[indices[corner]!] = 1;
  }
  let length = 0;
  const kept = new Float64Array(positions.length);
  for (let vertex = 0; vertex < count; vertex++) {
    if (places[vertex] === 0) continue;
    for (let axis = 0; axis < 3; axis++) kept[3 * length + axis] = positions[3 * vertex + axis]!;
    places[vertex] = length++;
  }
  for (let corner = 0; corner < indices.length; corner++) indices[corner] = places[indices[corner]!]!;
  return { positions: kept.slice(0, 3 * length), indices };
}

function cornersAt(positions: Numbers, indices: Numbers): Float64Array {
  return Float64Array.from({ length: 3 * indices.length }, (_, i) => positions[3 * indices[Math.floor(i / 3)]! + (i % 3)]!);
}

/** Corners with equal coordinates become one vertex. Open addressing, since a map of texts would hold far more. */
function merged(corners: Numbers): Surface {
  const count = corners.length / 3;
  const slots = new Int32Array(2 ** Math.ceil(Math.log2(2 * count + 1))).fill(-1);
  const positions = new Float64Array(corners.length);
  const indices = new Uint32Array(count);
  const place = new Float64Array(3);
  const bits = new Int32Array(place.buffer);
  let length = 0;
  for (let corner = 0; corner < count; corner++) {
    // Both zeros are one place.
    for (let axis = 0; axis < 3; axis++) place[axis] = corners[3 * corner + axis]! + 0;
    let hash = 0;
    for (const word of bits) hash = Math.imul(hash ^ word, 0x9e3779b1) ^ (hash >>> 15);
    const isOther = (at: number): boolean => positions[at] !== place[0] || positions[at + 1] !== place[1] || positions[at + 2] !== place[2];
    let slot = (hash ^ (hash >>> 13)) & (slots.length - 1);
    while (slots[slot]! >= 0 && isOther(3 * slots[slot]!)) slot = (slot + 1) & (slots.length - 1);
    if (slots[slot]! < 0) {
      slots[slot] = length;
      positions.set(place, 3 * length++);
    }
    indices[corner] = slots[slot]!;
  }
  return { positions: positions.slice(0, 3 * length), indices };
}
