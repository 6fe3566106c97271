/**
 * References matched to the frames that are shown, and the mark up to which a frame is shown; as
 * `cags_client.store.references` and `ClientPipeline._basis_at`. `P` is what the page makes of a reference: a decoded picture.
 */
import type { Reference } from "../seam.ts";

/** References kept: those sent ahead of display and the last few shown. */
const KEPT = 24;

/** Frames for which a late reference is waited for before more is shown than the one before it assumes. */
const PATIENCE_FRAMES = 3;

/** A reference is late by at most this share of the clip; in a loop, any other belongs to the next round. */
const LATEST = 0.25;

/** Frames after a start or a jump for which the displayed levels tell how good the splats are; as `cags_client.store.references`. */
const BEGINNING = 12;

export interface Received<P> {
  readonly reference: Reference;
  /** null: it says nothing. */
  readonly picture: P;
}

/** Whether a reference is right for its basis alone; a picture is compared with whatever is held. */
function assumes(reference: Reference): boolean {
  return reference.kind !== "picture";
}

export class References<P> {
  private readonly received = new Map<number, Received<P>>();
  /** Frames of theirs that were not reached yet. */
  private readonly toCome = new Set<number>();
  /** On display. */
  private frame = -1;
  /** That was displayed since the start or the last jump. */
  private first: number | undefined;
  private mark = 0;
  private committed = 0;
  /** References up to this order are of no use, should they still be decoded. */
  private forgotten = 0;

  /** Take a decoded reference, or one that says nothing. */
  add(reference: Reference, picture: P): void {
    if (reference.order <= this.forgotten) return;
    this.received.delete(reference.frame);
    this.received.set(reference.frame, { reference, picture });
    this.toCome.add(reference.frame);
    while (this.received.size > KEPT) this.drop(this.received.keys().next().value!);
  }

  private drop(frame: number): void {
    this.received.delete(frame);
    this.toCome.delete(frame);
  }

  /**
   * Display media frame `frame` of a clip of `frames`. Call this before `newest` and `basis`.
   *
   * Each round of a loop has its own references. A reference whose frame was displayed or skipped no longer counts as one
   * to come, and it is dropped when the next round begins, where it would be wrong.
   */
  show(frame: number, frames: number): void {
    const begins = frame < this.frame;
    this.frame = frame;
    this.first ??= frame;
    for (const at of [...this.received.keys()]) {
      const ahead = (((at - frame) % frames) + frames) % frames;
      const coming = this.toCome.has(at);
      if (coming && (ahead === 0 || ahead >= frames / 2)) this.toCome.delete(at);
      const late = at > frame && !this.toCome.has(at) && (frames - ahead) % frames <= LATEST * frames;
      if ((begins && !coming) || late) this.drop(at);
    }
  }

  /** Whether the frame on display is one of the first after a start or a jump. */
  get beginning(): boolean {
    return this.first !== undefined && this.frame >= this.first && this.frame < this.first + BEGINNING;
  }

  /** The newest mark of the store: of every `mark` event, or of a frame's update. */
  marked(mark: number): void {
    this.mark = Math.max(this.mark, mark);
  }

  /** The reference of the frame on display, or the newest one of the `maxAge` frames before it. */
  newest(maxAge: number): Received<P> | undefined {
    let best: Received<P> | undefined;
    for (const [at, one] of this.received) {
      const age = this.frame - at;
      if (this.toCome.has(at) || age < 0 || age > maxAge) continue;
      if (!best || at > best.reference.frame) best = one;
    }
    return best;
  }

  /**
   * The mark up to which the frame on display is shown, with `found` as its reference: call once a picture, right before
   * it is committed. undefined: all that has come.
   *
   * That which the frame's own reference assumes. A picture assumes none: as much is shown as no coming reference falls
   * behind. While an own reference is late, as much is shown as the newest one assumes, which may have come after its
   * own frame, and no less than before; if that one says nothing, there is nothing to keep in force. While the clip stands
   * `still`, no reference of a later frame is waited for.
   */
  basis(found: Received<P> | undefined, still = false): number | undefined {
    const reference = found?.reference;
    if (reference && assumes(reference)) {
      const own = reference.frame === this.frame;
      if (own || (reference.kind !== "nothing" && this.frame - reference.frame <= PATIENCE_FRAMES)) {
        this.committed = Math.max(reference.basis, own ? 0 : this.committed);
        return this.committed;
      }
    }
    this.committed = Math.min(still ? Infinity : this.nextBasis(), this.mark);
    return this.committed || undefined;
  }

  /** The mark that the next references assume, of those that have come for later frames; Infinity: none does. */
  private nextBasis(): number {
    let least = Infinity;
    for (const at of this.toCome) {
      const { reference } = this.received.get(at)!;
      if (assumes(reference)) least = Math.min(least, reference.basis);
    }
    return least;
  }

  /** Forget everything (the viewer jumped), or references up to the order `until`. */
  reset(until = Infinity): void {
    if (until < Infinity) this.forgotten = until;
    else this.first = undefined;
    for (const [frame, { reference }] of this.received) {
      if (reference.order <= until) this.drop(frame);
    }
  }
}
