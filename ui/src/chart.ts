// The chart of the energy.
//
// Purpose: draws the energy of each iteration as it comes. Invariant: what is drawn is told in words beside it too. Must not
// know: where iterations come from.

import type { Iteration } from "./api.ts";
import { figure, raised } from "./words.ts";

const SPACE = "http://www.w3.org/2000/svg";
const LEFT = 44;
const RIGHT = 14;
const TOP = 24;
const BOTTOM = 28;

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
    const width = svg.clientWidth || 400;
    const height = svg.clientHeight || 180;
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.replaceChildren();
    this.say();
    const energies = steps.map(({ energy }) => energy);
    let least = energies.length > 0 ? Math.min(...energies) : 0;
    let most = energies.length > 0 ? Math.max(...energies) : 1;
    if (!(most > least)) {
      const about = Math.abs(most) || 1;
      least -= 0.05 * about;
      most += 0.05 * about;
    }
    const room = 0.06 * (most - least);
    const x = (i: number): number => LEFT + ((width - LEFT - RIGHT) * i) / Math.max(this.total - 1, 1);
    const y = (energy: number): number => TOP + ((height - TOP - BOTTOM) * (most + room - energy)) / (most - least + 2 * room);
    // All labels have one power of ten, which is written once.
    const power = Math.floor(Math.log10(Math.max(Math.abs(most), 1e-300)));
    const isPlain = power >= -2 && power < 4;
    const unit = isPlain ? 1 : 10 ** power;
    if (!isPlain && steps.length > 0) this.text(0, 11, "start", `× 10${raised(power)}`);
    for (let i = 0; i <= 3; i++) {
      const energy = least + ((most - least) * i) / 3;
      this.put("line", { x1: LEFT, x2: width - RIGHT, y1: y(energy), y2: y(energy), class: "grid" });
      if (steps.length > 0) this.text(LEFT - 8, y(energy) + 4, "end", isPlain ? figure(energy, 3) : (energy / unit).toFixed(2));
    }
    this.text(LEFT, height - 8, "start", steps.length > 0 ? "1" : "");
    this.text((LEFT + width - RIGHT) / 2, height - 8, "middle", "iteration");
    this.text(width - RIGHT, height - 8, "end", this.total > 0 ? String(this.total) : "");
    if (steps.length === 0) return;
    const change = steps.findIndex(({ kind }, i) => i > 0 && kind !== "lloyd" && steps[i - 1]?.kind === "lloyd");
    if (change > 0) {
      const at = (x(change) + x(change - 1)) / 2;
      this.put("line", { x1: at, x2: at, y1: TOP, y2: height - BOTTOM, class: "change" });
      this.text(at + 6, TOP + 10, "start", "quasi-Newton steps");
    }
    const points = steps.map(({ energy }, i) => `${x(i).toFixed(1)},${y(energy).toFixed(1)}`);
    const floor = height - BOTTOM;
    this.put("polygon", { points: `${x(0)},${floor} ${points.join(" ")} ${x(steps.length - 1).toFixed(1)},${floor}`, class: "area" });
    this.put("polyline", { points: points.join(" "), class: "curve" });
    const last = steps.length - 1;
    this.put("circle", { cx: x(last), cy: y(energies[last] as number), r: 4, class: "last" });
  }

  private say(): void {
    const { steps } = this;
    const first = steps[0];
    const last = steps[steps.length - 1];
    if (!first || !last) {
      this.words.textContent = "The energy falls as cells become even. It is drawn here while a job runs.";
      return;
    }
    const below = first.energy > 0 ? (100 * (first.energy - last.energy)) / first.energy : 0;
    this.words.textContent = `${figure(last.energy, 4)} after ${steps.length} of ${this.total} iterations, ${below.toFixed(1)} % below the first.`;
  }

  private put(name: string, attributes: Readonly<Record<string, string | number>>): SVGElement {
    const element = document.createElementNS(SPACE, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
    this.svg.append(element);
    return element;
  }

  private text(x: number, y: number, anchor: string, text: string): void {
    this.put("text", { x, y, "text-anchor": anchor }).textContent = text;
  }
}
