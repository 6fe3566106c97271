/** A message, or a sequence of them, that the wire protocol does not allow. */
export class ProtocolError extends Error {
  override name = "ProtocolError";
}

/** Damaged or hostile data of a bundle: what was held stays, and what it came with is left out. */
export class DecodeError extends Error {
  override name = "DecodeError";
}

/** A manifest that this program does not read. */
export class BundleError extends Error {
  override name = "BundleError";
}
