// The same call elsewhere.
//
// Purpose: writes the options of the form as a command, a request by curl and a call in Python. Invariant: each text does what
// the page does, and a file name is never more than a file name. Must not know: the form, the service.

/** Options that name a stored file. */
export const FILES: readonly string[] = ["sizes", "metric", "creases"];

/** Options that are lists, with semicolons between their parts. */
export const LISTS: readonly string[] = ["keep", "only", "size_in", "periodic"];

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

export type Language = "command" | "curl" | "python";

const KEY = '--header "Authorization: Bearer $TESSERA_KEY"';

/** Options of the service alone, and the next best elsewhere. */
const ELSEWHERE: Readonly<Record<string, string>> = { max_deviation_length: "max_deviation, in percent of the diagonal" };

/** Goes on in the next line, in a shell. */
const NEXT_LINE = " \\\n  ";

export function written(language: Language, call: Call): string {
  const { to, points_percent: percent, ...others } = call.options;
  const options = percent === undefined ? others : { points: `${String(percent)}%`, ...others };
  const output = `${call.stem}-remesh.${String(to ?? call.format)}`;
  const writers: Record<Language, () => string> = {
    command: () => command(call, options, output),
    curl: () => curl(call, to === undefined ? options : { ...options, to }, output),
    python: () => python(call, options, output),
  };
  return writers[language]();
}

function command(call: Call, options: Readonly<Record<string, unknown>>, output: string): string {
  const flags = Object.entries(options).flatMap(([key, value]) => {
    // The command measures everything.
    if (key in ELSEWHERE || key === "measure") return [];
    if (FILES.includes(key)) return [`--${key} ${key}.txt`];
    if (key === "attributes") return value === false ? ["--no-attributes"] : [];
    if (key === "strict_creases") return value === true ? ["--creases strict"] : [];
    if (typeof value === "boolean") return value ? [`--${key.replaceAll("_", "-")}`] : [];
    if (LISTS.includes(key)) return String(value).split(";").map((part) => `--${key.replaceAll("_", "-")} ${shell(part)}`);
    // The command has hyphens in the words of a density too.
    const word = key === "density" ? String(value).replaceAll("_", "-") : String(value);
    return [`--${key.replaceAll("_", "-")} ${shell(word)}`];
  });
  const { name, format } = call;
  const input = isNamed(name, format) ? [] : [`--input-format ${format}`];
  return remarks(options) + fetched(call) + [`tessera remesh ${shell(path(name))}`, ...input, ...flags, `--output ${shell(path(output))}`].join(NEXT_LINE);
}

/** What a call cannot say. */
function remarks(options: Readonly<Record<string, unknown>>): string {
  const keys = Object.keys(options).filter((key) => key in ELSEWHERE);
  return keys.map((key) => `# Not here: ${key} ${String(options[key])}. Give ${ELSEWHERE[key]}.\n`).join("");
}

/** Fetches the files that options name. */
function fetched({ options, base, needsKey }: Call): string {
  const files = FILES.filter((key) => options[key] !== undefined);
  return files.map((key) => `curl --fail-with-body ${needsKey ? `${KEY} ` : ""}${shell(`${base}v1/blobs/${String(options[key])}`)} --output ${key}.txt\n`).join("");
}

function curl({ name, format, base, needsKey }: Call, options: Readonly<Record<string, unknown>>, output: string): string {
  const query = new URLSearchParams(Object.entries({ format, ...options }).map(([key, value]) => [key, String(value)]));
  return [
    "curl --fail-with-body",
    ...(needsKey ? [KEY] : []),
    `--data-binary ${shell(`@${path(name)}`)}`,
    shell(`${base}v1/remesh?${query}`),
    `--output ${shell(path(output))}`,
  ].join(NEXT_LINE);
}

function python({ name }: Call, options: Readonly<Record<string, unknown>>, output: string): string {
  const given = Object.entries({ ...options, ...(options["measure"] ? { measure: options["measure"] === "full" } : {}) });
  const literal = (key: string, value: unknown): string => {
    if (FILES.includes(key)) return `numpy.loadtxt("${key}.txt"${key === "creases" ? ", dtype=int, ndmin=2" : ""})`;
    if (LISTS.includes(key)) return JSON.stringify(String(value).split(";"));
    return typeof value === "boolean" ? (value ? "True" : "False") : JSON.stringify(value);
  };
  const words = given.filter(([key]) => !(key in ELSEWHERE)).map(([key, value]) => `, ${key}=${literal(key, value)}`);
  const hasFiles = FILES.some((key) => key in options);
  const files = hasFiles ? "# sizes.txt, metric.txt, creases.txt: the command fetches them.\nimport numpy\n" : "";
  return `${remarks(options)}${files}import tessera_remesh\n\nresult = tessera_remesh.remesh(${JSON.stringify(path(name))}${words.join("")})\nresult.save(${JSON.stringify(path(output))})`;
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
