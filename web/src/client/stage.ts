/** Draws the newest frame on the page's canvas: one picture, or two under a wipe; then what lies over them. */

import { clamp } from "../player/vectors.ts";
import type { GridHead, Line } from "./messages.ts";
import { type DecodedFrame, type Drawable, letGo, sizeOf } from "./pictures.ts";

type Colour = readonly [number, number, number];

/** From the base alone (red) to every layer (blue). */
const DETAIL: readonly Colour[] = [[215, 48, 31], [252, 141, 89], [253, 204, 92], [127, 205, 187], [44, 127, 184]];
const ALPHA = 150;
/** A picture that is smaller by no more, a side, is one of the window's own pixels. */
const ROUNDED_PX = 2;
const OUTLINE = "#7cf5ff";

export class Stage {
  /** Share of the width that the left picture has, where there are two. */
  wipe = 0.5;
  readonly #canvas: HTMLCanvasElement;
  readonly #context: CanvasRenderingContext2D;
  #names: readonly string[] = [];
  #frame: DecodedFrame | null = null;
  #grids: readonly OffscreenCanvas[] = [];

  constructor(canvas: HTMLCanvasElement) {
    this.#canvas = canvas;
    this.#context = canvas.getContext("2d", { alpha: false })!;
    new ResizeObserver(() => this.#fit()).observe(canvas);
  }

  /** Names of the pictures to draw: one, or two under a wipe. */
  set names(names: readonly string[]) {
    this.#names = names;
    this.draw();
  }

  /** Show a decoded frame from now on; the one before is let go. */
  show(frame: DecodedFrame): void {
    if (this.#frame) letGo(this.#frame);
    this.#frame = frame;
    this.#grids = frame.head.overlays.grids.map((grid, i) => tinted(grid, frame.grids[i]!));
    this.draw();
  }

  draw(): void {
    if (!this.#frame) return;
    const { images } = this.#frame;
    const [left, right] = this.#names.map((name) => images.get(name));
    const some = left ?? right ?? images.values().next().value;
    if (!some) return;
    const [width, height] = sizeOf(some);
    if (this.#canvas.width !== width) this.#canvas.width = width;
    if (this.#canvas.height !== height) this.#canvas.height = height;
    this.#fit();
    const two = this.#names.length > 1;
    const at = Math.round(width * this.wipe);
    this.#picture(left, 0, two ? at : width);
    if (two) this.#picture(right, at, width);
    this.#overlays();
    if (two) this.#line([at / width, 0, at / width, 1], "#fff", 2);
  }

  /** Pixel for pixel where the picture was made for this window: what is judged is then the client's, not a scaling. */
  #fit(): void {
    const { width, height, clientWidth, clientHeight, style } = this.#canvas;
    const own = [clientWidth - width, clientHeight - height].every((rest) => rest >= 0 && rest <= ROUNDED_PX);
    style.setProperty("object-fit", own && devicePixelRatio === 1 ? "none" : "");
  }

  #picture(image: Drawable | undefined, from: number, to: number): void {
    const { width, height } = this.#canvas;
    const context = this.#context;
    if (image) {
      const [w, h] = sizeOf(image);
      context.imageSmoothingEnabled = w !== width || h !== height;
      context.drawImage(image, (from / width) * w, 0, ((to - from) / width) * w, h, from, 0, to - from, height);
      return;
    }
    context.fillStyle = "#05070a";
    context.fillRect(from, 0, to - from, height);
    context.fillStyle = "#a9b0bb";
    context.textAlign = "center";
    context.font = `${Math.max(12, height / 40)}px system-ui, sans-serif`;
    context.fillText("not in this frame", (from + to) / 2, height / 2);
  }

  #overlays(): void {
    const { width, height } = this.#canvas;
    this.#context.imageSmoothingEnabled = true;
    for (const grid of this.#grids) this.#context.drawImage(grid, 0, 0, width, height);
    const { tiles = [], reference = [] } = this.#frame!.head.overlays;
    for (const { detail, lines } of tiles) for (const line of lines) this.#line(line, `rgb(${detailColour(detail).join(" ")} / 0.85)`, 1.2);
    for (const [style, wide] of [["#0008", 4], [OUTLINE, 2]] as const) for (const line of reference) this.#line(line, style, wide);
    if (reference.length) this.#plan(reference);
  }

  #line([x0, y0, x1, y1]: Line, style: string, wide: number): void {
    const { width, height } = this.#canvas;
    const context = this.#context;
    context.strokeStyle = style;
    context.lineWidth = wide;
    context.beginPath();
    context.moveTo(x0 * width, y0 * height);
    context.lineTo(x1 * width, y1 * height);
    context.stroke();
  }

  /** The reference's border around this view, small: it mostly lies outside the view. */
  #plan(lines: readonly Line[]): void {
    const { width, height } = this.#canvas;
    const context = this.#context;
    const [w, h, left, top] = [0.2 * width, 0.2 * height, 0.78 * width, 0.62 * height];
    context.save();
    context.beginPath();
    context.rect(left, top, w, h);
    context.fillStyle = "#0a0e14c8";
    context.fill();
    context.clip();
    const inside = (u: number, size: number, from: number): number => from + size * (0.5 + (u - 0.5) * 0.5);
    for (const [x0, y0, x1, y1] of lines)
      this.#line([inside(x0, w, left) / width, inside(y0, h, top) / height, inside(x1, w, left) / width, inside(y1, h, top) / height], OUTLINE, 1.5);
    context.strokeStyle = "#fff";
    context.strokeRect(inside(0, w, left), inside(0, h, top), w / 2, h / 2);
    context.restore();
  }
}

/** Of a share 0..1 of the quality layers. */
export function detailColour(share: number): Colour {
  const at = clamp(share, 0, 1) * (DETAIL.length - 1);
  const i = Math.min(Math.floor(at), DETAIL.length - 2);
  return DETAIL[i]!.map((low, c) => Math.round(low + (DETAIL[i + 1]![c]! - low) * (at - i))) as unknown as Colour;
}

const TINTS: Readonly<Record<string, (value: number) => readonly number[]>> = {
  occlusion: (v) => [255, 79, 163, (v * ALPHA) / 255],
  confidence: (v) => [255, 79, 79, ((255 - v) * ALPHA) / 255],
  detail: (v) => (v ? [...detailColour((v - 1) / 254), ALPHA] : [0, 0, 0, 0]),
};

function tinted({ name, width, height }: GridHead, bytes: Uint8Array): OffscreenCanvas {
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d")!;
  const image = context.createImageData(width, height);
  const table = Array.from({ length: 256 }, (_, value) => TINTS[name]!(value));
  bytes.forEach((value, i) => image.data.set(table[value]!, i * 4));
  context.putImageData(image, 0, 0);
  return canvas;
}
