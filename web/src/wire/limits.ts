/** Bounds of the wire protocol, as `cags_protocol.wire.limits`: each is checked before anything of that size is allocated. */

export const PROTOCOL_VERSION = 4;
export const SUPPORTED_VERSIONS: readonly number[] = [4];
export const SUBPROTOCOL = "cags.v1";
export const MAX_HEADER_BYTES = 64 * 1024;
export const MAX_MESSAGE_BYTES = 16 * 1024 * 1024;
export const MAX_BLOB_BYTES = 256 * 1024 * 1024;
export const MAX_PARTIAL_MESSAGES = 64;
export const MAX_PARTIAL_BYTES = 32 * 1024 * 1024;
export const MAX_POSE_SAMPLES = 64;
export const MAX_ACK_RANGES = 32;
export const MAX_EVICTED_TILES = 512;
export const MAX_TEXT_BYTES = 1024;
export const MAX_LODS = 64;
