// The camera of both views.
//
// Purpose: one place from which both surfaces are seen, turned by pointers, fingers and keys. Invariant: both views always
// have the same camera. Must not know: what is drawn.

import { Quaternion, Vector3 } from "three";

/** Radians of a key, and of a pixel. */
const KEY_TURN = Math.PI / 24;
const DRAG_TURN = 0.008;
const ZOOM = 1.15;

export class Camera {
  readonly turn = new Quaternion();
  /** What is looked at, beside the centre, in the plane of the view. */
  readonly shift = new Vector3();
  zoom = 1;
  /** What is in view at zoom 1 reaches so far from the centre. */
  radius = 0.5;
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
    this.turn.identity();
    this.rotate(-0.45, 0.22);
    this.shift.set(0, 0, 0);
    this.zoom = 1;
    this.tell();
  }

  /** Turns the surface about the axes of the screen. */
  rotate(right: number, down: number): void {
    const about = new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), right);
    about.multiply(new Quaternion().setFromAxisAngle(new Vector3(1, 0, 0), down));
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

  magnify(by: number): void {
    this.zoom = Math.min(Math.max(this.zoom * by, 0.2), 200);
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
    // The wheel scrolls the page until the view is chosen.
    element.addEventListener("wheel", (event) => {
      if (document.activeElement !== element && !event.ctrlKey) return;
      event.preventDefault();
      this.magnify(Math.exp(-event.deltaY * (event.deltaMode === 0 ? 0.0015 : 0.05)));
    }, { passive: false });
    element.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (this.key(event.key, event.shiftKey)) event.preventDefault();
    });
  }

  private key(key: string, isShift: boolean): boolean {
    const arrows: Readonly<Record<string, readonly [number, number]>> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const arrow = arrows[key];
    if (arrow && isShift) this.pan(0.05 * arrow[0], -0.05 * arrow[1]);
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
