/** Puts a picture of 8-bit colours on a canvas, byte for byte. */

import type { Gpu } from "./device.ts";

const SHADER = /* wgsl */ `
@group(0) @binding(0) var<storage, read> shown: array<u32>;
@group(0) @binding(1) var<uniform> row: vec4<u32>;
@vertex fn corner(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
  return vec4(f32(i & 1u) * 4.0 - 1.0, f32(i >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}
@fragment fn pixel(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
  return vec4(unpack4x8unorm(shown[u32(at.y) * row.x + u32(at.x)]).rgb, 1.0);
}`;

export class Presenter {
  readonly #gpu: Gpu;
  readonly #canvas: HTMLCanvasElement;
  readonly #context: GPUCanvasContext;
  readonly #pipeline: GPURenderPipeline;
  readonly #row: GPUBuffer;

  constructor(gpu: Gpu, canvas: HTMLCanvasElement) {
    this.#gpu = gpu;
    this.#canvas = canvas;
    this.#context = canvas.getContext("webgpu")!;
    const format = navigator.gpu.getPreferredCanvasFormat();
    this.#context.configure({ device: gpu.device, format, alphaMode: "opaque" });
    const module = gpu.device.createShaderModule({ label: "present", code: SHADER });
    this.#pipeline = gpu.device.createRenderPipeline({
      layout: "auto",
      vertex: { module, entryPoint: "corner" },
      fragment: { module, entryPoint: "pixel", targets: [{ format }] },
    });
    this.#row = gpu.buffer(16, "uniform");
  }

  resize(width: number, height: number): void {
    if (this.#canvas.width !== width) this.#canvas.width = width;
    if (this.#canvas.height !== height) this.#canvas.height = height;
  }

  clear(): void {
    this.#pass(null);
  }

  /** `shown` [H, W]: 8 bits a channel; `width` of its rows. */
  present(shown: GPUBuffer, width: number): void {
    const { device } = this.#gpu;
    device.queue.writeBuffer(this.#row, 0, new Uint32Array([width, 0, 0, 0]));
    const entries = [shown, this.#row].map((buffer, binding) => ({ binding, resource: { buffer } }));
    this.#pass(device.createBindGroup({ layout: this.#pipeline.getBindGroupLayout(0), entries }));
  }

  #pass(group: GPUBindGroup | null): void {
    const { device } = this.#gpu;
    const encoder = device.createCommandEncoder();
    const view = this.#context.getCurrentTexture().createView();
    const pass = encoder.beginRenderPass({
      colorAttachments: [{ view, loadOp: "clear", storeOp: "store", clearValue: [0, 0, 0, 1] }],
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
