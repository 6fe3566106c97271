/** The page: a viewer first. Joins the server that it came from, shows the scene, and does what its user wants. */

import "./page.css";
import { ClientShow } from "../client/show.ts";
import { type Mode, ViewCamera } from "../player/camera.ts";
import { Gestures } from "../player/gestures.ts";
import { type Opened, openedAs, savedView, titleOf } from "./author.ts";
import { Bar } from "./bar.ts";
import { download, Film, pictureOf } from "./capture.ts";
import { keep, kept, onChange, takesKey, the } from "./dom.ts";
import { DrawnShow } from "./drawn.ts";
import * as embed from "./embed.ts";
import { Inspector } from "./inspector.ts";
import { Messages } from "./messages.ts";
import { hashOf, type Left, leave, movedTo, type Place, placeOf, sceneOf, taken, tokenHash } from "./place.ts";
import type { Host, Playing, Show } from "./show.ts";
import type { Angles } from "./view.ts";

const TELL_MS = 250;
/** How long it is said why the page was loaded anew. */
const EXPLAINED_MS = 8000;
/** A page that loses its device within this time of being reloaded is not reloaded again: it might never end. */
const AGAIN_MS = 30_000;

/** Where a client listens that draws for this page; undefined: the page draws itself. */
const CLIENT = document.querySelector<HTMLMetaElement>('meta[name="cags-client"]')?.content;
/** The scene that the address names, of a server with several. */
const SCENE = sceneOf(location.search);

class Viewer implements Host {
  readonly show: Show;
  readonly messages: Messages;
  readonly canvas = the<HTMLCanvasElement>("picture");
  camera: ViewCamera | null = null;
  angles: Angles = { tanX: 1, tanY: 1 };
  /** Whether the page before reloaded itself as this one. */
  readonly #again: boolean;
  /** Why only a reloaded page can draw; empty while this one can. */
  #lost = "";
  readonly #stage = the("stage");
  readonly #light = the("light");
  readonly #lightText = the("light-text");
  readonly #bar: Bar;
  readonly #inspector = new Inspector(the("figures"));
  readonly #gestures: Gestures;
  #scene: Opened | undefined;
  #place: Place = {};
  #film: Film | null = null;
  #toldMs = 0;
  #there = false; // a picture of the newest play

  constructor() {
    const left = takenUp();
    this.#again = left !== undefined;
    this.place = left?.place ?? placeOf(location.hash);
    this.messages = new Messages(() => (this.#lost ? this.#reload(this.#lost) : void this.show.begin()), (token) => {
      this.place = { ...this.place, token };
      void this.show.begin();
    });
    this.show = CLIENT === undefined ? new DrawnShow(this) : new ClientShow(this, CLIENT);
    this.#gestures = new Gestures(this.canvas, () => this.canvas.focus({ preventScroll: true }));
    this.#bar = new Bar({
      toggle: () => (this.player?.playing ? this.player.pause() : this.player?.play()),
      seek: (frame) => this.player?.seek(frame),
      mode: (mode) => this.setMode(mode),
      home: () => this.#home(),
      share: () => void this.#share(),
      snapshot: () => void this.#snapshot(),
      record: () => this.#record(),
      immerse: () => this.show.immerse(),
    });
    if (left) this.messages.toast(left.why, EXPLAINED_MS);
    the("record").hidden = Film.kind === undefined;
    the("scenes").hidden = SCENE === undefined;
    this.#listen();
    const tick = (now: number): void => {
      if (!this.show.immersed) this.step(now);
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  get place(): Place {
    return this.#place;
  }

  /** The list of scenes opens with the same token. */
  set place(place: Place) {
    this.#place = place;
    for (const id of ["scenes", "all"]) the<HTMLAnchorElement>(id).href = `.${tokenHash(place.token)}`;
  }

  get player(): Playing | null {
    return this.show.player;
  }

  setMode(mode: Mode): void {
    if (this.camera) this.camera.mode = mode;
    this.#bar.setMode(mode);
    keep("camera", mode);
  }

  /** Begin at the first view of a scene, or where the link says. */
  stand(given: Opened): void {
    const scene = (this.#scene = openedAs(given, this.place));
    this.#title(titleOf(scene));
    this.#stage.style.setProperty("background", scene.view.background ?? "");
    this.camera = new ViewCamera(scene);
    this.#home();
    if (this.place.pose) this.camera.place(this.place.pose);
    this.setMode(this.place.mode ?? (kept("camera") as Mode | undefined) ?? "orbit");
    this.#gestures.drive(this.camera);
  }

  ready(): void {
    const { name, frames, fps } = this.player!.info!;
    embed.tell("ready", { name, seconds: frames / fps });
  }

  failed(headline: string, message: string, way: "again" | "scenes" | "none" = "again"): void {
    embed.tell("error", { message });
    this.messages.fail(headline, sentence(message), way);
  }

  // ---------------------------------------------------------------------------------------------------------- in time

  step(now: number): void {
    this.#gestures.step(now);
    const { player } = this;
    const there = this.#there;
    this.#there = false;
    this.#showLight();
    if (!player) return;
    player.step();
    this.#there = player.shown !== null;
    if (this.#there && !there) {
      this.#stage.setAttribute("data-picture", "");
      this.messages.quiet();
    }
    this.#word(player);
    this.#bar.update(player);
    if (this.#bar.inspecting) this.#inspector.update(player.pictures, (rate) => this.show.figures(rate));
    if (now - this.#toldMs > TELL_MS) {
      this.#toldMs = now;
      if (player.info) embed.tell("time", { seconds: player.seconds, playing: player.playing });
    }
  }

  #showLight(): void {
    const { state, text } = this.show.verdict;
    if (this.#lightText.textContent !== text) this.#lightText.textContent = text;
    this.#light.dataset.state = state;
  }

  /** What keeps the picture from going on is said over it, until it does. */
  #word(player: Playing): void {
    const { trouble } = this.show;
    const said = trouble?.[0] ?? "";
    if (said === this.#said || this.messages.failed) return;
    this.#said = said;
    if (trouble) this.messages.say(...trouble);
    else if (player.shown) this.messages.quiet();
    else this.messages.say("Loading");
  }
  #said = "";

  // --------------------------------------------------------------------------------------------------------- wishes

  #home(): void {
    this.camera?.home(this.angles.tanX, this.angles.tanY);
  }

  reload(why: string): boolean {
    this.#lost = why;
    if (this.#again && performance.now() < AGAIN_MS) return false;
    this.#reload(why);
    return true;
  }

  #reload(why: string): void {
    try {
      leave(sessionStorage, location.href, { place: this.#placeNow(), why });
    } catch {
      // storage is turned off: the visit begins again where the address says
    }
    location.reload();
  }

  /** Where the visit stands, with all that the address and the user have said. */
  #placeNow(): Place {
    const { player, camera } = this;
    return {
      ...this.place,
      ...(player?.info ? { seconds: player.seconds, playing: player.playing, loop: the<HTMLInputElement>("loop").checked } : {}),
      ...(camera ? { pose: camera.pose, mode: camera.mode } : {}),
    };
  }

  async #share(): Promise<void> {
    if (!this.player || !this.camera) return;
    const link = location.href.replace(/#.*/, "") + hashOf(this.player.seconds, this.camera.pose, this.camera.mode);
    try {
      await navigator.clipboard.writeText(link);
      this.messages.toast("Link copied");
    } catch {
      history.replaceState(null, "", link);
      this.messages.toast("The link is in the address bar");
    }
  }

  async #snapshot(): Promise<void> {
    if (!this.player?.shown) return;
    this.show.present();
    download(await pictureOf(this.canvas), `${this.#fileName()}-${this.player.seconds.toFixed(2)}s.png`);
    this.messages.toast("Picture saved");
  }

  /** Begin to film what is shown, or end it. */
  #record(): void {
    const kind = Film.kind;
    if (this.#film) this.#film.stop();
    else if (kind && this.player?.shown) {
      this.#film = new Film(this.canvas, kind, (film, suffix) => {
        this.#film = null;
        this.#bar.setRecording(false);
        download(film, `${this.#fileName()}.${suffix}`);
        this.messages.toast("Film saved");
      });
      this.#bar.setRecording(true);
      this.messages.toast("Recording; press again to end");
    }
  }

  #saveView(): void {
    if (!this.#scene || !this.camera) return;
    const text = savedView(this.#scene, this.camera, this.angles.tanX, this.angles.tanY);
    download(new Blob([text], { type: "application/json" }), `${this.#fileName()}-view.json`);
    this.messages.toast("View saved; cags-encode --view takes it");
  }

  #fileName(): string {
    return this.player?.info?.name ?? "scene";
  }

  #listen(): void {
    window.addEventListener("keydown", (event) => {
      if (event.defaultPrevented || takesKey(event.target, event.code)) return;
      if (this.#bar.key(event, this.player) || this.#gestures.key(event, true)) event.preventDefault();
    });
    window.addEventListener("keyup", (event) => void this.#gestures.key(event, false));
    document.addEventListener("visibilitychange", () => !this.show.immersed && this.player?.rest(document.hidden));
    addEventListener("hashchange", () => {
      this.place = movedTo(location.hash, this.place);
      void this.show.begin();
    });
    addEventListener("pagehide", () => this.player?.close());
    window.addEventListener("pageshow", ({ persisted }) => persisted && void this.show.begin()); // back from where browsers keep pages
    the("save-view").addEventListener("click", () => this.#saveView());
    onChange<HTMLInputElement>("loop", (box) => this.player?.setLoop(box.checked));
    onChange<HTMLSelectElement>("rate", (list) => this.player?.setRate(Number(list.value)));
    embed.listen({
      play: () => this.player?.play(),
      pause: () => this.player?.pause(),
      seek: (seconds) => this.player?.info && this.player.seek(seconds * this.player.info.fps),
      pose: (pose) => this.camera?.place(pose),
      mode: (mode) => this.setMode(mode),
    });
  }

  #title(text: string): void {
    the("title").textContent = text;
    document.title = `${text} · cags-stream`;
  }
}

/** What this page left before it was loaded anew. */
function takenUp(): Left | undefined {
  try {
    return taken(sessionStorage, location.href);
  } catch {
    return undefined; // storage is turned off, or holds what no page of ours wrote
  }
}

function sentence(text: string): string {
  return text && text[0].toUpperCase() + text.slice(1) + (/[.!?]$/.test(text) ? "" : ".");
}

const viewer = new Viewer();
void viewer.show.begin();

declare global {
  interface Window {
    /** For tests and the curious: the page's own objects. */
    cags: Viewer;
  }
}
window.cags = viewer;
