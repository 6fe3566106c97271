/**
 * Brings pictures of both eyes to a headset: a WebGL layer, for that is what every browser with WebXR has (WebGPU layers are
 * behind flags). A picture of splats takes longer than a headset's refresh, so it is shown where it belongs as the head
 * turns on: each eye's picture is re-projected from where it was drawn to where the eye is now.
 */

import type { Viewed } from "../player/player.ts";
import type { Camera } from "../seam.ts";
import { reprojection } from "./views.ts";

const VERTEX = `#version 300 es
out vec2 at;
void main() {
  at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0;
  gl_Position = vec4(at, 0.0, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
out vec4 colour;
uniform mat3 there;
uniform sampler2D picture;
void main() {
  vec3 place = there * vec3(at, 1.0);
  vec2 st = place.xy / place.z;
  if (place.z <= 0.0 || st != clamp(st, 0.0, 1.0)) discard;
  colour = vec4(texture(picture, st).rgb, 1.0);
}`;

interface Picture {
  readonly texture: WebGLTexture;
  camera: Camera;
}

export class EyeLayer {
  readonly gl: WebGL2RenderingContext;
  /** Of each eye, drawn of one moment. */
  shown: readonly Picture[] = [];
  readonly #program: WebGLProgram;
  readonly #there: WebGLUniformLocation | null;
  #next: Picture[] = [];
  #spare: Picture[] = [];

  private constructor(gl: WebGL2RenderingContext) {
    this.gl = gl;
    this.#program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]] as const) {
      const shader = gl.createShader(kind)!;
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.#program, shader);
    }
    gl.linkProgram(this.#program);
    if (!gl.getProgramParameter(this.#program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(this.#program) ?? "no program");
    this.#there = gl.getUniformLocation(this.#program, "there");
  }

  /** Throws where the browser has no WebGL for a headset. */
  static async make(): Promise<EyeLayer> {
    const gl = document.createElement("canvas").getContext("webgl2", { alpha: false, antialias: false, depth: false });
    if (!gl) throw new Error("this browser has no WebGL");
    await gl.makeXRCompatible();
    return new EyeLayer(gl);
  }

  /** Take an eye's picture; with the last of `of` eyes, they are shown. */
  keep(eye: number, of: number, camera: Camera, picture: ImageBitmap): void {
    const { gl } = this;
    const kept = this.#spare[eye] ?? this.#made(camera);
    kept.camera = camera;
    gl.bindTexture(gl.TEXTURE_2D, kept.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, picture);
    this.#next[eye] = kept;
    if (eye + 1 < of || this.#next.length < of) return;
    this.#spare = [...this.shown];
    this.shown = this.#next;
    this.#next = [];
  }

  /** Show the newest pictures to eyes that have looked on. */
  draw(target: XRWebGLLayer, eyes: readonly { readonly view: XRView; readonly now: Viewed }[], behind: readonly [number, number, number]): void {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
    gl.clearColor(...behind, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(this.#program);
    for (const [i, { view, now }] of eyes.entries()) {
      const picture = this.shown[i];
      const port = target.getViewport(view);
      if (!picture || !port) continue;
      gl.viewport(port.x, port.y, port.width, port.height);
      gl.bindTexture(gl.TEXTURE_2D, picture.texture);
      gl.uniformMatrix3fv(this.#there, true, reprojection(picture.camera, now));
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
  }

  /** Let go of everything. */
  destroy(): void {
    for (const { texture } of [...this.shown, ...this.#next, ...this.#spare]) this.gl.deleteTexture(texture);
    this.gl.deleteProgram(this.#program);
    this.shown = this.#next = this.#spare = [];
  }

  #made(camera: Camera): Picture {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const [name, value] of [
      [gl.TEXTURE_MIN_FILTER, gl.LINEAR],
      [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE],
      [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    ] as const)
      gl.texParameteri(gl.TEXTURE_2D, name, value);
    return { texture, camera };
  }
}
