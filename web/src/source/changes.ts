/** What has changed since a reference was made, as `cags_client.frame.changes`: there it says nothing that could be relied on. */
import type { Camera, ChangedSince } from "../seam.ts";
import { worldToCamera } from "../wire/geometry.ts";

const REMEMBERED = 64;
const REMEMBERED_FRAMES = 12;
const MOST_PLACES_BYTES = 64 << 20;
const SEEN_SIGMAS = 2;
const MOST_LOOKED_AT = 4096;
const MOVED_PX = 2;

export interface Changed {
  readonly positions: Float32Array<ArrayBuffer>;
  readonly radii: Float32Array<ArrayBuffer>;
}

/** The commits of late of one scene: what each changed, the mark up to which it showed, and where splats were. */
export class Changes {
  private commits: { readonly mark: number; readonly rows: Int32Array; readonly began: Int32Array }[] = [];
  private places: { readonly frame: number; readonly means: Float32Array }[] = [];
  private frame = -1; // that was committed last
  private mark = 0; // of what is displayed
  private newest = 0; // that ever was

  /** Another group of frames is on display. */
  clear(): void {
    this.mark = 0;
    this.frame = -1;
    this.commits = [];
    this.places = [];
  }

  /** `rows` changed by showing `frame` with what came up to `mark`, or further, where that was shown before; `began`: the
   * media frame of what changed each. */
  committed(frame: number, mark: number, rows: Int32Array, began: Int32Array): void {
    if (frame < this.frame) this.commits = []; // the play went back
    this.frame = frame;
    this.mark = mark;
    this.newest = Math.max(this.newest, mark);
    if (rows.length) this.commits.push({ mark: this.newest, rows, began });
    if (this.commits.length > REMEMBERED) this.commits.shift();
  }

  /** A reference made from mark `basis` is shown with its own frame. */
  used(basis: number): void {
    this.commits = this.commits.filter(({ mark }) => mark > basis);
  }

  /** Media `frame` is shown, when splats are at `means` [n, 3], of which a copy is kept. */
  shown(frame: number, means: Float32Array): void {
    while (this.places.length && this.places.at(-1)!.frame >= frame) this.places.pop();
    if (this.places.length * means.byteLength > MOST_PLACES_BYTES) this.places.shift();
    this.places.push({ frame, means: means.slice() });
    if (this.places.length > REMEMBERED_FRAMES) this.places.shift();
  }

  /** Positions and radii of what was changed since a reference's frame, or by more than the mark that a difference
   * assumes; of what has moved, for a picture and where more is shown than that. Of many every so many-th. */
  since(since: ChangedSince, means: Float32Array, logScales: Float32Array): Changed {
    const { frame, basis } = since;
    const flags = new Uint8Array(means.length / 3);
    for (const { mark, rows, began } of this.commits) {
      const later = basis !== undefined && mark > basis;
      for (let i = 0; i < rows.length; i++) if (later || began[i]! > frame) flags[rows[i]!] = 1;
    }
    if (basis === undefined || this.mark > basis) this.addMoved(flags, since, means);
    let count = 0;
    for (const flag of flags) count += flag;
    const step = Math.ceil(count / MOST_LOOKED_AT) || 1;
    const rows: number[] = [];
    for (let row = 0, i = 0; row < flags.length; row++) if (flags[row] && i++ % step === 0) rows.push(row);
    const positions = new Float32Array(3 * rows.length);
    rows.forEach((row, i) => positions.set(means.subarray(3 * row, 3 * row + 3), 3 * i));
    const radius = (row: number): number => SEEN_SIGMAS * Math.exp(Math.max(...logScales.subarray(3 * row, 3 * row + 3)));
    return { positions, radii: Float32Array.from(rows, radius) };
  }

  private addMoved(flags: Uint8Array, { frame, camera, focalPx }: ChangedSince, means: Float32Array): void {
    const before = this.places.filter((place) => place.frame <= frame).at(-1) ?? this.places[0];
    if (!before || before.means.length !== means.length) return;
    const depth = depthOf(camera);
    const old = before.means;
    for (let row = 0, i = 0; row < flags.length; row++, i += 3) {
      const [x, y, z] = [means[i]! - old[i]!, means[i + 1]! - old[i + 1]!, means[i + 2]! - old[i + 2]!];
      if (!x && !y && !z) continue;
      const far = Math.max(depth(means[i]!, means[i + 1]!, means[i + 2]!), camera.near);
      if (Math.sqrt(x * x + y * y + z * z) * focalPx > MOVED_PX * far) flags[row] = 1;
    }
  }
}

function depthOf(camera: Camera): (x: number, y: number, z: number) => number {
  const { rotation, translation } = worldToCamera(camera.pose);
  const [a, b, c] = rotation.slice(6) as [number, number, number];
  return (x, y, z) => a * x + b * y + c * z + translation[2];
}
