/** Several files as one archive, stored and not compressed: frames of a clip travel together. */

import { crc32 } from "../bytes/crc32.ts";

const [MOST_FILES, MOST_BYTES] = [2 ** 16 - 1, 2 ** 32 - 1];

/** A ZIP archive (PKWARE's APPNOTE 4.3), without folders. Throws for more files or bytes than its fields can say. */
export async function zipped(files: readonly File[]): Promise<Blob> {
  if (files.length > MOST_FILES || files.reduce((sum, { size }) => sum + size, 0) > MOST_BYTES) {
    throw new Error(`These are too many files to be sent at once: at most ${MOST_FILES}, of 4 GB together.`);
  }
  const [parts, directory]: [BlobPart[], BlobPart[]] = [[], []];
  let offset = 0;
  let length = 0;
  for (const file of files) {
    const data = new Uint8Array(await file.arrayBuffer());
    const name = new TextEncoder().encode(file.name);
    const about = [[20, 2], [0x800, 2], [0, 2], [0, 2], [0x21, 2], [crc32(data), 4], [data.length, 4], [data.length, 4], [name.length, 2], [0, 2]] as const;
    const local = fields([[0x04034b50, 4], ...about]);
    const entry = fields([[0x02014b50, 4], [20, 2], ...about, [0, 2], [0, 2], [0, 2], [0, 4], [offset, 4]]);
    parts.push(local, name, data);
    directory.push(entry, name);
    offset += local.length + name.length + data.length;
    length += entry.length + name.length;
  }
  const end = fields([[0x06054b50, 4], [0, 2], [0, 2], [files.length, 2], [files.length, 2], [length, 4], [offset, 4], [0, 2]]);
  return new Blob([...parts, ...directory, end], { type: "application/zip" });
}

/** Little-endian numbers of these bytes. */
function fields(values: readonly (readonly [value: number, bytes: number])[]): Uint8Array<ArrayBuffer> {
  const out = new Uint8Array(values.reduce((sum, [, bytes]) => sum + bytes, 0));
  let at = 0;
  for (const [value, bytes] of values) for (let i = 0; i < bytes; i++) out[at++] = (value / 2 ** (8 * i)) & 0xff;
  return out;
}
