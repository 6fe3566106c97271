declare module "draco3d/draco_decoder_nodejs.js" {
  /** Start the decoder. */
  export default function createDecoder(options: { wasmBinary: ArrayBuffer | Uint8Array }): Promise<unknown>;
}
