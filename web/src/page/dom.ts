/** Elements of the page by their ids. */

export function the<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as T;
}

/** Put words into an element unless it has them: a screen reader says all that is put into a status, again too. */
export function word(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Do so whenever its user has changed an element. */
export function onChange<T extends HTMLElement>(id: string, apply: (element: T) => void): void {
  const element = the<T>(id);
  element.addEventListener("change", () => apply(element));
}

const SLIDER_KEYS = /^(Arrow|Home$|End$|Page)/;

/** Whether an element that has the focus takes this key itself. Others, such as letters on a slider, are the page's. */
export function takesKey(target: EventTarget | null, code: string): boolean {
  if (target instanceof HTMLSelectElement) return true;
  if (target instanceof HTMLButtonElement) return code === "Space" || code === "Enter";
  if (!(target instanceof HTMLInputElement)) return false;
  if (code === "Escape") return false;
  if (target.type === "checkbox") return code === "Space";
  return target.type !== "range" || SLIDER_KEYS.test(code);
}

/** A setting that the browser keeps; undefined where it keeps none. */
export function kept(name: string): string | undefined {
  try {
    return localStorage.getItem(`cags.${name}`) ?? undefined;
  } catch {
    return undefined; // storage is turned off: nothing is remembered
  }
}

export function keep(name: string, value: string): void {
  try {
    localStorage.setItem(`cags.${name}`, value);
  } catch {
    // as above
  }
}

/** Settles once the page is on the screen: it may have been opened in a tab behind another one. */
export function seen(): Promise<void> {
  return new Promise((resolve) => {
    const look = (): void => {
      if (document.hidden) return;
      document.removeEventListener("visibilitychange", look);
      resolve();
    };
    document.addEventListener("visibilitychange", look);
    look();
  });
}
