/** What the page says in words: instead of a picture, or over it. */

import { the } from "./dom.ts";

const TOAST_MS = 2500;

export class Messages {
  readonly #stage = the("stage");
  readonly #headline = the("headline");
  readonly #hint = the("hint");
  readonly #again = the<HTMLButtonElement>("again");
  readonly #all = the("all");
  readonly #token = the<HTMLFormElement>("token");
  readonly #toast = the("toast");
  #toastTimer = 0;

  constructor(onAgain: () => void, onToken: (token: string) => void) {
    this.#again.addEventListener("click", onAgain);
    this.#token.addEventListener("submit", (event) => {
      event.preventDefault();
      onToken(the<HTMLInputElement>("token-text").value);
    });
  }

  /** Under way: a word, and what may help. */
  say(headline: string, hint = ""): void {
    this.#put(headline, hint, "data-said");
  }

  /** There is nothing to say: the picture speaks. */
  quiet(): void {
    this.#stage.removeAttribute("data-said");
    this.#stage.removeAttribute("data-failed");
  }

  /** It has ended; what may help is a new attempt, another scene, or nothing here. */
  fail(headline: string, hint: string, way: "again" | "scenes" | "none" = "again"): void {
    this.#put(headline, hint, "data-failed");
    this.#stage.setAttribute("data-said", "");
    this.#again.hidden = way !== "again";
    this.#all.hidden = way !== "scenes";
  }

  /** Whether it is said that it has ended, or what is asked of the user first: nothing under way is said over that. */
  get failed(): boolean {
    return this.#stage.hasAttribute("data-failed");
  }

  askToken(wrong: boolean): void {
    this.#put(wrong ? "This token does not open the server" : "This server asks for a token", "Whoever runs the server can give you one.", "data-failed");
    this.#token.hidden = false;
    the("token-text").focus();
  }

  /** A short word that goes by itself. */
  toast(text: string, ms = TOAST_MS): void {
    this.#toast.textContent = text;
    this.#toast.hidden = false;
    clearTimeout(this.#toastTimer);
    this.#toastTimer = window.setTimeout(() => (this.#toast.hidden = true), ms);
  }

  #put(headline: string, hint: string, state: string): void {
    this.quiet();
    this.#again.hidden = this.#all.hidden = true;
    this.#token.hidden = true;
    this.#headline.textContent = headline;
    this.#hint.textContent = hint;
    this.#stage.setAttribute(state, "");
  }
}
