"""Ours against every baseline, scene by scene and link by link: who is ahead, by how much, and where not, why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cags_bench.confidence import Interval, paired, pooled
from cags_bench.jsonl import JsonObject, check
from cags_bench.reproduce.experiments.sessions import session_cases
from cags_bench.reproduce.experiments.streaming import PSNR, link_title
from cags_bench.reproduce.methods import BASELINES, METHODS
from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Section

RIVALS = ("cags-paper", *BASELINES)
"""What ours is compared with."""

PUBLISHED_AHEAD_OF, PUBLISHED_MBPS = "lts-f", 30.0
"""What the published way must be ahead of, and where."""

LARGE_GAIN_DB = 5.0
LARGE_GAIN_RIVALS = ("lts-f", "v3-a", "v3-a-predicted")
LARGE_GAIN_MBPS = (30.0, 60.0)
"""The paper's claim: five decibels or more over these baselines at these rates."""

WHOLE_SHARE = 0.95
"""Of the highest mean LoD: from here on the scene has arrived, and the link no longer limits."""

MORE_BYTES = 1.1
LIKE_BYTES = 0.9


@dataclass(frozen=True)
class Duel:
    """One method, ours unless it says otherwise, against another on one scene over one link."""

    scene: str
    link: str
    mbps: float | None
    rival: str
    ours: JsonObject
    theirs: JsonObject
    ours_db: Sequence[float]
    """By frame."""
    theirs_db: Sequence[float]
    method: str = "cags"
    """Whose lead it is."""

    @property
    def lead_db(self) -> float:
        """How far ours is ahead in the mean; negative: behind."""
        return self.lead.mean

    @property
    def lead(self) -> Interval:
        """The same with its bounds, paired frame by frame."""
        return paired(self.ours_db, self.theirs_db)

    @property
    def target_db(self) -> float:
        """What the paper claims here."""
        large = self.method == "cags" and self.rival in LARGE_GAIN_RIVALS and self.mbps in LARGE_GAIN_MBPS
        return LARGE_GAIN_DB if large else 0.0

    @property
    def met(self) -> bool:
        """Whether the claim holds: it is sure that the lead is more."""
        return self.lead.above(self.target_db)

    def reason(self) -> str:
        """Why the claim does not hold here, as far as the measured figures tell."""
        title, lod = METHODS[self.rival].title, self.ours.get("lod_mean")
        if lod is not None and lod >= WHOLE_SHARE * self.ours["top_lod"]:
            return (
                f"the link brings the whole scene in time (mean LoD {lod:.1f} of {self.ours['top_lod']}): what is left "
                f"of ours is its quantiser's own error at {self.ours[PSNR]:.1f} dB, and {title}'s is finer"
                if self.lead_db <= 0
                else f"the link brings the whole scene in time (mean LoD {lod:.1f} of {self.ours['top_lod']}), so both "
                "show nearly everything and little is left to be ahead by"
            )
        parts = []
        share = self.theirs["goodput_mbps"] / max(self.ours["goodput_mbps"], 1e-9)
        if share > MORE_BYTES:
            parts.append(f"{title} used {share:.2f} times our bytes")
        elif share < LIKE_BYTES:
            parts.append(f"{title} used {share:.0%} of our bytes and needed no more")
        gain = self.ours[PSNR] - self.ours["psnr_distorted_db"]
        if gain < 0:
            parts.append(f"references cost us {-gain:.1f} dB")
        missed = self.ours["frames_missed"] / max(self.ours["frames"], 1)
        if missed > 0.1:
            parts.append(f"{missed:.0%} of our frames were shown without all their data")
        return "; ".join(parts) or (
            f"at mean LoD {lod if lod is not None else 0:.1f} of {self.ours['top_lod']} and the same bytes, {title} is "
            f"at {self.theirs[PSNR]:.1f} dB already"
        )


def rivals(context: Context) -> Section:
    """Every duel, the checks of the claims, and a reason for each that does not hold."""
    duels = _duels(context)
    rows: list[list[Cell]] = [
        [
            d.scene,
            d.link,
            METHODS[d.method].title,
            METHODS[d.rival].title,
            d.ours[PSNR],
            d.theirs[PSNR],
            d.lead_db,
            d.lead.low,
            d.lead.high,
            d.ours["goodput_mbps"],
            d.theirs["goodput_mbps"],
            "yes" if d.met else "no",
        ]
        for d in duels
    ]
    notes = [_verdict([d for d in duels if d.method == "cags"]), _spent(context)] if duels else ["No session is kept."]
    notes += [
        f"{d.scene}, {d.link}: {METHODS[d.method].title} {d.lead} dB against {METHODS[d.rival].title}"
        + (f" where the paper has {d.target_db:g} or more" if d.target_db else "")
        + f": {d.reason()}."
        for d in duels
        if not d.met
    ]
    return Section(
        name="rivals",
        title="Ours against every baseline",
        paper="Figures 'fixed' and 'dynamic bandwidth', scene by scene at the same link and so the same total bytes. "
        "Leads are paired frame by frame; their 95 % intervals are of this walk, in blocks of nine frames.",
        columns=(
            "scene",
            "link",
            "method",
            "baseline",
            "method [dB]",
            "baseline [dB]",
            "lead",
            "95 % from",
            "to",
            "method [Mbps]",
            "baseline [Mbps]",
            "met",
        ),
        rows=rows,
        notes=notes,
        checks=_checks(duels),
    )


def _duels(context: Context) -> list[Duel]:
    plan = context.plan
    pairs = [("cags", rival) for rival in RIVALS]
    pairs += [("cags-paper", PUBLISHED_AHEAD_OF)]
    out = []
    for scene in plan.scenes:
        for mbps in plan.links:
            for method, rival in pairs:
                if method != "cags" and mbps != PUBLISHED_MBPS:
                    continue
                out += _duel(context, scene, mbps, method, rival)
    return out


def _duel(context: Context, scene: str, mbps: float | None, method: str, rival: str) -> list[Duel]:
    """One duel; none where one of the two is not of the plan, or was not played."""
    cases = [context.case(scene, name, mbps) for name in (method, rival)]
    if not {method, rival} <= set(context.plan.methods) or not all(context.there(case) for case in cases):
        return []
    ours, theirs = (context.result(case) for case in cases)
    ours_db, theirs_db = ([float(frame[PSNR]) for frame in one["frames"]] for one in (ours, theirs))
    link = link_title(mbps)
    return [Duel(scene, link, mbps, rival, ours["summary"], theirs["summary"], ours_db, theirs_db, method)]


def _spent(context: Context) -> str:
    """What was played of all that could have been, and what it took."""
    plan, cases = context.plan, session_cases(context)
    played = [case for case in cases if context.there(case)]
    hours = sum(context.runner.cpu_s(case) for case in played) / 3600
    return (
        f"{len(played)} of {len(cases)} sessions of {plan.frames} frames at {plan.width}x{plan.height} were played; "
        f"they took {hours:.2f} processor hours, encoding apart."
    )


def _verdict(duels: list[Duel]) -> str:
    ahead, met = sum(d.lead_db > 0 for d in duels), sum(d.met for d in duels)
    leads = sorted(d.lead_db for d in duels)
    return (
        f"Ours is ahead in {ahead} of {len(duels)} comparisons, and the claim is sure in {met}. The lead is "
        f"{leads[len(leads) // 2]:+.1f} dB at the median, {leads[0]:+.1f} at worst and {leads[-1]:+.1f} at best."
    )


def _checks(duels: list[Duel]) -> list[JsonObject]:
    """One a rival: ahead of it everywhere; and one a rival of the large gains. The least sure duel decides."""
    out = []
    for method, rival in dict.fromkeys((d.method, d.rival) for d in duels):
        own = [d for d in duels if (d.method, d.rival) == (method, rival)]
        if method != "cags":
            out.append(_claim(f"{METHODS[method].title} ahead of {METHODS[rival].title} at {own[0].link}", own, 0.0))
            continue
        out.append(_claim(f"ahead of {METHODS[rival].title} on every scene and link", own, 0.0))
        large = [d for d in own if d.target_db]
        if large:
            rates = " and ".join(dict.fromkeys(d.link for d in large))
            out.append(_claim(f"far ahead of {METHODS[rival].title} at {rates}", large, LARGE_GAIN_DB))
    return out


def _claim(name: str, duels: list[Duel], bound_db: float) -> JsonObject:
    """Whether each of ``duels`` is won by more than ``bound_db`` for sure."""
    worst = min(duels, key=lambda d: d.lead.low)
    won = sum(d.lead.above(bound_db) for d in duels)
    mean = pooled([[a - b for a, b in zip(d.ours_db, d.theirs_db, strict=True)] for d in duels])
    value = f"{mean} in the mean; least {worst.lead} on {worst.scene}, {worst.link}; sure in {won} of {len(duels)}"
    return check(name, f"> {bound_db:g} dB", value, won == len(duels))
