// Histograms of the facets.
//
// Purpose: draws the shares of both surfaces over one axis. Invariant: both have one scale; what is drawn is told in words too.
// Must not know: how shares are counted.

import { draw, the } from "./dom.ts";
import type { Side } from "./tasks.ts";
import { figure } from "./words.ts";

const HEIGHT = 120;
const [TOP, BOTTOM, LEFT, RIGHT] = [8, 22, 38, 10] as const;

export class Bars {
  private readonly shares: Record<Side, readonly number[] | null> = { input: null, result: null };
  private readonly svg: SVGSVGElement;

  /** The values reach from 0 to `most`. */
  constructor(id: string, private readonly most: number, private readonly unit: string) {
    this.svg = the(id, SVGSVGElement);
    new ResizeObserver(() => this.draw()).observe(this.svg);
  }

  /** Percent of the facets in each bin, or nothing. */
  show(side: Side, shares: readonly number[] | null): void {
    this.shares[side] = shares;
    this.draw();
  }

  get isShown(): boolean {
    return this.shares.input !== null || this.shares.result !== null;
  }

  private draw(): void {
    const { svg, shares, most, unit } = this;
    const width = svg.clientWidth || 400;
    svg.setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
    svg.replaceChildren();
    const highest = Math.max(...(shares.input ?? [0]), ...(shares.result ?? [0]));
    const step = highest > 40 ? 20 : highest > 20 ? 10 : 5;
    const top = Math.max(step * Math.ceil(highest / step), step);
    const y = (percent: number): number => TOP + (HEIGHT - TOP - BOTTOM) * (1 - percent / top);
    const x = (part: number): number => LEFT + (width - LEFT - RIGHT) * part;
    for (let percent = 0; percent <= top; percent += step) {
      if (top / step > 3 && (percent / step) % 2 === 1) continue;
      draw(svg, "line", { x1: LEFT, x2: width - RIGHT, y1: y(percent), y2: y(percent), class: "grid" });
      draw(svg, "text", { x: LEFT - 6, y: y(percent) + 4, "text-anchor": "end" }).textContent = `${percent} %`;
    }
    for (let i = 0; i <= 4; i++) {
      draw(svg, "text", { x: x(i / 4), y: HEIGHT - 6, "text-anchor": i === 4 ? "end" : "middle" }).textContent = `${figure((most * i) / 4)}${unit}`;
    }
    for (const side of ["input", "result"] as const) {
      const heights = shares[side];
      if (!heights) continue;
      const outline = heights.flatMap((share, i) => [i, i + 1].map((edge) => `${x(edge / heights.length).toFixed(1)},${y(share).toFixed(1)}`));
      draw(svg, "polygon", { points: `${x(0)},${y(0)} ${outline.join(" ")} ${x(1)},${y(0)}`, class: `bars-${side}` });
    }
    svg.setAttribute("aria-description", `${this.told("input", "Input")} ${this.told("result", "Remesh")}`.trim());
  }

  private told(side: Side, name: string): string {
    const heights = this.shares[side];
    if (!heights) return "";
    const most = heights.indexOf(Math.max(...heights));
    const edge = (i: number): string => `${figure((this.most * i) / heights.length)}${this.unit}`;
    return `${name}: most facets, ${figure(heights[most] as number, 2)} %, from ${edge(most)} to ${edge(most + 1)}.`;
  }
}
