// A view of a surface.
//
// Purpose: draws one surface on a canvas, plain, coloured by values, or as cells. Invariant: it draws when something changed and
// never else; what is replaced on the graphics card is given back. Must not know: files, the service, the other view.

import {
  BufferAttribute, BufferGeometry, DataTexture, DoubleSide, FloatType, GLSL3, LinearFilter, Mesh, NearestFilter, PerspectiveCamera,
  RawShaderMaterial, RGBAFormat, RGBAIntegerFormat, Scene, Sphere, UnsignedByteType, UnsignedIntType, Vector2, Vector3, WebGLRenderer,
  Color, type Texture,
} from "three";

import { Camera } from "./camera.ts";
import { texels, type Scale } from "./colours.ts";
import { CELLS_FRAGMENT, CELLS_VERTEX, SURFACE_FRAGMENT, SURFACE_VERTEX } from "./shaders.ts";
import type { Cells } from "./tasks.ts";

export { Camera };

/** Texels in a row of a texture that holds a list. */
const ROW = 2048;

const FIELD_DEG = 30;

/** What colours a surface. */
export interface Colouring {
  readonly values: Float32Array<ArrayBuffer>;
  readonly scale: Scale;
  readonly range: readonly [number, number];
}

/** Colours of the page that a view needs. */
export interface Theme {
  readonly base: string;
  readonly back: string;
  readonly line: string;
  readonly tints: readonly [string, string, string];
  readonly dot: string;
}

export class View {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly eye = new PerspectiveCamera(FIELD_DEG, 1, 0.01, 100);
  private readonly surface: Mesh<BufferGeometry, RawShaderMaterial>;
  private readonly cells: Mesh<BufferGeometry, RawShaderMaterial>;
  private hasCells = false;
  private showsCells = false;
  private isAsked = false;
  private readonly scales = new Map<Scale, DataTexture>();

  /** Throws if there is no WebGL. */
  constructor(private readonly canvas: HTMLCanvasElement, private readonly camera: Camera) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: "high-performance" });
    this.renderer.setClearColor(0, 0);
    this.surface = new Mesh(empty(), material(SURFACE_VERTEX, SURFACE_FRAGMENT, {
      base: new Color(), back: new Color(), line: new Color(), coloured: false, edges: false, range: new Vector2(0, 1), scale: null,
    }));
    this.cells = new Mesh(empty(), material(CELLS_VERTEX, CELLS_FRAGMENT, {
      back: new Color(), line: new Color(), dot_: new Color(), tintA: new Color(), tintB: new Color(), tintC: new Color(),
      seeds: null, nearest: null, texelsOfFacet: 0,
    }));
    this.scene.add(this.surface, this.cells);
    for (const mesh of [this.surface, this.cells]) mesh.frustumCulled = false;
    this.surface.visible = false;
    this.cells.visible = false;
    camera.onChange(() => this.ask());
    camera.control(canvas);
    new ResizeObserver(() => this.resize()).observe(canvas);
    canvas.addEventListener("webglcontextrestored", () => this.ask());
    this.resize();
  }

  /** Shows these corners, or nothing. */
  show(corners: Float32Array<ArrayBuffer> | null): void {
    this.dropCells();
    replace(this.surface, corners ? geometry(corners) : empty());
    this.surface.material.uniforms["coloured"]!.value = false;
    this.surface.visible = corners !== null;
    this.ask();
  }

  colour(colouring: Colouring | null): void {
    const { uniforms } = this.surface.material;
    uniforms["coloured"]!.value = colouring !== null;
    if (colouring) {
      const { values, scale, range } = colouring;
      const old = this.surface.geometry.getAttribute("value") as BufferAttribute | undefined;
      if (old?.array !== values) {
        const corners = (this.surface.geometry.getAttribute("position") as BufferAttribute).array as Float32Array<ArrayBuffer>;
        replace(this.surface, geometry(corners, values));
      }
      uniforms["scale"]!.value = this.scale(scale);
      (uniforms["range"]!.value as Vector2).set(range[0], range[1]);
    }
    this.ask();
  }

  edges(isShown: boolean): void {
    this.surface.material.uniforms["edges"]!.value = isShown;
    this.ask();
  }

  /** Shows cells in place of the surface, if there are any. */
  asCells(isShown: boolean): void {
    this.showsCells = isShown;
    this.choose();
  }

  /** Takes cells. */
  setCells(cells: Cells): void {
    const { uniforms } = this.cells.material;
    if (cells.corners) replace(this.cells, geometry(cells.corners));
    give(uniforms, "seeds", list(cells.seeds, 4, FloatType));
    give(uniforms, "nearest", list(cells.nearest, 4, UnsignedIntType));
    uniforms["texelsOfFacet"]!.value = cells.k / 4;
    this.hasCells = true;
    this.choose();
  }

  dropCells(): void {
    if (!this.hasCells) return;
    this.hasCells = false;
    replace(this.cells, empty());
    give(this.cells.material.uniforms, "seeds", null);
    give(this.cells.material.uniforms, "nearest", null);
    this.choose();
  }

  theme(theme: Theme): void {
    const ofSurface = this.surface.material.uniforms;
    const ofCells = this.cells.material.uniforms;
    const set = (uniform: { value: unknown }, colour: string): void => {
      // The shaders work in the colours of the screen.
      const [r, g, b] = channels(colour);
      (uniform.value as Color).setRGB(r, g, b);
    };
    set(ofSurface["base"]!, theme.base);
    for (const uniforms of [ofSurface, ofCells]) {
      set(uniforms["back"]!, theme.back);
      set(uniforms["line"]!, theme.line);
    }
    set(ofCells["dot_"]!, theme.dot);
    set(ofCells["tintA"]!, theme.tints[0]);
    set(ofCells["tintB"]!, theme.tints[1]);
    set(ofCells["tintC"]!, theme.tints[2]);
    this.ask();
  }

  private choose(): void {
    const isCells = this.showsCells && this.hasCells;
    this.cells.visible = isCells;
    const hasSurface = (this.surface.geometry.getAttribute("position")?.count ?? 0) > 0;
    this.surface.visible = hasSurface && !isCells;
    this.ask();
  }

  private scale(scale: Scale): DataTexture {
    let texture = this.scales.get(scale);
    if (!texture) {
      texture = new DataTexture(texels(scale), scale.stops.length, 1, RGBAFormat, UnsignedByteType);
      texture.magFilter = LinearFilter;
      texture.minFilter = LinearFilter;
      texture.needsUpdate = true;
      this.scales.set(scale, texture);
    }
    return texture;
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.eye.aspect = width / height;
    this.ask();
  }

  private ask(): void {
    if (this.isAsked) return;
    this.isAsked = true;
    requestAnimationFrame(() => {
      this.isAsked = false;
      this.draw();
    });
  }

  private draw(): void {
    const { camera, eye } = this;
    // The ball around the surface fits the narrower side.
    const half = (Math.PI * FIELD_DEG) / 360;
    const distance = (1.03 * camera.radius) / Math.sin(Math.min(half, Math.atan(Math.tan(half) * eye.aspect)));
    eye.zoom = camera.zoom;
    eye.near = Math.max(distance - 2, 0.02);
    eye.far = distance + 2;
    const height = 2 * distance * Math.tan(half);
    eye.position.copy(new Vector3(camera.shift.x * height, camera.shift.y * height, distance));
    eye.updateProjectionMatrix();
    for (const mesh of [this.surface, this.cells]) mesh.quaternion.copy(camera.turn);
    this.renderer.render(this.scene, eye);
  }
}

function empty(): BufferGeometry {
  return geometry(new Float32Array(0));
}

function geometry(corners: Float32Array<ArrayBuffer>, values?: Float32Array<ArrayBuffer>): BufferGeometry {
  const made = new BufferGeometry();
  made.setAttribute("position", new BufferAttribute(corners, 3));
  if (values) made.setAttribute("value", new BufferAttribute(values, 1));
  made.boundingSphere = new Sphere(new Vector3(), 1);
  return made;
}

function replace(mesh: Mesh<BufferGeometry, RawShaderMaterial>, made: BufferGeometry): void {
  mesh.geometry.dispose();
  mesh.geometry = made;
}

function material(vertexShader: string, fragmentShader: string, values: Record<string, unknown>): RawShaderMaterial {
  const uniforms = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, { value }]));
  return new RawShaderMaterial({ glslVersion: GLSL3, vertexShader, fragmentShader, uniforms, side: DoubleSide });
}

/** A list as a texture, four numbers a texel. */
function list(values: Float32Array<ArrayBuffer> | Uint32Array<ArrayBuffer>, channels: number, type: typeof FloatType | typeof UnsignedIntType): Texture {
  const count = values.length / channels;
  const height = Math.max(Math.ceil(count / ROW), 1);
  let full = values;
  if (values.length !== ROW * height * channels) {
    full = values instanceof Float32Array ? new Float32Array(ROW * height * channels) : new Uint32Array(ROW * height * channels);
    full.set(values);
  }
  const isWhole = type === UnsignedIntType;
  const texture = new DataTexture(full, ROW, height, isWhole ? RGBAIntegerFormat : RGBAFormat, type);
  texture.internalFormat = isWhole ? "RGBA32UI" : "RGBA32F";
  texture.minFilter = NearestFilter;
  texture.magFilter = NearestFilter;
  texture.unpackAlignment = 4;
  texture.needsUpdate = true;
  return texture;
}

/** Replaces a texture. */
function give(uniforms: Record<string, { value: unknown }>, name: string, texture: Texture | null): void {
  const uniform = uniforms[name];
  if (!uniform) return;
  (uniform.value as Texture | null)?.dispose();
  uniform.value = texture;
}

/** The channels of `#rrggbb`, 0 to 1. */
function channels(colour: string): [number, number, number] {
  const hex = /^#([0-9a-f]{6})$/i.exec(colour.trim())?.[1] ?? "888888";
  return [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255) as [number, number, number];
}
