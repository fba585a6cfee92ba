// The options of a remesh.
//
// Purpose: reads the form into the names of the service, fills it from a job, and shows at a field what is wrong with it.
// Invariant: an empty field is not sent, so that the service's default holds; the defaults and formats on the page are those of
// the service's document; options of a job that have no field are kept, or left out, and named. Must not know: how a job is made.

import { Problem, type Schemas, type Spec } from "./api.ts";
import { FILES, LISTS } from "./copy.ts";
import { make, the } from "./dom.ts";
import { count, whole } from "./words.ts";

/** The least points for a closed surface, and the most that a server takes. */
const POINTS = [4, 4_000_000] as const;

/** The parts of a list. */
export function partsOf(list: string): string[] {
  return list.split(";").map((part) => part.trim()).filter((part) => part !== "");
}

/** Options that say how many points there are, in place of a number. */
const SIZES: readonly string[] = ["edge_length", "facets", "sizes", "metric"];

export class Options {
  private schemas: Schemas = {};
  /** Options of the job that was opened, without a field. */
  private others: Readonly<Record<string, unknown>> = {};
  private left: readonly string[] = [];

  constructor(private readonly form: HTMLFormElement) {
    form.addEventListener("input", (event) => {
      if (event.target instanceof Element) this.clear(event.target);
    });
    const points = the("points", HTMLInputElement);
    points.addEventListener("input", () => {
      // A number takes the place of another size.
      const { edge_length: _, facets: __, ...others } = this.others;
      if (points.value !== "") this.keep(others, this.left);
    });
    the("others-drop", HTMLButtonElement).addEventListener("click", () => {
      this.keep({});
      form.dispatchEvent(new Event("input"));
    });
  }

  /** Sets the number of points. */
  points(value: number): void {
    the("points", HTMLInputElement).value = String(value);
    this.keep({});
  }

  /** Fills the form as a job has it. */
  fill(spec: Spec): void {
    this.clearAll();
    const { density, points_percent: percent, anisotropy, anisotropy_auto: isAuto, ...remesh } = spec.remesh ?? {};
    this.share(Number(anisotropy ?? 0));
    const { source, ...ofDensity } = density ?? {};
    const set: Record<string, unknown> = {
      ...lists(remesh), ...lists(ofDensity), density: source, backend: spec.backend, to: spec.result?.file, attributes: spec.mesh?.file?.attributes,
      ...(percent === undefined ? {} : { points: `${String(percent)}%` }),
      ...(isAuto ? { anisotropy: "auto" } : anisotropy ? { anisotropy } : {}),
    };
    const left = Object.keys(spec).filter((name) => !["mesh", "remesh", "backend", "result", "labels", "arrays"].includes(name));
    for (const [name, { digest, form }] of Object.entries(spec.arrays ?? {})) {
      const option = form === "ARRAY_FORM_TEXT" ? { edge_lengths: "sizes", metric: "metric", creases: "creases" }[name] : undefined;
      if (option) set[option] = digest;
      else left.push(name);
    }
    for (const field of this.fields()) {
      const value = this.plain(field.name, set[field.name]);
      const standard = field instanceof HTMLSelectElement ? (field.options[0]?.value ?? "") : "";
      const isKnown = !(field instanceof HTMLSelectElement) || [...field.options].some((option) => option.value === String(value));
      field.value = value !== undefined && isKnown ? String(value) : standard;
      const isFilled = field.value !== standard && field.closest("details");
      if (isFilled) isFilled.open = true;
      if (isKnown) delete set[field.name];
    }
    the("keep", HTMLInputElement).dispatchEvent(new Event("input"));
    const rest = Object.entries(set).map(([name, value]) => [name, this.plain(name, value)] as const);
    const isStandard = (name: string, value: unknown): boolean => value === undefined || typeof value === "object" || value === this.schemas[name]?.default;
    this.keep(Object.fromEntries(rest.filter(([name, value]) => !isStandard(name, value) && !(name === "attributes" && value === true))), left);
  }

  /** Offers the anisotropy of a job, if it is a number above 0. */
  private share(value: number): void {
    const field = the("anisotropy", HTMLSelectElement);
    field.querySelector("[data-share]")?.remove();
    if (value > 0) field.append(make("option", { value: String(value), "data-share": "" }, `Long: anisotropy ${value}`));
  }

  private keep(others: Readonly<Record<string, unknown>>, left: readonly string[] = []): void {
    this.others = others;
    this.left = left;
    the("points", HTMLInputElement).required = !SIZES.some((name) => name in others);
    const words = (name: string): string => name.replaceAll("_", " ");
    const names = Object.entries(others).map(([name, value]) => (FILES.includes(name) ? words(name) : `${words(name)} ${String(value)}`));
    the("others", HTMLElement).hidden = names.length + left.length === 0;
    the("others-names", HTMLElement).textContent = [
      names.length > 0 ? `Also set: ${names.join(", ")}.` : "", left.length > 0 ? `Of this job, not set here: ${left.map(words).join(", ")}.` : "",
    ].join(" ").trim();
    the("others-drop", HTMLElement).hidden = names.length === 0;
  }

  /** A value as the form has it: that of an enum is DENSITY_SOURCE_LFS in a specification and lfs here. A whole number may be text. */
  private plain(name: string, value: unknown): unknown {
    if (typeof value !== "string") return value;
    const word = value.toLowerCase();
    const known = this.schemas[name]?.enum?.filter((one) => word.endsWith(`_${one}`)).sort((a, b) => b.length - a.length)[0];
    return known ?? (/^\d+$/.test(value) && !LISTS.includes(name) ? Number(value) : value);
  }

  /** Shows the service's defaults in empty fields, and all formats that it writes. */
  learn(schemas: Schemas): void {
    this.schemas = schemas;
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
    const points = the("points", HTMLInputElement);
    const isRight = points.value.trim() === "" || Object.keys(size(points.value)).length > 0;
    points.setCustomValidity(isRight ? "" : `Give ${POINTS.map(count).join(" to ")} points, as 10000 or 10k, or percent of the input's vertices, as 50%.`);
    for (const field of this.fields()) {
      if (field.checkValidity()) continue;
      this.say(field, field.validationMessage);
      first ??= field;
    }
    this.show(first);
    return first === null;
  }

  read(): Record<string, unknown> {
    const options: Record<string, unknown> = { ...this.others };
    for (const field of this.fields()) {
      if (field.value === "" || field.name === "") continue;
      if (field.name === "points") {
        Object.assign(options, size(field.value));
        continue;
      }
      if (LISTS.includes(field.name)) {
        const parts = partsOf(field.value);
        if (parts.length > 0) options[field.name] = parts.join(";");
        continue;
      }
      const number = Number(field.value);
      options[field.name] = Number.isNaN(number) ? field.value : number;
    }
    return options;
  }

  /** Shows a problem at the fields that it names; false if it names none of them. */
  blame(problem: Problem): boolean {
    let first: HTMLElement | null = null;
    for (const { field: name, description } of problem.fields) {
      const last = (name.split(".").pop() ?? name).replace(/\[\d+\]$/, "");
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

/** Options whose lists are one text each. */
function lists(options: Readonly<Record<string, unknown>>): Record<string, unknown> {
  return Object.fromEntries(Object.entries(options).map(([name, value]) => [name, Array.isArray(value) ? value.join(";") : value]));
}

/** A number of points, or a share of the vertices; nothing if it is neither. */
function size(text: string): Record<string, number> {
  const share = /^\s*(\d+(?:\.\d+)?)\s*%\s*$/.exec(text)?.[1];
  if (share !== undefined) return Number(share) > 0 ? { points_percent: Number(share) } : {};
  const points = whole(text);
  return points !== null && points >= POINTS[0] && points <= POINTS[1] ? { points } : {};
}
