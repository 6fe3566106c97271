/** A file dropped on the gallery: sent, encoded by the server, and then a scene among the others. */

import { the, word } from "./dom.ts";
import { zipped } from "./zip.ts";

type Ask = (path: string, options?: RequestInit) => Promise<Response>;

/** What the server says of the job under way. */
interface Job {
  readonly state: "idle" | "receiving" | "encoding" | "done" | "failed";
  readonly text: string;
  /** Of the stage, 0..1; null while it is not known. */
  readonly share: number | null;
  readonly scene: string;
}

const LOOK_MS = 700;
const NOTHING: Job = { state: "idle", text: "", share: null, scene: "" };
/** What a clip's frames may be. */
const FRAMES = [".ply", ".spz", ".splat", ".sog"] as const;

const isUnderWay = ({ state }: Job): boolean => state === "receiving" || state === "encoding";

export class Uploads {
  readonly #ask: Ask;
  readonly #say: (text: string) => void;
  readonly #done: () => void;
  #mostBytes = 0;
  #looking = 0;
  #sending: AbortController | null = null;
  #stopping = false;

  /** `done`: there is another scene. */
  constructor(ask: Ask, say: (text: string) => void, done: () => void) {
    this.#ask = ask;
    this.#say = say;
    this.#done = done;
    const [zone, files] = [the("upload"), the<HTMLInputElement>("files")];
    the("choose").addEventListener("click", () => files.click());
    the("cancel").addEventListener("click", () => (this.#sending ? this.#sending.abort() : void this.#stop()));
    files.addEventListener("change", () => {
      void this.#send([...(files.files ?? [])]);
      files.value = ""; // so that the same file can be chosen again
    });
    for (const kind of ["dragover", "dragleave", "drop"] as const) {
      document.addEventListener(kind, (event) => {
        event.preventDefault();
        zone.toggleAttribute("data-over", kind === "dragover" && this.#mostBytes > 0);
        if (kind === "drop") this.#dropped(event.dataTransfer);
      });
    }
  }

  /** Take files of up to so many bytes; 0: the server takes none. */
  offer(mostBytes: number): void {
    this.#mostBytes = mostBytes;
    the("upload").hidden = mostBytes === 0;
    the("takes").textContent = `.ply, .spz, .splat, .sog, .splatv, .npz, the frames of a clip, or a .zip of them; up to ${Math.round(mostBytes / 1e6)} MB`;
    if (mostBytes) void this.#look();
  }

  #dropped(data: DataTransfer | null): void {
    const folder = [...(data?.items ?? [])].map((item) => item.webkitGetAsEntry?.()).find((entry) => entry?.isDirectory);
    if (!folder) void this.#send([...(data?.files ?? [])]);
    else if (this.#mostBytes) this.#say(`${folder.name} is a folder. Drop the files that are in it, or a .zip of them.`);
  }

  async #send(files: readonly File[]): Promise<void> {
    if (!files.length || !this.#mostBytes) return;
    if (this.#sending || !the("job").hidden) return this.#say("One file at a time: the server still has another.");
    this.#say("");
    const bytes = files.reduce((sum, file) => sum + file.size, 0);
    if (bytes > this.#mostBytes) return this.#say(`${files[0].name}: ${(bytes / 1e6).toFixed(0)} MB are more than the ${(this.#mostBytes / 1e6).toFixed(0)} MB that this server takes.`);
    const strange = files.length > 1 && files.find(({ name }) => !FRAMES.some((end) => name.toLowerCase().endsWith(end)));
    if (strange) return this.#say(`${strange.name}: is no frame of a clip (${FRAMES.join(", ")}). Send the frames alone.`);
    this.#show({ state: "receiving", text: "Sending", share: null, scene: "" });
    const sending = (this.#sending = new AbortController());
    let look = 0;
    try {
      const [name, body] = files.length === 1 ? [files[0].name, files[0]] : ["frames.zip", await zipped(files)];
      sending.signal.throwIfAborted();
      look = window.setTimeout(() => void this.#look(), LOOK_MS);
      const answer = await this.#ask(`upload?${new URLSearchParams({ name })}`, { method: "POST", body, signal: sending.signal });
      if (!answer.ok) throw new Error(await reasonOf(answer));
      void this.#look();
    } catch (error) {
      clearTimeout(look);
      clearTimeout(this.#looking);
      the("job").hidden = true;
      the("invite").hidden = false;
      if (!sending.signal.aborted) this.#say(error instanceof TypeError ? "The server ended the upload." : (error as Error).message);
    } finally {
      this.#sending = null;
    }
  }

  /** Have the server give the job up. */
  async #stop(): Promise<void> {
    this.#stopping = true;
    try {
      const answer = await this.#ask("upload", { method: "DELETE" });
      if (answer.ok) await this.#look();
      else this.#say(await reasonOf(answer));
    } catch {
      this.#say("The server is not there; it may go on encoding.");
    } finally {
      this.#stopping = false;
    }
  }

  /** Follow the job under way, whoever began it. */
  async #look(): Promise<void> {
    clearTimeout(this.#looking);
    const again = (): void => void (this.#looking = window.setTimeout(() => void this.#look(), LOOK_MS));
    const answer = await this.#ask("upload").catch(() => undefined);
    const job = answer?.ok ? await (answer.json() as Promise<Job>).catch(() => undefined) : undefined;
    const following = !the("job").hidden;
    if (!job) {
      if (!following) return;
      if (answer && answer.status >= 400 && answer.status < 500) return this.#over(await reasonOf(answer));
      if (!answer?.ok) word(the("job-text"), "The server is not there; this page looks for it");
      return again(); // the server may be back, and still at it
    }
    if (isUnderWay(job)) again();
    else if (this.#sending) return again(); // that was the job before
    this.#show(job);
    if (!following || isUnderWay(job)) return;
    if (job.state === "done") this.#done();
    else if (job.state === "idle") this.#say("The upload was lost: the server has started anew. Send the file again.");
    else if (!this.#stopping) this.#say(job.text);
  }

  /** There is no job to follow any more. */
  #over(why: string): void {
    this.#show(NOTHING);
    this.#say(why);
  }

  #show(job: Job): void {
    const { text, share } = job;
    const busy = isUnderWay(job);
    the("job").hidden = !busy;
    the("invite").hidden = busy;
    word(the("job-text"), text);
    const bar = the<HTMLProgressElement>("job-share");
    if (share === null) bar.removeAttribute("value");
    else bar.value = share;
  }
}

/** Why a server, or a proxy in front of it, takes no file. */
async function reasonOf(answer: Response): Promise<string> {
  const said = (await answer.json().catch(() => undefined)) as { error?: string } | undefined;
  return said?.error ?? `The server answers ${answer.status} ${answer.statusText}.`;
}
