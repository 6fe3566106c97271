// Pictures that came to drawable ones: H.264 by WebCodecs, JPEG, or 4:2:0 as it is. All of a frame come out together.

const STUCK_MS = 1500;
const COLOURS = { matrix: "smpte170m", primaries: "bt709", transfer: "iec61966-2-1", fullRange: false };

/** What this browser can show: {h264, raw}. `?jpeg` and `?h264` in the page's address leave the others out, to try. */
export async function formats() {
  const asked = new URLSearchParams(location.search);
  if (asked.has("jpeg") || !("VideoDecoder" in window)) return { h264: false, raw: false };
  const { supported } = await VideoDecoder.isConfigSupported({ codec: "avc1.42c01f", optimizeForLatency: true });
  return { h264: supported, raw: !asked.has("h264") };
}

/** One H.264 stream. `done(number, image)` for each picture, `failed()` when it must start again at a key picture. */
class Stream {
  #decoder = null;
  #codec = "";

  constructor(done, failed) {
    this.done = done;
    this.failed = failed;
  }

  decode(number, picture, data) {
    if (picture.key && (this.#codec !== picture.codec || this.#decoder?.state !== "configured")) this.#configure(picture.codec);
    if (this.#decoder?.state !== "configured") return this.failed();
    this.#decoder.decode(new EncodedVideoChunk({ type: picture.key ? "key" : "delta", timestamp: number, data }));
  }

  #configure(codec) {
    this.close();
    this.#codec = codec;
    this.#decoder = new VideoDecoder({
      output: (image) => this.done(image.timestamp, image),
      error: () => this.failed(),
    });
    this.#decoder.configure({ codec, optimizeForLatency: true });
  }

  close() {
    if (this.#decoder && this.#decoder.state !== "closed") this.#decoder.close();
    this.#decoder = null;
  }
}

export class FrameDecoder {
  #streams = new Map();
  #pending = new Map();

  /** `ready(frame)`: {header, payloads, images: Map(name -> VideoFrame | ImageBitmap)}; `lost(number)`: give up, ask for a key. */
  constructor(ready, lost) {
    this.ready = ready;
    this.lost = lost;
  }

  add(header, payloads) {
    const frame = { header, payloads, images: new Map(), since: performance.now() };
    this.#pending.set(header.number, frame);
    this.#forget(header.pictures.map((picture) => picture.name));
    header.pictures.forEach((picture, i) => this.#decode(header.number, picture, payloads.pictures[i]));
    if (!header.pictures.length) this.#finish(frame);
    this.#dropStuck();
  }

  reset() {
    for (const stream of this.#streams.values()) stream.close();
    for (const frame of this.#pending.values()) closeImages(frame);
    this.#streams.clear();
    this.#pending.clear();
  }

  #decode(number, picture, data) {
    if (picture.codec === "jpeg") {
      createImageBitmap(new Blob([data], { type: "image/jpeg" })).then(
        (image) => this.#done(number, picture.name, image),
        () => this.#fail(number),
      );
      return;
    }
    if (picture.codec === "i420") return this.#done(number, picture.name, uncoded(number, picture, data));
    if (!this.#streams.has(picture.name)) {
      const done = (timestamp, image) => this.#done(timestamp, picture.name, image);
      this.#streams.set(picture.name, new Stream(done, () => this.#failStream(picture.name)));
    }
    this.#streams.get(picture.name).decode(number, picture, data);
  }

  #done(number, name, image) {
    const frame = this.#pending.get(number);
    if (!frame) return image.close();
    frame.images.set(name, image);
    if (frame.images.size === frame.header.pictures.length) this.#finish(frame);
  }

  #finish(frame) {
    this.#pending.delete(frame.header.number);
    this.ready(frame);
  }

  #failStream(name) {
    this.#streams.get(name)?.close();
    this.#streams.delete(name);
    for (const number of [...this.#pending.keys()]) this.#fail(number);
  }

  #fail(number) {
    const frame = this.#pending.get(number);
    if (!frame) return;
    this.#pending.delete(number);
    closeImages(frame);
    this.lost(number);
  }

  #forget(wanted) {
    for (const [name, stream] of this.#streams) {
      if (wanted.includes(name)) continue;
      stream.close();
      this.#streams.delete(name);
    }
  }

  #dropStuck() {
    const limit = performance.now() - STUCK_MS;
    for (const [number, frame] of this.#pending) if (frame.since < limit) this.#fail(number);
  }
}

/** A picture that came as it is: three planes, one after another. */
function uncoded(timestamp, { width, height }, data) {
  return new VideoFrame(data, { format: "I420", codedWidth: width, codedHeight: height, timestamp, colorSpace: COLOURS });
}

export function closeImages(frame) {
  for (const image of frame.images.values()) image.close();
  frame.images.clear();
}
