// The two views, side by side or under a slider.
//
// Purpose: keeps what both views show, and colours them as the toolbar says. Invariant: a colouring that is not there cannot be
// chosen, nor a slider between fewer than two surfaces; both views share one scale and one camera. Without WebGL it says so and shows nothing. Must not know: files, the
// service.

import type { Camera, Standpoint, Up } from "./camera.ts";
import { DISTANCE, gradient, QUALITY, type Scale } from "./colours.ts";
import { make, the } from "./dom.ts";
import type { Cells, Compared, Loaded, Side } from "./tasks.ts";
import type { Colouring, Theme, View } from "./view.ts";
import { count, figure } from "./words.ts";

type Mode = "plain" | "cells" | "quality" | "distance";

const MODES: readonly Mode[] = ["plain", "cells", "quality", "distance"];
const SIDES: readonly Side[] = ["input", "result"];

export class Stage {
  /** Whether meshes can be shown. The views come after the page. */
  readonly canDraw: Promise<boolean>;
  private camera: Camera | null = null;
  private readonly views: Record<Side, View | null> = { input: null, result: null };
  private readonly shown: Record<Side, Loaded | null> = { input: null, result: null };
  private compared: Compared | null = null;
  private cellCount = 0;
  private expectsCells = false;
  /** Whose cells: of the points of a step, or of the vertices of the result. */
  private cellsOf = "seed";
  private isSlider = false;
  private readonly area = the("views", HTMLElement);
  private mode: Mode = "plain";
  /** Whether a person chose the mode. */
  private isChosen = false;

  constructor() {
    this.canDraw = this.open();
    for (const mode of MODES) {
      this.radio(mode).addEventListener("change", () => {
        this.isChosen = true;
        this.mode = mode;
        this.paint();
      });
    }
    const edges = the("edges", HTMLInputElement);
    edges.addEventListener("change", () => this.each((view) => view.edges(edges.checked)));
    the("reset", HTMLButtonElement).addEventListener("click", () => this.camera?.reset());
    for (const button of document.querySelectorAll<HTMLElement>("[data-stand]")) {
      button.addEventListener("click", () => this.camera?.stand(button.dataset["stand"] as Standpoint));
    }
    const up = the("up", HTMLSelectElement);
    up.addEventListener("change", () => this.camera?.upright(up.value as Up));
    for (const layout of ["pair", "slider"]) {
      the(`layout-${layout}`, HTMLInputElement).addEventListener("change", () => {
        this.isSlider = layout === "slider";
        this.paint();
      });
    }
    const split = the("split", HTMLInputElement);
    const divide = (): void => this.area.style.setProperty("--split", split.value);
    split.addEventListener("input", divide);
    divide();
    this.fullScreen();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.theme());
    this.paint();
  }

  private fullScreen(): void {
    const button = the("full", HTMLButtonElement);
    const viewer = the("viewer", HTMLElement);
    button.hidden = !document.fullscreenEnabled;
    button.addEventListener("click", () => void (document.fullscreenElement ? document.exitFullscreen() : viewer.requestFullscreen()));
    document.addEventListener("fullscreenchange", () => {
      button.textContent = document.fullscreenElement ? "Leave full screen" : "Full screen";
    });
  }

  /** Invites to a first mesh, in place of empty views; or no longer. */
  welcome(isEmpty: boolean): void {
    this.area.toggleAttribute("data-empty", isEmpty);
    the("welcome", HTMLElement).hidden = !isEmpty;
    the("stage", HTMLElement).toggleAttribute("data-empty", isEmpty);
  }

  /** Fetches and begins the views. */
  private async open(): Promise<boolean> {
    const note = the("no-webgl", HTMLElement);
    try {
      const { Camera, View } = await import("./view.ts").catch((error: unknown) => {
        note.textContent = "The views could not be loaded, so meshes are not shown. Remeshing and the download work.";
        throw error;
      });
      const camera = new Camera();
      for (const side of SIDES) this.views[side] = new View(the(`${side}-canvas`, HTMLCanvasElement), camera);
      camera.upright(the("up", HTMLSelectElement).value as Up);
      this.camera = camera;
    } catch {
      this.views.input = null;
      this.views.result = null;
      note.hidden = false;
      the("stage", HTMLElement).toggleAttribute("data-flat", true);
      return false;
    }
    this.theme();
    this.each((view) => view.edges(the("edges", HTMLInputElement).checked));
    return true;
  }

  /** Shows nothing on a side, and says why. */
  clear(side: Side, why: string): void {
    this.shown[side] = null;
    this.compared = null;
    if (side === "input") {
      this.cellCount = 0;
      this.expectsCells = false;
    }
    this.views[side]?.show(null);
    this.note(side, why);
    the(`${side}-counts`, HTMLElement).textContent = "";
    this.paint();
  }

  show(side: Side, loaded: Loaded): void {
    this.shown[side] = loaded;
    this.compared = null;
    if (side === "input") this.cellCount = 0;
    this.views[side]?.show(loaded.corners);
    this.note(side, "");
    the(`${side}-counts`, HTMLElement).textContent = `${count(loaded.vertices)} vertices, ${count(loaded.facets)} facets`;
    if (side === "input" || this.shown.input === null) this.camera?.fit(loaded.radius);
    if (side === "result") this.prefer("quality");
    this.paint();
  }

  /** Cells will come. */
  expectCells(): void {
    this.expectsCells = true;
    this.isChosen = false;
    this.prefer("cells");
    this.paint();
  }

  /** Cells of another job say nothing of this one. */
  forgetCells(): void {
    this.cellCount = 0;
    this.views.input?.dropCells();
    this.paint();
  }

  get hasCells(): boolean {
    return this.cellCount > 0;
  }

  cells(cells: Cells, of = "seed"): void {
    this.views.input?.setCells(cells);
    this.cellCount = cells.count;
    this.cellsOf = of;
    this.paint();
  }

  compare(compared: Compared): void {
    this.compared = compared;
    this.paint();
  }

  /** Takes a mode if no person chose one. */
  private prefer(mode: Mode): void {
    if (!this.isChosen) this.mode = mode;
  }

  private has(mode: Mode): boolean {
    switch (mode) {
      case "plain": return true;
      case "cells": return this.expectsCells || this.cellCount > 0;
      case "quality": return this.shown.input !== null || this.shown.result !== null;
      case "distance": return this.compared !== null;
    }
  }

  private paint(): void {
    if (!this.has(this.mode)) this.mode = "plain";
    const isPair = this.shown.input !== null && this.shown.result !== null;
    the("layout-slider", HTMLInputElement).disabled = !isPair;
    the(this.isSlider && isPair ? "layout-slider" : "layout-pair", HTMLInputElement).checked = true;
    this.area.toggleAttribute("data-slider", this.isSlider && isPair);
    the("split", HTMLInputElement).hidden = !(this.isSlider && isPair);
    for (const mode of MODES) {
      this.radio(mode).disabled = !this.camera || !this.has(mode);
      this.radio(mode).checked = mode === this.mode;
    }
    this.views.input?.asCells(this.mode === "cells");
    for (const side of SIDES) {
      const colouring = this.colouring(side);
      if (this.shown[side]) this.views[side]?.colour(colouring);
      this.legend(side, colouring);
    }
  }

  private colouring(side: Side): Colouring | null {
    const loaded = this.shown[side];
    if (!loaded) return null;
    if (this.mode === "quality") return { values: loaded.quality, scale: QUALITY, range: [0, 1] };
    if (this.mode === "distance" && this.compared) {
      const { inputFigures, resultFigures } = this.compared;
      // A few far vertices would leave all others one colour.
      const most = Math.max(inputFigures.most, resultFigures.most) || Math.max(inputFigures.largest, resultFigures.largest, 1e-9);
      return { values: this.compared[side], scale: DISTANCE, range: [0, most] };
    }
    return null;
  }

  private legend(side: Side, colouring: Colouring | null): void {
    const element = the(`${side}-legend`, HTMLElement);
    const loaded = this.shown[side];
    if (!loaded) return element.replaceChildren();
    if (!colouring) {
      const isCells = this.mode === "cells" && side === "input";
      const words = isCells ? (this.cellCount > 0 ? `${count(this.cellCount)} cells, each the points nearest to its ${this.cellsOf}` : "Cells come with the first iteration") : "";
      return element.replaceChildren(make("span", { class: "legend-words" }, words));
    }
    const [least, most] = colouring.range;
    if (this.mode === "quality") {
      const { figures } = loaded;
      const words = `least ${figure(figures.least, 2)}, mean ${figure(figures.mean, 3)}; under 30°: ${figure(figures.under30, 2)} %`;
      return element.replaceChildren(bar(colouring.scale, figure(least), figure(most)), make("span", { class: "legend-words" }, words));
    }
    const figures = side === "input" ? this.compared?.inputFigures : this.compared?.resultFigures;
    const words = `largest ${figure(figures?.largest ?? NaN, 2)} %, mean ${figure(figures?.mean ?? NaN, 2)} % of the diagonal`;
    element.replaceChildren(bar(colouring.scale, "0", `${figure(most, 2)} % and more`), make("span", { class: "legend-words" }, words));
  }

  private note(side: Side, words: string): void {
    the(`${side}-note`, HTMLElement).textContent = words;
  }

  private radio(mode: Mode): HTMLInputElement {
    return the(`colours-${mode}`, HTMLInputElement);
  }

  private each(act: (view: View) => void): void {
    for (const side of SIDES) {
      const view = this.views[side];
      if (view) act(view);
    }
  }

  /** Takes the colours of the page, which are dark or light. */
  private theme(): void {
    const style = getComputedStyle(document.documentElement);
    const of = (name: string): string => style.getPropertyValue(`--${name}`).trim();
    const theme: Theme = {
      base: of("mesh-base"), back: of("mesh-back"), line: of("mesh-line"), dot: of("mesh-dot"),
      tints: [of("cell-a"), of("cell-b"), of("cell-c")],
    };
    this.each((view) => view.theme(theme));
  }
}

function bar(scale: Scale, least: string, most: string): HTMLElement {
  const strip = make("span", { class: "legend-strip" });
  strip.style.background = gradient(scale);
  return make("span", { class: "legend-bar" }, make("span", {}, least), strip, make("span", {}, most));
}
