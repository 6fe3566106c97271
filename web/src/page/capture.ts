/** Keeps what the canvas shows: a picture, or a film of as long as it is asked for. */

/** The first of these that the browser writes. */
const FILMS = ["video/mp4;codecs=avc1.640028", "video/webm;codecs=vp9", "video/webm"];
const FRAMES_A_SECOND = 30;
const BITS_A_SECOND = 12_000_000;

/** Save `data` as a file of this name. */
export function download(data: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(data);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** The canvas as PNG; to be asked for in the turn in which it was drawn on. */
export function pictureOf(canvas: HTMLCanvasElement): Promise<Blob> {
  return new Promise((resolve, reject) => canvas.toBlob((data) => (data ? resolve(data) : reject(new Error("the picture cannot be read")))));
}

/** Films a canvas. */
export class Film {
  readonly #recorder: MediaRecorder;
  readonly #parts: Blob[] = [];

  /** The kind of film that this browser writes; undefined: none. */
  static get kind(): string | undefined {
    return typeof MediaRecorder === "undefined" ? undefined : FILMS.find((kind) => MediaRecorder.isTypeSupported(kind));
  }

  /** Begin. `ended` is given the film, and the suffix of its name. */
  constructor(canvas: HTMLCanvasElement, kind: string, ended: (film: Blob, suffix: string) => void) {
    const stream = canvas.captureStream(FRAMES_A_SECOND);
    this.#recorder = new MediaRecorder(stream, { mimeType: kind, videoBitsPerSecond: BITS_A_SECOND });
    this.#recorder.addEventListener("dataavailable", ({ data }) => this.#parts.push(data));
    this.#recorder.addEventListener("stop", () => {
      for (const track of stream.getTracks()) track.stop();
      ended(new Blob(this.#parts, { type: kind.split(";")[0] }), kind.startsWith("video/mp4") ? "mp4" : "webm");
    });
    this.#recorder.start(1000);
  }

  stop(): void {
    this.#recorder.stop();
  }
}
