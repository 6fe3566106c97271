/** The instruments: figures that expire when they are old. */

import type { Player } from "../player/player.ts";
import { nowUs } from "../seam.ts";
import { detailOf, STALE_US } from "./light.ts";

const REFRESH_MS = 250;

/** A figure without a text stays as it was, faded. */
export type Figure = readonly [name: string, text: string | undefined];

export class Inspector {
  readonly #list: HTMLElement;
  readonly #cells = new Map<string, HTMLElement>();
  #shownMs = -Infinity;
  #pictures: readonly [number, number] = [0, 0];
  #rate = 0;

  constructor(list: HTMLElement) {
    this.#list = list;
  }

  /** Show the figures of now, a few times a second. */
  update(pictures: number, figures: (rate: number) => readonly Figure[]): void {
    const now = performance.now();
    if (now - this.#shownMs < REFRESH_MS) return;
    this.#shownMs = now;
    const [at, before] = this.#pictures;
    if (now - at > 1000) {
      this.#rate = ((pictures - before) * 1000) / (now - at);
      this.#pictures = [now, pictures];
    }
    for (const [name, text] of figures(this.#rate)) this.#put(name, text);
  }

  #put(name: string, text: string | undefined): void {
    let cell = this.#cells.get(name);
    if (!cell) {
      const [term, value] = [document.createElement("dt"), document.createElement("dd")];
      term.textContent = name;
      this.#list.append(term, value);
      this.#cells.set(name, (cell = value));
    }
    if (text !== undefined) cell.textContent = text;
    else if (!cell.textContent) cell.textContent = "–";
    cell.toggleAttribute("data-old", text === undefined);
  }
}

/** Of what this page draws itself, on `device`; of corrections only where the scene comes with references. */
export function drawnFigures(player: Player, device: string, rate: number, references: boolean): Figure[] {
  const fresh = <T>(atUs: number | undefined, value: T): T | undefined =>
    atUs !== undefined && nowUs() - atUs < STALE_US ? value : undefined;
  const { status, shown, info } = player;
  const detail = detailOf(player);
  const size = shown?.camera.intrinsics;
  const age = shown?.reference ? `${shown.frame - shown.reference.frame} frames` : "none";
  const corrections = (figure: Figure): Figure[] => (references ? [figure] : []);
  return [
    ["Link", fresh(status?.atUs, `${((status?.goodputBps ?? 0) / 1e6).toFixed(1)} Mbit/s`)],
    ["Round trip", status?.rttMs === undefined ? undefined : fresh(status.atUs, `${status.rttMs.toFixed(0)} ms`)],
    ["Received", status ? megabytes(status.bytesTiles + status.bytesReference + status.bytesOther) : undefined],
    ...corrections(["Corrections", status ? megabytes(status.bytesReference) : undefined]),
    ["Ahead", shown ? fresh(shown.atUs, `${(shown.update.bufferMs / 1000).toFixed(1)} s`) : undefined],
    ["Detail in view", detail === undefined ? undefined : `${Math.round(100 * detail)} %`],
    ...corrections(["Correction age", shown ? fresh(shown.atUs, age) : undefined]),
    ["Splats", shown ? shown.update.capacity.toLocaleString("en") : undefined],
    ["Picture", size && `${size.widthPx} × ${size.heightPx}`],
    ["Pictures a second", `${rate.toFixed(0)}${info ? ` (scene: ${info.fps})` : ""}`],
    ["Time a picture", shown ? fresh(shown.atUs, milliseconds(shown.frameMs)) : undefined],
    ["Decoding", shown ? fresh(shown.atUs, `${shown.update.workMs.toFixed(1)} ms`) : undefined],
    ["Upload", shown ? fresh(shown.atUs, `${(shown.times.uploadBytes / 1e3).toFixed(0)} kB`) : undefined],
    ["Frames late", String(player.missed)],
    ["Decoding errors", status ? String(status.decodeErrors + player.videoErrors) : undefined],
    ["Drawn by", device],
  ];
}

export function milliseconds(ms: number): string {
  return ms < 1000 ? `${ms.toFixed(0)} ms` : `${(ms / 1000).toFixed(1)} s`;
}

function megabytes(bytes: number): string {
  return `${(bytes / 1e6).toFixed(bytes < 1e7 ? 2 : 1)} MB`;
}
