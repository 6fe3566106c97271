/** A scene that a Python client draws for this page (`cags-client --view`); no graphics processor is needed here. */

import { beside, poseOf } from "../page/place.ts";
import { type Host, NOWHERE, SERVER_AWAY, type Show } from "../page/show.ts";
import { the } from "../page/dom.ts";
import type { Figure } from "../page/inspector.ts";
import { milliseconds } from "../page/inspector.ts";
import { SHORT_OF_DETAIL, STALE_US, type Verdict } from "../page/light.ts";
import { nowUs } from "../seam.ts";
import { Line } from "./line.ts";
import * as to from "./messages.ts";
import type { ClientText, FrameHead, SceneText } from "./messages.ts";
import { Panel } from "./panel.ts";
import { type DecodedFrame, formats, Pictures } from "./pictures.ts";
import { ClientPlayer } from "./player.ts";
import { brief, Plots } from "./plots.ts";
import { Stage } from "./stage.ts";

const HALF = "half";
/** The client learns a window's new size when it has settled. */
const SETTLED_MS = 300;
/** Poses of which the middle one is told. */
const LATELY = 60;

export class ClientShow implements Show {
  readonly player: ClientPlayer;
  readonly #host: Host;
  readonly #url: string;
  readonly #stage: Stage;
  readonly #panel: Panel;
  readonly #plots = new Plots(the("plots"));
  readonly #pictures: Pictures;
  #line: Line | null = null;
  #open = false;
  #closed = false; // since it was open, or tried to be
  #full = false; // the newest attempt was one page too many
  #attempts = 0;
  #settled = 0;

  constructor(host: Host, path: string) {
    this.#host = host;
    this.#url = beside(path).href.replace(/^http/, "ws");
    this.#stage = new Stage(host.canvas);
    this.player = new ClientPlayer({
      send: (text) => this.#line?.send(text),
      show: (frame) => this.#show(frame),
      pose: () => host.camera?.pose ?? NOWHERE,
      follow: (camera) => this.#follow(camera),
      leave: () => this.#line?.close(),
    });
    this.#pictures = new Pictures((frame) => this.player.came(frame), (number) => this.player.lost(number));
    this.#panel = new Panel(this.player, {
      look: (look) => {
        this.#stage.names = look.pictures;
        this.#line?.send(to.look(look));
      },
      wipe: (share) => {
        this.#stage.wipe = share;
        this.#stage.draw();
      },
    });
    addEventListener("resize", () => {
      clearTimeout(this.#settled);
      this.#settled = window.setTimeout(() => this.#tellWindow(), SETTLED_MS);
    });
    the("drawing").hidden = true;
    for (const id of ["client", "live"]) the(id).hidden = false;
  }

  async begin(): Promise<void> {
    const attempt = ++this.#attempts;
    this.player.forget();
    this.#full = false;
    this.#host.messages.say("Connecting");
    const shows = await formats(location.search);
    if (attempt !== this.#attempts) return;
    this.#line = new Line(this.#url, {
      opened: () => {
        this.#open = true;
        this.#pictures.reset();
        this.#line!.send(to.hello(shows, this.#host.place.token));
        this.#tellWindow();
      },
      text: (message) => this.#told(message),
      frame: (message) => this.#pictures.add(message),
      closed: () => {
        this.#open = false;
        this.#closed = true;
      },
      refused: (why, reason) => {
        this.#open = false;
        this.#full = why === "room";
        if (why === "token") this.#host.messages.askToken(this.#host.place.token !== undefined);
        else if (this.#full) this.#host.failed("The client takes no more pages", reason || "Try again later");
        else this.#host.failed("The client does not understand this page", reason);
      },
    });
  }

  present(): void {
    this.#stage.draw();
  }

  /** Pictures come ready made, of one view: a headset has nothing from them. */
  immerse(): void {}
  readonly immersed = false;

  get trouble(): Show["trouble"] {
    if (this.#closed && !this.#open) return ["The client is not there", "The picture stands; it goes on by itself when the client is back."];
    if (this.player.state?.away) return SERVER_AWAY;
    return null;
  }

  get verdict(): Verdict {
    const { info, state, shown, shownMs, waiting } = this.player;
    if (this.#full) return { state: "bad", text: "client: no room" };
    if (this.#closed && !this.#open) return { state: "bad", text: "client: not reached" };
    if (!info || !state) return { state: "wait", text: "connecting" };
    if (state.away) return { state: "bad", text: "server: not reached" };
    if (!shown || waiting) return { state: "wait", text: "loading" };
    if (shown.missed && state.playing) return { state: "bad", text: "your link: too slow" };
    if (shown.resolution === HALF) return { state: "fair", text: "the client: fewer pixels" };
    const share = performance.now() - shownMs < STALE_US / 1000 ? detailOf(shown, info) : undefined;
    if (share !== undefined && share < SHORT_OF_DETAIL) return { state: "fair", text: "your link: less detail" };
    return { state: "good", text: "good" };
  }

  figures(rate: number): readonly Figure[] {
    const { shown, shownMs, info, state, photonMs } = this.player;
    const fresh = (text: string | undefined): string | undefined => (performance.now() - shownMs < STALE_US / 1000 ? text : undefined);
    const number = (name: string, unit: string): string | undefined => (typeof shown?.stats[name] === "number" ? fresh(`${brief(shown.stats[name])} ${unit}`) : undefined);
    const lately = this.#photonMs === undefined ? [] : photonMs.slice(-LATELY).sort((a, b) => a - b);
    const detail = shown && info ? detailOf(shown, info) : undefined;
    const picture = shown?.pictures[0];
    return [
      ["Link", number("goodput_mbps", "Mbit/s")],
      ["Hand to picture", lately.length ? milliseconds(lately[lately.length >> 1]!) : undefined],
      ["Ahead", number("buffer_ms", "ms")],
      ["Detail in view", detail === undefined ? undefined : fresh(`${Math.round(100 * detail)} %`)],
      ["Picture", picture && `${picture.width} × ${picture.height}`],
      ["Worked out at", shown ? fresh(`${shown.resolution}${state?.settings["resolution"] === "auto" ? ", chosen" : ""}`) : undefined],
      ["Pictures a second", `${rate.toFixed(0)}${info ? ` (scene: ${info.fps})` : ""}`],
      ["Time a picture", shown ? fresh(milliseconds(Object.values(shown.stages_ms).reduce((sum, ms) => sum + ms, 0))) : undefined],
      ["Comes as", picture?.codec],
      ["Link's capacity", state?.shaper?.capacity_mbps === undefined ? undefined : `${brief(state.shaper.capacity_mbps)} Mbit/s`],
      ["PSNR", number("psnr_restored_db", "dB")],
    ];
  }

  #tellWindow(): void {
    const [width, height] = this.#host.place.size ?? [innerWidth, innerHeight].map((side) => Math.max(1, Math.round(side * devicePixelRatio)));
    this.#line?.send(to.windowed(width!, height!));
  }

  /** From the last movement of a hand to its picture; undefined where that is a while ago. */
  get #photonMs(): number | undefined {
    return nowUs() - this.player.movedUs < STALE_US ? this.player.photonMs.at(-1) : undefined;
  }

  #told(message: ClientText): void {
    const { messages } = this.#host;
    if (message.type === "scene") this.#meet(message);
    else if (message.type === "error") messages.toast(message.text);
    else {
      const first = this.player.state === null;
      if (message.shaper?.error && message.shaper.error !== this.player.state?.shaper?.error) messages.toast(message.shaper.error);
      this.player.told(message);
      this.#panel.state(message);
      if (first && message.steers) this.#goThere();
    }
  }

  #meet(scene: SceneText): void {
    const known = this.player.info?.name === scene.name;
    if (!known) {
      this.#host.stand(openedBy(scene));
      this.#host.messages.say("Loading", scene.view.title ?? scene.name);
    }
    this.#closed = false;
    this.player.meet(scene);
    this.#panel.meet(scene);
    if (!known) this.#host.ready();
  }

  /** What the address says of the play and the camera; another page's are left as they are. */
  #goThere(): void {
    const { seconds, playing, loop, pose } = this.#host.place;
    const { player } = this;
    if (seconds !== undefined && player.info) player.seek(seconds * player.info.fps);
    if (playing === false) player.pause();
    if (loop === false) player.setLoop(false);
    if (!pose || !this.#host.camera) return;
    this.#host.camera.place(pose);
    player.hold();
  }

  #show(frame: DecodedFrame): void {
    const { head } = frame;
    const { clientWidth } = the("plots");
    const { state } = this.player;
    this.#stage.show(frame);
    this.#host.angles = anglesOf(head);
    const stats = { ...head.stats, capacity_mbps: head.stats["capacity_mbps"] ?? state?.shaper?.capacity_mbps ?? null, photon_ms: this.#photonMs ?? null };
    this.#plots.add(stats, head.stages_ms, clientWidth > 0);
  }

  #follow({ position, rotation }: FrameHead["camera"]): void {
    this.#host.camera?.place({ position, rotation });
  }
}

/** Share of the levels of detail of what is in view; undefined where nothing is known. */
function detailOf({ stats }: FrameHead, { lods }: SceneText): number | undefined {
  const mean = stats["lod_mean"];
  return typeof mean !== "number" ? undefined : lods > 1 ? mean / (lods - 1) : 1;
}

function anglesOf({ camera, pictures: [first] }: FrameHead): Host["angles"] {
  const tanY = Math.tan(camera.fov_y / 2);
  return { tanX: first ? (tanY * first.width) / first.height : tanY, tanY };
}

function openedBy({ name, up, focus_centre, focus_radius, bounds, view: { pose, ...view } }: SceneText): Parameters<Host["stand"]>[0] {
  return { name, up, focusCentre: focus_centre, focusRadius: focus_radius, bounds, view: { ...view, ...(pose ? { pose: poseOf(pose) } : {}) } };
}
