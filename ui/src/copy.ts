// The same call elsewhere.
//
// Purpose: writes the options of the form as a command, a request by curl and a call in Python. Invariant: each text does what
// the page does, and a file name is never more than a file name. Must not know: the form, the service.

export interface Call {
  /** Name of the input file. */
  readonly name: string;
  readonly stem: string;
  readonly format: string;
  readonly options: Readonly<Record<string, unknown>>;
  /** Where the service is, with a slash at the end. */
  readonly base: string;
  readonly needsKey: boolean;
}

export const LANGUAGES = ["command", "curl", "python"] as const;

export type Language = (typeof LANGUAGES)[number];

export function written(language: Language, call: Call): string {
  const { to, ...options } = call.options;
  const output = `${call.stem}-remesh.${String(to ?? call.format)}`;
  const writers: Record<Language, () => string> = {
    command: () => command(call, options, output),
    curl: () => curl(call, output),
    python: () => python(call, options, output),
  };
  return writers[language]();
}

function command({ name, format }: Call, options: Readonly<Record<string, unknown>>, output: string): string {
  const flags = Object.entries(options).flatMap(([key, value]) => {
    if (key === "attributes") return value === false ? ["--no-attributes"] : [];
    return [`--${key.replaceAll("_", "-")} ${shell(String(value))}`];
  });
  const input = isNamed(name, format) ? [] : [`--input-format ${format}`];
  return ["tessera remesh", shell(path(name)), ...input, ...flags, "--output", shell(path(output))].join(" ");
}

function curl({ name, format, options, base, needsKey }: Call, output: string): string {
  const query = new URLSearchParams(Object.entries({ format, ...options }).map(([key, value]) => [key, String(value)]));
  return [
    "curl --fail-with-body",
    ...(needsKey ? ['--header "Authorization: Bearer $TESSERA_KEY"'] : []),
    `--data-binary ${shell(`@${path(name)}`)}`,
    shell(`${base}v1/remesh?${query}`),
    `--output ${shell(path(output))}`,
  ].join(" ");
}

function python({ name }: Call, options: Readonly<Record<string, unknown>>, output: string): string {
  const given = Object.entries({ ...options, ...(options["measure"] ? { measure: options["measure"] === "full" } : {}) });
  const words = given.map(([key, value]) => `, ${key}=${typeof value === "boolean" ? (value ? "True" : "False") : JSON.stringify(value)}`);
  return `import tessera_remesh\n\nresult = tessera_remesh.remesh(${JSON.stringify(path(name))}${words.join("")})\nresult.save(${JSON.stringify(path(output))})`;
}

/** Whether a file's name says its format. */
function isNamed(name: string, format: string): boolean {
  return new RegExp(`\\.${format}(\\.gz)?$`, "i").test(name);
}

/** A name that is no option. */
function path(name: string): string {
  return name.startsWith("-") ? `./${name}` : name;
}

/** One word for a POSIX shell. */
function shell(word: string): string {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`;
}
