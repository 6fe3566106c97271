/** The inspector's part that is of a client: what it says that there is to look at and to choose. */

import { the } from "../page/dom.ts";
import type { Look, SceneText, StateText } from "./messages.ts";
import type { ClientPlayer } from "./player.ts";

const TITLES: Readonly<Record<string, string>> = {
  restored: "restored", distorted: "distorted: splats alone", correction: "what the reference changed", reference: "reference",
  truth: "truth", error: "error × 4", depth: "depth", occlusion: "Hidden from the reference", confidence: "Confidence in the reference",
  detail: "Layers of detail", tiles: "Tiles", score: "PSNR", restorer: "Restoration", exactness: "Drawing", resolution: "Resolution",
};
const OVERLAYS: Readonly<Record<string, string>> = { reference: "Border of the reference" };
const NOTHING = "";
/** The page's own controls of the play, which only the page that steers may use. */
const PLAY = ["play", "time", "loop", "rate"] as const;
const CAP_MBPS = [0.5, 150] as const;
const CAP_STEPS = 100;
const MOST_DELAY_MS = 250;

export interface PanelWishes {
  look(look: Look): void;
  wipe(share: number): void;
}

export class Panel {
  readonly #host = the("client");
  readonly #player: ClientPlayer;
  readonly #wishes: PanelWishes;
  #told = "";
  #picture!: HTMLSelectElement;
  #beside!: HTMLSelectElement;
  #wipe!: HTMLInputElement;
  #overlays: HTMLInputElement[] = [];
  #choices = new Map<string, HTMLSelectElement>();
  #link: { readonly cap: HTMLInputElement; readonly delay: HTMLInputElement; readonly words: HTMLOutputElement[] } | null = null;
  #follow!: HTMLButtonElement;

  constructor(player: ClientPlayer, wishes: PanelWishes) {
    this.#player = player;
    this.#wishes = wishes;
  }

  /** List what a client offers; what was chosen stays chosen where there is still such a thing. */
  meet(scene: SceneText): void {
    const before = this.#picture ? this.look : null;
    this.#told = "";
    this.#host.replaceChildren(heading("Camera"), (this.#follow = this.#button("Follow the recorded walk")), heading("Picture"));
    this.#picture = this.#select("picture-a", "Picture", scene.pictures, before?.pictures[0]);
    this.#beside = this.#select("picture-b", "Beside it", [NOTHING, ...scene.pictures], before?.pictures[1]);
    this.#wipe = slider("wipe", 100, 50);
    this.#host.append(labelled("Share of the left", this.#wipe));
    this.#overlays = scene.overlays.map((name) => this.#checkbox(name, before?.overlays.includes(name) ?? false));
    this.#host.append(heading("Client"));
    this.#choices = new Map(Object.entries(scene.settings).map(([name, choices]) => [name, this.#select(`set-${name}`, titleOf(name), choices)]));
    for (const [name, list] of this.#choices) list.addEventListener("change", () => this.#player.set(name, list.value));
    for (const list of [this.#picture, this.#beside, ...this.#overlays]) list.addEventListener("change", () => this.#looked());
    this.#wipe.addEventListener("input", () => this.#wishes.wipe(Number(this.#wipe.value) / 100));
    this.#link = scene.shaper ? this.#shaper() : null;
    this.#looked();
  }

  /** Show how things stand. A control that has the focus is left alone. */
  state(state: StateText): void {
    const told = JSON.stringify(state);
    if (told === this.#told) return;
    this.#told = told;
    for (const [name, list] of this.#choices) put(list, state.settings[name] ?? "");
    put(the<HTMLSelectElement>("rate"), String(state.rate));
    the<HTMLInputElement>("loop").checked = state.loop;
    this.#follow.disabled = !state.held || !state.steers;
    the("watching").hidden = state.steers;
    const link = this.#link ? [this.#link.cap, this.#link.delay] : [];
    for (const control of [...PLAY.map((id) => the<HTMLInputElement>(id)), ...this.#choices.values(), ...link]) control.disabled = !state.steers;
    if (!this.#link || !state.shaper || state.shaper.error) return;
    put(this.#link.cap, String(stepOf(state.shaper.cap_mbps ?? null)));
    put(this.#link.delay, String(state.shaper.delay_ms ?? 0));
    this.#sayLink();
  }

  get look(): Look {
    const pictures = [...new Set([this.#picture.value, this.#beside.value])].filter((name) => name !== NOTHING);
    return { pictures, overlays: this.#overlays.filter((box) => box.checked).map((box) => box.value) };
  }

  #looked(): void {
    this.#wipe.disabled = this.look.pictures.length < 2;
    this.#wishes.look(this.look);
  }

  #shaper(): { cap: HTMLInputElement; delay: HTMLInputElement; words: HTMLOutputElement[] } {
    const [cap, delay] = [slider("cap", CAP_STEPS, CAP_STEPS), slider("delay", MOST_DELAY_MS, 0)];
    const words = [cap, delay].map(() => document.createElement("output"));
    this.#host.append(heading("Link"), labelled("Bandwidth cap", words[0]!, cap), labelled("Delay one way", words[1]!, delay));
    for (const range of [cap, delay]) range.addEventListener("input", () => this.#sayLink());
    cap.addEventListener("change", () => this.#player.set("cap_mbps", capOf(Number(cap.value))));
    delay.addEventListener("change", () => this.#player.set("delay_ms", Number(delay.value)));
    return { cap, delay, words };
  }

  #sayLink(): void {
    const { cap, delay, words } = this.#link!;
    const mbps = capOf(Number(cap.value));
    words[0]!.textContent = mbps === null ? "none" : `${mbps.toFixed(mbps < 10 ? 1 : 0)} Mbit/s`;
    words[1]!.textContent = `${delay.value} ms`;
  }

  #button(text: string): HTMLButtonElement {
    const button = document.createElement("button");
    button.type = "button";
    button.id = "follow";
    button.textContent = text;
    button.addEventListener("click", () => this.#player.release());
    return button;
  }

  #select(id: string, label: string, names: readonly string[], chosen?: string): HTMLSelectElement {
    const list = document.createElement("select");
    list.id = id;
    list.append(...names.map((name) => new Option(name === NOTHING ? "nothing" : TITLES[name] ?? name, name)));
    if (chosen !== undefined && names.includes(chosen)) list.value = chosen;
    this.#host.append(labelled(label, list));
    return list;
  }

  #checkbox(name: string, checked: boolean): HTMLInputElement {
    const box = document.createElement("input");
    Object.assign(box, { type: "checkbox", value: name, checked, id: `overlay-${name}` });
    const label = document.createElement("label");
    label.append(box, OVERLAYS[name] ?? titleOf(name));
    this.#host.append(label);
    return box;
  }
}

const titleOf = (name: string): string => TITLES[name] ?? name;

/** Logarithmic, because half as much matters alike everywhere; the right end lifts the cap. */
export function capOf(step: number): number | null {
  const [least, most] = CAP_MBPS;
  return step >= CAP_STEPS ? null : least * (most / least) ** (step / (CAP_STEPS - 1));
}

export function stepOf(cap: number | null): number {
  const [least, most] = CAP_MBPS;
  if (cap === null) return CAP_STEPS;
  return Math.max(0, Math.min(CAP_STEPS - 1, Math.round(((CAP_STEPS - 1) * Math.log(cap / least)) / Math.log(most / least))));
}

function put(control: HTMLInputElement | HTMLSelectElement, value: string): void {
  if (document.activeElement !== control && control.value !== value) control.value = value;
}

function slider(id: string, max: number, value: number): HTMLInputElement {
  const range = document.createElement("input");
  Object.assign(range, { type: "range", id, min: "0", max: String(max), step: "1", value: String(value) });
  return range;
}

function heading(text: string): HTMLElement {
  const made = document.createElement("h3");
  made.textContent = text;
  return made;
}

function labelled(text: string, ...controls: HTMLElement[]): HTMLElement {
  const label = document.createElement("label");
  label.className = "wide";
  label.append(text, ...controls);
  return label;
}
