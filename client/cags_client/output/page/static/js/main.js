// Wires the page together: what the server tells goes to the stage, the plots and the panel; wishes go back.

import { Camera, Gestures } from "./camera.js";
import { Connection } from "./connection.js";
import { FrameDecoder, formats } from "./decoder.js";
import { Panel } from "./panel.js";
import { Plots, brief } from "./plots.js";
import { Stage } from "./stage.js";

const $ = (id) => document.getElementById(id);
const FIGURES_MS = 500;

/** What the page measured of itself; for the figures in the head, for tests, and for a look in the console. */
const measured = { frames: 0, fps: 0, photonMs: [], codec: "", frame: -1, pose: null, picture: null, stats: {} };
window.cags = measured;

const shows = await formats().catch(() => ({ h264: false, raw: false }));
const stage = new Stage($("picture"), $("wipe"));
const plots = new Plots($("plots"));
const sent = new Map(); // pose number -> time of the input that made it
let camera = null;
let gestures = null;
let scene = null;
let lastInput = null;
let poseNumber = 0;
let capacity = null;
let photon = null;
let shownTimes = [];

const connection = new Connection(`ws://${location.host}/live`, {
  open() {
    decoder.reset();
    connection.send({ type: "hello", ...shows });
    panel.look();
  },
  text(message) {
    if (message.type === "scene") meet(message);
    else if (message.type === "state") panel.state(message);
    else if (message.type === "shaper") tellShaper(message);
    else if (message.type === "error") panel.trouble(message.text);
  },
  frame(header, payloads) {
    decoder.add(header, payloads);
  },
  closed(reason, retrying) {
    panel.link("gone", retrying ? "reconnecting" : "refused");
    if (reason) panel.trouble(reason);
  },
});

const decoder = new FrameDecoder(show, (number) => connection.send({ type: "shown", number, key: true }));
const panel = new Panel(stage, (message) => connection.send(message), {
  rig: changeRig,
  home() {
    camera?.home();
    take(performance.now());
  },
});

function meet(message) {
  const known = scene?.name === message.name;
  scene = message;
  panel.scene(message);
  if (known) return;
  camera = new Camera(message);
  gestures?.element && (gestures.camera = camera);
  gestures ??= new Gestures($("picture"), camera, take);
}

/** The camera moved by the visitor's hand at `time`: it is theirs from now on. */
function take(time) {
  if (panel.rig === "walk") panel.setRig(gestures.flying ? "fly" : "orbit");
  if (lastInput === null) requestAnimationFrame(sendPose);
  lastInput ??= time;
}

function sendPose() {
  const number = ++poseNumber;
  sent.set(number, lastInput);
  if (sent.size > 256) sent.delete(sent.keys().next().value);
  lastInput = null;
  connection.send({ type: "pose", number, ...camera.pose() });
}

function changeRig(rig) {
  if (rig === "walk") connection.send({ type: "action", action: "release" });
  else if (gestures) {
    gestures.flying = rig === "fly";
    take(performance.now());
  }
}

let waiting = null;

/** Keep the newest decoded frame for the next refresh of the screen. A page that nobody sees says nothing of what it
 *  was sent, so that the server soon stops drawing for it; the first refresh afterwards says it all at once. */
function show(frame) {
  if (!waiting) requestAnimationFrame(refresh);
  else if (!document.hidden) acknowledge(waiting);
  waiting?.images.forEach((image) => image.close());
  waiting = frame;
}

function refresh(now) {
  const frame = waiting;
  waiting = null;
  stage.show(frame);
  acknowledge(frame);
  measure(frame.header, now);
}

function acknowledge(frame) {
  connection.send({ type: "shown", number: frame.header.number, key: false });
}

function measure(header, now) {
  panel.frame(header);
  if (panel.rig === "walk") camera?.follow(header.camera);
  else if (camera) camera.fovY = header.camera.fov_y;
  const input = sent.get(header.pose);
  if (input !== undefined) {
    sent.delete(header.pose);
    photon = performance.now() - input;
    measured.photonMs.push(photon);
    if (measured.photonMs.length > 600) measured.photonMs.shift();
  }
  shownTimes.push(now);
  shownTimes = shownTimes.filter((t) => t > now - 2000);
  measured.frames += 1;
  measured.fps = shownTimes.length > 1 ? ((shownTimes.length - 1) * 1000) / (now - shownTimes[0]) : 0;
  measured.frame = header.frame;
  measured.pose = header.pose;
  measured.codec = header.pictures[0]?.codec ?? "";
  measured.picture = header.pictures[0] ?? null;
  measured.stats = { ...header.stats, capacity_mbps: header.stats.capacity_mbps ?? capacity, photon_ms: photon };
  plots.add(now, measured.stats, header.stages_ms);
  tellFigures(now, header.stats);
}

let told = 0;

function tellFigures(now, stats) {
  if (now - told < FIGURES_MS) return;
  told = now;
  $("figure-fps").textContent = measured.fps.toFixed(0);
  const lately = measured.photonMs.slice(-60).sort((a, b) => a - b);
  $("figure-photon").textContent = lately.length ? lately[lately.length >> 1].toFixed(0) : "–";
  $("figure-rate").textContent = Number.isFinite(stats.goodput_mbps) ? brief(stats.goodput_mbps) : "–";
}

function tellShaper(message) {
  capacity = message.capacity_mbps ?? null;
  panel.shaper(message);
}

/** Arrows and the space bar choose among radio buttons that were come to by keyboard, as everywhere. */
const choosing = (event) => event.target.matches("[type=radio]:focus-visible") && /^(Arrow| $)/.test(event.key);
const typing = (target) => target.closest("input, select, dialog, [role=slider]") !== null;

addEventListener("keydown", (event) => {
  if (choosing(event) || (typing(event.target) && event.target.type !== "radio")) return;
  if (gestures?.key(event, true) || panel.key(event)) event.preventDefault();
});
addEventListener("keyup", (event) => gestures?.key(event, false));
addEventListener("themechange", () => {
  stage.ground = null;
  stage.draw();
  plots.draw();
});

connection.open();
