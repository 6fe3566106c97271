/** The gallery: the scenes of a server that has several, and a place to drop another one. */

import "./gallery.css";
import { headingsOf } from "./author.ts";
import { the, word } from "./dom.ts";
import { lasts, size } from "./facts.ts";
import { bearer, placeOf, tokenHash } from "./place.ts";
import { Uploads } from "./uploads.ts";

interface Entry {
  readonly name: string;
  readonly title: string;
  readonly seconds: number;
  readonly frames: number;
  readonly bytes: number;
}

let token = placeOf(location.hash).token;

/** Ask the server for something beside this page. */
export function ask(path: string, options: RequestInit = {}): Promise<Response> {
  return fetch(new URL(path, location.href.replace(/[?#].*/, "")), {
    ...options,
    headers: { ...options.headers, ...(token ? { Authorization: bearer(token) } : {}) },
  });
}

const uploads = new Uploads(ask, say, () => void show());

async function show(): Promise<void> {
  let answer: Response;
  try {
    answer = await ask("scenes");
  } catch {
    return say("The server is not there. Load this page again when it is.");
  }
  if (answer.status === 401) return askToken();
  const asked = !the("token").hidden && the("token").contains(document.activeElement);
  the("token").hidden = true;
  if (!answer.ok) return say(`The server answers ${answer.status} ${answer.statusText}.`);
  say("");
  const { scenes, upload_bytes } = (await answer.json()) as { scenes: Entry[]; upload_bytes: number };
  word(the("count"), scenes.length === 1 ? "1 scene" : `${scenes.length} scenes`);
  const headings = headingsOf(scenes);
  the("scenes").replaceChildren(...(scenes.length ? scenes.map((scene, i) => card(scene, headings[i]!)) : [nothing(upload_bytes > 0)]));
  uploads.offer(upload_bytes);
  if (asked) the("scenes").querySelector("a")?.focus(); // the field that had the focus is gone
}

/** Show the form; what has been tried in it is marked, to be written over. */
function askToken(): void {
  const [form, field] = [the("token"), the<HTMLInputElement>("token-text")];
  const wrong = token !== undefined;
  form.hidden = false;
  field.setAttribute("aria-invalid", String(wrong));
  say(wrong ? "This token does not open the server." : "This server asks for a token. Whoever runs it can give you one.");
  if (!wrong) return;
  field.focus();
  field.select();
}

function card({ name, seconds, frames, bytes }: Entry, title: string): HTMLLIElement {
  const [item, link, picture, heading, facts] = [make("li"), make("a"), make("img"), make("h2"), make("p")];
  const scene = new URLSearchParams({ scene: name });
  link.href = `?${scene}${tokenHash(token)}`;
  picture.alt = "";
  picture.width = 480;
  picture.height = 300;
  void load(picture, `thumbnail?${scene}`);
  heading.textContent = title;
  facts.textContent = `${frames === 1 ? "still" : lasts(seconds)} · ${size(bytes)}`;
  link.append(picture, heading, facts);
  item.append(link);
  return item;
}

/** A thumbnail, which a server with a token gives only to those who show it. */
async function load(picture: HTMLImageElement, path: string): Promise<void> {
  const answer = await ask(path).catch(() => undefined);
  if (answer?.ok) picture.src = URL.createObjectURL(await answer.blob());
}

function nothing(uploadable: boolean): HTMLLIElement {
  const item = make("li");
  item.className = "empty";
  item.textContent = uploadable ? "There is no scene yet. Drop one above." : "There is no scene in the server's folder. cags-encode makes one.";
  return item;
}

function say(text: string): void {
  the("message").textContent = text;
  the("message").hidden = text === "";
}

function make<K extends keyof HTMLElementTagNameMap>(name: K): HTMLElementTagNameMap[K] {
  return document.createElement(name);
}

the<HTMLFormElement>("token").addEventListener("submit", (event) => {
  event.preventDefault();
  say(""); // what is said of this one is heard, even if it is the same as of the last
  token = the<HTMLInputElement>("token-text").value;
  void show();
});
addEventListener("hashchange", () => {
  token = placeOf(location.hash).token ?? token;
  void show();
});
void show();
