/** One honest light: how good the picture is, and what holds it back. */

import type { Player } from "../player/player.ts";
import { nowUs } from "../seam.ts";

export type LightState = "good" | "fair" | "bad" | "wait";

export interface Verdict {
  readonly state: LightState;
  readonly text: string;
}

/** Figures older than this say nothing. */
export const STALE_US = 3_000_000;
/** Less than this share of the detail is told. */
export const SHORT_OF_DETAIL = 0.6;

export function verdictOf(player: Player): Verdict {
  const { status, shown, info } = player;
  if (!info || !status || status.link === "connecting") return { state: "wait", text: "connecting" };
  if (status.link === "away") return { state: "bad", text: "server: not reached" };
  if (status.link === "ended") return { state: "bad", text: "server: ended" };
  if (!shown || player.waiting) return { state: "wait", text: "loading" };
  if (player.playing && player.cadencePermille < 1000) return { state: "fair", text: "this device: fewer frames" };
  if (player.scale < 1) return { state: "fair", text: "this device: fewer pixels" };
  if (shown.update.missed && player.playing) return { state: "bad", text: "your link: too slow" };
  if (player.playing && Number.isNaN(shown.update.lodMean)) return { state: "fair", text: "nothing in view" };
  const share = detailOf(player);
  if (share !== undefined && share < SHORT_OF_DETAIL) return { state: "fair", text: "your link: less detail" };
  if (status.references && player.playing && shown.reference && shown.frame - shown.reference.frame > 5)
    return { state: "fair", text: "server: late" };
  return { state: "good", text: "good" };
}

/** Share of the levels of detail of what is in view; undefined where nothing is known. */
export function detailOf({ shown, info }: Player): number | undefined {
  if (!shown || !info || nowUs() - shown.atUs > STALE_US || Number.isNaN(shown.update.lodMean)) return undefined;
  return info.lods > 1 ? shown.update.lodMean / (info.lods - 1) : 1;
}
