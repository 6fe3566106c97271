import assert from "node:assert/strict";
import { after, test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { zipped } from "../../src/page/zip.ts";

/** As much of an element as the gallery asks of one. */
class Element extends EventTarget {
  hidden = false;
  /** As often as a screen reader would say a status. */
  told = 0;
  #words = "";
  get textContent(): string {
    return this.#words;
  }
  set textContent(text: string) {
    this.#words = text;
    this.told++;
  }
  files: readonly File[] = [];
  value: string | number = "";
  toggleAttribute(): void {}
  removeAttribute(): void {}
  click(): void {
    this.dispatchEvent(new Event("click"));
  }
}

const elements = new Map<string, Element>();
const page = Object.assign(new EventTarget(), {
  getElementById: (id: string) => {
    if (!elements.has(id)) elements.set(id, new Element());
    return elements.get(id);
  },
});
Object.assign(globalThis, { document: page, window: globalThis });
const { Uploads } = await import("../../src/page/uploads.ts");

interface Asked {
  readonly path: string;
  readonly options: RequestInit;
}

/** The gallery of a server that answers as `answers` does. */
function gallery(answers: (asked: Asked) => Promise<Response>): { asked: Asked[]; said: string[]; drop: (...files: File[]) => void; at: (id: string) => Element } {
  elements.clear();
  const mine = ++galleries;
  const [asked, said]: [Asked[], string[]] = [[], []];
  const ask = (path: string, options: RequestInit = {}): Promise<Response> => {
    asked.push({ path, options });
    return mine === galleries ? answers({ path, options }) : new Promise(() => undefined);
  };
  const at = (id: string): Element => page.getElementById(id)!;
  at("job").hidden = true;
  new Uploads(ask, (text) => said.push(text), () => undefined).offer(1_000);
  const drop = (...files: File[]): void => {
    at("files").files = files;
    at("files").dispatchEvent(new Event("change"));
  };
  return { asked, said, drop, at };
}

let galleries = 0; // an earlier one may still follow a job, and would go on following it
after(() => galleries++);

const IDLE = { state: "idle", text: "", share: null, scene: "" };
const json = (value: unknown, status = 200): Promise<Response> => Promise.resolve(Response.json(value, { status }));
const file = (name: string, bytes = 10): File => new File([new Uint8Array(bytes)], name);
/** A server that has not answered yet, until it is let. */
function held(): { answer: Promise<Response>; let: () => void } {
  let go = (): void => undefined;
  const answer = new Promise<Response>((resolve) => (go = () => resolve(Response.json(IDLE, { status: 202 }))));
  return { answer, let: go };
}
const posts = (asked: readonly Asked[]): Asked[] => asked.filter(({ options }) => options.method === "POST");

test("a file that cannot be read is said, and the page can take another", async () => {
  const { asked, said, drop, at } = gallery(() => json(IDLE));
  const gone = Object.assign(file("b.ply"), { arrayBuffer: () => Promise.reject(new Error("b.ply cannot be read")) });
  drop(file("a.ply"), gone);
  await sleep(10);
  assert.equal(said.at(-1), "b.ply cannot be read");
  assert.deepEqual([at("job").hidden, at("invite").hidden], [true, false]);
  assert.equal(posts(asked).length, 0);
});

test("what is cancelled while its archive is made is not sent, and nothing is said", async () => {
  const { asked, said, drop, at } = gallery(() => json(IDLE));
  drop(file("a.ply"), file("b.ply"));
  at("cancel").click();
  await sleep(10);
  assert.equal(posts(asked).length, 0);
  assert.deepEqual(said.filter(Boolean), []);
  assert.equal(at("job").hidden, true);
});

test("a second file waits for the first one to be done", async () => {
  const post = held();
  const { asked, said, drop } = gallery(({ options }) => (options.method === "POST" ? post.answer : json(IDLE)));
  drop(file("a.ply"));
  await sleep(5);
  drop(file("b.ply"));
  await sleep(5);
  assert.match(said.at(-1)!, /One file at a time/);
  assert.equal(posts(asked).length, 1);
  post.let();
});

test("what a server or a proxy in front of it answers is said", async () => {
  for (const [answer, words] of [
    [() => json({ error: "a.ply: is no PLY" }, 400), "a.ply: is no PLY"],
    [() => Promise.resolve(new Response("<html>", { status: 413, statusText: "Too Large" })), "The server answers 413 Too Large."],
    [() => Promise.reject(new TypeError("network")), "The server ended the upload."],
  ] as const) {
    const { said, drop } = gallery(({ options }) => (options.method === "POST" ? answer() : json(IDLE)));
    drop(file("a.ply"));
    await sleep(10);
    assert.equal(said.at(-1), words);
  }
});

test("a file beyond the server's bound is not sent", async () => {
  const { asked, said, drop } = gallery(() => json(IDLE));
  drop(file("large.ply", 2_000));
  await sleep(5);
  assert.match(said.at(-1)!, /large\.ply/);
  assert.equal(posts(asked).length, 0);
});

test("a job that cannot be given up is said", async () => {
  const busy = { state: "encoding", text: "frame 3", share: 0.5, scene: "" };
  for (const [answer, words] of [
    [() => Promise.reject(new TypeError("network")), /not there/],
    [() => json({ error: "it is another's" }, 403), /another's/],
  ] as const) {
    const { said, at } = gallery(({ options }) => (options.method === "DELETE" ? answer() : json(busy)));
    await sleep(5);
    assert.equal(at("job").hidden, false);
    at("cancel").click();
    await sleep(5);
    assert.match(said.at(-1)!, words);
    at("job").hidden = true;
  }
});

test("an answer that is no job does not end the following of one", async () => {
  let asks = 0;
  const answers = (): Promise<Response> => (++asks === 2 ? Promise.resolve(new Response("<html>")) : json(asks === 1 ? { ...IDLE, state: "encoding" } : IDLE));
  const { at } = gallery(answers);
  await sleep(1_600);
  assert.ok(asks >= 3);
  assert.equal(at("job").hidden, true);
});

test("an upload that its server loses is said to be lost, and where the server is meanwhile", async () => {
  let asks = 0;
  const busy = { ...IDLE, state: "encoding", text: "Frames" };
  const { at, said } = gallery(() => (++asks === 1 ? json(busy) : asks === 2 ? Promise.reject(new TypeError("network")) : json(IDLE)));
  await sleep(1_000);
  assert.match(at("job-text").textContent, /not there/);
  assert.equal(at("job").hidden, false);
  await sleep(800);
  assert.match(said.at(-1)!, /lost/);
  assert.deepEqual([at("job").hidden, at("invite").hidden], [true, false]);
});

test("a server that has a job no longer to be asked for is not asked on", async () => {
  let asks = 0;
  const { at, said } = gallery(() => (++asks === 1 ? json({ ...IDLE, state: "encoding" }) : json({ error: "no uploads here" }, 404)));
  await sleep(1_600);
  assert.deepEqual([said.at(-1), at("job").hidden, asks], ["no uploads here", true, 2]);
});

test("what the server says again of a job is not told again", async () => {
  let share = 0;
  const { at } = gallery(() => json({ ...IDLE, state: "encoding", text: "Frames", share: (share += 0.1) }));
  await sleep(1_600);
  assert.ok(Number(at("job-share").value) > 0.25);
  assert.deepEqual([at("job-text").textContent, at("job-text").told], ["Frames", 1]);
});

test("a job that is given up here goes without a word, and one that is given up elsewhere with one", async () => {
  for (const here of [true, false]) {
    let job = { ...IDLE, state: "encoding" };
    const end = (): void => void (job = { ...IDLE, state: "failed", text: "the upload was ended" });
    const { at, said } = gallery(({ options }) => (options.method === "DELETE" && end(), json(job)));
    await sleep(5);
    if (here) at("cancel").click();
    else end();
    await sleep(1_000);
    assert.deepEqual(said.filter(Boolean), here ? [] : ["the upload was ended"]);
    assert.deepEqual([at("job").hidden, at("invite").hidden], [true, false]);
  }
});

test("what the server says of the job before does not end a file that is being sent", async () => {
  const before = { ...IDLE, state: "failed", text: "old.ply: is no PLY" };
  const post = held();
  const { at, said, drop } = gallery(({ options }) => (options.method === "POST" ? post.answer : json(before)));
  drop(file("a.ply"));
  await sleep(1_000);
  assert.deepEqual(said.filter(Boolean), []);
  assert.equal(at("job").hidden, false);
  post.let();
});

test("folders, and files among frames that are none, are named and not sent", async () => {
  const { asked, said, drop } = gallery(() => json(IDLE));
  drop(file("a.ply"), file("readme.txt"));
  assert.match(said.at(-1)!, /^readme\.txt: is no frame/);
  const items = [{ webkitGetAsEntry: () => ({ isDirectory: true, name: "clip" }) }];
  page.dispatchEvent(Object.assign(new Event("drop"), { dataTransfer: { items, files: [file("clip")] } }));
  assert.match(said.at(-1)!, /^clip is a folder/);
  await sleep(5);
  assert.equal(posts(asked).length, 0);
});

test("more files than an archive can say are refused", async () => {
  const many = Array.from({ length: 65_536 }, () => file("a.ply", 0));
  await assert.rejects(zipped(many), /too many files/);
});
