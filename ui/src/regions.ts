// The regions that stay as they are.
//
// Purpose: offers the regions of the input beside the field of parts that stay. Invariant: the field alone says what stays; the ticks
// follow it. Must not know: files, the service.

import { make } from "./dom.ts";
import { partsOf } from "./options.ts";

export class Regions {
  private ticks: readonly HTMLInputElement[] = [];

  constructor(private readonly field: HTMLInputElement, private readonly box: HTMLFieldSetElement, private readonly list: HTMLElement) {
    field.addEventListener("input", () => this.follow());
  }

  /** Shows these; nothing if there are none. */
  offer(names: readonly string[]): void {
    this.ticks = names.map((name) => make("input", { type: "checkbox", value: name.includes(":") ? `region:${name}` : name }));
    for (const tick of this.ticks) tick.addEventListener("change", () => this.set(tick));
    this.list.replaceChildren(...names.map((name, k) => make("label", { class: "check" }, this.ticks[k]!, name)));
    this.box.hidden = names.length === 0;
    this.follow();
  }

  private set(tick: HTMLInputElement): void {
    const others = partsOf(this.field.value).filter((part) => part !== tick.value);
    this.field.value = [...others, ...(tick.checked ? [tick.value] : [])].join("; ");
    this.field.dispatchEvent(new Event("input", { bubbles: true }));
  }

  private follow(): void {
    const parts = partsOf(this.field.value);
    for (const tick of this.ticks) tick.checked = parts.includes(tick.value);
  }
}
