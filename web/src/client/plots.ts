/** Small live plots over the last seconds; the newest value stands beside each name. */

import type { FrameHead } from "./messages.ts";

const SPAN_MS = 20_000;
const SAMPLE_MS = 100;
/** Of all of them, one after another: laying one out costs about as much as decoding a picture. */
const REDRAW_MS = 1050;
/** Colours of lines, told from either ground of the page: `tests/web/page/test_look.py` measures them. */
export const LINES = ["#3987e5", "#c26a00", "#1a9850", "#b8589c", "#7d74d1", "#d0453a", "#0d96a6", "#8c7a2b"];

/** Height of the highest value, which stands above the lines. */
const LABEL_PX = 10;

/** Name, unit, and lines: a label and its figure; no lines: the stages of a frame, one upon another. */
const PLOTS: readonly (readonly [string, string, readonly (readonly [string, string])[]])[] = [
  ["Rate", "Mbit/s", [["received", "goodput_mbps"], ["link", "capacity_mbps"]]],
  ["Time a frame", "ms", []],
  ["Hand to picture", "ms", [["", "photon_ms"]]],
  ["Quality", "dB", [["restored", "psnr_restored_db"], ["distorted", "psnr_distorted_db"]]],
  ["Detail in view", "level", [["", "lod_mean"]]],
  ["Prediction error", "°", [["", "prediction_error_deg"]]],
  ["Ahead", "ms", [["", "buffer_ms"]]],
];

interface Sample {
  readonly atMs: number;
  readonly stats: FrameHead["stats"];
  readonly stages: FrameHead["stages_ms"];
}
interface Series {
  readonly label: string;
  readonly colour: string;
  readonly value: (sample: Sample) => number | null | undefined;
  /** Where its line lies, if elsewhere than its value says. */
  readonly height: (sample: Sample) => number | null | undefined;
}
interface Plot {
  readonly lines: readonly (readonly [string, string])[];
  readonly legend: HTMLElement;
  readonly canvas: HTMLCanvasElement;
}

export class Plots {
  #samples: Sample[] = [];
  readonly #plots: Plot[];
  #drawnMs = 0;
  #next = 0;

  constructor(host: HTMLElement) {
    this.#plots = PLOTS.map(([name, unit, lines]) => {
      const figure = document.createElement("figure");
      const caption = document.createElement("figcaption");
      const title = document.createElement("b");
      title.textContent = `${name}, ${unit}`;
      const legend = document.createElement("span");
      const canvas = document.createElement("canvas");
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${name} in ${unit}, last 20 seconds`);
      caption.append(title, legend);
      figure.append(caption, canvas);
      host.append(figure);
      return { lines, legend, canvas };
    });
  }

  /** Take the figures of a frame; the newest of a moment stays. `seen`: somebody looks at the plots. */
  add(stats: FrameHead["stats"], stages: FrameHead["stages_ms"], seen: boolean): void {
    const atMs = performance.now();
    const before = this.#samples.at(-2);
    if (before && atMs - before.atMs < SAMPLE_MS) this.#samples.pop();
    this.#samples.push({ atMs, stats, stages });
    while (this.#samples[0]!.atMs < atMs - SPAN_MS) this.#samples.shift();
    if (!seen || atMs - this.#drawnMs < REDRAW_MS / this.#plots.length) return;
    this.#drawnMs = atMs;
    this.#next = (this.#next + 1) % this.#plots.length;
    this.#draw(this.#plots[this.#next]!, atMs);
  }

  #seriesOf({ lines }: Plot): Series[] {
    const known = (one: Series): boolean => this.#samples.some((sample) => Number.isFinite(one.value(sample)));
    if (lines.length)
      return lines.map(([label, name], i) => {
        const value = ({ stats }: Sample): number | null | undefined => stats[name];
        return { label, colour: LINES[i]!, value, height: value };
      }).filter(known);
    const names = [...new Set(this.#samples.slice(-30).flatMap(({ stages }) => Object.keys(stages)))];
    return names.map((label, i) => ({
      label,
      colour: LINES[i % LINES.length]!,
      value: ({ stages }) => stages[label],
      height: ({ stages }) => (label in stages ? names.slice(0, i + 1).reduce((sum, name) => sum + (stages[name] ?? 0), 0) : null),
    }));
  }

  #draw(plot: Plot, now: number): void {
    const series = this.#seriesOf(plot);
    const newest = this.#samples.at(-1)!;
    plot.legend.replaceChildren(...series.map(({ label, colour, value }) => {
      const entry = document.createElement("span");
      const mark = document.createElement("i");
      mark.style.setProperty("background", colour);
      entry.append(mark, `${label} ${brief(value(newest))}`);
      return entry;
    }));
    const { canvas } = plot;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * devicePixelRatio))) as [number, number];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const context = canvas.getContext("2d")!;
    context.clearRect(0, 0, width, height);
    const heights = series.flatMap((one) => this.#samples.map(one.height)).filter((value): value is number => Number.isFinite(value));
    const [low, high] = rangeOf(heights, plot.lines[0]?.[1].startsWith("psnr") ?? false);
    context.lineWidth = 1.6 * devicePixelRatio;
    context.lineJoin = "round";
    for (const one of series) this.#line(context, one, (t) => width * (1 - (now - t) / SPAN_MS), (v) => height - 2 - ((v - low) / (high - low)) * (height - LABEL_PX * devicePixelRatio));
    if (!heights.length) return;
    context.fillStyle = getComputedStyle(canvas).color;
    context.font = `${LABEL_PX * devicePixelRatio}px system-ui, sans-serif`;
    context.fillText(brief(high), 0, (LABEL_PX - 2) * devicePixelRatio);
  }

  #line(context: CanvasRenderingContext2D, { colour, height }: Series, x: (atMs: number) => number, y: (value: number) => number): void {
    context.strokeStyle = colour;
    context.beginPath();
    let pen = false;
    for (const sample of this.#samples) {
      const value = height(sample);
      if (typeof value === "number") context[pen ? "lineTo" : "moveTo"](x(sample.atMs), y(value));
      pen = typeof value === "number";
    }
    context.stroke();
  }
}

/** From 0, but for what has no meaningful 0. */
function rangeOf(values: readonly number[], floating: boolean): readonly [number, number] {
  const high = Math.max(...values, floating ? -Infinity : 1e-3);
  if (!floating) return [0, high];
  const low = Math.min(...values) - 0.5;
  return values.length ? [low, Math.max(high, low + 1)] : [0, 1];
}

export function brief(value: number | null | undefined): string {
  if (typeof value !== "number") return "–";
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : 2);
}
