"""Splats over time: parsing of files, and states at a time."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_encoder.formats.repair import DropBroken
from cags_encoder.formats.spacetime_ply import parse_spacetime_ply
from cags_encoder.formats.splatv import MAGIC, parse_splatv
from cags_encoder.formats.timed import FAINTEST, TimedSplats
from support.timed_files import spacetime_ply_bytes, splatv_bytes, timed_splats

TIMED = timed_splats()


def opacity(logits: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-logits.astype(np.float64)))


@pytest.mark.parametrize("time", [0.0, 0.3, 1.0])
def test_a_splat_follows_its_polynomial_and_fades_as_a_gaussian(time: float) -> None:
    rows = TIMED.alive(time)
    found = TIMED.at(time, rows, "clip")
    for at, row in enumerate(rows):
        since = time - TIMED.centres[row]
        moved = sum(TIMED.motion[row, power].astype(float) * since ** (power + 1) for power in range(3))
        assert found.means[at] == pytest.approx(TIMED.splats.means[row] + moved, abs=1e-5)
        faded = opacity(TIMED.splats.logit_opacities[row]) * np.exp(-((since / TIMED.widths[row]) ** 2))
        assert opacity(found.logit_opacities[at]) == pytest.approx(faded, rel=1e-3)
        turned = TIMED.splats.quats[row] + since * TIMED.omega[row]
        assert abs(found.quats[at] @ turned) == pytest.approx(np.linalg.norm(turned), rel=1e-5)


def test_what_cannot_be_seen_is_absent() -> None:
    for time in (0.0, 0.5):
        alive = np.isin(np.arange(len(TIMED)), TIMED.alive(time))
        faded = opacity(TIMED.splats.logit_opacities) * np.exp(-np.square((time - TIMED.centres) / TIMED.widths))
        assert alive.tolist() == (faded >= FAINTEST).tolist()
        assert 0 < alive.sum() < len(TIMED)


def test_a_ply_of_spacetime_gaussians_comes_back() -> None:
    found = parse_spacetime_ply(spacetime_ply_bytes(TIMED), "f")
    assert_close(found, TIMED, 1e-6)


def test_a_splatv_comes_back_without_its_filling() -> None:
    found = parse_splatv(splatv_bytes(TIMED), "f")
    assert_close(found, TIMED, 2e-3)
    assert opacity(found.splats.logit_opacities) == pytest.approx(opacity(TIMED.splats.logit_opacities), abs=0.51 / 255)


def assert_close(found: TimedSplats, wanted: TimedSplats, tolerance: float) -> None:
    assert len(found) == len(wanted)
    assert found.splats.means == pytest.approx(wanted.splats.means)
    assert found.splats.log_scales == pytest.approx(wanted.splats.log_scales, abs=tolerance)
    assert found.splats.quats == pytest.approx(wanted.splats.quats, abs=tolerance)
    colours = np.clip(0.5 + 0.28209479 * wanted.splats.sh0, *((0, 1) if tolerance > 1e-4 else (-9, 9)))
    assert 0.5 + 0.28209479 * found.splats.sh0 == pytest.approx(colours, abs=max(tolerance, 1e-6))
    for name in ("centres", "widths", "motion", "omega"):
        assert getattr(found, name) == pytest.approx(getattr(wanted, name), rel=2 * tolerance, abs=tolerance)


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("motion_4", np.nan, "motion of splat 0 cannot be used"),
        ("omega_0", np.inf, "omega of splat 0 cannot be used"),
        ("trbf_center", np.nan, "centre in time of splat 0 cannot be used"),
        ("trbf_scale", np.nan, "width in time of splat 0 cannot be used"),
        ("x", np.nan, "means[0]"),
    ],
)
def test_broken_splats_are_named_or_left_out(column: str, value: float, words: str) -> None:
    first_two = {column: np.r_[value, value, np.full(len(TIMED) - 2, 0.1)]}
    data = spacetime_ply_bytes(TIMED, **first_two)
    with pytest.raises(SceneError, match=r"repair=drop") as caught:
        parse_spacetime_ply(data, "some/file")
    assert words in str(caught.value)
    dropped = parse_spacetime_ply(data, "some/file", DropBroken())
    assert dropped.splats.log_scales == pytest.approx(TIMED.splats.log_scales[2:], abs=1e-6)
    assert dropped.omega[:, 1] == pytest.approx(TIMED.omega[2:, 1])


def test_a_width_of_zero_is_refused() -> None:
    zero = replace(TIMED, widths=np.r_[0.0, TIMED.widths[1:]])
    with pytest.raises(SceneError, match="width in time of splat 0"):
        parse_splatv(splatv_bytes(zero), "f")


def test_an_empty_moment_is_held_by_the_brightest() -> None:
    assert len(TIMED.alive(50.0)) == 0
    assert len(TIMED.at(50.0, TIMED.brightest(50.0), "clip")) == 1


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is not a .splatv file"),
        (struct.pack("<II", 7, 0), "is not a .splatv file"),
        (struct.pack("<II", MAGIC, 1 << 31), "claims 2147483648 bytes of JSON"),
        (struct.pack("<II", MAGIC, 2) + b"{x", "is not JSON"),
        (struct.pack("<II", MAGIC, 2) + b"{}", "must be a list of at most 64 chunks"),
        (splatv_bytes(TIMED, [{"type": "splat", "size": True}]), "needs a type and a size"),
        (splatv_bytes(TIMED, [{"type": "splat", "size": -64}]), "needs a type and a size"),
        (splatv_bytes(TIMED, [{"type": "splat", "size": 65}]), "not a multiple of 64"),
        (splatv_bytes(TIMED, [{"type": "splat", "size": 1 << 40}]), "is cut short"),
        (splatv_bytes(TIMED, [{"type": "splat", "size": 0}]), "holds no splats"),
        (splatv_bytes(TIMED, [{"type": "note", "size": 3}]), "has no chunk 'splat'"),
        (splatv_bytes(TIMED, ["splat"]), "needs a type and a size"),
    ],
)
def test_damaged_containers_are_refused_in_a_line(data: bytes, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        parse_splatv(data, "some/file")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_ply_that_lacks_a_property_is_refused() -> None:
    data = spacetime_ply_bytes(TIMED).replace(b"omega_3", b"gamma_3")
    with pytest.raises(SceneError, match="has no property 'omega_3'"):
        parse_spacetime_ply(data, "f")
