// Draws the newest frame: one picture, two beside each other, or two under a wipe; then what lies over them.

import { closeImages } from "./decoder.js";

const DETAIL_STOPS = [[215, 48, 31], [252, 141, 89], [253, 204, 92], [127, 205, 187], [44, 127, 184]];
const ALPHA = 150;
const NEARLY = 1.5; // a picture that would grow by less is shown pixel for pixel,
const DENSE = 1.5; // but for screens of so many pixels to a CSS pixel, on which nobody sees the difference

/** Colour of a share 0..1 of the quality layers: red is the base alone, blue is everything. */
export function detailColour(share) {
  const at = Math.min(Math.max(share, 0), 1) * (DETAIL_STOPS.length - 1);
  const i = Math.min(Math.floor(at), DETAIL_STOPS.length - 2);
  return DETAIL_STOPS[i].map((low, c) => Math.round(low + (DETAIL_STOPS[i + 1][c] - low) * (at - i)));
}

const TINTS = {
  occlusion: (v) => [255, 79, 163, (v * ALPHA) / 255],
  confidence: (v) => [255, 79, 79, ((255 - v) * ALPHA) / 255],
  detail: (v) => (v ? [...detailColour((v - 1) / 254), ALPHA] : [0, 0, 0, 0]),
};

export class Stage {
  constructor(canvas, wipeHandle) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false }); // desynchronized costs a copy a frame without a GPU
    this.wipeHandle = wipeHandle;
    this.mode = "single";
    this.wipe = 0.5;
    this.names = ["restored", "distorted"];
    this.frame = null;
    this.view = { width: 1, height: 1 }; // until the page is laid out
    this.scale = devicePixelRatio; // canvas pixels a CSS pixel
    this.#watchSize();
    this.#watchWipe();
  }

  /** Show a decoded frame from now on; the one before is let go. */
  show(frame) {
    if (this.frame) closeImages(this.frame);
    this.frame = frame;
    frame.grids = frame.header.overlays.grids.map((grid, i) => tinted(grid, frame.payloads.grids[i]));
    this.draw();
  }

  draw() {
    const { context, canvas, frame } = this;
    const [a, b] = this.names.map((name) => frame?.images.get(name));
    this.#resize(a ?? b);
    context.fillStyle = this.ground ??= getComputedStyle(canvas).getPropertyValue("--stage") || "#05070a";
    context.fillRect(0, 0, canvas.width, canvas.height);
    if (!frame) return;
    const two = this.mode !== "single";
    const boxes = this.#boxes(a ?? b);
    if (!boxes) return;
    this.#picture(a, boxes[0], this.mode === "wipe" ? [0, this.wipe] : [0, 1]);
    if (two) this.#picture(b, boxes[1], this.mode === "wipe" ? [this.wipe, 1] : [0, 1]);
    for (const box of this.mode === "side" ? boxes : [boxes[0]]) this.#overlays(box);
    this.#placeWipe(boxes[0]);
  }

  /** Boxes [x, y, w, h] in canvas pixels, of the picture's shape, as large as fits. */
  #boxes(image) {
    if (!image) return null;
    const [w, h] = sizeOf(image);
    const { width, height } = this.canvas;
    if (this.mode !== "side") return Array(2).fill(fitted(w, h, 0, 0, width, height));
    const gap = Math.round(4 * this.scale);
    if (width >= height) {
      const half = (width - gap) / 2;
      return [fitted(w, h, 0, 0, half, height), fitted(w, h, half + gap, 0, half, height)];
    }
    const half = (height - gap) / 2;
    return [fitted(w, h, 0, 0, width, half), fitted(w, h, 0, half + gap, width, half)];
  }

  #picture(image, [x, y, w, h], [from, to]) {
    if (!image) return this.#missing([x, y, w, h]);
    const { context } = this;
    const [iw, ih] = sizeOf(image);
    context.imageSmoothingQuality = w < iw ? "medium" : "low"; // "high" is bicubic: 12 ms a picture without a GPU
    context.drawImage(image, iw * from, 0, iw * (to - from), ih, x + w * from, y, w * (to - from), h);
  }

  #missing([x, y, w, h]) {
    const { context } = this;
    context.fillStyle = "#8fa0b3";
    context.textAlign = "center";
    context.font = `${14 * this.scale}px system-ui, sans-serif`;
    context.fillText("not in this frame", x + w / 2, y + h / 2);
  }

  #overlays([x, y, w, h]) {
    const { context, frame } = this;
    context.save();
    context.beginPath();
    context.rect(x, y, w, h);
    context.clip();
    context.imageSmoothingEnabled = true;
    for (const grid of frame.grids) context.drawImage(grid, x, y, w, h);
    const { tiles = [], reference = [] } = frame.header.overlays;
    const line = ([x0, y0, x1, y1]) => {
      context.moveTo(x + x0 * w, y + y0 * h);
      context.lineTo(x + x1 * w, y + y1 * h);
    };
    context.lineWidth = 1.2 * this.scale;
    for (const box of tiles) {
      context.strokeStyle = `rgb(${detailColour(box.detail).join(" ")} / 0.85)`;
      context.beginPath();
      box.lines.forEach(line);
      context.stroke();
    }
    if (reference.length) this.#outline(reference, line);
    context.restore();
    if (reference.length) this.#inset(reference, [x, y, w, h]);
  }

  #outline(lines, line) {
    const { context } = this;
    for (const [style, width] of [["#0008", 4], ["#7cf5ff", 2]]) {
      context.strokeStyle = style;
      context.lineWidth = width * this.scale;
      context.beginPath();
      lines.forEach(line);
      context.stroke();
    }
  }

  /** A small plan of the reference's picture around this view: the border itself mostly lies outside the view. */
  #inset(lines, [x, y, w, h]) {
    const { context } = this;
    const [iw, ih] = [w * 0.2, h * 0.2];
    const [left, top] = [x + w - iw - 14 * this.scale, y + h - ih - 14 * this.scale];
    const at = (u, v) => [left + iw * (0.5 + (u - 0.5) * 0.5), top + ih * (0.5 + (v - 0.5) * 0.5)];
    context.save();
    context.fillStyle = "#0a0e14c8";
    context.beginPath();
    context.roundRect(left, top, iw, ih, 8 * this.scale);
    context.fill();
    context.clip();
    context.lineWidth = 1.5 * this.scale;
    context.strokeStyle = "#7cf5ff";
    context.beginPath();
    for (const [x0, y0, x1, y1] of lines) {
      context.moveTo(...at(x0, y0));
      context.lineTo(...at(x1, y1));
    }
    context.stroke();
    const corner = at(0, 0);
    context.strokeStyle = "#fff";
    context.strokeRect(...corner, iw * 0.5, ih * 0.5);
    context.restore();
  }

  #watchSize() {
    new ResizeObserver(([entry]) => {
      this.view = entry.contentRect;
      this.draw();
    }).observe(this.canvas.parentElement);
  }

  /** A picture that nearly fills the stage is shown pixel for pixel: crisp, and without a GPU scaling it would cost as
   *  much as decoding it. Others fill the stage, on a canvas of as many pixels as the picture has, which the compositor
   *  scales at a third of what drawing it larger costs; lines over it want the screen's own pixels. */
  #resize(image) {
    const { canvas, frame, view } = this;
    const { grids, tiles, reference } = frame?.header.overlays ?? {};
    this.scale = devicePixelRatio;
    let [width, height] = [view.width, view.height];
    if (image && this.mode !== "side") {
      const [w, h] = sizeOf(image);
      const larger = Math.min((width * this.scale) / w, (height * this.scale) / h);
      if (larger >= 1 && larger < NEARLY && this.scale < DENSE) [width, height] = [w / this.scale, h / this.scale];
      else if (!grids?.length && !tiles && !reference) this.scale = Math.min(this.scale, Math.max(w / width, h / height));
    }
    this.#place(width, height);
    const pixels = [width, height].map((side) => Math.max(1, Math.round(side * this.scale)));
    if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) [canvas.width, canvas.height] = pixels;
  }

  /** Give the canvas its size on the page, in the middle of the stage. */
  #place(width, height) {
    const { style } = this.canvas;
    const size = `${width}px ${height}px`;
    if (this.size === size) return;
    this.size = size;
    style.width = `${width}px`;
    style.height = `${height}px`;
    this.left = Math.round((this.view.width - width) / 2);
    style.left = `${this.left}px`;
    style.top = `${Math.round((this.view.height - height) / 2)}px`;
  }

  #placeWipe([x, , w]) {
    this.wipeHandle.hidden = this.mode !== "wipe";
    if (this.mode !== "wipe") return;
    const left = `${this.left + Math.round((x + w * this.wipe) / this.scale)}px`;
    if (this.wipeHandle.style.left !== left) this.wipeHandle.style.left = left;
    this.wipeHandle.setAttribute("aria-valuenow", Math.round(this.wipe * 100));
    this.box = [x, w];
  }

  #setWipe(share) {
    this.wipe = Math.min(Math.max(share, 0), 1);
    this.draw();
  }

  #watchWipe() {
    const handle = this.wipeHandle;
    handle.addEventListener("pointerdown", (event) => handle.setPointerCapture(event.pointerId));
    handle.addEventListener("pointermove", (event) => {
      if (!handle.hasPointerCapture(event.pointerId) || !this.box) return;
      const left = this.canvas.getBoundingClientRect().left;
      this.#setWipe(((event.clientX - left) * this.scale - this.box[0]) / this.box[1]);
    });
    handle.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1 }[event.key];
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      this.#setWipe(this.wipe + step);
    });
  }
}

function sizeOf(image) {
  return [image.displayWidth ?? image.width, image.displayHeight ?? image.height];
}

function fitted(w, h, left, top, width, height) {
  const scale = Math.min(width / w, height / h);
  return [left + (width - w * scale) / 2, top + (height - h * scale) / 2, w * scale, h * scale];
}

function tinted(grid, bytes) {
  const canvas = new OffscreenCanvas(grid.width, grid.height);
  const context = canvas.getContext("2d");
  const image = context.createImageData(grid.width, grid.height);
  const table = Array.from({ length: 256 }, (_, value) => TINTS[grid.name](value));
  for (let i = 0; i < bytes.length; i++) image.data.set(table[bytes[i]], i * 4);
  context.putImageData(image, 0, 0);
  return canvas;
}
