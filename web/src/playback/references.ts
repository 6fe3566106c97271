/**
 * References matched to the frames that are shown, and the mark up to which a frame is shown; as
 * `cags_client.store.references` and `ClientPipeline._basis_at`. `P` is what the page makes of a reference: a decoded picture.
 */
import type { Reference } from "../seam.ts";

/** References kept: those sent ahead of display and the last few shown. */
const KEPT = 24;

/** Frames for which a late reference is waited for before more is shown than the one before it assumes. */
const PATIENCE_FRAMES = 3;

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
  /** Frames that were not reached yet. */
  private readonly toCome = new Set<number>();
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
    while (this.received.size > KEPT) this.received.delete(this.received.keys().next().value!);
  }

  /** The newest mark of the store: of every `mark` event, or of a frame's update. */
  marked(mark: number): void {
    this.mark = Math.max(this.mark, mark);
  }

  /** That of `frame`, or the newest of the `maxAge` frames before it; never one of a frame to come. */
  newest(frame: number, maxAge: number): Received<P> | undefined {
    let best: Received<P> | undefined;
    for (const [at, one] of this.received) {
      if (at <= frame && frame - at <= maxAge && (!best || at > best.reference.frame)) best = one;
    }
    return best;
  }

  /**
   * The mark up to which `frame` is shown, with `found` as its reference: call once a picture, right before it is
   * committed, of a clip of `frames`. undefined: all that has come.
   *
   * That which the frame's own reference assumes. A picture assumes none: as much is shown as no coming reference falls
   * behind. While an own reference is late, what is shown stays as the one before assumes.
   */
  basisAt(frame: number, found: Received<P> | undefined, frames: number): number | undefined {
    const reference = found?.reference;
    const coming = this.nextBasis(frame, frames);
    if (reference && assumes(reference) && frame - reference.frame <= PATIENCE_FRAMES) {
      if (reference.frame === frame) this.committed = reference.basis;
      return this.committed;
    }
    this.committed = coming === undefined ? this.mark : Math.min(coming, this.mark);
    return this.committed || undefined;
  }

  /**
   * The mark that the next references assume, of those that have come for frames after `frame` in a clip of `frames`.
   * A frame that was reached once, or was skipped, is never one to come again: its reference must not hold back what came
   * since, not even half a clip later, when a loop would reach it next.
   */
  private nextBasis(frame: number, frames: number): number | undefined {
    let least: number | undefined;
    for (const at of this.toCome) {
      const ahead = (((at - frame) % frames) + frames) % frames;
      const one = this.received.get(at);
      if (!one || ahead === 0 || ahead >= frames / 2) this.toCome.delete(at);
      else if (assumes(one.reference)) least = Math.min(least ?? Infinity, one.reference.basis);
    }
    return least;
  }

  /** Another connection's video follows; what is there stays in use. */
  restart(): void {}

  /** Forget everything (the viewer jumped), or references up to the order `until`. */
  reset(until = Infinity): void {
    if (until < Infinity) this.forgotten = until;
    for (const [frame, { reference }] of this.received) {
      if (reference.order > until) continue;
      this.received.delete(frame);
      this.toCome.delete(frame);
    }
  }
}
