"""Baselines and checks, broken by hand one at a time: each change turns a check red.

Changes of what is played run whole sessions and are slow; those of settings, figures, lists and pages are not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from cags_bench.confidence import paired
from cags_bench.reproduce import methods
from cags_bench.reproduce.experiments.rivals import Duel, _checks
from cags_bench.reproduce.methods import METHODS, Method
from cags_client.frame.presented import PresentedFrame
from cags_research.seen import listed, unlisted
from cags_server.ratecontrol.plan import Plan
from cags_server.session.tile_sender import TileSender
from support.baseline_checks import (
    FRAMES,
    Played,
    check_everything_is_shown,
    check_labels,
    check_more_is_never_worse,
    check_published,
    play,
)
from support.page_age import ROOT, History, Page, check_page, check_told
from support.page_age import listed as listed_old

# ------------------------------------------------------------------------------------------------- what is played


def frozen(patch: pytest.MonkeyPatch) -> None:
    """The server sends the first picture and nothing after it."""
    patch.setattr(TileSender, "upgrades", lambda self, frame, upgrades, deadline_us: self.frame_ends(frame))


def new_tiles_wait(patch: pytest.MonkeyPatch) -> None:
    """What V3-A suffered from: a new tile that is sent whole never comes to be shown."""
    sent = TileSender._whole_tiles
    patch.setattr(
        TileSender,
        "_whole_tiles",
        lambda self, upgrades, deadline_us: sent(self, tuple(u for u in upgrades if u.from_lod), deadline_us),
    )


def never_the_best(patch: pytest.MonkeyPatch) -> None:
    """The last level of a tile is never sent."""
    raised = Plan.raise_once
    patch.setattr(Plan, "raise_once", lambda self, tile: self.depth(tile) < tile.max_depth - 1 and raised(self, tile))


def a_constant(patch: pytest.MonkeyPatch) -> None:
    """Every frame shows the first one's picture."""
    first: list[object] = []
    shown = PresentedFrame.__dict__["rgb"].fget

    def held(self: PresentedFrame) -> object:
        first.append(shown(self))
        return first[0]

    patch.setattr(PresentedFrame, "rgb", property(held))


PLAYED: dict[str, tuple[str, Callable[[pytest.MonkeyPatch], None]]] = {
    "V3-A stands still": ("v3-a", frozen),
    "LTS-F stands still": ("lts-f", frozen),
    "new tiles of V3-A wait for ever": ("v3-a", new_tiles_wait),
    "LTS-F never gets its last level": ("lts-f-even", never_the_best),
    "remote rendering shows a constant": ("reference-only", a_constant),
    "our own client shows a constant": ("cags", a_constant),
}


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("bundles"))


@pytest.mark.slow
@pytest.mark.parametrize("change", PLAYED)
def test_a_broken_session_is_found(change: str, cache: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name, breaks = PLAYED[change]
    breaks(monkeypatch)
    played = play(METHODS[name], cache)
    with pytest.raises(AssertionError, match=f"^{name}: "):
        check_everything_is_shown(name, played)


# --------------------------------------------------------------------------------------------------- what is set


def published_with(part: str, **changes: object) -> Callable[[], None]:
    usual = METHODS["cags-paper"]
    return lambda: check_published(replace(usual, **{part: {**getattr(usual, part), **changes}}))


def labelled(**changes: Method) -> Callable[[], None]:
    return lambda: check_labels({**METHODS, **changes})


def whole(mean_db: float, **changes: object) -> Played:
    """A play without a fault."""
    steady = {"changed": [0.1] * (FRAMES - 1), "truth_changed": [0.1] * (FRAMES - 1)}
    return Played(**{"shown_db": [mean_db] * FRAMES, "decoded_db": [99.0] * FRAMES, **steady, **changes})  # type: ignore[arg-type]


def duel(ours: list[float], theirs: list[float], rival: str = "lts-f") -> Duel:
    return Duel("room", "30 Mbps", 30.0, rival, {}, {}, ours, theirs)


def claims(one: Duel) -> None:
    assert all(check["ok"] for check in _checks([one]))


def sure(ours: list[float], theirs: list[float]) -> None:
    assert paired(ours, theirs).above(0.0)


def all_listed_without(kind: str, spec: str, scene: str) -> Callable[[], None]:
    def check() -> None:
        left = [entry for entry in listed() if (entry.kind, entry.spec) != (kind, spec)]
        assert len(left) == len(listed()) - 1
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("cags_research.seen.listed", lambda: tuple(left))
            assert unlisted(kind, [scene]) == []

    return check


class Told(History):
    """A history that knows one commit, some changes ago."""

    def __init__(self, changes: int) -> None:
        self._changes = changes

    def holds(self, commit: str) -> bool:
        return commit == "abcdef1"

    def changes_since(self, commit: str) -> int:
        return self._changes


FILE = "docs/evaluation/fixed.jsonl"
LONG = 60

FOUND: dict[str, Callable[[], None]] = {
    "the published field of view is ours": published_with("server", fov="lstm"),
    "published references have the client's footprint": published_with("server", reference_footprint="client"),
    "the published client does not erode": published_with("client", erosion=False),
    "the published policy is ours": published_with("server", abr="utility"),
    "the published quantiser is ours": published_with("encode", quantiser="layered"),
    "the published order of layers is measured": published_with("encode", lod_order="measured"),
    "the published client corrects as ours": published_with("client", restore="correct"),
    "published references are differences": published_with("server", references="auto"),
    "the published server is given more": published_with("server", tiles_ahead=5),
    "V3-A is LTS-F by another name": labelled(**{"v3-a": METHODS["lts-f"]}),
    "ours gets the faster link": labelled(cags=replace(METHODS["cags"], predicted=True)),
    "V3-A with prediction is V3-A": labelled(**{"v3-a-predicted": METHODS["v3-a"]}),
    "LTS-F, a level a frame, is LTS-F": labelled(**{"lts-f-even": METHODS["lts-f"]}),
    "remote rendering is planned as far ahead as ours": labelled(
        **{
            "reference-only": replace(
                METHODS["reference-only"], server={**METHODS["reference-only"].server, "lead_frames": 6}
            )
        }
    ),
    "remote rendering of a small picture is of a large one": labelled(
        **{"reference-only-small": METHODS["reference-only"]}
    ),
    "a faster link shows less": lambda: check_more_is_never_worse(
        "lts-f", [("slow", whole(40.0)), ("fast", whole(39.5))]
    ),
    "a middle link shows less than the slowest": lambda: check_more_is_never_worse(
        "v3-a", [("slow", whole(40.0)), ("middle", whole(38.0)), ("fast", whole(41.0))]
    ),
    "frames are not shown at all": lambda: check_everything_is_shown("cags", whole(40.0, shown_db=[40.0] * 3)),
    "frames are shown without their data": lambda: check_everything_is_shown("cags", whole(40.0, missed=1)),
    "one late frame in the middle": lambda: check_everything_is_shown(
        "v3-a", whole(40.0, decoded_db=[99.0] * (FRAMES - 1) + [43.0])
    ),
    "ours and theirs are exchanged": lambda: claims(duel([20.0] * LONG, [30.0] * LONG)),
    "ours is compared with itself": lambda: claims(duel([30.0] * LONG, [30.0] * LONG)),
    "a lead of four decibels passes for five": lambda: claims(duel([34.0] * LONG, [30.0] * LONG)),
    "one lucky stretch passes for a lead": lambda: sure([30.0] * 51 + [60.0] * 9, [30.0] * LONG),
    "a session without figures passes": lambda: claims(duel([float("nan")] * LONG, [20.0] * LONG)),
    "a scene that was trained on is taken off the list": all_listed_without("scene", "plant.splat", "a/plant.splat"),
    "people who were trained on are taken off the list": all_listed_without(
        "walk", "*_user0[1-6].csv", "room_user02.csv"
    ),
    "figures of a commit that nobody has": lambda: check_page(Page(FILE, ("1234567",)), {}, Told(0)),
    "figures of no commit": lambda: check_page(Page(FILE, ()), {}, Told(0)),
    "old figures that nobody lists": lambda: check_page(Page(FILE, ("abcdef1",)), {}, Told(31)),
    "new figures that are listed as old": lambda: check_page(Page(FILE, ("abcdef1",)), {FILE: "abcdef1"}, Told(2)),
    "the list says another commit": lambda: check_page(Page(FILE, ("abcdef1",)), {FILE: "abcdef2"}, Told(31)),
    "the page of words keeps quiet": lambda: check_told(
        "# Evaluation\n\n## Summary\n\nAll is well.\n", {FILE: "abcdef1"}
    ),
}
"""What is done, and the check that has to fail."""


@pytest.mark.parametrize("change", FOUND)
def test_a_change_turns_a_check_red(change: str) -> None:
    with pytest.raises(AssertionError):
        FOUND[change]()


def test_nothing_is_red_without_a_change() -> None:
    """Or the checks above would fail for another reason."""
    check_published(METHODS["cags-paper"])
    check_labels(methods.METHODS)
    check_everything_is_shown("cags", whole(40.0))
    check_more_is_never_worse("lts-f", [("slow", whole(40.0)), ("fast", whole(40.0))])
    claims(duel([36.0] * LONG, [30.0] * LONG))
    sure([31.0] * LONG, [30.0] * LONG)
    assert unlisted("scene", ["a/plant.splat"]) == []
    check_page(Page(FILE, ("abcdef1",)), {}, Told(30))
    check_page(Page(FILE, ("abcdef1",)), {FILE: "abcdef1"}, Told(21))
    check_page(Page(FILE, ("abcdef1",)), {FILE: "abcdef1"}, Told(31))
    check_told("# Evaluation\n\n## Summary\n\nOf abcdef1.\n", {FILE: "abcdef1"})
    assert listed_old("## Figures older than their code\n\n- `a` (abcdef1)\n\n## 1.0\n\n- `b` (abcdef2)\n") == {
        "a": "abcdef1"
    }


def test_twenty_changes_are_tried_and_listed() -> None:
    listed_on = (ROOT / "docs/lab/evaluation.md").read_text(encoding="utf-8").partition("## Checks, broken by hand")[2]
    cells = [
        row.split(" | ")[1].rstrip(" |")
        for row in listed_on.partition("\n## ")[0].splitlines()
        if row.startswith("| ") and "; " in row
    ]
    on_page = [change for cell in cells for change in cell.split("; ")]
    assert sorted(on_page) == sorted([*PLAYED, *FOUND])
    assert len(on_page) >= 20
