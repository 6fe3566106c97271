/** Puts a picture of 8-bit colours on a canvas: byte for byte over black, or over another background. */

import type { Gpu } from "./device.ts";
import type { Target } from "./scene.ts";

const SHADER = /* wgsl */ `
struct Job { row: u32, behind_r: f32, behind_g: f32, behind_b: f32, words: u32 }  // words a pixel of the picture
@group(0) @binding(0) var<storage, read> shown: array<u32>;
@group(0) @binding(1) var<storage, read> picture: array<u32>;
@group(0) @binding(2) var<uniform> job: Job;
@vertex fn corner(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
  return vec4(f32(i & 1u) * 4.0 - 1.0, f32(i >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}
@fragment fn pixel(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
  let i = u32(at.y) * job.row + u32(at.x);
  let rgb = unpack4x8unorm(shown[i]).rgb;
  let last = picture[job.words * i + job.words - 1u];
  let alpha = select(bitcast<f32>(last), unpack2x16unorm(last).y, job.words == 2u);
  let covered = max(alpha, max(rgb.r, max(rgb.g, rgb.b)));  // what a correction adds covers at least as much
  return vec4(rgb + (1.0 - covered) * vec3(job.behind_r, job.behind_g, job.behind_b), 1.0);
}`;

export class Presenter {
  /** Behind the splats: red, green and blue, 0..1. */
  background: readonly [number, number, number] = [0, 0, 0];
  readonly #gpu: Gpu;
  readonly #canvas: HTMLCanvasElement | OffscreenCanvas;
  readonly #context: GPUCanvasContext;
  readonly #pipeline: GPURenderPipeline;
  readonly #job: GPUBuffer;

  constructor(gpu: Gpu, canvas: HTMLCanvasElement | OffscreenCanvas) {
    this.#gpu = gpu;
    this.#canvas = canvas;
    this.#context = canvas.getContext("webgpu") as GPUCanvasContext;
    const format = navigator.gpu.getPreferredCanvasFormat();
    this.#context.configure({ device: gpu.device, format, alphaMode: "opaque" });
    const module = gpu.device.createShaderModule({ label: "present", code: SHADER });
    this.#pipeline = gpu.device.createRenderPipeline({
      layout: "auto",
      vertex: { module, entryPoint: "corner" },
      fragment: { module, entryPoint: "pixel", targets: [{ format }] },
    });
    this.#job = gpu.buffer(32, "uniform");
  }

  resize(width: number, height: number): void {
    if (this.#canvas.width !== width) this.#canvas.width = width;
    if (this.#canvas.height !== height) this.#canvas.height = height;
  }

  clear(): void {
    this.#pass(null);
  }

  /** The target's `shown` [H, W]: 8 bits a channel; its `picture` [H, W]: the splats' own, with alpha, `compact` as
   * `blend.wgsl` says; `width` of their rows. */
  present({ target, width, compact }: { target: Target; width: number; compact: boolean }): void {
    const { device } = this.#gpu;
    const [shown, picture] = [target.get("shown"), target.get("picture")];
    device.queue.writeBuffer(this.#job, 0, new Uint32Array([width]));
    device.queue.writeBuffer(this.#job, 4, new Float32Array(this.background));
    device.queue.writeBuffer(this.#job, 16, new Uint32Array([compact ? 2 : 4]));
    const entries = [shown, picture, this.#job].map((buffer, binding) => ({ binding, resource: { buffer } }));
    this.#pass(device.createBindGroup({ layout: this.#pipeline.getBindGroupLayout(0), entries }));
  }

  #pass(group: GPUBindGroup | null): void {
    const { device } = this.#gpu;
    const encoder = device.createCommandEncoder();
    const view = this.#context.getCurrentTexture().createView();
    const pass = encoder.beginRenderPass({
      colorAttachments: [{ view, loadOp: "clear", storeOp: "store", clearValue: [...this.background, 1] }],
    });
    if (group) {
      pass.setPipeline(this.#pipeline);
      pass.setBindGroup(0, group);
      pass.draw(3);
    }
    pass.end();
    device.queue.submit([encoder.finish()]);
  }
}
