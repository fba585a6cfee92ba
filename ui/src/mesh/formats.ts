// Formats of files.
//
// Purpose: finds the format by the name, else by the first bytes; lists the formats that can be shown. Invariant: a packed file
// is recognized by its bytes, never by its name alone. Must not know: the formats of the service, how a format is read.

/** A format that this page shows. The service may read more. */
export type ShownFormat = "ply" | "obj" | "stl" | "off";

export const SHOWN: readonly ShownFormat[] = ["ply", "obj", "stl", "off"];

export function isShown(format: string): format is ShownFormat {
  return (SHOWN as readonly string[]).includes(format);
}

/** The stem of a name and its extension, both without `.gz`. */
export function nameParts(name: string): { stem: string; extension: string } {
  const plain = name.replace(/\.gz$/i, "");
  const dot = plain.lastIndexOf(".");
  if (dot <= 0) return { stem: plain || "mesh", extension: "" };
  return { stem: plain.slice(0, dot), extension: plain.slice(dot + 1).toLowerCase() };
}

export function isPacked(head: Uint8Array): boolean {
  return head[0] === 0x1f && head[1] === 0x8b;
}

/** The format by the first bytes, if they say it. */
export function sniff(head: Uint8Array, size: number): string | null {
  const text = new TextDecoder("latin1").decode(head.subarray(0, 4096));
  if (/^ply\r?\n/.test(text)) return "ply";
  if (head.length >= 84) {
    const count = new DataView(head.buffer, head.byteOffset).getUint32(80, true);
    if (84 + 50 * count === size) return "stl";
  }
  if (text.startsWith("glTF")) return "glb";
  const first = text.split("\n").map((line) => line.trim()).find((line) => line !== "" && !line.startsWith("#"));
  const word = first?.split(/\s+/)[0] ?? "";
  if (word === "solid") return "stl";
  if (/^(ST)?C?N?OFF$/.test(word)) return "off";
  if (["v", "vn", "vt", "f", "o", "g", "s", "usemtl", "mtllib"].includes(word)) return "obj";
  return null;
}
