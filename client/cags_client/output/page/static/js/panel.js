// Everything beside the picture: menus, sliders, the transport bar, theme, help and messages.

const $ = (id) => document.getElementById(id);
const TITLES = {
  restored: "Restored", distorted: "Distorted", aligned: "Aligned reference", reference: "Reference",
  truth: "Truth", error: "Error × 4", depth: "Depth",
};
const NAMED = ["restorer", "exactness", "resolution"]; // settings that are chosen from a menu
const MODES = ["single", "wipe", "side"];
const CAP_LEAST_MBPS = 0.5;
const CAP_MOST_MBPS = 150;
const TROUBLE_MS = 6000;
const CLOCK_MS = 150; // a layout of the page costs as much as decoding a picture

export class Panel {
  #send;
  #on;
  #scene = null;
  #state = { playing: true, loop: true };
  #seeking = false;
  #troubleTimer = 0;
  #frame = 0;
  #clocked = 0;
  #idle = false;

  /** `send(message)` goes to the server; `on` holds rig(name) and home(). */
  constructor(stage, send, on) {
    this.stage = stage;
    this.#send = send;
    this.#on = on;
    this.#theme();
    this.#help();
    this.#transport();
    this.#picture();
    this.#stream();
  }

  // ------------------------------------------------------------------------------------------- told by the server

  scene(scene) {
    this.#scene = scene;
    $("scene-name").textContent = scene.name;
    document.title = `${scene.name} – cags-stream`;
    $("seek").max = scene.frames - 1;
    const [a, b] = [$("picture-a"), $("picture-b")];
    for (const menu of [a, b]) fill(menu, scene.pictures, TITLES, menu.value);
    if (!b.dataset.chosen) b.value = "distorted";
    fill($("restorer"), scene.restorers);
    const score = $("score-label");
    score.hidden = !scene.pictures.includes("truth");
    for (const id of ["cap", "delay"]) $(id).disabled = !scene.shaper;
    $("shaper-note").hidden = scene.shaper;
    this.look();
  }

  state(state) {
    if (JSON.stringify(state) === JSON.stringify(this.#state)) return;
    this.#state = state;
    $("play").dataset.playing = state.playing;
    $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
    $("loop").setAttribute("aria-pressed", state.loop);
    for (const name of NAMED) if (document.activeElement !== $(name)) $(name).value = state[name];
    if (document.activeElement !== $("rate")) $("rate").value = String(state.rate);
    if (!state.held && this.rig !== "walk") this.setRig("walk");
    if (state.held && this.rig === "walk") this.setRig("orbit");
    if (state.away) this.link("gone", "server lost");
  }

  shaper(message) {
    if (message.error) return this.trouble(message.error);
    if (document.activeElement !== $("delay") && Number.isFinite(message.delay_ms)) {
      $("delay").value = message.delay_ms;
      this.#tellDelay();
    }
    if (document.activeElement !== $("cap")) {
      $("cap").value = message.cap_mbps ? sliderOfCap(message.cap_mbps) : 100;
      this.#tellCap();
    }
  }

  frame(header) {
    this.#frame = header.frame;
    if (!this.#state.away) this.link("live", "live");
    const now = performance.now();
    if (now - this.#clocked < CLOCK_MS && this.#state.playing) return;
    this.#clocked = now;
    $("waiting").hidden = true;
    if (!this.#seeking) $("seek").value = header.frame;
    say("pixels", this.#state.resolution === "auto" ? `chose ${header.resolution}` : "");
    this.#tags(header);
    say("clock", `${header.frame + 1} / ${this.#scene?.frames ?? "?"}`);
  }

  /** Names of the pictures; one that cannot differ from what was received, for nothing is left to restore, says so. */
  #tags(header) {
    if (header) {
      const whole = header.stats.lod_mean >= this.#scene?.lods - 1 - 1e-3;
      this.#idle = whole && this.#state.restorer !== "none" && !("restore" in header.stages_ms);
    }
    for (const [i, id] of ["tag-a", "tag-b"].entries()) {
      const name = this.stage.names[i];
      say(id, this.#idle && name === "restored" ? `${TITLES[name]} · all detail is here` : TITLES[name]);
    }
  }

  link(state, text) {
    const chip = $("link-state");
    if (chip.dataset.state === state && chip.textContent === text) return;
    chip.dataset.state = state;
    chip.textContent = text;
  }

  trouble(text) {
    const box = $("trouble");
    box.textContent = text;
    box.hidden = false;
    clearTimeout(this.#troubleTimer);
    this.#troubleTimer = setTimeout(() => (box.hidden = true), TROUBLE_MS);
  }

  // ------------------------------------------------------------------------------------------------- the visitor's

  get rig() {
    return document.querySelector("[name=rig]:checked").value;
  }

  setRig(name) {
    document.querySelector(`[name=rig][value=${name}]`).checked = true;
  }

  /** Tell the server which pictures and overlays are wanted now. */
  look() {
    const mode = this.stage.mode;
    const names = [$("picture-a").value || "restored", $("picture-b").value || "distorted"];
    const wanted = mode === "single" ? [names[0]] : [...new Set(names)];
    const overlays = [...$("overlays").querySelectorAll("input:checked")].map((box) => box.value);
    this.stage.names = names;
    this.#tags();
    $("tag-b").hidden = mode === "single";
    $("picture-b").disabled = mode === "single";
    this.#send({ type: "look", pictures: wanted, overlays });
    this.stage.draw();
  }

  /** A key that is not the camera's; returns whether it was one of ours. */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    const digit = Number(event.key);
    if (digit >= 1 && digit <= (this.#scene?.pictures.length ?? 0)) {
      $("picture-a").value = this.#scene.pictures[digit - 1];
      this.look();
      return true;
    }
    if (event.key === " " && event.target.closest("button, a")) return false;
    const act = this.#keys[event.key.toLowerCase()];
    act?.();
    return Boolean(act);
  }

  #keys = {
    " ": () => this.#playOrPause(),
    l: () => this.#act("loop", this.#state.loop ? 0 : 1),
    ",": () => this.#step(-1),
    ".": () => this.#step(1),
    c: () => this.#mode(MODES[(MODES.indexOf(this.stage.mode) + 1) % MODES.length]),
    r: () => this.#on.home(),
    t: () => this.#chooseRig("walk"),
    f: () => this.#fullScreen(),
    "?": () => $("help").showModal(),
  };

  #act(action, value) {
    this.#send(value === undefined ? { type: "action", action } : { type: "action", action, value });
  }

  #playOrPause() {
    this.#act(this.#state.playing ? "pause" : "play");
    $("announce").textContent = this.#state.playing ? "Paused" : "Playing";
  }

  #step(by) {
    this.#act("pause");
    this.#act("seek", Math.min(Math.max(this.#frame + by, 0), this.#scene.frames - 1));
  }

  #chooseRig(name) {
    this.setRig(name);
    this.#on.rig(name);
  }

  #mode(mode) {
    this.stage.mode = mode;
    document.querySelector(`[name=mode][value=${mode}]`).checked = true;
    $("wipe").hidden = mode !== "wipe";
    this.look();
  }

  #fullScreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else $("frame").requestFullscreen?.().catch(() => this.trouble("This browser does not allow full screen here."));
  }

  #transport() {
    $("play").onclick = () => this.#playOrPause();
    $("loop").onclick = () => this.#keys.l();
    $("full").onclick = () => this.#fullScreen();
    $("rate").onchange = (event) => this.#act("rate", Number(event.target.value));
    const seek = $("seek");
    seek.addEventListener("pointerdown", () => (this.#seeking = true));
    seek.addEventListener("input", () => {
      $("clock").textContent = `${Number(seek.value) + 1} / ${this.#scene?.frames ?? "?"}`;
    });
    seek.addEventListener("change", () => {
      this.#seeking = false;
      this.#act("seek", Number(seek.value));
    });
  }

  #picture() {
    for (const box of document.querySelectorAll("[name=mode]")) box.onchange = () => this.#mode(box.value);
    for (const box of document.querySelectorAll("[name=rig]")) box.onchange = () => this.#on.rig(box.value);
    $("picture-a").onchange = () => this.look();
    $("picture-b").onchange = (event) => {
      event.target.dataset.chosen = "yes";
      this.look();
    };
    $("overlays").onchange = () => this.look();
  }

  #stream() {
    for (const name of NAMED)
      $(name).onchange = (event) => this.#send({ type: "setting", name, value: event.target.value });
    $("cap").oninput = () => this.#tellCap();
    $("cap").onchange = () => this.#send({ type: "setting", name: "cap_mbps", value: capOfSlider() });
    $("delay").oninput = () => this.#tellDelay();
    $("delay").onchange = () => this.#send({ type: "setting", name: "delay_ms", value: Number($("delay").value) });
  }

  #tellCap() {
    const cap = capOfSlider();
    say("cap-value", cap === null ? "none" : `${cap.toFixed(cap < 10 ? 1 : 0)} Mbps`);
  }

  #tellDelay() {
    say("delay-value", `${$("delay").value} ms`);
  }

  #theme() {
    const root = document.documentElement;
    const system = matchMedia("(prefers-color-scheme: light)");
    const set = (theme) => {
      root.dataset.theme = theme;
      dispatchEvent(new Event("themechange"));
    };
    const chosen = localStorage.getItem("theme");
    set(chosen ?? (system.matches ? "light" : "dark"));
    system.onchange = () => localStorage.getItem("theme") ?? set(system.matches ? "light" : "dark");
    $("theme").onclick = () => {
      const next = root.dataset.theme === "light" ? "dark" : "light";
      localStorage.setItem("theme", next);
      set(next);
    };
  }

  #help() {
    $("help-open").onclick = () => $("help").showModal();
  }
}

/** Writing a text lays the page out anew, even where it is the same: several times a second, as costly as a picture. */
function say(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

/** Logarithmic, because half as much matters alike everywhere; the right end lifts the cap. */
function capOfSlider() {
  const at = Number($("cap").value);
  return at >= 100 ? null : CAP_LEAST_MBPS * (CAP_MOST_MBPS / CAP_LEAST_MBPS) ** (at / 99);
}

function sliderOfCap(cap) {
  return Math.min(99, Math.round((99 * Math.log(cap / CAP_LEAST_MBPS)) / Math.log(CAP_MOST_MBPS / CAP_LEAST_MBPS)));
}

function fill(menu, names, titles = {}, keep = menu.value) {
  const options = names.map((name) => new Option(titles[name] ?? name, name));
  menu.replaceChildren(...options);
  if (names.includes(keep)) menu.value = keep;
}
