/** Runs the pass graph of `graph.json`: buffers' sizes, bind groups, sorts, dispatches; `cags_gpu/graph.py` does the same. */

import type { Access, Constants, Gpu } from "./device.ts";
import { SORT } from "./layout.ts";
import { graph, type Step } from "./shaders.ts";

const MAX_GROUPS = 65535;
const RADIX_BITS = 8;
const BLOCK = 2048;

export type Counts = Readonly<Record<string, number>>;
export type Flags = Readonly<Record<string, boolean>>;
/** Gives the buffer of a name. */
export type Resolve = (name: string) => GPUBuffer;

/** One dispatch, or a buffer that is set to zeros. */
export type Dispatch =
  | { readonly clear: GPUBuffer }
  | {
      readonly clear?: undefined;
      readonly pipeline: GPUComputePipeline;
      readonly group: GPUBindGroup;
      readonly groups: readonly [number, number];
      readonly indirect?: readonly [GPUBuffer, number] | undefined;
    };

type Bound = readonly [GPUBuffer | string, Access] | null;

/** Sizes of the owner's buffers at `counts`, as far as these name what a size depends on. */
export function bufferBytes(owner: keyof typeof graph.buffers, counts: Counts): Record<string, number> {
  const sizes: Record<string, number> = {};
  for (const [name, rule] of Object.entries(graph.buffers[owner])) {
    if (rule.of in counts) sizes[name] = rule.bytes * Math.ceil(counts[rule.of] / (rule.per ?? 1)) + (rule.plus ?? 0);
  }
  return sizes;
}

/** The dispatches of a graph; `flags` choose steps and give pipelines their constants. */
export function build(gpu: Gpu, name: string, counts: Counts, flags: Flags, resolve: Resolve): Dispatch[] {
  const steps: Dispatch[] = [];
  const sorted = new Map<string, string>();
  for (const step of graph.graphs[name]) {
    if (!holds(step, flags)) continue;
    if (step.sort) steps.push(...sort(gpu, step, counts, resolve, sorted));
    else if (step.clear) steps.push({ clear: resolve(step.clear) });
    else {
      const bind = step.bind!.map((pair): Bound => pair && [sorted.get(pair[0]) ?? pair[0], pair[1]]);
      const groups = step.groups ? groupsOf(step.groups, counts) : ([1, 1] as const);
      const indirect = step.indirect === undefined ? undefined : ([resolve("dispatch"), step.indirect] as const);
      steps.push(dispatch(gpu, step.shader!, step.entry!, bind, constantsOf(step, flags), resolve, groups, indirect));
    }
  }
  return steps;
}

/** Compile what the graphs need beforehand; `variants` are the flags they will run with. */
export async function prepare(gpu: Gpu, variants: readonly (readonly [string, Flags])[]): Promise<void> {
  const waits: Promise<void>[] = [];
  for (const [name, flags] of variants) {
    for (const step of graph.graphs[name]) {
      if (!step.shader || !holds(step, flags)) continue;
      const accesses = step.bind!.map((pair) => pair && pair[1]);
      waits.push(gpu.prepare(step.shader, step.entry!, accesses, constantsOf(step, flags)));
    }
  }
  for (const [entry, accesses] of Object.entries(SORT_ACCESSES)) waits.push(gpu.prepare("radix", entry, accesses, {}));
  await Promise.all(waits);
}

const SORT_ACCESSES: Readonly<Record<"count" | "scan" | "scatter", readonly (Access | null)[]>> = {
  count: ["uniform", "read", "read", null, null, null, "write"],
  scan: ["uniform", "read", null, null, null, null, "write"],
  scatter: ["uniform", "read", "read", "read", "write", "write", "write"],
};

function holds(step: Step, flags: Flags): boolean {
  return (step.when ?? []).every((name) => (name.startsWith("!") ? !flags[name.slice(1)] : flags[name]));
}

function constantsOf(step: Step, flags: Flags): Constants {
  return Object.fromEntries(Object.entries(step.constants ?? {}).map(([key, flag]) => [key, flags[flag]]));
}

function groupsOf(groups: readonly (readonly [string, number])[], counts: Counts): [number, number] {
  const numbers = groups.map(([name, per]) => Math.ceil(counts[name] / per));
  if (numbers.length === 2) return [numbers[0], numbers[1]];
  const columns = Math.min(numbers[0], MAX_GROUPS);
  return [columns, columns ? Math.ceil(numbers[0] / columns) : 0];
}

function dispatch(
  gpu: Gpu,
  shader: string,
  entry: string,
  bind: readonly Bound[],
  constants: Constants,
  resolve: Resolve,
  groups: readonly [number, number],
  indirect?: readonly [GPUBuffer, number],
): Dispatch {
  const accesses = bind.map((pair) => pair && pair[1]);
  const entries = bind.flatMap((pair, binding) =>
    pair ? [{ binding, resource: { buffer: typeof pair[0] === "string" ? resolve(pair[0]) : pair[0] } }] : [],
  );
  const group = gpu.device.createBindGroup({ layout: gpu.layout(accesses), entries });
  return { pipeline: gpu.pipeline(shader, entry, accesses, constants), group, groups, indirect };
}

/** Passes of a radix sort. Buffers are listed as the first pass's input, then the two that take turns. */
function sort(gpu: Gpu, step: Step, counts: Counts, resolve: Resolve, sorted: Map<string, string>): Dispatch[] {
  const bits = typeof step.bits === "string" ? counts[step.bits] : step.bits!;
  const count = counts[step.of!];
  const blocks = Math.max(1, Math.ceil(count / BLOCK));
  const indirect = step.indirect === undefined ? undefined : ([resolve("dispatch"), step.indirect] as const);
  const groups = groupsOf([[step.of!, BLOCK]], counts);
  let [keys, ...keyTurns] = step.keys!;
  let [values, ...valueTurns] = step.values!;
  const steps: Dispatch[] = [];
  for (let turn = 0; turn * RADIX_BITS < bits; turn++) {
    const to = (turn + 1) % 2;
    const job = gpu.uniform(SORT.pack({ shift: turn * RADIX_BITS, count, blocks, counted: indirect ? 1 : 0 }));
    const pass = (entry: keyof typeof SORT_ACCESSES, where: readonly [number, number], by?: readonly [GPUBuffer, number]): void => {
      const names = [job, "state", keys, values, keyTurns[to], valueTurns[to], step.histogram!];
      const bind = SORT_ACCESSES[entry].map((access, i): Bound => access && [names[i], access]);
      steps.push(dispatch(gpu, "radix", entry, bind, {}, resolve, where, by));
    };
    pass("count", groups, indirect);
    pass("scan", [1 << RADIX_BITS, 1]);
    pass("scatter", groups, indirect);
    [keys, values] = [keyTurns[to], valueTurns[to]];
  }
  sorted.set(`@${step.sort}`, values).set(`@${step.sort}.keys`, keys);
  return steps;
}

/** Record `steps` one after the other, in as few passes as clearing allows. */
export function encode(encoder: GPUCommandEncoder, steps: Iterable<Dispatch>): void {
  let running: GPUComputePassEncoder | null = null;
  for (const step of steps) {
    if (step.clear) {
      running?.end();
      running = null;
      encoder.clearBuffer(step.clear);
      continue;
    }
    running ??= encoder.beginComputePass();
    running.setPipeline(step.pipeline);
    running.setBindGroup(0, step.group);
    if (step.indirect) running.dispatchWorkgroupsIndirect(...step.indirect);
    else running.dispatchWorkgroups(...step.groups);
  }
  running?.end();
}
