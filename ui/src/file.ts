// A file that a person chose.
//
// Purpose: finds its format, and unpacks gzip. Invariant: the unpacked file is at most 64 times as large, as at the service.
// Must not know: the content of a mesh.

import { isPacked, nameParts, sniff } from "./mesh/formats.ts";

const MOST_UNPACKED = 64;

export interface Chosen {
  readonly name: string;
  /** The name without its extension. */
  readonly stem: string;
  readonly format: string;
  /** Not packed. */
  readonly file: Blob;
}

/** Opens a file whose format is one of these. Errors are for people. */
export async function open(file: File, formats: readonly string[]): Promise<Chosen> {
  if (file.size === 0) throw new Error(`the file ${file.name} is empty`);
  const { stem, extension } = nameParts(file.name);
  const isGzip = isPacked(await head(file));
  const plain = isGzip ? await unpack(file) : file;
  const sniffed = sniff(await head(plain), plain.size);
  const format = formats.includes(extension) ? extension : sniffed;
  if (format === null || !formats.includes(format)) throw new Error(`${file.name} is no mesh file that the server reads`);
  return { name: file.name, stem, format, file: plain };
}

async function head(file: Blob): Promise<Uint8Array> {
  return new Uint8Array(await file.slice(0, 4096).arrayBuffer());
}

async function unpack(file: Blob): Promise<Blob> {
  const reader = file.stream().pipeThrough(new DecompressionStream("gzip")).getReader();
  const parts: Uint8Array<ArrayBuffer>[] = [];
  let length = 0;
  for (;;) {
    const { value, done } = await reader.read().catch(() => {
      throw new Error("the file is packed by gzip and cannot be unpacked");
    });
    if (done) return new Blob(parts);
    length += value.length;
    if (length > MOST_UNPACKED * file.size + (1 << 16)) {
      await reader.cancel();
      throw new Error(`the file unpacks to more than ${MOST_UNPACKED} times its size`);
    }
    parts.push(value as Uint8Array<ArrayBuffer>);
  }
}
