/** The WebSocket to the client that serves this page; it comes back by itself. */

import { type ClientText, type FrameMessage, unpack } from "./messages.ts";

const RETRY_MS = [300, 1000, 2000, 4000];
/** The client's close codes: the token is not right; a message was not. */
const WRONG_TOKEN = 4401;
const REFUSED = 1008;

export interface LineEvents {
  opened(): void;
  text(message: ClientText): void;
  frame(message: FrameMessage): void;
  closed(): void;
  /** It will not come back by itself. */
  refused(why: "token" | "message", reason: string): void;
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
      this.#tries = 0;
      this.#events.opened();
    });
    socket.addEventListener("message", ({ data }: MessageEvent<string | ArrayBuffer>) => {
      if (this.#ended) return;
      if (typeof data === "string") this.#events.text(JSON.parse(data) as ClientText);
      else this.#events.frame(unpack(data));
    });
    socket.addEventListener("close", ({ code, reason }) => {
      if (this.#ended) return;
      if (code === WRONG_TOKEN || code === REFUSED) return this.#events.refused(code === REFUSED ? "message" : "token", reason);
      this.#events.closed();
      this.#timer = window.setTimeout(() => this.#open(), RETRY_MS[Math.min(this.#tries++, RETRY_MS.length - 1)]);
    });
  }
}
