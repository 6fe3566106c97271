/** A WebGPU device with its pipelines; how one is had, and in one sentence why not. */

import { source } from "./shaders.ts";

/** What a device is asked for beyond WebGPU's defaults: as much as the adapter has. */
const LIMITS = ["maxStorageBufferBindingSize", "maxBufferSize"] as const;

export type Access = "uniform" | "read" | "write";
export type Constants = Readonly<Record<string, boolean>>;

/** The browser cannot show scenes; the message is for its user. */
export class UnsupportedError extends Error {}

/** A scene or frame that this adapter's buffers cannot hold. */
export class TooLargeError extends Error {}

/** What a page hears of a device that goes wrong by itself. */
export interface GpuEvents {
  /** It went away. */
  lost(reason: string): void;
  /** It refused what it was given, so that pictures are missing something from now on; told once, in a sentence for the
   * page's user. */
  refused(message: string): void;
}

export class Gpu {
  readonly device: GPUDevice;
  readonly name: string;
  readonly maxBindingBytes: number;
  lost = false;
  readonly #made = new Map<string, unknown>();

  private constructor(device: GPUDevice, name: string) {
    this.device = device;
    this.name = name;
    this.maxBindingBytes = Math.min(device.limits.maxStorageBufferBindingSize, device.limits.maxBufferSize);
  }

  /** Throws {@link UnsupportedError}. */
  static async make(events: GpuEvents): Promise<Gpu> {
    if (!isSecureContext)
      throw new UnsupportedError("This page needs https:// or localhost: browsers give no graphics processor to plain http.");
    if (!navigator.gpu)
      throw new UnsupportedError("This browser has no WebGPU. Chrome or Edge 113, Safari 26 and Firefox 141 or newer have it.");
    const adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
    if (!adapter)
      throw new UnsupportedError("This browser found no graphics processor. Turn on hardware acceleration in its settings and load the page again.");
    const requiredLimits = Object.fromEntries(LIMITS.map((name) => [name, adapter.limits[name]]));
    const device = await adapter.requestDevice({ requiredLimits });
    const { vendor, architecture, description } = adapter.info;
    const gpu = new Gpu(device, description || [vendor, architecture].filter(Boolean).join(" ") || "graphics processor");
    void device.lost.then((info) => {
      gpu.lost = true;
      if (info.reason !== "destroyed") events.lost(info.message);
    });
    let told = false; // what follows a refusal fails, too
    device.addEventListener("uncapturederror", ({ error }) => {
      if (!told && !gpu.lost) events.refused(refusalOf(error));
      told = true;
    });
    return gpu;
  }

  destroy(): void {
    this.lost = true;
    this.device.destroy();
  }

  /** A buffer of at least 16 bytes that shaders read and write, or (`uniform`) only read. */
  buffer(size: number, kind: "storage" | "uniform" | "indirect" = "storage"): GPUBuffer {
    if (size > this.maxBindingBytes)
      throw new TooLargeError(`${Math.ceil(size / 2 ** 20)} MiB is more than the graphics processor takes at once (${Math.floor(this.maxBindingBytes / 2 ** 20)} MiB)`);
    const usage = kind === "uniform" ? GPUBufferUsage.UNIFORM : GPUBufferUsage.STORAGE | (kind === "indirect" ? GPUBufferUsage.INDIRECT : 0);
    const rounded = Math.max(16, Math.ceil(size / 16) * 16);
    return this.device.createBuffer({ size: rounded, usage: usage | GPUBufferUsage.COPY_DST | GPUBufferUsage.COPY_SRC });
  }

  /** A uniform buffer that holds `data`; equal data share one. */
  uniform(data: ArrayBuffer): GPUBuffer {
    return this.#once(`uniform ${new Uint32Array(data).join()}`, () => {
      const buffer = this.buffer(data.byteLength, "uniform");
      this.device.queue.writeBuffer(buffer, 0, data);
      return buffer;
    });
  }

  /** The layout of bindings that are uniform, read, write or (null) not used. */
  layout(accesses: readonly (Access | null)[]): GPUBindGroupLayout {
    const kinds = { uniform: "uniform", read: "read-only-storage", write: "storage" } as const;
    return this.#once(`layout ${accesses.join()}`, () =>
      this.device.createBindGroupLayout({
        entries: accesses.flatMap((access, binding) =>
          access ? [{ binding, visibility: GPUShaderStage.COMPUTE, buffer: { type: kinds[access] } }] : [],
        ),
      }),
    );
  }

  /** The pipeline of an entry point, compiled once for each set of constants. */
  pipeline(shader: string, entry: string, accesses: readonly (Access | null)[], constants: Constants): GPUComputePipeline {
    const key = pipelineKey(shader, entry, constants);
    return this.#once(key, () => this.device.createComputePipeline(this.#described(shader, entry, accesses, constants)));
  }

  /** Compile a pipeline beforehand, without holding up the page. */
  async prepare(shader: string, entry: string, accesses: readonly (Access | null)[], constants: Constants): Promise<void> {
    const key = pipelineKey(shader, entry, constants);
    if (this.#made.has(key)) return;
    const made = await this.device.createComputePipelineAsync(this.#described(shader, entry, accesses, constants));
    if (!this.#made.has(key)) this.#made.set(key, made);
  }

  #described(
    shader: string,
    entry: string,
    accesses: readonly (Access | null)[],
    constants: Constants,
  ): GPUComputePipelineDescriptor {
    const module = this.#once(`module ${shader}`, () =>
      this.device.createShaderModule({ label: shader, code: source(shader) }),
    );
    return {
      label: `${shader}.${entry}`,
      layout: this.device.createPipelineLayout({ bindGroupLayouts: [this.layout(accesses)] }),
      compute: { module, entryPoint: entry, constants: Object.fromEntries(Object.entries(constants).map(([name, on]) => [name, on ? 1 : 0])) },
    };
  }

  #once<T>(key: string, make: () => T): T {
    if (!this.#made.has(key)) this.#made.set(key, make());
    return this.#made.get(key) as T;
  }
}

/** What a device refused: without a handler every later submission fails in silence. */
function refusalOf(error: GPUError): string {
  if (error instanceof GPUOutOfMemoryError)
    return "The graphics processor has no memory left for this scene; close other pages and programs that draw, and try again.";
  return `The graphics processor refused a step of the drawing (${error.message.split("\n")[0]})`;
}

function pipelineKey(shader: string, entry: string, constants: Constants): string {
  return `pipeline ${shader} ${entry} ${JSON.stringify(Object.entries(constants).sort())}`;
}
