/** The page: a viewer first. Joins the server that it came from, shows the scene, and does what its user wants. */

import "./page.css";
import { UnsupportedError } from "../gpu/device.ts";
import type { Exactness } from "../gpu/layout.ts";
import { Renderer } from "../gpu/renderer.ts";
import { type Mode, ViewCamera } from "../player/camera.ts";
import { Gestures } from "../player/gestures.ts";
import { Player } from "../player/player.ts";
import type { Chroma, Intrinsics, Pose, SceneInfo, SourceError } from "../seam.ts";
import { connectWorker } from "../source/remote.ts";
import { finestChroma } from "../video/decoder.ts";
import { Bar } from "./bar.ts";
import { keep, kept, the } from "./dom.ts";
import * as embed from "./embed.ts";
import { Inspector } from "./inspector.ts";
import { verdictOf } from "./light.ts";
import { Messages } from "./messages.ts";
import { hashOf, type Place, placeOf } from "./place.ts";
import { type Angles, anglesOf, intrinsicsOf, pixelsOf } from "./view.ts";

/** The server is asked again after a while when it was not there at all. */
const RETRY_MS = 2000;
/** The server learns a window's new shape when it has settled. */
const SETTLED_MS = 700;
/** Shapes that differ by more than this factor begin a new session. */
const OTHER_SHAPE = 1.3;
const TELL_MS = 250;

/** What the server says about its scene before anything streams. */
interface Bundle {
  readonly name: string;
  readonly up: [number, number, number];
  readonly focus_centre: [number, number, number];
  readonly focus_radius: number;
  readonly bounds: SceneInfo["bounds"];
  readonly fps: number;
}

/** Where the scene lies that this page was published with; undefined: it comes from the page's own server. */
const PUBLISHED = document.querySelector<HTMLMetaElement>('meta[name="cags-source"]')?.content;
/** Until a published scene says what it is. */
const NOWHERE: Bundle = {
  name: "",
  up: [0, 1, 0],
  focus_centre: [0, 0, 0],
  focus_radius: 1,
  fps: 30,
  bounds: [[-1, -1, -1], [1, 1, 1]],
};

class Viewer {
  player: Player | null = null;
  renderer: Renderer | null = null;
  camera: ViewCamera | null = null;
  readonly #canvas = the<HTMLCanvasElement>("picture");
  readonly #stage = the("stage");
  readonly #light = the("light");
  readonly #lightText = the("light-text");
  readonly #messages: Messages;
  readonly #bar: Bar;
  readonly #inspector = new Inspector(the("figures"));
  readonly #gestures: Gestures;
  #place: Place = placeOf(location.hash);
  #angles: Angles = { tanX: 1, tanY: 1 };
  #chroma: Chroma | undefined;
  #settled = 0;
  #toldMs = 0;
  #retry = 0;

  constructor() {
    this.#messages = new Messages(() => void this.begin(), (token) => {
      this.#place = { ...this.#place, token };
      void this.begin();
    });
    this.#gestures = new Gestures(this.#canvas, () => this.#canvas.focus({ preventScroll: true }));
    this.#bar = new Bar({
      toggle: () => (this.player?.playing ? this.player.pause() : this.player?.play()),
      seek: (frame) => this.player?.seek(frame),
      mode: (mode) => this.setMode(mode),
      home: () => this.#home(),
      share: () => void this.#share(),
      snapshot: () => void this.#snapshot(),
    });
    this.#listen();
    const tick = (now: number): void => {
      this.#step(now);
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  /** Join, from the beginning. */
  async begin(): Promise<void> {
    clearTimeout(this.#retry);
    this.player?.close();
    this.player = null;
    this.#messages.say("Connecting");
    try {
      const bundle = PUBLISHED ? NOWHERE : await this.#bundle();
      if (!bundle) return;
      this.#title(bundle.name);
      this.#chroma ??= await finestChroma();
      this.renderer ??= await Renderer.make(this.#canvas, (reason) => this.#lostDevice(reason));
      this.#join(bundle);
    } catch (error) {
      this.#cannot(error);
    }
  }

  setMode(mode: Mode): void {
    if (this.camera) this.camera.mode = mode;
    this.#bar.setMode(mode);
    keep("camera", mode);
  }

  /** Where the view is, for links and tests. */
  get intrinsics(): Intrinsics {
    const [width, height] = pixelsOf(innerWidth, innerHeight, devicePixelRatio, this.#place.size);
    return intrinsicsOf(width, height, this.#angles);
  }

  // ---------------------------------------------------------------------------------------------------------- joining

  async #bundle(): Promise<Bundle | undefined> {
    const { token } = this.#place;
    const headers = token ? { Authorization: `Bearer ${token}` } : undefined;
    let answer: Response;
    try {
      answer = await fetch(new URL("bundle", location.href), headers ? { headers } : {});
    } catch {
      this.#messages.say("The server is not there", "This page looks for it and goes on by itself.");
      this.#retry = window.setTimeout(() => void this.begin(), RETRY_MS);
      return undefined;
    }
    if (answer.status === 401) {
      this.#messages.askToken(token !== undefined);
      return undefined;
    }
    if (!answer.ok) throw new Error(`the server answers ${answer.status} ${answer.statusText}`);
    return (await answer.json()) as Bundle;
  }

  #join(bundle: Bundle): void {
    const [width, height] = pixelsOf(innerWidth, innerHeight, devicePixelRatio, this.#place.size);
    this.#angles = anglesOf(width, height);
    this.#stand({ up: bundle.up, focusCentre: bundle.focus_centre, focusRadius: bundle.focus_radius, bounds: bundle.bounds });
    const source = connectWorker(new Worker(new URL("worker.js", import.meta.url), { type: "module" }));
    const startFrame = Math.floor((this.#place.seconds ?? 0) * bundle.fps + 1e-6);
    const view = (): { pose: Pose; intrinsics: Intrinsics } => ({ pose: this.camera!.pose, intrinsics: this.intrinsics });
    const player = new Player(source, this.renderer!, view, this.#options(startFrame), {
      changed: () => undefined,
      info: (info) => this.#onInfo(info),
      failed: (error) => this.#onFailure(player, error),
      notice: (message) => this.#messages.toast(message),
    });
    this.player = player;
    source.connect(
      PUBLISHED ? new URL(PUBLISHED, location.href).href : new URL("stream", location.href.replace(/^http/, "ws")).href,
      {
        ...view(),
        startFrame,
        reconnectS: Infinity,
        references: this.#chroma ? "any" : "none",
        ...(this.#chroma ? { chroma: this.#chroma } : {}),
        ...(this.#place.token ? { token: this.#place.token } : {}),
      },
      (event) => player.handle(event),
    );
    this.#messages.say("Loading", bundle.name);
  }

  #options(startFrame: number): ConstructorParameters<typeof Player>[3] {
    return {
      startFrame,
      playing: this.#place.playing ?? true,
      loop: this.#place.loop ?? the<HTMLInputElement>("loop").checked,
      adaptResolution: the<HTMLInputElement>("adapt").checked && !this.#place.size,
      exactness: the<HTMLSelectElement>("exactness").value as Exactness,
      correct: the<HTMLInputElement>("correct").checked,
    };
  }

  /** Begin at the first view of a scene, or where the link says. */
  #stand(scene: Pick<SceneInfo, "up" | "focusCentre" | "focusRadius" | "bounds">): void {
    this.camera = new ViewCamera(scene);
    this.#home();
    if (this.#place.pose) this.camera.place(this.#place.pose);
    this.setMode(this.#place.mode ?? (kept("camera") as Mode | undefined) ?? "orbit");
    this.#gestures.drive(this.camera);
  }

  #onInfo(info: SceneInfo): void {
    if (PUBLISHED) {
      this.#title(info.name);
      this.#stand(info);
    }
    embed.tell("ready", { name: info.name, seconds: info.frames / info.fps });
  }

  #onFailure(player: Player, { code, message, fatal }: SourceError): void {
    if (player !== this.player) return;
    embed.tell("error", { message });
    if (!fatal) return this.#messages.toast(message);
    if (code === "token") return this.#messages.askToken(this.#place.token !== undefined);
    this.#messages.fail("The play has ended", sentence(message));
  }

  #cannot(error: unknown): void {
    const message = error instanceof Error ? error.message : String(error);
    embed.tell("error", { message });
    if (error instanceof UnsupportedError) this.#messages.fail("This browser cannot show the scene", message, false);
    else this.#messages.fail("The scene cannot be shown", sentence(message));
  }

  #lostDevice(reason: string): void {
    this.renderer = null;
    this.#messages.toast(`The graphics processor was lost (${reason}); starting again`);
    this.#keepPlace();
    const fresh = this.#canvas.cloneNode() as HTMLCanvasElement;
    this.#canvas.replaceWith(fresh); // a canvas stays with the device that it was given
    location.reload();
  }

  // ---------------------------------------------------------------------------------------------------------- in time

  #step(now: number): void {
    this.#gestures.step(now);
    const { player } = this;
    if (!player) return;
    player.step();
    if (player.shown && !this.#stage.hasAttribute("data-picture")) {
      this.#stage.setAttribute("data-picture", "");
      this.#messages.quiet();
    }
    this.#word(player);
    this.#bar.update(player);
    if (this.#bar.inspecting) this.#inspector.update(player, this.renderer?.gpu.name ?? "");
    const { state, text } = verdictOf(player);
    if (this.#lightText.textContent !== text) this.#lightText.textContent = text;
    this.#light.dataset.state = state;
    if (now - this.#toldMs > TELL_MS) {
      this.#toldMs = now;
      if (player.info) embed.tell("time", { seconds: player.seconds, playing: player.playing });
    }
  }

  /** A lost server is said over the picture, until it is back. */
  #word(player: Player): void {
    const away = player.status?.link === "away";
    if (away === this.#away) return;
    this.#away = away;
    if (away) this.#messages.say("The server is not there", "The picture stands on what has come; it goes on by itself.");
    else if (player.shown) this.#messages.quiet();
  }
  #away = false;

  // --------------------------------------------------------------------------------------------------------- wishes

  #home(): void {
    this.camera?.home(this.#angles.tanX, this.#angles.tanY);
  }

  #hash(): string {
    return hashOf(this.player!.seconds, this.camera!.pose, this.camera!.mode);
  }

  #keepPlace(): void {
    if (this.player && this.camera) history.replaceState(null, "", this.#hash());
  }

  async #share(): Promise<void> {
    if (!this.player || !this.camera) return;
    const link = location.href.replace(/#.*/, "") + this.#hash();
    try {
      await navigator.clipboard.writeText(link);
      this.#messages.toast("Link copied");
    } catch {
      history.replaceState(null, "", link);
      this.#messages.toast("The link is in the address bar");
    }
  }

  async #snapshot(): Promise<void> {
    if (!this.renderer || !this.player?.shown) return;
    const { width, height, rgba } = await this.renderer.pixels();
    const canvas = new OffscreenCanvas(width, height);
    canvas.getContext("2d")!.putImageData(new ImageData(rgba, width, height), 0, 0);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await canvas.convertToBlob());
    link.download = `${this.player.info?.name ?? "scene"}-${this.player.seconds.toFixed(2)}s.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    this.#messages.toast("Picture saved");
  }

  #listen(): void {
    window.addEventListener("keydown", (event) => {
      if (event.target instanceof HTMLInputElement && event.target.type !== "checkbox") return;
      if (event.target instanceof HTMLSelectElement) return;
      if (event.target instanceof HTMLButtonElement && (event.code === "Space" || event.code === "Enter")) return;
      if (this.#bar.key(event, this.player) || this.#gestures.key(event, true)) event.preventDefault();
    });
    window.addEventListener("keyup", (event) => void this.#gestures.key(event, false));
    document.addEventListener("visibilitychange", () => this.player?.rest(document.hidden));
    addEventListener("resize", () => this.#resized());
    addEventListener("hashchange", () => {
      this.#place = { ...placeOf(location.hash), ...(this.#place.token ? { token: this.#place.token } : {}) };
      void this.begin();
    });
    addEventListener("pagehide", () => this.player?.close());
    this.#setting<HTMLInputElement>("correct", (box) => this.player && (this.player.correct = box.checked));
    this.#setting<HTMLInputElement>("adapt", (box) => this.player && (this.player.adaptResolution = box.checked));
    this.#setting<HTMLInputElement>("loop", (box) => this.player?.setLoop(box.checked));
    this.#setting<HTMLSelectElement>("exactness", (list) => this.player && (this.player.exactness = list.value as Exactness));
    this.#setting<HTMLSelectElement>("rate", (list) => this.player?.setRate(Number(list.value)));
    embed.listen({
      play: () => this.player?.play(),
      pause: () => this.player?.pause(),
      seek: (seconds) => this.player?.info && this.player.seek(seconds * this.player.info.fps),
      pose: (pose) => this.camera?.place(pose),
      mode: (mode) => this.setMode(mode),
    });
  }

  #setting<T extends HTMLElement>(id: string, apply: (element: T) => void): void {
    const element = the<T>(id);
    element.addEventListener("change", () => apply(element));
  }

  /** A window of another shape begins a new session where the play stands. */
  #resized(): void {
    clearTimeout(this.#settled);
    this.#settled = window.setTimeout(() => {
      const wanted = anglesOf(innerWidth, innerHeight);
      const other = (wanted.tanX * this.#angles.tanY) / (wanted.tanY * this.#angles.tanX);
      if (!this.player?.shown || this.#place.size || Math.max(other, 1 / other) < OTHER_SHAPE) return;
      const { seconds, playing } = this.player;
      this.#place = { ...this.#place, seconds, playing, pose: this.camera!.pose, mode: this.camera!.mode };
      void this.begin();
    }, SETTLED_MS);
  }

  #title(name: string): void {
    the("title").textContent = name;
    document.title = `${name} · cags-stream`;
  }
}

function sentence(text: string): string {
  return text && text[0].toUpperCase() + text.slice(1) + (/[.!?]$/.test(text) ? "" : ".");
}

const viewer = new Viewer();
void viewer.begin();

declare global {
  interface Window {
    /** For tests and the curious: the page's own objects. */
    cags: Viewer;
  }
}
window.cags = viewer;
