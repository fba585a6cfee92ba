// Names of regions in a file.
//
// Purpose: lists the regions that OBJ and STL name, so that the page can offer them. Invariant: none, or from two to a bound; a name has no
// semicolon, which divides parts. Must not know: what regions are for.

import type { ShownFormat } from "./formats.ts";

/** The most that are listed, as many as parts may stay. */
const MOST = 64;

/** Materials of OBJ, and solids of text STL. */
const STATEMENTS: Partial<Record<ShownFormat, RegExp>> = { obj: /^usemtl[ \t]+(\S.*)$/gm, stl: /^[ \t]*solid[ \t]+(\S.*)$/gm };

export function regionNames(bytes: Uint8Array, format: ShownFormat): string[] {
  const statement = STATEMENTS[format];
  const isText = format === "obj" || /^\s*solid[^]*facet/.test(new TextDecoder().decode(bytes.subarray(0, 1024)));
  if (!statement || !isText) return [];
  const names = new Set<string>();
  for (const [, name] of new TextDecoder().decode(bytes).matchAll(statement)) {
    const plain = name!.trim();
    if (!plain.includes(";")) names.add(plain);
    if (names.size === MOST) break;
  }
  return names.size > 1 ? [...names] : [];
}
