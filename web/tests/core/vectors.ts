/** What the Python side of a test has written for this one. */
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { Draco } from "../../src/decode/draco.ts";
import { Kernels } from "../../src/decode/kernels.ts";

export const HERE = fileURLToPath(new URL(".", import.meta.url));
const WEB = fileURLToPath(new URL("../..", import.meta.url));

/** The vectors of a name; their shape is the Python test's. */
export function vectors<T>(name: string): T {
  return JSON.parse(readFileSync(join(process.env["CAGS_VECTORS"] ?? ".", `${name}.json`), "utf-8")) as T;
}

export function fromHex(text: string): Uint8Array<ArrayBuffer> {
  return Uint8Array.from(Buffer.from(text, "hex"));
}

export function fromBase64(text: string): Uint8Array<ArrayBuffer> {
  return Uint8Array.from(Buffer.from(text, "base64"));
}

export function hex(data: Uint8Array): string {
  return Buffer.from(data).toString("hex");
}

export async function kernels(): Promise<Kernels> {
  return Kernels.load(Uint8Array.from(readFileSync(join(WEB, "dist", "kernels.wasm"))));
}

export async function draco(): Promise<Draco> {
  return Draco.load(readFileSync(join(WEB, "node_modules", "draco3d", "draco_decoder.wasm")));
}
