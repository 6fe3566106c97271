"""Ours against the baselines: what the page says follows from the figures alone."""

from dataclasses import replace

import pytest

from cags_bench.reproduce.experiments.rivals import Duel, _checks, _verdict

OURS = {
    "psnr_restored_db": 30.0,
    "psnr_distorted_db": 25.0,
    "lod_mean": 5.0,
    "top_lod": 24,
    "goodput_mbps": 4.0,
    "frames": 40,
    "frames_missed": 0,
}
FRAMES = 40


def by_frame(mean_db: float, spread_db: float = 0.5) -> list[float]:
    return [mean_db + (spread_db if frame // 9 % 2 else -spread_db) for frame in range(FRAMES)]


BEHIND = Duel(
    "room",
    "30 Mbps",
    30.0,
    "lts-f",
    OURS,
    {"psnr_restored_db": 33.0, "goodput_mbps": 4.0},
    [30.0] * FRAMES,
    [33.0] * FRAMES,
)


def test_a_claim_is_five_decibels_over_two_baselines_at_two_rates() -> None:
    close = replace(BEHIND, theirs_db=[26.0] * FRAMES)
    assert (close.lead_db, close.target_db, close.met) == (4.0, 5.0, False)
    for change in ({"mbps": 150.0}, {"mbps": None}, {"rival": "cr-no-ref"}, {"method": "cags-paper"}):
        assert replace(close, **change).met  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("ours", "goodput", "words"),
    [
        ({"lod_mean": 24.0}, 4.0, "its quantiser's own error at 30.0 dB"),
        ({}, 8.0, "LTS-F used 2.00 times our bytes"),
        ({}, 2.0, "LTS-F used 50% of our bytes and needed no more"),
        ({"psnr_distorted_db": 32.0}, 4.0, "references cost us 2.0 dB"),
        ({"frames_missed": 20}, 4.0, "50% of our frames were shown without all their data"),
        ({}, 4.0, "at mean LoD 5.0 of 24 and the same bytes, LTS-F is at 33.0 dB already"),
        ({"lod_mean": None}, 4.0, "and the same bytes"),
    ],
)
def test_a_reason_follows_from_the_figures(ours: dict[str, float], goodput: float, words: str) -> None:
    duel = replace(BEHIND, ours=OURS | ours, theirs={"psnr_restored_db": 33.0, "goodput_mbps": goodput})
    assert words in duel.reason()


def test_a_lead_that_is_not_sure_is_none() -> None:
    unsure = replace(BEHIND, mbps=150.0, theirs_db=by_frame(29.8, spread_db=2.0))
    assert unsure.lead_db > 0
    assert not unsure.met
    assert replace(unsure, theirs_db=by_frame(29.8, spread_db=0.05)).met


def test_a_claim_names_its_least_sure_case() -> None:
    ahead = replace(BEHIND, scene="wave", theirs_db=[20.0] * FRAMES)
    checks = {c["name"]: c for c in _checks([BEHIND, ahead])}
    assert list(checks) == ["ahead of LTS-F on every scene and link", "far ahead of LTS-F at 30 Mbps"]
    for one in checks.values():
        assert not one["ok"]
        assert "least -3.00 [-3.00, -3.00] on room, 30 Mbps; sure in 1 of 2" in one["value"]
    assert all(one["ok"] for one in _checks([ahead, ahead]))
    assert "ahead in 1 of 2" in _verdict([BEHIND, ahead])
