/** What a client still holds when it comes back: the payload of a hello that resumes, seven bytes a tile. */
import { ProtocolError } from "../bytes/errors.ts";
import { MAX_LODS } from "./limits.ts";
import type { HeldTile } from "./messages.ts";

export const MAX_INVENTORY_TILES = 16_384;
const TILE_BYTES = 7;

/** The newest {@link MAX_INVENTORY_TILES} of what is held; tiles of which nothing is held are left out. */
export function packInventory(tiles: Iterable<HeldTile>): Uint8Array<ArrayBuffer> {
  const held = [...tiles].filter((t) => t.lods).sort((a, b) => b.frame - a.frame || a.tile - b.tile);
  const chosen = held.slice(0, MAX_INVENTORY_TILES);
  const out = new Uint8Array(chosen.length * TILE_BYTES);
  const view = new DataView(out.buffer);
  for (const [i, t] of chosen.entries()) {
    view.setUint32(TILE_BYTES * i, t.frame, true);
    view.setUint16(TILE_BYTES * i + 4, t.tile, true);
    view.setUint8(TILE_BYTES * i + 6, t.lods);
  }
  return out;
}

/** The tiles of an inventory. Raises {@link ProtocolError} for what is none. */
export function unpackInventory(data: Uint8Array): HeldTile[] {
  if (data.length % TILE_BYTES || data.length > MAX_INVENTORY_TILES * TILE_BYTES) {
    throw new ProtocolError(`inventory has ${data.length} bytes; at most ${MAX_INVENTORY_TILES} tiles of ${TILE_BYTES} each`);
  }
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const tiles: HeldTile[] = [];
  for (let at = 0; at < data.length; at += TILE_BYTES) {
    const t = { frame: view.getUint32(at, true), tile: view.getUint16(at + 4, true), lods: view.getUint8(at + 6) };
    if (t.frame > 2 ** 31 - 1 || t.lods < 1 || t.lods > MAX_LODS) {
      throw new ProtocolError(`inventory: frame ${t.frame}, tile ${t.tile}, ${t.lods} LoDs is not a tile that can be held`);
    }
    tiles.push(t);
  }
  return tiles;
}
