/** Elements of the page by their ids. */

export function the<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as T;
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
