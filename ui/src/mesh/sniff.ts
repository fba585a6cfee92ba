// The format of a file that a person chose.
//
// Purpose: reads the format off the name, else off the first bytes. Invariant: a packed file is told from its bytes, never
// from its name alone. Must not know: what the service reads, how a format is read.

/** Extensions that mean another format's name. */
const SAME: Readonly<Record<string, string>> = { gltf: "glb", meshb: "mesh" };

/** The stem of a name and its extension, both without `.gz`. */
export function nameParts(name: string): { stem: string; extension: string } {
  const plain = name.replace(/\.gz$/i, "");
  const dot = plain.lastIndexOf(".");
  if (dot <= 0) return { stem: plain || "mesh", extension: "" };
  const extension = plain.slice(dot + 1).toLowerCase();
  return { stem: plain.slice(0, dot), extension: SAME[extension] ?? extension };
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
