/** Pictures that came to drawable ones: H.264 by WebCodecs, JPEG, or 4:2:0 as it is. All of a frame come out together. */

import type { Formats, FrameHead, FrameMessage, PictureHead } from "./messages.ts";

const STUCK_MS = 1500;
const COLOURS: VideoColorSpaceInit = { matrix: "smpte170m", primaries: "bt709", transfer: "iec61966-2-1", fullRange: false };

export type Drawable = VideoFrame | ImageBitmap;

export interface DecodedFrame {
  readonly head: FrameHead;
  readonly grids: FrameMessage["grids"];
  /** By name. */
  readonly images: Map<string, Drawable>;
}

/** What this browser shows. `?jpeg` and `?h264` in the page's address leave the others out, to try. */
export async function formats(search: string): Promise<Formats> {
  const asked = new URLSearchParams(search);
  if (asked.has("jpeg") || typeof VideoDecoder === "undefined") return { h264: false, raw: false };
  const answer = await VideoDecoder.isConfigSupported({ codec: "avc1.42c01f", optimizeForLatency: true }).catch(() => undefined);
  const h264 = answer?.supported ?? false;
  return { h264, raw: h264 && !asked.has("h264") };
}

export function sizeOf(image: Drawable): readonly [number, number] {
  return image instanceof ImageBitmap ? [image.width, image.height] : [image.displayWidth, image.displayHeight];
}

export function letGo({ images }: DecodedFrame): void {
  for (const image of images.values()) image.close();
  images.clear();
}

export class Pictures {
  readonly #ready: (frame: DecodedFrame) => void;
  readonly #lost: (number: number) => void;
  readonly #streams = new Map<string, Stream>();
  readonly #pending = new Map<number, DecodedFrame & { readonly sinceMs: number }>();

  /** `lost`: given up; the next one is to be decoded by itself. */
  constructor(ready: (frame: DecodedFrame) => void, lost: (number: number) => void) {
    this.#ready = ready;
    this.#lost = lost;
  }

  add({ head, pictures, grids }: FrameMessage): void {
    const frame = { head, grids, images: new Map<string, Drawable>(), sinceMs: performance.now() };
    this.#pending.set(head.number, frame);
    for (const [name, stream] of this.#streams) if (!head.pictures.some((picture) => picture.name === name)) this.#end(name, stream);
    head.pictures.forEach((picture, i) => this.#decode(head.number, picture, pictures[i]!));
    if (!head.pictures.length) this.#finish(frame);
    for (const [number, { sinceMs }] of this.#pending) if (sinceMs < performance.now() - STUCK_MS) this.#fail(number);
  }

  /** Forget everything: of a new connection the streams begin anew. */
  reset(): void {
    for (const [name, stream] of this.#streams) this.#end(name, stream);
    for (const frame of this.#pending.values()) letGo(frame);
    this.#pending.clear();
  }

  #end(name: string, stream: Stream): void {
    stream.close();
    this.#streams.delete(name);
  }

  #decode(number: number, head: PictureHead, data: Uint8Array<ArrayBuffer>): void {
    const { name, codec } = head;
    if (codec === "jpeg") {
      createImageBitmap(new Blob([data], { type: "image/jpeg" })).then((image) => this.#done(number, name, image), () => this.#fail(number));
    } else if (codec === "i420") this.#done(number, name, uncoded(number, head, data));
    else {
      const stream = this.#streams.get(name) ?? new Stream((at, image) => this.#done(at, name, image), () => this.#broken(name));
      this.#streams.set(name, stream);
      stream.decode(number, head, data);
    }
  }

  #done(number: number, name: string, image: Drawable): void {
    const frame = this.#pending.get(number);
    if (!frame) return image.close();
    frame.images.set(name, image);
    if (frame.images.size === frame.head.pictures.length) this.#finish(frame);
  }

  #finish(frame: DecodedFrame): void {
    this.#pending.delete(frame.head.number);
    this.#ready(frame);
  }

  #broken(name: string): void {
    const stream = this.#streams.get(name);
    if (stream) this.#end(name, stream);
    for (const number of [...this.#pending.keys()]) this.#fail(number);
  }

  #fail(number: number): void {
    const frame = this.#pending.get(number);
    if (!frame) return;
    this.#pending.delete(number);
    letGo(frame);
    this.#lost(number);
  }
}

/** One H.264 stream. */
class Stream {
  readonly #done: (number: number, image: VideoFrame) => void;
  readonly #failed: () => void;
  #decoder: VideoDecoder | null = null;
  #codec = "";

  /** `failed`: it must begin again at a picture that is decoded by itself. */
  constructor(done: (number: number, image: VideoFrame) => void, failed: () => void) {
    this.#done = done;
    this.#failed = failed;
  }

  decode(number: number, { key, codec }: PictureHead, data: Uint8Array<ArrayBuffer>): void {
    if (key && (this.#codec !== codec || this.#decoder?.state !== "configured")) this.#configure(codec);
    if (this.#decoder?.state !== "configured") return this.#failed();
    this.#decoder.decode(new EncodedVideoChunk({ type: key ? "key" : "delta", timestamp: number, data }));
  }

  #configure(codec: string): void {
    this.close();
    this.#codec = codec;
    this.#decoder = new VideoDecoder({ output: (image) => this.#done(image.timestamp, image), error: () => this.#failed() });
    this.#decoder.configure({ codec, optimizeForLatency: true });
  }

  close(): void {
    if (this.#decoder && this.#decoder.state !== "closed") this.#decoder.close();
    this.#decoder = null;
  }
}

/** A picture that came as it is: three planes, one after another. */
function uncoded(timestamp: number, { width, height }: PictureHead, data: Uint8Array<ArrayBuffer>): VideoFrame {
  return new VideoFrame(data, { format: "I420", codedWidth: width, codedHeight: height, timestamp, colorSpace: COLOURS });
}
