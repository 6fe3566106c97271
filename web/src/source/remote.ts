/** A source in a worker, with the same interface on the page: what `worker.ts` answers. */
import { type ConnectOptions, type FrameRange, type FrameRequest, type FrameUpdate, type Intrinsics, NO_FRAMES, type PlayState, type PoseSample, type SceneSource, type SourceEvent, within } from "../seam.ts";
import type { KeepingState } from "./live.ts";

/** What the page asks of the worker. */
export type Request =
  | { readonly ask: "connect"; readonly url: string; readonly options: ConnectOptions }
  | { readonly ask: "control"; readonly state: KeepingState }
  | { readonly ask: "poses"; readonly samples: readonly PoseSample[]; readonly cadence: number | undefined }
  | { readonly ask: "keyframe"; readonly seq: number }
  | { readonly ask: "reshape"; readonly intrinsics: Intrinsics }
  | { readonly ask: "frame"; readonly number: number; readonly request: FrameRequest }
  | { readonly ask: "close" };

/** What the worker answers. `kept`: frames among which the play can jump, now that a frame is on display. */
export type Answer =
  | { readonly tell: "event"; readonly event: SourceEvent }
  | { readonly tell: "frame"; readonly number: number; readonly update: FrameUpdate; readonly kept: FrameRange }
  | { readonly tell: "failed"; readonly number: number; readonly message: string };

/** The part of a Worker that is used. */
export interface Port {
  postMessage(message: Request, transfer?: Transferable[]): void;
  onmessage: ((event: MessageEvent<Answer>) => void) | null;
  onerror: ((event: ErrorEvent) => void) | null;
  terminate(): void;
}

const CLOSING_MS = 500;
const LEFT = "the viewer has left";

/** The {@link SceneSource} that runs in `worker`. */
export function connectWorker(worker: Worker): SceneSource {
  return new RemoteSource(worker as unknown as Port);
}

export class RemoteSource implements SceneSource {
  private readonly port: Port;
  private readonly waiting = new Map<number, { resolve: (update: FrameUpdate) => void; reject: (error: Error) => void }>();
  private asked = 0;
  private range: FrameRange = NO_FRAMES;
  private failure: string | undefined;
  private closed = false;
  private listen: (event: SourceEvent) => void = () => {};

  constructor(port: Port) {
    this.port = port;
    port.onmessage = (event) => this.onAnswer(event.data);
    port.onerror = (event) => this.broken(event.message || "the viewer's worker could not be started");
  }

  connect(url: string, options: ConnectOptions, listen: (event: SourceEvent) => void): void {
    this.listen = listen;
    if (this.failure !== undefined) return this.broken(this.failure);
    this.port.postMessage({ ask: "connect", url, options });
  }

  control(state: PlayState): void {
    const keeps = within(this.range, state.frame);
    this.port.postMessage({ ask: "control", state: { ...state, keeps } });
    if (state.action === "seek" && !keeps) this.range = NO_FRAMES;
  }

  get kept(): FrameRange {
    return this.range;
  }

  sendPoses(samples: readonly PoseSample[], cadence?: number): void {
    this.port.postMessage({ ask: "poses", samples, cadence });
  }

  requestKeyframe(seq: number): void {
    this.port.postMessage({ ask: "keyframe", seq });
  }

  reshape(intrinsics: Intrinsics): void {
    this.port.postMessage({ ask: "reshape", intrinsics });
  }

  frame(request: FrameRequest): Promise<FrameUpdate> {
    if (this.closed) return Promise.reject(new Error(LEFT));
    const number = ++this.asked;
    return new Promise((resolve, reject) => {
      this.waiting.set(number, { resolve, reject });
      this.port.postMessage({ ask: "frame", number, request }, [...(request.spent ?? [])]);
    });
  }

  close(): void {
    if (this.closed) return;
    this.closed = true;
    this.refuse(LEFT); // the worker may be gone before it answers
    this.port.postMessage({ ask: "close" });
    setTimeout(() => this.port.terminate(), CLOSING_MS);
  }

  private onAnswer(answer: Answer): void {
    if (answer.tell === "event") return this.listen(answer.event);
    const waiting = this.waiting.get(answer.number);
    this.waiting.delete(answer.number);
    if (answer.tell === "failed") return waiting?.reject(new Error(answer.message));
    this.range = answer.kept;
    waiting?.resolve(answer.update);
  }

  private broken(message: string): void {
    this.failure = message;
    this.refuse(message);
    this.listen({ type: "error", error: { code: "worker", message, fatal: true } });
  }

  private refuse(message: string): void {
    for (const { reject } of this.waiting.values()) reject(new Error(message));
    this.waiting.clear();
  }
}
