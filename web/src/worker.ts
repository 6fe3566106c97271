/** The worker that receives, decodes and stores a scene; the page asks it through {@link Request}. */
import { Draco } from "./decode/draco.ts";
import { Kernels } from "./decode/kernels.ts";
import { LiveSource } from "./source/live.ts";
import { StaticSource } from "./source/static.ts";
import type { Answer, Request } from "./source/remote.ts";
import type { Decoders } from "./source/scene.ts";
import type { SceneSource } from "./seam.ts";

/** The part of a worker's global scope that is used. */
interface Host {
  postMessage(message: Answer, transfer?: Transferable[]): void;
  onmessage: ((event: MessageEvent<Request>) => void) | null;
}

const host = self as unknown as Host;
/** Fetched at once: the page looks up the scene, and makes its device, meanwhile. */
const loading = load();
loading.catch(() => undefined); // told when they are needed
let source: SceneSource | undefined;
let starting: Promise<void> = Promise.resolve();

async function load(): Promise<Decoders> {
  const at = (name: string): Promise<Response> => fetch(new URL(name, import.meta.url));
  const [kernels, decoder] = await Promise.all([at("kernels.wasm"), at("draco_decoder.wasm")]);
  if (!kernels.ok || !decoder.ok) throw new Error("the viewer's decoders cannot be fetched from the server");
  const [module, binary] = await Promise.all([kernels.arrayBuffer(), decoder.arrayBuffer()]);
  const [wasm, draco] = await Promise.all([Kernels.load(module), Draco.load(binary)]);
  return { kernels: wasm, draco };
}

function tell(answer: Answer): void {
  const transfer: Transferable[] = [];
  if (answer.tell === "event" && answer.event.type === "reference") transfer.push(answer.event.reference.data.buffer);
  if (answer.tell === "frame") {
    for (const patch of answer.update.patches) transfer.push(patch.words.buffer);
    const { changed } = answer.update;
    if (changed) transfer.push(changed.positions.buffer, changed.radii.buffer);
  }
  host.postMessage(answer, transfer);
}

async function connect(request: Extract<Request, { ask: "connect" }>): Promise<void> {
  try {
    source = /^wss?:/.test(request.url) ? new LiveSource(await loading) : new StaticSource(loading);
    source.connect(request.url, request.options, (event) => tell({ tell: "event", event }));
  } catch (error) {
    const message = error instanceof Error ? error.message : String(error);
    tell({ tell: "event", event: { type: "error", error: { code: "decoders", message, fatal: true } } });
  }
}

async function frame({ number, request }: Extract<Request, { ask: "frame" }>): Promise<void> {
  try {
    if (!source) throw new Error("no frame before the scene is known");
    const update = await source.frame(request);
    tell({ tell: "frame", number, update, kept: source.kept });
  } catch (error) {
    tell({ tell: "failed", number, message: error instanceof Error ? error.message : String(error) });
  }
}

host.onmessage = ({ data }) => {
  if (data.ask === "connect") starting = connect(data);
  else starting.then(() => answer(data)).catch(fail); // else what went wrong here would be known to nobody
};

function fail(error: unknown): void {
  const message = error instanceof Error ? error.message : String(error);
  tell({ tell: "event", event: { type: "error", error: { code: "worker", message, fatal: true } } });
}

function answer(data: Exclude<Request, { ask: "connect" }>): void {
  switch (data.ask) {
    case "control": return source?.control(data.state);
    case "poses": return source?.sendPoses(data.samples, data.cadence);
    case "keyframe": return source?.requestKeyframe(data.seq);
    case "reshape": return source?.reshape(data.intrinsics);
    case "frame": return void frame(data);
    case "close": return source?.close();
  }
}
