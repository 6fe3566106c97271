/** The WebSocket to the client that serves this page; it comes back by itself. */

import { type ClientText, type FrameMessage, unpack } from "./messages.ts";

const RETRY_MS = [300, 1000, 2000, 4000];
/** Close codes after which nothing is to be had by asking again at once: the client's own for a wrong token and for a page
 * too many; a message that it does not take; "try again later", of whatever lies between. */
const REFUSALS: Readonly<Record<number, Refusal>> = { 4401: "token", 4429: "room", 1008: "message", 1013: "room" };

export type Refusal = "token" | "room" | "message";

export interface LineEvents {
  opened(): void;
  text(message: ClientText): void;
  frame(message: FrameMessage): void;
  closed(): void;
  /** It will not come back by itself. */
  refused(why: Refusal, reason: string): void;
}

export class Line {
  readonly #url: string;
  readonly #events: LineEvents;
  #socket: WebSocket | null = null;
  #tries = 0;
  #timer = 0;
  #ended = false;

  constructor(url: string, events: LineEvents) {
    this.#url = url;
    this.#events = events;
    this.#open();
  }

  send(text: string): void {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(text);
  }

  close(): void {
    this.#ended = true;
    clearTimeout(this.#timer);
    this.#socket?.close();
  }

  #open(): void {
    const socket = (this.#socket = new WebSocket(this.#url));
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      this.#events.opened();
    });
    socket.addEventListener("message", ({ data }: MessageEvent<string | ArrayBuffer>) => {
      if (this.#ended) return;
      this.#tries = 0; // opening alone says nothing: what closes at once would be asked again in no time
      if (typeof data === "string") this.#events.text(JSON.parse(data) as ClientText);
      else this.#events.frame(unpack(data));
    });
    socket.addEventListener("close", ({ code, reason }) => {
      if (this.#ended) return;
      const refusal = REFUSALS[code];
      if (refusal) return this.#events.refused(refusal, reason);
      this.#events.closed();
      this.#timer = window.setTimeout(() => this.#open(), RETRY_MS[Math.min(this.#tries++, RETRY_MS.length - 1)]);
    });
  }
}
