// The part of three.js that its loaders use.
//
// Purpose: the build gives this module to the loaders of PLY, OBJ and STL in place of "three", so that the worker holds no
// scene. Invariant: attributes keep double precision. Must not know: files, how a surface is drawn.

export { Color } from "three/src/math/Color.js";
export { SRGBColorSpace } from "three/src/constants.js";
export { Vector3 } from "three/src/math/Vector3.js";

type Numbers = ArrayLike<number>;

/** Holds the numbers as the loader read them. */
export class BufferAttribute {
  constructor(readonly array: Numbers) {}
}
export {
  BufferAttribute as Float32BufferAttribute, BufferAttribute as Int8BufferAttribute, BufferAttribute as Int16BufferAttribute,
  BufferAttribute as Int32BufferAttribute, BufferAttribute as Uint8BufferAttribute, BufferAttribute as Uint16BufferAttribute,
  BufferAttribute as Uint32BufferAttribute,
};

export class BufferGeometry {
  readonly attributes: Record<string, BufferAttribute> = {};
  readonly userData: Record<string, unknown> = {};
  index: { readonly array: Numbers } | null = null;

  /** Keeps the position. Nothing else is shown. */
  setAttribute(name: string, attribute: BufferAttribute): void {
    if (name === "position") this.attributes[name] = attribute;
  }

  setIndex(array: Numbers): void {
    this.index = { array };
  }

  /** The position keeps its index. */
  toNonIndexed(): this {
    return this;
  }

  addGroup(): void {}
  computeBoundingSphere(): void {}
}

export class Loader {}
export { Loader as FileLoader };

export class Group {
  readonly children: Drawn[] = [];

  add(child: Drawn): void {
    this.children.push(child);
  }
}

class Drawn {
  constructor(readonly geometry: BufferGeometry) {}
}
export class Mesh extends Drawn {
  readonly isMesh = true;
}
export { Drawn as LineSegments, Drawn as Points };

export class Material {}
export { Material as LineBasicMaterial, Material as MeshPhongMaterial, Material as PointsMaterial };
