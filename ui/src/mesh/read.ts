// Readers of OBJ, PLY, STL and OFF.
//
// Purpose: makes a surface of the bytes of a file. Invariant: coordinates are read to the nearest double; polygons become
// fans; corners of an STL with equal coordinates are one vertex; wrong content is an error that says where. No file makes a
// reader hold more than a small multiple of its size. Must not know: the page, the service; attributes are not kept.

import type { Surface } from "./surface.ts";

/** What this page can show. The service may read more. */
export type ShownFormat = "obj" | "ply" | "stl" | "off";

export const SHOWN: readonly ShownFormat[] = ["ply", "obj", "stl", "off"];

export function isShown(format: string): format is ShownFormat {
  return (SHOWN as readonly string[]).includes(format);
}

/** A file with wrong content. Its message is for people. */
export class BadFile extends Error {}

export function read(bytes: Uint8Array, format: ShownFormat): Surface {
  if (bytes.length === 0) throw new BadFile("the file is empty");
  const surface = readers[format](bytes);
  if (surface.indices.length === 0) throw new BadFile("the file has no facets");
  return withoutLoose(surface);
}

/** Leaves out vertices without a facet: they are no part of the surface. */
function withoutLoose({ positions, indices }: Surface): Surface {
  const count = positions.length / 3;
  const places = new Uint32Array(count);
  for (const vertex of indices) places[vertex] = 1;
  let used = 0;
  for (let vertex = 0; vertex < count; vertex++) {
    if (places[vertex] === 0) continue;
    positions.copyWithin(3 * used, 3 * vertex, 3 * vertex + 3);
    places[vertex] = used++;
  }
  if (used < count) for (let corner = 0; corner < indices.length; corner++) indices[corner] = places[indices[corner]];
  return { positions: positions.slice(0, 3 * used), indices };
}

const readers: Record<ShownFormat, (bytes: Uint8Array) => Surface> = { obj: readObj, ply: readPly, stl: readStl, off: readOff };

// ---- Lists that grow

class Reals {
  private list = new Float64Array(1 << 12);
  length = 0;

  push(x: number): void {
    if (this.length === this.list.length) {
      const longer = new Float64Array(2 * this.list.length);
      longer.set(this.list);
      this.list = longer;
    }
    this.list[this.length++] = x;
  }

  at(i: number): number {
    return this.list[i];
  }

  done(): Float64Array {
    return this.list.slice(0, this.length);
  }
}

class Wholes {
  private list = new Uint32Array(1 << 12);
  length = 0;

  push(x: number): void {
    if (this.length === this.list.length) {
      const longer = new Uint32Array(2 * this.list.length);
      longer.set(this.list);
      this.list = longer;
    }
    this.list[this.length++] = x;
  }

  done(): Uint32Array {
    return this.list.slice(0, this.length);
  }
}

/** Adds a polygon as a fan. */
function fan(facets: Wholes, polygon: readonly number[]): void {
  for (let i = 2; i < polygon.length; i++) {
    facets.push(polygon[0]);
    facets.push(polygon[i - 1]);
    facets.push(polygon[i]);
  }
}

// ---- Text

const LINE = 10;
const HASH = 35;
const isSpace = (byte: number): boolean => byte === 32 || byte === 9 || byte === 13 || byte === 11 || byte === 12;

/** Reads words and numbers out of bytes, without making a text of all of them. */
class Words {
  at = 0;
  line = 1;

  constructor(readonly bytes: Uint8Array) {}

  get isOver(): boolean {
    return this.at >= this.bytes.length;
  }

  fail(what: string): never {
    throw new BadFile(`line ${this.line}: ${what}`);
  }

  /** Moves to the next word of this line; false if there is none. */
  onLine(): boolean {
    const { bytes } = this;
    while (this.at < bytes.length && isSpace(bytes[this.at])) this.at++;
    return this.at < bytes.length && bytes[this.at] !== LINE && bytes[this.at] !== HASH;
  }

  nextLine(): void {
    const { bytes } = this;
    while (this.at < bytes.length && bytes[this.at] !== LINE) this.at++;
    if (this.at < bytes.length) {
      this.at++;
      this.line++;
    }
  }

  /** Moves to the next word, on whatever line; false at the end. */
  anywhere(): boolean {
    while (!this.onLine()) {
      if (this.isOver) return false;
      this.nextLine();
    }
    return true;
  }

  word(): string {
    const begin = this.at;
    const { bytes } = this;
    while (this.at < bytes.length && !isSpace(bytes[this.at]) && bytes[this.at] !== LINE) this.at++;
    // A long word is none that anybody expects.
    return String.fromCharCode(...bytes.subarray(begin, Math.min(this.at, begin + 64)));
  }

  number(): number {
    const { bytes } = this;
    const begin = this.at;
    let at = begin;
    let sign = 1;
    if (bytes[at] === 45) {
      sign = -1;
      at++;
    } else if (bytes[at] === 43) at++;
    let digits = 0;
    let mantissa = 0;
    let exponent = 0;
    for (; bytes[at] >= 48 && bytes[at] <= 57; at++) {
      mantissa = 10 * mantissa + (bytes[at] - 48);
      digits++;
    }
    if (bytes[at] === 46) {
      for (at++; bytes[at] >= 48 && bytes[at] <= 57; at++) {
        mantissa = 10 * mantissa + (bytes[at] - 48);
        digits++;
        exponent--;
      }
    }
    const isEnd = at >= bytes.length || isSpace(bytes[at]) || bytes[at] === LINE;
    // Up to 15 digits and a power of ten that is exact, one division rounds as it must.
    if (isEnd && digits > 0 && digits <= 15 && exponent >= -22) {
      this.at = at;
      return sign * (exponent < 0 ? mantissa / 10 ** -exponent : mantissa);
    }
    const word = this.word();
    const x = word === "" ? NaN : Number(word);
    if (!Number.isFinite(x)) this.fail(`${JSON.stringify(word)} is no finite number`);
    return x;
  }

  whole(): number {
    const x = this.number();
    if (!Number.isInteger(x)) this.fail(`${x} is no whole number`);
    return x;
  }
}

function readObj(bytes: Uint8Array): Surface {
  const words = new Words(bytes);
  const positions = new Reals();
  const facets = new Wholes();
  const polygon: number[] = [];
  while (!words.isOver) {
    if (words.onLine()) {
      const first = bytes[words.at];
      const second = bytes[words.at + 1];
      if (first === 118 && isSpace(second)) {
        words.at++;
        for (let axis = 0; axis < 3; axis++) {
          if (!words.onLine()) words.fail("a vertex has fewer than three coordinates");
          positions.push(words.number());
        }
      } else if (first === 102 && isSpace(second)) {
        words.at++;
        polygon.length = 0;
        while (words.onLine()) {
          const index = corner(words);
          const count = positions.length / 3;
          const vertex = index > 0 ? index - 1 : count + index;
          if (vertex < 0 || vertex >= count || index === 0) words.fail(`there is no vertex ${index}`);
          polygon.push(vertex);
        }
        if (polygon.length < 3) words.fail("a face has fewer than three corners");
        fan(facets, polygon);
      }
    }
    words.nextLine();
  }
  return { positions: positions.done(), indices: facets.done() };
}

/** The vertex of a corner `vertex/texture/normal`. */
function corner(words: Words): number {
  const { bytes } = words;
  let sign = 1;
  if (bytes[words.at] === 45) {
    sign = -1;
    words.at++;
  }
  const begin = words.at;
  let index = 0;
  for (; bytes[words.at] >= 48 && bytes[words.at] <= 57; words.at++) index = 10 * index + (bytes[words.at] - 48);
  if (words.at === begin) words.fail(`${JSON.stringify(words.word())} is no corner of a face`);
  while (words.at < bytes.length && !isSpace(bytes[words.at]) && bytes[words.at] !== LINE) words.at++;
  return sign * index;
}

function readOff(bytes: Uint8Array): Surface {
  const words = new Words(bytes);
  const need = (what: string): void => {
    if (!words.anywhere()) words.fail(`the file ends before ${what}`);
  };
  need("its head");
  const head = words.word();
  if (!/^(ST)?C?N?OFF$/.test(head)) words.fail(`${JSON.stringify(head)} is no head of an OFF file`);
  if (words.onLine() && bytes[words.at] === 66) throw new BadFile("binary OFF files are not shown");
  const counts: number[] = [];
  for (const what of ["vertices", "faces", "edges"]) {
    need(`the number of ${what}`);
    counts.push(words.whole());
  }
  const [vertices, faces] = counts;
  // A vertex takes at least six bytes of text, a face at least eight.
  if (vertices < 0 || faces < 0 || 6 * vertices + 8 * faces > bytes.length + 16) {
    throw new BadFile("the file has fewer bytes than its head says");
  }
  const positions = new Float64Array(3 * vertices);
  for (let vertex = 0; vertex < vertices; vertex++) {
    for (let axis = 0; axis < 3; axis++) {
      need(`vertex ${vertex}`);
      positions[3 * vertex + axis] = words.number();
    }
    words.nextLine();
  }
  const facets = new Wholes();
  const polygon: number[] = [];
  for (let face = 0; face < faces; face++) {
    need(`face ${face}`);
    const corners = words.whole();
    polygon.length = 0;
    for (let i = 0; i < corners; i++) {
      need(`face ${face}`);
      const vertex = words.whole();
      if (vertex < 0 || vertex >= vertices) words.fail(`there is no vertex ${vertex}`);
      polygon.push(vertex);
    }
    fan(facets, polygon);
    words.nextLine();
  }
  return { positions, indices: facets.done() };
}

// ---- STL

function readStl(bytes: Uint8Array): Surface {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const count = bytes.length >= 84 ? view.getUint32(80, true) : -1;
  const merge = new Merge();
  if (count >= 0 && 84 + 50 * count === bytes.length) {
    for (let facet = 0; facet < count; facet++) {
      for (let i = 0; i < 9; i += 3) {
        const at = 84 + 50 * facet + 12 + 4 * i;
        const place = [0, 4, 8].map((offset) => view.getFloat32(at + offset, true));
        if (!place.every(Number.isFinite)) throw new BadFile(`facet ${facet}: a coordinate is not finite`);
        merge.add(place[0], place[1], place[2]);
      }
    }
    return merge.done();
  }
  const words = new Words(bytes);
  if (!words.anywhere() || words.word() !== "solid") {
    throw new BadFile("the file is no STL: it has neither the head of a text nor the size of a binary file");
  }
  words.nextLine();
  while (words.anywhere()) {
    if (words.word() !== "vertex") continue;
    const place: number[] = [];
    for (let axis = 0; axis < 3; axis++) {
      if (!words.onLine()) words.fail("a vertex has fewer than three coordinates");
      place.push(words.number());
    }
    merge.add(place[0], place[1], place[2]);
  }
  if (merge.corners % 3 !== 0) throw new BadFile("the last facet has fewer than three corners");
  return merge.done();
}

/** Corners with equal coordinates become one vertex. Open addressing, since a map of texts would hold far more. */
class Merge {
  private readonly positions = new Reals();
  private readonly facets = new Wholes();
  private slots = new Int32Array(1 << 12).fill(-1);
  private readonly bits = new DataView(new ArrayBuffer(24));

  get corners(): number {
    return this.facets.length;
  }

  add(x: number, y: number, z: number): void {
    // Both zeros are one place.
    const place = [x + 0, y + 0, z + 0];
    let slot = this.slot(place[0], place[1], place[2]);
    while (this.slots[slot] >= 0 && !this.is(this.slots[slot], place)) slot = (slot + 1) & (this.slots.length - 1);
    let vertex = this.slots[slot];
    if (vertex < 0) {
      vertex = this.positions.length / 3;
      this.slots[slot] = vertex;
      for (const x of place) this.positions.push(x);
      if (2 * (vertex + 1) > this.slots.length) this.grow();
    }
    this.facets.push(vertex);
  }

  done(): Surface {
    return { positions: this.positions.done(), indices: this.facets.done() };
  }

  private is(vertex: number, place: readonly number[]): boolean {
    return [0, 1, 2].every((axis) => this.positions.at(3 * vertex + axis) === place[axis]);
  }

  private slot(x: number, y: number, z: number): number {
    const { bits } = this;
    bits.setFloat64(0, x);
    bits.setFloat64(8, y);
    bits.setFloat64(16, z);
    let hash = 0;
    for (let i = 0; i < 24; i += 4) hash = Math.imul(hash ^ bits.getInt32(i), 0x9e3779b1) ^ (hash >>> 15);
    return (hash ^ (hash >>> 13)) & (this.slots.length - 1);
  }

  private grow(): void {
    this.slots = new Int32Array(2 * this.slots.length).fill(-1);
    for (let vertex = 0; 3 * vertex < this.positions.length; vertex++) {
      const at = (axis: number): number => this.positions.at(3 * vertex + axis);
      let slot = this.slot(at(0), at(1), at(2));
      while (this.slots[slot] >= 0) slot = (slot + 1) & (this.slots.length - 1);
      this.slots[slot] = vertex;
    }
  }
}

// ---- PLY

type Scalar = "i8" | "u8" | "i16" | "u16" | "i32" | "u32" | "f32" | "f64";

const SCALARS: Readonly<Record<string, Scalar>> = {
  char: "i8", int8: "i8", uchar: "u8", uint8: "u8", short: "i16", int16: "i16", ushort: "u16", uint16: "u16",
  int: "i32", int32: "i32", uint: "u32", uint32: "u32", float: "f32", float32: "f32", double: "f64", float64: "f64",
};

const SIZES: Readonly<Record<Scalar, number>> = { i8: 1, u8: 1, i16: 2, u16: 2, i32: 4, u32: 4, f32: 4, f64: 8 };

interface Property {
  readonly name: string;
  readonly of: Scalar;
  /** The type of the count, of a list. */
  readonly counted: Scalar | null;
}

interface Element {
  readonly name: string;
  readonly count: number;
  readonly properties: Property[];
}

/** Reads one value after the other. */
interface Source {
  next(of: Scalar): number;
}

function readPly(bytes: Uint8Array): Surface {
  const { elements, form, begin } = head(bytes);
  const source: Source = form === "ascii" ? new TextSource(bytes, begin) : new BinarySource(bytes, begin, form === "binary_little_endian");
  let positions: Float64Array | null = null;
  let facets: Uint32Array | null = null;
  for (const element of elements) {
    // Each property takes at least one byte.
    if (element.count * Math.max(element.properties.length, 1) > bytes.length) {
      throw new BadFile(`the file has fewer bytes than ${element.count} elements "${element.name}" need`);
    }
    if (element.name === "vertex") positions = vertices(element, source);
    else if (element.name === "face") facets = faces(element, source);
    else skip(element, source);
    if (positions && facets) break;
  }
  if (!positions) throw new BadFile("the file has no element \"vertex\"");
  if (!facets) throw new BadFile("the file has no element \"face\"");
  const count = positions.length / 3;
  for (const vertex of facets) if (vertex >= count) throw new BadFile(`a face names vertex ${vertex}, and there are ${count}`);
  return { positions, indices: facets };
}

function head(bytes: Uint8Array): { elements: Element[]; form: string; begin: number } {
  const lines: string[] = [];
  let begin = 0;
  while (lines[lines.length - 1] !== "end_header") {
    const end = bytes.indexOf(LINE, begin);
    if (end < 0 || end > 1 << 20) throw new BadFile("the head of the PLY file does not end");
    lines.push(new TextDecoder().decode(bytes.subarray(begin, end)).trim());
    begin = end + 1;
    if (lines[0] !== "ply") throw new BadFile("the file does not begin with \"ply\"");
  }
  let form = "";
  const elements: Element[] = [];
  for (const line of lines) {
    const words = line.split(/\s+/);
    if (words[0] === "format") form = words[1];
    else if (words[0] === "element") elements.push({ name: words[1], count: Number(words[2]), properties: [] });
    else if (words[0] === "property") {
      const isList = words[1] === "list";
      const of = SCALARS[isList ? words[3] : words[1]];
      const counted = isList ? SCALARS[words[2]] : null;
      const element = elements[elements.length - 1];
      if (!of || counted === undefined || !element) throw new BadFile(`the head of the PLY file has ${JSON.stringify(line)}`);
      element.properties.push({ name: words[isList ? 4 : 2], of, counted });
    }
  }
  if (!["ascii", "binary_little_endian", "binary_big_endian"].includes(form)) throw new BadFile(`the format of the PLY file is ${JSON.stringify(form)}`);
  if (!elements.every(({ count }) => Number.isInteger(count) && count >= 0)) throw new BadFile("a count in the head of the PLY file is no number");
  return { elements, form, begin };
}

class TextSource implements Source {
  private readonly words: Words;

  constructor(bytes: Uint8Array, begin: number) {
    this.words = new Words(bytes);
    this.words.at = begin;
    for (let i = 0; i < begin; i++) if (bytes[i] === LINE) this.words.line++;
  }

  next(): number {
    if (!this.words.anywhere()) this.words.fail("the file ends too early");
    return this.words.number();
  }
}

class BinarySource implements Source {
  private readonly view: DataView;

  constructor(bytes: Uint8Array, private at: number, private readonly little: boolean) {
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  next(of: Scalar): number {
    const { view, at, little } = this;
    this.at += SIZES[of];
    if (this.at > view.byteLength) throw new BadFile("the file ends too early");
    switch (of) {
      case "i8": return view.getInt8(at);
      case "u8": return view.getUint8(at);
      case "i16": return view.getInt16(at, little);
      case "u16": return view.getUint16(at, little);
      case "i32": return view.getInt32(at, little);
      case "u32": return view.getUint32(at, little);
      case "f32": return view.getFloat32(at, little);
      case "f64": return view.getFloat64(at, little);
    }
  }
}

/** Reads past a property. */
function pass(property: Property, source: Source): void {
  const count = property.counted ? source.next(property.counted) : 1;
  for (let i = 0; i < count; i++) source.next(property.of);
}

function skip(element: Element, source: Source): void {
  for (let i = 0; i < element.count; i++) for (const property of element.properties) pass(property, source);
}

function vertices(element: Element, source: Source): Float64Array {
  const axes = element.properties.map(({ name, counted }) => (counted ? -1 : ["x", "y", "z"].indexOf(name)));
  for (const axis of [0, 1, 2]) {
    if (!axes.includes(axis)) throw new BadFile(`the vertices have no ${"xyz"[axis]}`);
  }
  const positions = new Float64Array(3 * element.count);
  for (let vertex = 0; vertex < element.count; vertex++) {
    element.properties.forEach((property, i) => {
      if (axes[i] < 0) return pass(property, source);
      const x = source.next(property.of);
      if (!Number.isFinite(x)) throw new BadFile(`vertex ${vertex}: a coordinate is not finite`);
      positions[3 * vertex + axes[i]] = x;
    });
  }
  return positions;
}

function faces(element: Element, source: Source): Uint32Array {
  const facets = new Wholes();
  const polygon: number[] = [];
  const isCorners = ({ name, counted }: Property): boolean => counted !== null && (name === "vertex_indices" || name === "vertex_index");
  if (!element.properties.some(isCorners)) throw new BadFile("the faces have no vertex_indices");
  for (let face = 0; face < element.count; face++) {
    for (const property of element.properties) {
      if (!isCorners(property) || !property.counted) {
        pass(property, source);
        continue;
      }
      const count = source.next(property.counted);
      polygon.length = 0;
      for (let i = 0; i < count; i++) {
        const vertex = source.next(property.of);
        if (!Number.isInteger(vertex) || vertex < 0) throw new BadFile(`face ${face}: there is no vertex ${vertex}`);
        polygon.push(vertex);
      }
      fan(facets, polygon);
    }
  }
  return facets.done();
}
