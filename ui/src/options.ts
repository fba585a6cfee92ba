// The options of a remesh.
//
// Purpose: reads the form into the names of the service, and shows at a field what is wrong with it. Invariant: an empty field
// is not sent, so that the service's default holds; the defaults and formats on the page are those of the service's document.
// Must not know: how a job is made.

import { Problem, type Schemas } from "./api.ts";
import { make } from "./dom.ts";

export class Options {
  constructor(private readonly form: HTMLFormElement) {
    form.addEventListener("input", (event) => {
      if (event.target instanceof Element) this.clear(event.target);
    });
  }

  /** Shows the service's defaults in empty fields, and all formats that it writes. */
  learn(schemas: Schemas): void {
    for (const field of this.fields()) {
      const schema = schemas[field.name];
      const standard = schema?.default;
      if (field instanceof HTMLInputElement && standard !== undefined && standard !== null) field.placeholder = String(standard);
      if (field instanceof HTMLSelectElement && field.name === "to") {
        const known = [...field.options].map(({ value }) => value);
        const others = (schema?.enum ?? []).filter((format) => !known.includes(format));
        field.append(...others.map((format) => make("option", { value: format }, format.toUpperCase())));
      }
    }
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
