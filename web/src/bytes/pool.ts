/** Memory that is used again: a block of megabytes is new pages each time, and costs as much as what is written into it. */

/** Blocks that are kept at most; a frame has two patches, and one frame is under way while another is made. */
const KEPT = 4;
/** Sizes are rounded up to it, so that a block serves frames of nearly as many rows. */
const STEP_BYTES = 1 << 16;
/** A block this many times larger than what is wanted stays for those that need it. */
const LARGER = 4;

export class BufferPool {
  private readonly blocks: ArrayBuffer[] = [];

  /** Take back blocks that nobody reads any more; the oldest are let go where there are too many. */
  give(blocks: readonly ArrayBuffer[]): void {
    this.blocks.push(...blocks.filter((block) => block.byteLength > 0));
    this.blocks.splice(0, Math.max(0, this.blocks.length - KEPT));
  }

  /** A copy of `values`, in a block that was given back where one fits. */
  copy(values: Uint32Array): Uint32Array<ArrayBuffer> {
    const { byteLength, length } = values;
    const at = this.blocks.findIndex((block) => block.byteLength >= byteLength && block.byteLength <= LARGER * Math.max(byteLength, STEP_BYTES));
    const block = at < 0 ? new ArrayBuffer(Math.ceil(byteLength / STEP_BYTES) * STEP_BYTES) : this.blocks.splice(at, 1)[0]!;
    const out = new Uint32Array(block, 0, length);
    out.set(values);
    return out;
  }
}
