/**
 * The client's whole frame: changed rows uploaded, splats drawn with their depth, what the reference says is lacking
 * sampled by depth and added, the picture put on a canvas. `cags_gpu/correct.py` makes the same bytes.
 */

import type { Camera, FrameUpdate, Intrinsics } from "../seam.ts";
import { placementOf } from "./camera.ts";
import { Gpu, type GpuEvents } from "./device.ts";
import { bufferBytes, build, type Counts, encode, prepare } from "./graph.ts";
import { CHANGED, COMPARE, CORRECTION, type DrawOptions, type Exactness, footprintOf, type Footprint, VETO_CELL_PX } from "./layout.ts";
import { Presenter } from "./presenter.ts";
import { frameFlags, type Named, ResidentScene, type Target } from "./scene.ts";
import { Workspace } from "./workspace.ts";

const CELL_PX = 8;

/** Changed splats for which there is room at first. */
const LEAST_BOXES = 64;
/** A splat is seen that lies no further behind a cell's farthest depth, a share of it; see `cags_common.correction.changed`. */
const BEHIND = 0.1;

/** See `cags_common.correction.CorrectSettings`. */
const CORRECT = { depthTolerance: 0.03, slopeCells: 1, borderPx: 16, holeAlpha: 0.3 } as const;

/** A decoded reference. */
export interface CodedReference {
  /** [h, w, 3] in [0, 1]. Not changed afterwards: what was made of it is kept. */
  readonly coded: Float32Array<ArrayBuffer>;
  readonly camera: Camera;
  /** A picture of the scene, from which the client's render from the reference camera is subtracted; else a companded difference. */
  readonly picture: boolean;
  readonly knee: number;
  /** Mean squared error that coding has left in a picture, RGB from 0 to 1: less of what is below it is added. */
  readonly error: number;
}

/** How to draw a frame. */
export interface FrameOptions {
  readonly exactness: Exactness;
  readonly footprint: Footprint;
  readonly maxShDegree: number;
  readonly reference?: CodedReference | undefined;
  /** Mean squared error for which to take a picture, RGB from 0 to 1; without: what coding has left. */
  readonly error?: number;
  /** Of the display: with which footprint the client's own view of a picture is drawn. */
  readonly display: Intrinsics;
  /** Boxes of cells of what changed since the reference was made, as `cellBoxes` packs them: where they are seen nothing is
   * added. */
  readonly changed?: Uint32Array<ArrayBuffer> | undefined;
  /** Share of the correction's confidence that is taken away everywhere, 0 to 1. */
  readonly stale?: number;
}

export interface FrameTimes {
  /** Bytes that went to the device since the frame before. */
  readonly uploadBytes: number;
  /** Entries (splat, tile) drawn. */
  readonly entries: number;
  /** From submission until the device was done, milliseconds. */
  readonly gpuMs: number;
  /** How often the frame was drawn: more than once where buffers had to grow. */
  readonly attempts: number;
}

/** Bytes are shown, opaque. */
const SHOWN = { floats: false, confidence: false } as const;

/** What the buffers of the reference hold, and what it was made under. */
type HeldReference = { readonly reference: CodedReference; readonly under: string } | null;

/** Draws on one canvas. One frame at a time. */
export class Renderer {
  readonly gpu: Gpu;
  readonly #workspace: Workspace;
  readonly #presenter: Presenter;
  /** Off the page, for pictures that are taken away. */
  #apart: { readonly canvas: OffscreenCanvas; readonly presenter: Presenter } | null = null;
  readonly #counted: GPUBuffer;
  #scene: ResidentScene | null = null;
  #sceneNumber = -1;
  #uploaded = 0;
  #held: HeldReference = null;
  #shown: { target: Target; width: number; height: number; compact: boolean } | null = null;

  /** Settles once the shaders are compiled, which goes on while a scene is fetched: before it frames take longer. */
  readonly prepared: Promise<unknown>;

  private constructor(gpu: Gpu, canvas: HTMLCanvasElement, corrects: boolean) {
    this.gpu = gpu;
    this.prepared = prepare(gpu, graphs(corrects)).catch(() => undefined); // what fails here is told by the first frame
    this.#workspace = new Workspace(gpu);
    this.#presenter = new Presenter(gpu, canvas);
    this.#counted = gpu.device.createBuffer({ size: 16, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
  }

  /** Throws {@link UnsupportedError}. `corrects`: references may come; shaders that only they need take most of the time of
   * compiling, and are not compiled beforehand where none can. */
  static async make(canvas: HTMLCanvasElement, events: GpuEvents, corrects: boolean): Promise<Renderer> {
    return new Renderer(await Gpu.make(events), canvas, corrects);
  }

  destroy(): void {
    this.gpu.destroy();
  }

  /** Upload what a media frame changed. Throws {@link TooLargeError}. */
  update(update: FrameUpdate): void {
    if (!this.#scene || update.fresh || update.scene !== this.#sceneNumber) {
      this.#scene?.destroy();
      this.#scene = this.#shown = null;
      if (update.capacity) this.#scene = new ResidentScene(this.#workspace, update);
      this.#sceneNumber = update.scene;
      this.#held = null;
    }
    this.#uploaded += this.#scene?.change(update.patches) ?? 0;
  }

  /** Draw and present; resolves once the picture is on the canvas, or (`apart`) can be {@link taken}. */
  async draw(camera: Camera, options: FrameOptions, apart = false): Promise<FrameTimes> {
    const begun = performance.now();
    const { widthPx, heightPx } = camera.intrinsics;
    const presenter = apart ? this.#aside().presenter : this.#presenter;
    presenter.resize(widthPx, heightPx);
    if (!this.#scene) {
      presenter.clear();
      return { uploadBytes: 0, entries: 0, gpuMs: 0, attempts: 0 };
    }
    const uploadBytes = this.#uploaded;
    this.#uploaded = 0;
    for (let attempts = 1; ; attempts++) {
      const { target, wanted, held } = await this.#submitted(this.#scene, camera, options);
      if (!this.#workspace.grow(wanted)) continue;
      this.#scene.submitted();
      this.#held = held;
      const made = { target, width: widthPx, height: heightPx, compact: isCompact(options) };
      if (!apart) this.#shown = made;
      presenter.present(made);
      return { uploadBytes, entries: wanted, gpuMs: performance.now() - begun, attempts };
    }
  }

  /** Behind the splats: red, green and blue, 0..1. */
  set background(colour: readonly [number, number, number]) {
    this.#presenter.background = colour;
    if (this.#apart) this.#apart.presenter.background = colour;
  }

  /** The picture that was drawn apart last; the caller closes it. */
  taken(): ImageBitmap {
    return this.#aside().canvas.transferToImageBitmap();
  }

  #aside(): { readonly canvas: OffscreenCanvas; readonly presenter: Presenter } {
    if (!this.#apart) {
      const canvas = new OffscreenCanvas(16, 16);
      this.#apart = { canvas, presenter: new Presenter(this.gpu, canvas) };
      this.#apart.presenter.background = this.#presenter.background;
    }
    return this.#apart;
  }

  /** Put the picture that was drawn last on the canvas (again): it can be read until the page's next turn. */
  present(): void {
    if (this.#shown) this.#presenter.present(this.#shown);
  }

  /** The picture that was drawn last, over black: [H, W, 4], 8 bits a channel. */
  async pixels(): Promise<{ width: number; height: number; rgba: Uint8ClampedArray<ArrayBuffer> }> {
    if (!this.#shown) throw new Error("nothing was drawn yet");
    const { target, width, height } = this.#shown;
    const { device } = this.gpu;
    const size = 4 * width * height;
    const copy = device.createBuffer({ size, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
    const encoder = device.createCommandEncoder();
    encoder.copyBufferToBuffer(target.get("shown"), 0, copy, 0, size);
    device.queue.submit([encoder.finish()]);
    await copy.mapAsync(GPUMapMode.READ);
    const rgba = new Uint8ClampedArray(copy.getMappedRange().slice(0));
    copy.destroy();
    return { width, height, rgba };
  }

  /** Record, submit, and wait for the number of entries that the frame wanted. */
  async #submitted(
    scene: ResidentScene,
    camera: Camera,
    options: FrameOptions,
  ): Promise<{ target: Target; wanted: number; held: HeldReference }> {
    const { device } = this.gpu;
    this.#workspace.reserve(scene.count, 0, options.exactness === "exact"); // before anything refers to its buffers
    const encoder = device.createCommandEncoder();
    encoder.clearBuffer(this.#workspace.get("state"));
    const target = scene.record(encoder, camera, drawing(options), "", isCompact(options));
    const held = this.#finish(encoder, scene, target, camera, options);
    encoder.copyBufferToBuffer(this.#workspace.get("state"), 0, this.#counted, 0, 16);
    device.queue.submit([encoder.finish()]);
    await this.#counted.mapAsync(GPUMapMode.READ);
    const wanted = new Uint32Array(this.#counted.getMappedRange())[3];
    this.#counted.unmap();
    return { target, wanted, held };
  }

  /** What follows the drawing: the picture as it is, or with what the reference says is lacking. */
  #finish(
    encoder: GPUCommandEncoder,
    scene: ResidentScene,
    target: Target,
    camera: Camera,
    options: FrameOptions,
  ): HeldReference {
    const { reference } = options;
    const vetoed = (options.changed?.length ?? 0) > 0 || (options.stale ?? 0) > 0;
    this.gpu.device.queue.writeBuffer(target.correction, 0, correctionJob(camera, reference, vetoed));
    const own: Named = { correction: target.correction, shown: target.get("shown") };
    const flags = { ...SHOWN, compact: isCompact(options) };
    const { version } = this.#workspace;
    if (!reference) {
      const steps = target.steps(version, `plain ${flags.compact}`, () =>
        build(this.gpu, "plain", target.counts, flags, (name) => own[name] ?? target.get(name)),
      );
      encode(encoder, steps);
      return this.#held;
    }
    const counts = { ...target.counts, ...referenceCounts(camera, reference.camera) };
    const kept = Object.entries(bufferBytes("reference", counts)).map(([name, size]) => [name, scene.kept(name, size)]);
    const named: Named = { ...own, ...Object.fromEntries(kept), veto: target.get("veto_cells") };
    if (vetoed) this.#veto(encoder, scene, target, camera, options);
    const held = this.#expand(encoder, scene, target, { options, reference, counts, named });
    const key = `correct ${flags.compact} ${reference.camera.intrinsics.widthPx}x${reference.camera.intrinsics.heightPx} ${counts.sampled_x} ${scene.keptVersion}`;
    const steps = target.steps(version, key, () =>
      build(this.gpu, "correct", counts, flags, (name) => named[name] ?? target.get(name)),
    );
    encode(encoder, steps);
    return held;
  }

  /** Where the picture shows what changed, and how much of the rest is not believed any more. */
  #veto(encoder: GPUCommandEncoder, scene: ResidentScene, target: Target, camera: Camera, options: FrameOptions): void {
    const { queue } = this.gpu.device;
    const { widthPx, heightPx } = camera.intrinsics;
    const boxes = options.changed ?? new Uint32Array(0);
    const count = boxes.length / 4;
    const room = Math.max(LEAST_BOXES, 2 ** Math.ceil(Math.log2(count + 1)));
    const held = scene.kept("boxes", bufferBytes("reference", { boxes: room }).boxes);
    if (count) queue.writeBuffer(held, 0, boxes);
    const grid = [Math.ceil(widthPx / VETO_CELL_PX), Math.ceil(heightPx / VETO_CELL_PX)];
    const job = CHANGED.pack({ size: [widthPx, heightPx], grid, count, behind: BEHIND, stale: options.stale ?? 0 });
    queue.writeBuffer(target.changed, 0, job);
    const named: Named = { changed_job: target.changed, boxes: held };
    const steps = target.steps(this.#workspace.version, `changed ${scene.keptVersion}`, () =>
      build(this.gpu, "changed", target.counts, {}, (name) => named[name] ?? target.get(name)),
    );
    encode(encoder, steps);
  }

  /** What the reference says is lacking, once a reference; of a picture anew when the splats changed. */
  #expand(
    encoder: GPUCommandEncoder,
    scene: ResidentScene,
    target: Target,
    made: { options: FrameOptions; reference: CodedReference; counts: Counts; named: Named },
  ): HeldReference {
    const { options, reference, counts, named } = made;
    const error = options.error ?? reference.error;
    const seen = reference.picture ? JSON.stringify([scene.changes, options.display, options.exactness, options.maxShDegree, error]) : "";
    const under = `${scene.keptVersion} ${seen}`;
    if (this.#held?.reference === reference && this.#held.under === under) return this.#held;
    this.gpu.device.queue.writeBuffer(named.coded, 0, reference.coded);
    const bound = { ...named };
    if (reference.picture) {
      const { intrinsics } = reference.camera;
      const footprint = footprintOf(options.display, intrinsics);
      const own = scene.record(encoder, reference.camera, { ...drawing(options), footprint }, "own");
      const job = COMPARE.pack({ size: [intrinsics.widthPx, intrinsics.heightPx], error });
      this.gpu.device.queue.writeBuffer(target.compare, 0, job);
      bound.own = own.get("picture");
      bound.compare_job = target.compare;
    }
    encode(encoder, build(this.gpu, reference.picture ? "compare" : "expand", counts, {}, (name) => bound[name]));
    return { reference, under };
  }
}

const DRAWING = ["project", "draw", "plain"] as const;
const CORRECTING = ["expand", "compare", "changed", "correct"] as const;

/** The graphs of a frame, with or without those of references, with the flags that they will run with. */
export function graphs(corrects: boolean): Parameters<typeof prepare>[1] {
  const frame = { ...frameFlags({ exactness: "balanced" }, true), ...SHOWN };
  const drawn = [...DRAWING, ...(corrects ? CORRECTING : [])].map((name) => [name, frame] as const);
  const moved = { motion: true, looks: false, colour: false };
  return [["update", { motion: true, looks: true, colour: true }], ["update", moved], ["hash", {}], ...drawn];
}

/** Whether the page's own picture is kept in 16 bits a channel, as `Frame.compact` of `cags_gpu.correct` says of displays. */
function isCompact({ exactness }: FrameOptions): boolean {
  return exactness !== "exact";
}

function drawing(options: FrameOptions): DrawOptions {
  const { footprint, exactness, maxShDegree } = options;
  return { footprint, exactness, maxShDegree, voidAlpha: CORRECT.holeAlpha, displayed: true };
}

function referenceCounts(client: Camera, reference: Camera): Counts {
  const { widthPx, heightPx } = reference.intrinsics;
  const { stride } = placementOf(client, reference);
  return {
    sampled_x: Math.ceil(client.intrinsics.widthPx / stride),
    sampled_y: Math.ceil(client.intrinsics.heightPx / stride),
    reference_x: widthPx,
    reference_y: heightPx,
    reference_pixels: widthPx * heightPx,
    reference_places: 2 * (widthPx + 1) * (heightPx + 1),
    reference_groups: Math.ceil(widthPx / 16) * Math.ceil(heightPx / 16),
  };
}

function correctionJob(camera: Camera, reference: CodedReference | undefined, vetoed: boolean): ArrayBuffer {
  const { widthPx, heightPx } = camera.intrinsics;
  const size = [widthPx, heightPx];
  if (!reference) return CORRECTION.pack({ size });
  const { rows, cellPx, stride } = placementOf(camera, reference.camera);
  return CORRECTION.pack({
    m0: rows[0],
    m1: rows[1],
    m2: rows[2],
    size,
    reference: [reference.camera.intrinsics.widthPx, reference.camera.intrinsics.heightPx],
    cell: cellPx,
    stride,
    tolerance: CORRECT.depthTolerance,
    slope_cells: CORRECT.slopeCells,
    border: CORRECT.borderPx,
    hole_alpha: CORRECT.holeAlpha,
    knee: reference.knee,
    grid: [Math.ceil(widthPx / CELL_PX), Math.ceil(heightPx / CELL_PX)],
    veto_cell: vetoed ? VETO_CELL_PX : 0,
  });
}
