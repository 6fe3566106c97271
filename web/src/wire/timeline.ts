/** Which media frame is displayed when, as `cags_protocol.timeline`: the same sum as the server's. */
import type { PlayState } from "../seam.ts";

interface Place {
  readonly frame: number;
  readonly atUs: number;
  readonly rate: number;
  readonly playing: boolean;
  readonly loop: boolean;
}

const START: Place = { frame: 0, atUs: 0, rate: 1, playing: false, loop: false };

/** Of a frame: links round times to 0.1 ms, which must not lead to the frame before. */
const ROUNDED = 0.01;

/** The media frame that a clip shows after `seconds`; beyond its end the last one. */
export function frameAt(seconds: number, { fps, frames }: { readonly fps: number; readonly frames: number }): number {
  return Math.max(0, Math.min(Math.floor(seconds * fps + ROUNDED), frames - 1));
}

/** Frame `frame` is displayed at `atUs`, the others at the frame rate times `rate`. They are counted from there by ticks,
 * which go on through every loop; while it is not playing, every tick displays `frame`. */
export class Timeline {
  readonly fps: number;
  readonly frames: number;
  readonly place: Place;

  constructor(fps: number, frames: number, place: Partial<Place> = {}) {
    this.fps = fps;
    this.frames = frames;
    this.place = { ...START, ...place };
  }

  /** The timeline that `state` asks for. A frame beyond the end is the last one. */
  controlled({ action, frame, atUs, rate = 1, loop = false }: PlayState): Timeline {
    const playing = action === "play" || (action !== "pause" && this.place.playing);
    return new Timeline(this.fps, this.frames, { frame: Math.min(frame, this.frames - 1), atUs, rate, playing, loop });
  }

  /** When the frame of `tick` is displayed. */
  displayUs(tick: number): number {
    return this.place.atUs + roundEven((tick * 1e6) / (this.fps * this.place.rate));
  }

  /** The first tick that is displayed at `fromUs` or later. */
  firstTick(fromUs: number): number {
    let tick = Math.floor(((fromUs - this.place.atUs) * this.fps * this.place.rate) / 1e6) - 1;
    while (this.displayUs(tick) < fromUs) tick++;
    return tick;
  }

  /** Media frame of `tick`, null past the end. */
  mediaFrame(tick: number): number | null {
    const { frame, playing, loop } = this.place;
    if (!playing) return frame;
    const at = frame + tick;
    if (loop) return at - Math.floor(at / this.frames) * this.frames;
    return at < this.frames ? at : null;
  }

  /** The tick after the last frame of the round that `tick` is in: of the only one without `loop`. */
  roundEnd(tick: number): number {
    const { frame, loop } = this.place;
    return (loop ? 1 + Math.floor((frame + tick) / this.frames) : 1) * this.frames - frame;
  }
}

/** To the nearest whole number, halves to the even one, as Python does. */
function roundEven(x: number): number {
  const up = Math.round(x);
  return up - x === 0.5 && up % 2 ? up - 1 : up;
}
