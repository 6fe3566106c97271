/** The shaders and the pass graph of `gpu/cags_gpu`, bundled as they are: one source for all hosts. */

import graphFile from "../../../gpu/cags_gpu/graph.json";
import bin from "../../../gpu/cags_gpu/wgsl/bin.wgsl";
import blend from "../../../gpu/cags_gpu/wgsl/blend.wgsl";
import changed from "../../../gpu/cags_gpu/wgsl/changed.wgsl";
import common from "../../../gpu/cags_gpu/wgsl/common.wgsl";
import compare from "../../../gpu/cags_gpu/wgsl/compare.wgsl";
import correct from "../../../gpu/cags_gpu/wgsl/correct.wgsl";
import exact from "../../../gpu/cags_gpu/wgsl/exact.wgsl";
import hash from "../../../gpu/cags_gpu/wgsl/hash.wgsl";
import project from "../../../gpu/cags_gpu/wgsl/project.wgsl";
import radix from "../../../gpu/cags_gpu/wgsl/radix.wgsl";
import ranges from "../../../gpu/cags_gpu/wgsl/ranges.wgsl";
import update from "../../../gpu/cags_gpu/wgsl/update.wgsl";
import type { Access } from "./device.ts";

export interface BufferRule {
  readonly of: string;
  readonly bytes: number;
  readonly per?: number;
  readonly plus?: number;
}

export type Bind = readonly [buffer: string, access: Access] | null;

export interface Step {
  readonly when?: readonly string[];
  readonly shader?: string;
  readonly entry?: string;
  readonly bind?: readonly Bind[];
  readonly constants?: Readonly<Record<string, string>>;
  readonly groups?: readonly (readonly [string, number])[];
  readonly indirect?: number;
  readonly clear?: string;
  readonly sort?: string;
  readonly keys?: readonly [string, string, string];
  readonly values?: readonly [string, string, string];
  readonly bits?: number | string;
  readonly of?: string;
  readonly histogram?: string;
}

export interface Graph {
  readonly buffers: Readonly<Record<"scene" | "work" | "view" | "reference", Readonly<Record<string, BufferRule>>>>;
  readonly graphs: Readonly<Record<string, readonly Step[]>>;
}

export const graph = graphFile as unknown as Graph;

const WHOLE: Readonly<Record<string, string>> = {
  update,
  hash,
  project: common + exact + project,
  radix,
  bin: common + bin,
  ranges: common + ranges,
  blend: common + blend,
  correct,
  compare,
  changed,
};

/** The WGSL of a shader, whole. */
export function source(shader: string): string {
  const text = WHOLE[shader];
  if (text === undefined) throw new RangeError(`there is no shader ${shader}`);
  return text;
}
