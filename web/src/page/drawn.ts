/** A scene that this page draws itself: splats from its own server or a published folder, on the graphics processor. */

import { readManifest, sceneInfo } from "../decode/manifest.ts";
import { UnsupportedError } from "../gpu/device.ts";
import type { Exactness } from "../gpu/layout.ts";
import { Renderer } from "../gpu/renderer.ts";
import { Player, type Viewpoint } from "../player/player.ts";
import type { Chroma, Intrinsics, SceneInfo, SceneSource, SourceError } from "../seam.ts";
import { connectWorker } from "../source/remote.ts";
import { finestChroma } from "../video/decoder.ts";
import { frameAt } from "../wire/timeline.ts";
import { Immersive, watchHeadset } from "../xr/immersive.ts";
import { coloursOf, openedAs, titleOf } from "./author.ts";
import { onChange, seen, the } from "./dom.ts";
import * as embed from "./embed.ts";
import { drawnFigures, type Figure } from "./inspector.ts";
import { type Verdict, verdictOf } from "./light.ts";
import { bearer, beside, sceneOf } from "./place.ts";
import { type Host, NOWHERE, SERVER_AWAY, type Show } from "./show.ts";
import { anglesOf, intrinsicsOf, MOST_PIXELS, pixelsOf, usableSize } from "./view.ts";

/** The server is asked again after a while when it was not there at all. */
const RETRY_MS = 2000;
/** The server learns a window's new shape when it has settled. */
const SETTLED_MS = 700;
/** Shapes that differ by more than this factor are told the server; within it, the picture is a part of what it knows. */
const OTHER_SHAPE = 1.3;
/** {@link Show.trouble} while a headset shows the scene. */
const IN_HEADSET = ["In virtual reality", "The scene is in the headset; this page shows it again when you leave."] as const;
/** Of a window that was never larger than a sliver. */
const NO_WINDOW = [640, 400] as const;

/** Where the scene lies that this page was published with; undefined: it comes from the page's own server. */
const PUBLISHED = document.querySelector<HTMLMetaElement>('meta[name="cags-source"]')?.content;

/** The server has no scene of the name in the address. */
class MissingError extends Error {}

export class DrawnShow implements Show {
  player: Player | null = null;
  renderer: Renderer | null = null;
  immersive: Immersive | null = null;
  readonly #host: Host;
  #rendering: Promise<Renderer> | undefined;
  #source: SceneSource | undefined; // started, and of no scene yet
  #attempts = 0;
  #over: string | undefined; // what the light says of a play that has ended
  #retry = 0;
  #settled = 0;
  #left: Promise<unknown> = Promise.resolve(); // once no earlier play draws any more
  #window: readonly [number, number] = NO_WINDOW;
  #chroma: Chroma | undefined;
  #background: readonly [number, number, number] = [0, 0, 0];

  constructor(host: Host) {
    this.#host = host;
    addEventListener("resize", () => this.#resized());
    watchHeadset((there) => (the("vr").hidden = !there));
    onChange<HTMLInputElement>("correct", (box) => this.player && (this.player.correct = box.checked));
    onChange<HTMLInputElement>("adapt", (box) => this.player && (this.player.adaptResolution = box.checked));
    onChange<HTMLSelectElement>("exactness", (list) => this.player && (this.player.exactness = list.value as Exactness));
  }

  /** The scene is fetched while the worker loads and the device is made. */
  async begin(): Promise<void> {
    clearTimeout(this.#retry);
    this.#leave();
    this.#over = undefined;
    this.#host.messages.say("Connecting");
    const attempt = ++this.#attempts;
    const rendering = (this.#rendering ??= this.#render());
    this.#source ??= connectWorker(new Worker(new URL("worker.js", import.meta.url), { type: "module" }));
    try {
      const [scene, chroma] = PUBLISHED ? [] : await Promise.all([this.#bundle(), finestChroma()]); // no references without a server
      if (attempt !== this.#attempts || (!PUBLISHED && !scene)) return;
      this.#chroma = chroma;
      the("correct").closest("label")!.hidden = !chroma;
      await Promise.race([rendering, undefined]); // throws where it is known that nothing can be drawn
      if (!this.immersed) await seen(); // a page in the background asks for nothing
      if (attempt !== this.#attempts) return;
      this.#host.angles = anglesOf(...this.#pixels());
      if (scene) this.#stand(scene);
      this.#join(scene, rendering);
      await rendering;
    } catch (error) {
      if (attempt !== this.#attempts) return;
      this.#leave();
      this.#cannot(error);
    }
  }

  get trouble(): Show["trouble"] {
    if (this.player?.status?.link === "away") return SERVER_AWAY;
    return this.immersed ? IN_HEADSET : null;
  }

  get verdict(): Verdict {
    if (this.#over !== undefined) return { state: "bad", text: this.#over };
    return this.player ? verdictOf(this.player) : { state: "wait", text: "connecting" };
  }

  figures(rate: number): readonly Figure[] {
    return this.player ? drawnFigures(this.player, this.renderer?.gpu.name ?? "", rate, this.#chroma !== undefined) : [];
  }

  present(): void {
    this.renderer?.present();
  }

  get immersed(): boolean {
    return this.immersive !== null;
  }

  immerse(): void {
    if (this.immersive) this.immersive.leave();
    else if (!the("vr").hidden && this.player?.shown) void this.#enter();
  }

  async #enter(): Promise<void> {
    const host = this.#host;
    try {
      this.immersive = await Immersive.enter({
        up: this.player!.info!.up,
        mostPixels: MOST_PIXELS,
        background: this.#background,
        start: () => host.camera!.pose,
        began: ({ intrinsics }) => this.player?.reshape(intrinsics),
        step: () => host.step(performance.now()),
        toggle: () => (this.player?.playing ? this.player.pause() : this.player?.play()),
        rest: (rested) => this.player?.rest(rested),
        ended: () => {
          this.immersive = null;
          this.player?.rest(document.hidden);
          this.player?.reshape(this.#intrinsics);
        },
      });
    } catch (error) {
      host.messages.toast(`The headset cannot be used (${error instanceof Error ? error.message : String(error)})`);
    }
  }

  /** From where the viewer looks: the page's camera, or the head in a headset. */
  get #viewpoint(): Viewpoint {
    return this.immersive?.viewpoint ?? { pose: this.#host.camera?.pose ?? NOWHERE, intrinsics: this.#intrinsics };
  }

  get #intrinsics(): Intrinsics {
    return intrinsicsOf(...this.#pixels(), this.#host.angles);
  }

  #pixels(): [number, number] {
    return pixelsOf(...this.#inner(), devicePixelRatio, this.#host.place.size);
  }

  /** Width and height of the window: a frame that is folded away keeps those that it had. */
  #inner(): readonly [number, number] {
    return (this.#window = usableSize(innerWidth, innerHeight) ?? this.#window);
  }

  #leave(): void {
    if (this.player) this.#left = Promise.all([this.#left, this.player.close()]);
    this.player = null;
  }

  /** The renderer, once there is a device; another attempt makes another where there was none. */
  #render(): Promise<Renderer> {
    const events = {
      lost: (reason: string) => this.#lostDevice(reason),
      refused: (message: string) => this.#refusedBy(made, message),
    };
    const made: Promise<Renderer> = Renderer.make(this.#host.canvas, events, !PUBLISHED).then((renderer) => {
      renderer.background = this.#background;
      return (this.renderer = renderer);
    });
    made.catch(() => (this.#rendering = undefined));
    return made;
  }

  async #bundle(): Promise<SceneInfo | undefined> {
    const { messages, place } = this.#host;
    const scene = sceneOf(location.search);
    const headers = place.token ? { Authorization: bearer(place.token) } : undefined;
    let answer: Response;
    try {
      answer = await fetch(beside("bundle"), headers ? { headers } : {});
    } catch {
      messages.say("The server is not there", "This page looks for it and goes on by itself.");
      this.#retry = window.setTimeout(() => void this.begin(), RETRY_MS);
      return undefined;
    }
    if (answer.status === 401) {
      this.#over = "no token yet";
      messages.askToken(place.token !== undefined);
      return undefined;
    }
    if (answer.status === 404 && scene !== undefined) throw new MissingError(`There is no scene '${scene}' here.`);
    const said = answer.headers.get("Content-Type")?.startsWith("application/json");
    if (answer.status === 404 && said) throw new Error(((await answer.json()) as { error: string }).error);
    if (!answer.ok) throw new Error(`the server answers ${answer.status} ${answer.statusText}`);
    return sceneInfo(readManifest(new Uint8Array(await answer.arrayBuffer())), false);
  }

  /** A published scene says what it is when it comes; until then the view is nowhere in particular. */
  #join(scene: SceneInfo | undefined, rendering: Promise<Renderer>): void {
    const { place, messages } = this.#host;
    const source = this.#source!;
    this.#source = undefined;
    const startSeconds = place.seconds ?? 0;
    const free = this.#left.then(() => rendering); // it draws for one play at a time
    const player = new Player(source, free, () => this.#viewpoint, this.#options(startSeconds), {
      changed: () => undefined,
      drew: (eye, of, camera, picture) => {
        this.immersive?.keep(eye, of, camera, picture);
        picture.close();
      },
      info: (info) => {
        if (PUBLISHED) this.#stand(info);
        this.#host.ready();
      },
      failed: (error) => this.#onFailure(player, error),
      notice: (message) => messages.toast(message),
    });
    this.player = player;
    the<HTMLInputElement>("loop").checked = player.loop;
    source.connect(
      PUBLISHED ? new URL(PUBLISHED, location.href).href : beside("stream").href.replace(/^http/, "ws"),
      {
        pose: this.#viewpoint.pose,
        intrinsics: this.#viewpoint.intrinsics,
        ...(scene ? { startFrame: frameAt(startSeconds, scene) } : { startSeconds }),
        reconnectS: Infinity,
        references: this.#chroma ? "any" : "none",
        ...(this.#chroma ? { chroma: this.#chroma } : {}),
        ...(place.token ? { token: place.token } : {}),
      },
      (event) => player.handle(event),
    );
    messages.say("Loading", scene ? titleOf(scene) : "");
  }

  #stand(scene: SceneInfo): void {
    this.#background = coloursOf(openedAs(scene, this.#host.place).view.background);
    if (this.renderer) this.renderer.background = this.#background;
    this.#host.stand(scene);
  }

  #options(startSeconds: number): ConstructorParameters<typeof Player>[3] {
    const { place } = this.#host;
    return {
      startSeconds,
      playing: place.playing ?? true,
      loop: place.loop ?? the<HTMLInputElement>("loop").checked,
      rate: Number(the<HTMLSelectElement>("rate").value),
      adaptResolution: the<HTMLInputElement>("adapt").checked && !place.size,
      exactness: the<HTMLSelectElement>("exactness").value as Exactness,
      correct: the<HTMLInputElement>("correct").checked,
    };
  }

  #onFailure(player: Player, { code, message, fatal }: SourceError): void {
    if (player !== this.player) return;
    const { messages, place } = this.#host;
    if (fatal) this.#over = "ended";
    if (fatal && code !== "token") return this.#host.failed("The play has ended", message);
    embed.tell("error", { message });
    if (fatal) messages.askToken(place.token !== undefined);
    else messages.toast(message);
  }

  #cannot(error: unknown): void {
    this.#over = "nothing to show";
    const message = error instanceof Error ? error.message : String(error);
    if (error instanceof UnsupportedError) this.#host.failed("This browser cannot show the scene", message, "none");
    else if (error instanceof MissingError) this.#host.failed("The scene is not there", message, "scenes");
    else this.#host.failed("The scene cannot be shown", message);
  }

  #lostDevice(reason: string): void {
    this.renderer = null;
    this.#rendering = undefined;
    const lost = `The graphics processor was lost${reason && ` (${reason.split("\n")[0]})`}`;
    if (this.#host.reload(`${lost}; the page has started again`)) return;
    this.#stop("this device: lost");
    this.#host.failed("The play has ended", `${lost} a second time`);
  }

  /** Stop what plays or begins to; `why` stands beside the light. */
  #stop(why: string): void {
    this.#attempts++;
    this.immersive?.leave();
    this.#leave();
    this.#over = why;
  }

  /** The device of `made` did not take what it was given, so nothing that it draws can be believed. Another attempt makes
   * another device. */
  #refusedBy(made: Promise<Renderer>, message: string): void {
    if (this.#rendering !== made) return;
    this.#rendering = undefined;
    this.#stop("this device: cannot draw");
    void made.then((renderer) => {
      renderer.destroy();
      if (this.renderer === renderer) this.renderer = null;
    });
    this.#host.failed("The play has ended", message);
  }

  /** A window of another shape is drawn whole, and the server told. */
  #resized(): void {
    clearTimeout(this.#settled);
    this.#settled = window.setTimeout(() => {
      const wanted = anglesOf(...this.#inner());
      const { angles, place } = this.#host;
      const other = (wanted.tanX * angles.tanY) / (wanted.tanY * angles.tanX);
      if (!this.player || place.size || this.immersed || Math.max(other, 1 / other) < OTHER_SHAPE) return;
      this.#host.angles = wanted;
      this.player.reshape(this.#intrinsics);
    }, SETTLED_MS);
  }
}
