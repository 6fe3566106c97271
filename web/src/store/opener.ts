/** What opens tiles for a store, which may be there before the codebooks are. */
import { DecodeError } from "../bytes/errors.ts";
import type { AnyTile, TileCodec } from "../decode/codec.ts";
import type { Kernels } from "../decode/kernels.ts";
import type { LooksTile } from "../decode/looks.ts";

export interface Opener {
  readonly kernels: Kernels;
  /** Decode LoD 0 of a tile of any kind; `looks` are those that a tile of motion moves. Raises {@link DecodeError}. */
  open(payload: Uint8Array, looks?: LooksTile): AnyTile;
}

/** An opener whose codec follows. */
export class LateOpener implements Opener {
  codec: TileCodec | undefined;
  readonly kernels: Kernels;

  constructor(kernels: Kernels) {
    this.kernels = kernels;
  }

  open(payload: Uint8Array, looks?: LooksTile): AnyTile {
    if (!this.codec) throw new DecodeError("tiles came before the codebooks that they need");
    return this.codec.open(payload, looks);
  }
}
