/** The author's view: what a scene says of how to open it, what the address says instead, and saving it. */

import { fartherThanAuthor, type Place as ScenePlace, type ViewCamera } from "../player/camera.ts";
import { minus, plus } from "../player/vectors.ts";
import type { AuthorView } from "../seam.ts";
import type { Place } from "./place.ts";

/** What must be known of a scene to open it. */
export type Opened = ScenePlace & { readonly name: string };

/** `scene` as the address wants it opened; a pose of the address is of a moment, and no first view. */
export function openedAs<T extends Opened>(scene: T, { target, background }: Place): T {
  const wanted = { ...(target ? { target } : {}), ...(background ? { background } : {}) };
  return { ...scene, view: { ...scene.view, ...wanted } };
}

/** Red, green and blue of `#rrggbb`, 0..1; black where there is none. */
export function coloursOf(background = "#000000"): [number, number, number] {
  const [r, g, b] = [1, 3, 5].map((at) => parseInt(background.slice(at, at + 2), 16) / 255);
  return [r, g, b];
}

/** What `cags-encode --view` takes: the view as it stands now, in a picture of these tangents of half its angles. */
export function savedView(scene: Opened, camera: ViewCamera, tanX: number, tanY: number): string {
  const { rotation } = camera.pose;
  const { target, radius } = camera.around;
  const { background } = scene.view;
  const position = plus(target, minus(camera.pose.position, target), 1 / fartherThanAuthor(tanX, tanY));
  const short = (parts: readonly number[]): number[] => parts.map((part) => Number(part.toFixed(7)));
  const view: Record<string, unknown> = {
    title: scene.view.title ?? scene.name,
    ...(background ? { background } : {}),
    pose: [...short(position), ...short(rotation)],
    target: short(target),
    radius: Number(radius.toPrecision(4)),
  };
  return `${JSON.stringify(view, null, 2)}\n`;
}

/** Headings that tell scenes apart: those with a title in common say their name as well. */
export function headingsOf(scenes: readonly { readonly title: string; readonly name: string }[]): string[] {
  const count = (title: string): number => scenes.filter((scene) => scene.title === title).length;
  return scenes.map(({ title, name }) => (count(title) > 1 && title !== name ? `${title} (${name})` : title));
}

export function titleOf({ view, name }: { readonly view: AuthorView; readonly name: string }): string {
  return view.title ?? name;
}
