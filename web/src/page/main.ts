/** The page: a viewer first. Joins the server that it came from, shows the scene, and does what its user wants. */

import "./page.css";
import { UnsupportedError } from "../gpu/device.ts";
import type { Exactness } from "../gpu/layout.ts";
import { Renderer } from "../gpu/renderer.ts";
import { type Mode, ViewCamera } from "../player/camera.ts";
import { Gestures } from "../player/gestures.ts";
import { Player } from "../player/player.ts";
import { readManifest, sceneInfo } from "../decode/manifest.ts";
import type { Chroma, Intrinsics, Pose, SceneInfo, SceneSource, SourceError } from "../seam.ts";
import { connectWorker } from "../source/remote.ts";
import { finestChroma } from "../video/decoder.ts";
import { coloursOf, openedAs, savedView, titleOf } from "./author.ts";
import { Bar } from "./bar.ts";
import { download, Film, pictureOf } from "./capture.ts";
import { keep, kept, the } from "./dom.ts";
import * as embed from "./embed.ts";
import { Inspector } from "./inspector.ts";
import { verdictOf } from "./light.ts";
import { Messages } from "./messages.ts";
import { beside, hashOf, type Place, placeOf, sceneOf } from "./place.ts";
import { type Angles, anglesOf, intrinsicsOf, pixelsOf } from "./view.ts";

/** The server is asked again after a while when it was not there at all. */
const RETRY_MS = 2000;
/** The server learns a window's new shape when it has settled. */
const SETTLED_MS = 700;
/** Shapes that differ by more than this factor begin a new session. */
const OTHER_SHAPE = 1.3;
const TELL_MS = 250;
/** Of a published scene that has yet to say how fast it is. */
const DEFAULT_FPS = 30;
/** The view until a published scene says where it is. */
const NOWHERE: Pose = { position: [0, 0, 0], rotation: [1, 0, 0, 0] };

/** Where the scene lies that this page was published with; undefined: it comes from the page's own server. */
const PUBLISHED = document.querySelector<HTMLMetaElement>('meta[name="cags-source"]')?.content;
/** The scene that the address names, of a server with several. */
const SCENE = sceneOf(location.search);

/** The server has no scene of the name in the address. */
class MissingError extends Error {}

class Viewer {
  player: Player | null = null;
  renderer: Renderer | null = null;
  camera: ViewCamera | null = null;
  #rendering: Promise<Renderer> | undefined;
  #source: SceneSource | undefined; // started, and of no scene yet
  #attempts = 0;
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
  #background: readonly [number, number, number] = [0, 0, 0];
  #scene: SceneInfo | undefined;
  #film: Film | null = null;
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
      record: () => this.#record(),
    });
    the("record").hidden = Film.kind === undefined;
    the("scenes").hidden = SCENE === undefined;
    this.#listen();
    const tick = (now: number): void => {
      this.#step(now);
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  /** Join, from the beginning. The scene is fetched while the worker loads and the device is made. */
  async begin(): Promise<void> {
    clearTimeout(this.#retry);
    this.#leave();
    this.#messages.say("Connecting");
    const attempt = ++this.#attempts;
    const rendering = (this.#rendering ??= this.#render());
    this.#source ??= connectWorker(new Worker(new URL("worker.js", import.meta.url), { type: "module" }));
    try {
      const [scene, chroma] = await Promise.all([PUBLISHED ? undefined : this.#bundle(), finestChroma()]);
      if (attempt !== this.#attempts || (!PUBLISHED && !scene)) return;
      this.#chroma = chroma;
      await Promise.race([rendering, undefined]); // throws where it is known that nothing can be drawn
      this.#angles = anglesOf(...pixelsOf(innerWidth, innerHeight, devicePixelRatio, this.#place.size));
      if (scene) this.#stand(scene);
      this.#join(scene, rendering);
      await rendering;
    } catch (error) {
      if (attempt !== this.#attempts) return;
      this.#leave();
      this.#cannot(error);
    }
  }

  #leave(): void {
    this.player?.close();
    this.player = null;
  }

  /** The renderer, once there is a device; another attempt makes another where there was none. */
  #render(): Promise<Renderer> {
    const made = Renderer.make(this.#canvas, (reason) => this.#lostDevice(reason)).then((renderer) => {
      renderer.background = this.#background;
      return (this.renderer = renderer);
    });
    made.catch(() => (this.#rendering = undefined));
    return made;
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

  async #bundle(): Promise<SceneInfo | undefined> {
    const { token } = this.#place;
    const headers = token ? { Authorization: `Bearer ${token}` } : undefined;
    let answer: Response;
    try {
      answer = await fetch(beside("bundle"), headers ? { headers } : {});
    } catch {
      this.#messages.say("The server is not there", "This page looks for it and goes on by itself.");
      this.#retry = window.setTimeout(() => void this.begin(), RETRY_MS);
      return undefined;
    }
    if (answer.status === 401) {
      this.#messages.askToken(token !== undefined);
      return undefined;
    }
    if (answer.status === 404 && SCENE !== undefined) throw new MissingError(`There is no scene '${SCENE}' here.`);
    if (answer.status === 404) throw new Error(((await answer.json()) as { error: string }).error);
    if (!answer.ok) throw new Error(`the server answers ${answer.status} ${answer.statusText}`);
    return sceneInfo(readManifest(new Uint8Array(await answer.arrayBuffer())), false);
  }

  /** A published scene says what it is when it comes; until then the view is nowhere in particular. */
  #join(scene: SceneInfo | undefined, rendering: Promise<Renderer>): void {
    const source = this.#source!;
    this.#source = undefined;
    const startFrame = Math.floor((this.#place.seconds ?? 0) * (scene?.fps ?? DEFAULT_FPS) + 1e-6);
    const view = (): { pose: Pose; intrinsics: Intrinsics } => ({ pose: this.camera?.pose ?? NOWHERE, intrinsics: this.intrinsics });
    const player = new Player(source, rendering, view, this.#options(startFrame), {
      changed: () => undefined,
      info: (info) => this.#onInfo(info),
      failed: (error) => this.#onFailure(player, error),
      notice: (message) => this.#messages.toast(message),
    });
    this.player = player;
    source.connect(
      PUBLISHED ? new URL(PUBLISHED, location.href).href : beside("stream").href.replace(/^http/, "ws"),
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
    this.#messages.say("Loading", scene ? titleOf(scene) : "");
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
  #stand(given: SceneInfo): void {
    const scene = (this.#scene = openedAs(given, this.#place));
    this.#title(titleOf(scene));
    this.#background = coloursOf(scene.view.background);
    if (this.renderer) this.renderer.background = this.#background;
    the("stage").style.setProperty("background", scene.view.background ?? "");
    this.camera = new ViewCamera(scene);
    this.#home();
    if (this.#place.pose) this.camera.place(this.#place.pose);
    this.setMode(this.#place.mode ?? (kept("camera") as Mode | undefined) ?? "orbit");
    this.#gestures.drive(this.camera);
  }

  #onInfo(info: SceneInfo): void {
    if (PUBLISHED) this.#stand(info);
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
    if (error instanceof UnsupportedError) this.#messages.fail("This browser cannot show the scene", message, "none");
    else if (error instanceof MissingError) this.#messages.fail("The scene is not there", message, "scenes");
    else this.#messages.fail("The scene cannot be shown", sentence(message));
  }

  #lostDevice(reason: string): void {
    this.renderer = null;
    this.#rendering = undefined;
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
    this.renderer.present();
    download(await pictureOf(this.#canvas), `${this.#fileName()}-${this.player.seconds.toFixed(2)}s.png`);
    this.#messages.toast("Picture saved");
  }

  /** Begin to film what is shown, or end it. */
  #record(): void {
    const kind = Film.kind;
    if (this.#film) this.#film.stop();
    else if (kind && this.player?.shown) {
      this.#film = new Film(this.#canvas, kind, (film, suffix) => {
        this.#film = null;
        this.#bar.setRecording(false);
        download(film, `${this.#fileName()}.${suffix}`);
        this.#messages.toast("Film saved");
      });
      this.#bar.setRecording(true);
      this.#messages.toast("Recording; press again to end");
    }
  }

  #saveView(): void {
    if (!this.#scene || !this.camera) return;
    const text = savedView(this.#scene, this.camera, this.#angles.tanX, this.#angles.tanY);
    download(new Blob([text], { type: "application/json" }), `${this.#fileName()}-view.json`);
    this.#messages.toast("View saved; cags-encode --view takes it");
  }

  #fileName(): string {
    return this.player?.info?.name ?? "scene";
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
    the("save-view").addEventListener("click", () => this.#saveView());
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

  #title(text: string): void {
    the("title").textContent = text;
    document.title = `${text} · cags-stream`;
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
