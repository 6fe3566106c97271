/**
 * The page inside another one: `frame.contentWindow.postMessage({ cags: "seek", seconds: 2 }, "*")`.
 *
 * Taken: play, pause, seek (`seconds`), pose (`pose`: position and quaternion `wxyz`, seven numbers), camera (`mode`).
 * Told to the parent: ready (`name`, `seconds`), time (`seconds`, `playing`), error (`message`).
 */

import { MODES, type Mode } from "../player/camera.ts";
import type { Pose } from "../seam.ts";
import { givenPose } from "./place.ts";

export interface EmbedWishes {
  play(): void;
  pause(): void;
  seek(seconds: number): void;
  pose(pose: Pose): void;
  mode(mode: Mode): void;
}

export function listen(wishes: EmbedWishes): void {
  const place = (pose: Pose | undefined): void => pose && wishes.pose(pose);
  addEventListener("message", ({ data, source }) => {
    if (source !== parent || typeof data !== "object" || data === null) return;
    const { cags, seconds, pose, mode } = data as Record<string, unknown>;
    if (cags === "play") wishes.play();
    else if (cags === "pause") wishes.pause();
    else if (cags === "seek" && typeof seconds === "number" && Number.isFinite(seconds)) wishes.seek(seconds);
    else if (cags === "pose") place(givenPose(pose));
    else if (cags === "camera") MODES.filter((known) => known === mode).forEach((known) => wishes.mode(known));
  });
}

/** Tell the page around this one, where there is one. */
export function tell(event: "ready" | "time" | "error", values: Readonly<Record<string, string | number | boolean>>): void {
  if (parent !== window) parent.postMessage({ cags: event, ...values }, "*");
}
