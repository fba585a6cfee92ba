// The chart of the energy.
//
// Purpose: draws the energy of each iteration as it comes, over that of regular hexagons. Invariant: what is
// drawn is told in words beside it too; every label is whole. Must not know: where iterations come from.

import type { Iteration } from "./api.ts";
import { draw } from "./dom.ts";
import { figure, raised } from "./words.ts";

const RIGHT = 14;
const TOP = 26;
const BOTTOM = 28;
/** Pixels of a digit. */
const DIGIT = 6.6;

export class Chart {
  private readonly steps: Iteration[] = [];
  private total = 0;

  constructor(private readonly svg: SVGSVGElement, private readonly words: HTMLElement) {
    new ResizeObserver(() => this.draw()).observe(svg);
  }

  clear(): void {
    this.steps.length = 0;
    this.total = 0;
    this.draw();
  }

  add(step: Iteration): void {
    this.steps.push(step);
    this.total = Math.max(this.steps.length, this.steps.length - 1 - step.index + step.total);
    this.draw();
  }

  private draw(): void {
    const { svg, steps } = this;
    const energies = steps.map(({ energy_ratio: ratio }) => ratio);
    const width = svg.clientWidth || 400;
    const height = svg.clientHeight || 180;
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.replaceChildren();
    this.say();
    let least = energies.length > 0 ? Math.min(...energies) : 0;
    let most = energies.length > 0 ? Math.max(...energies) : 1;
    if (!(most > least)) {
      const about = Math.abs(most) || 1;
      least -= 0.05 * about;
      most += 0.05 * about;
    }
    const step = round((most - least) / 3);
    least = step * Math.floor(least / step);
    most = step * Math.ceil(most / step);
    // All labels have one power of ten, which is written once.
    const power = Math.floor(Math.log10(Math.max(Math.abs(most), 1e-300)));
    const isPlain = power >= -2 && power < 4;
    const unit = isPlain ? 1 : 10 ** power;
    const digits = Math.max(0, Math.ceil(-Math.log10(step / unit) - 1e-9));
    const labels = Array.from({ length: Math.round((most - least) / step) + 1 }, (_, i) => ((least + i * step) / unit).toFixed(digits));
    const left = steps.length > 0 ? 12 + DIGIT * Math.max(...labels.map(({ length }) => length)) : 12;
    const x = (i: number): number => left + ((width - left - RIGHT) * i) / Math.max(this.total - 1, 1);
    const y = (energy: number): number => TOP + ((height - TOP - BOTTOM) * (most - energy)) / (most - least);
    if (steps.length > 0) this.axis(isPlain ? "" : ` × 10${raised(power)}`);
    labels.forEach((label, i) => {
      const at = y(least + i * step);
      draw(svg, "line", { x1: left, x2: width - RIGHT, y1: at, y2: at, class: "grid" });
      if (steps.length > 0) this.text(left - 8, at + 4, "end", label);
    });
    this.text(left, height - 8, "start", steps.length > 0 ? "1" : "");
    this.text((left + width - RIGHT) / 2, height - 8, "middle", "iteration");
    this.text(width - RIGHT, height - 8, "end", this.total > 0 ? String(this.total) : "");
    if (steps.length === 0) return;
    const change = steps.findIndex(({ kind }, i) => i > 0 && kind !== "lloyd" && steps[i - 1]?.kind === "lloyd");
    if (change > 0) {
      const at = (x(change) + x(change - 1)) / 2;
      draw(svg, "line", { x1: at, x2: at, y1: TOP, y2: height - BOTTOM, class: "change" });
      this.text(at + 6, TOP + 10, "start", "quasi-Newton steps");
    }
    const points = energies.map((energy, i) => `${x(i).toFixed(1)},${y(energy).toFixed(1)}`);
    const floor = height - BOTTOM;
    draw(svg, "polygon", { points: `${x(0)},${floor} ${points.join(" ")} ${x(steps.length - 1).toFixed(1)},${floor}`, class: "area" });
    draw(svg, "polyline", { points: points.join(" "), class: "curve" });
    const last = steps.length - 1;
    draw(svg, "circle", { cx: x(last), cy: y(energies[last] as number), r: 4, class: "last" });
  }

  /** The name of the axis, above it. */
  private axis(unit: string): void {
    const text = this.text(0, 12, "start", "E / E");
    draw(text, "tspan", { dy: 3, class: "below-line" }).textContent = "hex";
    if (unit) draw(text, "tspan", { dy: -3 }).textContent = unit;
  }

  private say(): void {
    const { steps } = this;
    if (steps.length === 0) {
      this.words.textContent = "The energy falls as cells become even. It is drawn here while a job runs.";
      return;
    }
    const [from, to] = [steps[0], steps[steps.length - 1]].map((step) => step?.energy_ratio ?? 0) as [number, number];
    const below = from > 0 ? (100 * (from - to)) / from : 0;
    this.words.textContent = `${figure(to, 4)} times that of regular hexagons after ${steps.length} of ${this.total} iterations, ${below.toFixed(1)} % below the first.`;
  }

  private text(x: number, y: number, anchor: string, text: string): SVGElement {
    const element = draw(this.svg, "text", { x, y, "text-anchor": anchor });
    element.textContent = text;
    return element;
  }
}

/** A step of 1, 2 or 5 times a power of ten, not less than this. */
function round(step: number): number {
  const power = 10 ** Math.floor(Math.log10(step));
  return power * ([1, 2, 5, 10].find((times) => times * power >= step * 0.999) ?? 10);
}
