// The camera of both views.
//
// Purpose: one place from which both surfaces are seen, turned by pointers, fingers and keys. Invariant: both views always
// have the same camera. Must not know: what is drawn.

import { Quaternion, Vector3 } from "three";

/** Radians of a key, and of a pixel. */
const KEY_TURN = Math.PI / 24;
const DRAG_TURN = 0.008;
const ZOOM = 1.15;

/** Which axis of the file is up in the first view. */
export type Up = "y" | "z";

/** Turns about the upright axis and towards the viewer, of the first view and of standard ones. */
const ISO = Math.atan(Math.SQRT1_2);
export const STANDPOINTS = {
  first: [-0.45, 0.22],
  front: [0, 0],
  top: [0, Math.PI / 2],
  side: [-Math.PI / 2, 0],
  iso: [-Math.PI / 4, ISO],
} as const;

export type Standpoint = keyof typeof STANDPOINTS;

const VIEW_KEYS: Readonly<Record<string, Standpoint>> = { "1": "front", "2": "top", "3": "side", "4": "iso" };

const X = new Vector3(1, 0, 0);
const Y = new Vector3(0, 1, 0);

export class Camera {
  readonly turn = new Quaternion();
  /** What is looked at, beside the centre, in the plane of the view. */
  readonly shift = new Vector3();
  zoom = 1;
  /** What is in view at zoom 1 reaches so far from the centre. */
  radius = 0.5;
  private up: Up = "y";
  private readonly listeners: (() => void)[] = [];

  constructor() {
    this.reset();
  }

  onChange(listener: () => void): void {
    this.listeners.push(listener);
  }

  /** Looks at a surface of this size, from the place of the beginning. */
  fit(radius: number): void {
    this.radius = radius > 0 ? radius : 0.5;
    this.reset();
  }

  reset(): void {
    this.stand("first");
  }

  /** Looks at the whole surface from a standard place. */
  stand(where: Standpoint): void {
    const [around, down] = STANDPOINTS[where];
    this.turn.setFromAxisAngle(X, down).multiply(new Quaternion().setFromAxisAngle(Y, around));
    if (this.up === "z") this.turn.multiply(new Quaternion().setFromAxisAngle(X, -Math.PI / 2));
    this.shift.set(0, 0, 0);
    this.zoom = 1;
    this.tell();
  }

  upright(up: Up): void {
    this.up = up;
    this.reset();
  }

  /** Turns the surface about the axes of the screen. */
  rotate(right: number, down: number): void {
    const about = new Quaternion().setFromAxisAngle(Y, right);
    about.multiply(new Quaternion().setFromAxisAngle(X, down));
    this.turn.premultiply(about).normalize();
    this.tell();
  }

  roll(angle: number): void {
    this.turn.premultiply(new Quaternion().setFromAxisAngle(new Vector3(0, 0, 1), angle));
    this.tell();
  }

  /** By parts of the view's height. */
  pan(right: number, up: number): void {
    this.shift.x -= right / this.zoom;
    this.shift.y -= up / this.zoom;
    this.tell();
  }

  /** About a place in the view, in parts of its height from the middle. What is there stays there. */
  magnify(by: number, right = 0, up = 0): void {
    const before = this.zoom;
    this.zoom = Math.min(Math.max(before * by, 0.2), 200);
    const change = 1 / before - 1 / this.zoom;
    this.shift.x += right * change;
    this.shift.y += up * change;
    this.tell();
  }

  /** Lets pointers and keys on an element move the camera. */
  control(element: HTMLElement): void {
    const pointers = new Map<number, { x: number; y: number }>();
    element.addEventListener("pointerdown", (event) => {
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      element.setPointerCapture(event.pointerId);
    });
    const end = (event: PointerEvent): void => void pointers.delete(event.pointerId);
    element.addEventListener("pointerup", end);
    element.addEventListener("pointercancel", end);
    element.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const dx = event.clientX - before.x;
      const dy = event.clientY - before.y;
      const height = element.clientHeight || 1;
      if (pointers.size === 2) {
        const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1] ?? before;
        const was = Math.hypot(before.x - other.x, before.y - other.y);
        const is = Math.hypot(event.clientX - other.x, event.clientY - other.y);
        if (was > 0 && is > 0) this.magnify(is / was);
        this.pan(dx / 2 / height, -dy / 2 / height);
      } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) this.pan(dx / height, -dy / height);
      else this.rotate(dx * DRAG_TURN, dy * DRAG_TURN);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("wheel", (event) => {
      event.preventDefault();
      const box = element.getBoundingClientRect();
      const [right, up] = [event.clientX - box.left - box.width / 2, box.top + box.height / 2 - event.clientY];
      this.magnify(Math.exp(-event.deltaY * (event.deltaMode === 0 ? 0.0015 : 0.05)), right / (box.height || 1), up / (box.height || 1));
    }, { passive: false });
    element.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (this.key(event.key, event.shiftKey)) event.preventDefault();
    });
  }

  private key(key: string, isShift: boolean): boolean {
    const arrows: Readonly<Record<string, readonly [number, number]>> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const arrow = arrows[key];
    const standpoint = VIEW_KEYS[key];
    if (standpoint) this.stand(standpoint);
    else if (arrow && isShift) this.pan(0.05 * arrow[0], -0.05 * arrow[1]);
    else if (arrow) this.rotate(KEY_TURN * arrow[0], KEY_TURN * arrow[1]);
    else if (key === "+" || key === "=") this.magnify(ZOOM);
    else if (key === "-") this.magnify(1 / ZOOM);
    else if (key === ",") this.roll(KEY_TURN);
    else if (key === ".") this.roll(-KEY_TURN);
    else if (key === "0" || key === "Home") this.reset();
    else return false;
    return true;
  }

  private tell(): void {
    for (const listener of this.listeners) listener();
  }
}
