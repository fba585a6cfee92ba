// The options of a remesh.
//
// Purpose: reads the form into the names that the service has, and shows at a field what is wrong with it. Invariant: what is
// left empty is not sent, so that the service's defaults hold. Must not know: how a job is made.

import { Problem } from "./api.ts";
import { make } from "./dom.ts";

export class Options {
  constructor(private readonly form: HTMLFormElement) {
    form.addEventListener("input", (event) => {
      if (event.target instanceof Element) this.clear(event.target);
    });
  }

  /** Whether all fields are in their ranges; says what is not. */
  check(): boolean {
    this.clearAll();
    let first: HTMLElement | null = null;
    for (const field of this.fields()) {
      if (field.checkValidity()) continue;
      this.say(field, field.validationMessage);
      first ??= field;
    }
    this.show(first);
    return first === null;
  }

  read(): Record<string, unknown> {
    const options: Record<string, unknown> = {};
    for (const field of this.fields()) {
      if (field.value === "" || field.name === "") continue;
      options[field.name] = field instanceof HTMLInputElement && field.type === "number" ? field.valueAsNumber : field.value;
    }
    return options;
  }

  /** Shows a problem at the fields that it names; false if it names none of them. */
  blame(problem: Problem): boolean {
    let first: HTMLElement | null = null;
    for (const { field: name, description } of problem.fields) {
      const last = name.split(".").pop() ?? name;
      const field = this.fields().find((one) => one.name === name || one.name === last);
      if (!field) continue;
      this.say(field, description);
      first ??= field;
    }
    this.show(first);
    return first !== null;
  }

  private fields(): (HTMLInputElement | HTMLSelectElement)[] {
    return [...this.form.elements].filter((one) => one instanceof HTMLInputElement || one instanceof HTMLSelectElement).filter(({ name }) => name !== "");
  }

  private say(field: HTMLElement, text: string): void {
    const id = `${field.id}-error`;
    field.setAttribute("aria-invalid", "true");
    field.setAttribute("aria-errormessage", id);
    field.closest(".field")?.append(make("p", { id, class: "field-error" }, text));
  }

  private show(field: HTMLElement | null): void {
    if (!field) return;
    const folded = field.closest("details");
    if (folded) folded.open = true;
    field.focus();
  }

  private clear(field: Element): void {
    field.removeAttribute("aria-invalid");
    field.removeAttribute("aria-errormessage");
    document.getElementById(`${field.id}-error`)?.remove();
  }

  private clearAll(): void {
    for (const field of this.fields()) this.clear(field);
  }
}
