/** Live H.264 by WebCodecs: one access unit in, one picture out. */

import type { Chroma } from "../seam.ts";
import { isPacked, rgbOfPacked, rgbOfPlanes } from "./colour.ts";

/** Of the server's encoder: High 4:4:4 Predictive, and High; level 2.1. */
const PROBES: readonly (readonly [Chroma, string])[] = [
  ["yuv444p", "avc1.F40015"],
  ["yuv420p", "avc1.640015"],
];
/** Largest reference that is decoded. */
const MAX_PIXELS = 1 << 21;
/** A decoder that gives nothing for so long is taken for broken. */
const PATIENCE_MS = 5000;

export class VideoError extends Error {}

/** The finest colour sampling that this browser decodes to planes; undefined: it decodes none. */
export async function finestChroma(): Promise<Chroma | undefined> {
  if (typeof VideoDecoder === "undefined") return undefined;
  for (const [chroma, codec] of PROBES) if (await configOf(codec)) return chroma;
  return undefined;
}

async function configOf(codec: string): Promise<VideoDecoderConfig | undefined> {
  for (const hardwareAcceleration of ["prefer-software", "no-preference"] as const) {
    const config: VideoDecoderConfig = { codec, hardwareAcceleration, optimizeForLatency: true };
    const answer = await VideoDecoder.isConfigSupported(config).catch(() => undefined);
    if (answer?.supported) return config;
  }
  return undefined;
}

/** Codec string of an access unit with parameter sets; undefined for one without. */
export function codecOf(accessUnit: Uint8Array): string | undefined {
  for (let i = 0; i + 6 < accessUnit.length; i++) {
    if (accessUnit[i] || accessUnit[i + 1] || accessUnit[i + 2] !== 1 || (accessUnit[i + 3] & 31) !== 7) continue;
    const bytes = accessUnit.subarray(i + 4, i + 7);
    return `avc1.${[...bytes].map((b) => b.toString(16).padStart(2, "0").toUpperCase()).join("")}`;
  }
  return undefined;
}

/** Decodes access units in order. After {@link reset} it waits for an IDR picture with parameter sets. */
export class H264Decoder {
  #decoder: VideoDecoder | null = null;
  #waiting: { take: (frame: VideoFrame) => void; fail: (error: Error) => void } | null = null;
  #time = 0;

  /** Whether a picture that needs earlier ones can be decoded. */
  get started(): boolean {
    return this.#decoder !== null;
  }

  /** RGB [h, w, 3] in [0, 1] of a picture of that size. Rejects with {@link VideoError}; the decoder is then reset. */
  async decode(accessUnit: Uint8Array<ArrayBuffer>, idr: boolean, width: number, height: number): Promise<Float32Array<ArrayBuffer>> {
    try {
      if (width * height > MAX_PIXELS) throw new VideoError(`a reference of ${width}x${height} pixels is too large`);
      if (idr && !this.#decoder) await this.#open(accessUnit);
      const frame = await this.#picture(accessUnit, idr);
      try {
        return await rgbOf(frame, width, height);
      } finally {
        frame.close();
      }
    } catch (error) {
      this.reset();
      throw error instanceof VideoError ? error : new VideoError(String(error));
    }
  }

  /** Forget every picture and wait for the next IDR. */
  reset(): void {
    const decoder = this.#decoder;
    this.#decoder = null;
    this.#waiting?.fail(new VideoError("the video was reset"));
    this.#waiting = null;
    if (decoder && decoder.state !== "closed") decoder.close();
  }

  async #open(accessUnit: Uint8Array): Promise<void> {
    const codec = codecOf(accessUnit);
    const config = codec && (await configOf(codec));
    if (!config) throw new VideoError(`this browser does not decode ${codec ?? "a picture without parameter sets"}`);
    this.#decoder = new VideoDecoder({
      output: (frame) => {
        if (this.#waiting) this.#waiting.take(frame);
        else frame.close();
        this.#waiting = null;
      },
      error: (error) => {
        this.#waiting?.fail(new VideoError(error.message));
        this.#waiting = null;
      },
    });
    this.#decoder.configure(config);
  }

  #picture(data: Uint8Array<ArrayBuffer>, idr: boolean): Promise<VideoFrame> {
    const decoder = this.#decoder;
    if (!decoder) return Promise.reject(new VideoError("the video has not begun"));
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => this.#waiting?.fail(new VideoError("the decoder gave no picture")), PATIENCE_MS);
      this.#waiting = {
        take: (frame) => (clearTimeout(timer), resolve(frame)),
        fail: (error) => (clearTimeout(timer), reject(error)),
      };
      decoder.decode(new EncodedVideoChunk({ type: idr ? "key" : "delta", timestamp: this.#time++, data }));
    });
  }
}

async function rgbOf(frame: VideoFrame, width: number, height: number): Promise<Float32Array<ArrayBuffer>> {
  const { format, visibleRect: size } = frame;
  if (size!.width !== width || size!.height !== height)
    throw new VideoError(`a reference of ${size!.width}x${size!.height} pixels, said to be ${width}x${height}`);
  const packed = isPacked(format);
  if (!packed && format !== "I444" && format !== "I420" && format !== "NV12") throw new VideoError(`pixel format ${format} is none that is sent`);
  if (!packed && format !== "I444" && (width % 2 || height % 2)) throw new VideoError(`4:2:0 of odd size ${width}x${height}`);
  const data = new Uint8Array(frame.allocationSize());
  const layout = await frame.copyTo(data);
  return packed ? rgbOfPacked({ width, height, data, layout, format }) : rgbOfPlanes({ width, height, data, layout, format });
}
