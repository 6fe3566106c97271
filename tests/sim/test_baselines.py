"""Every method that is compared works: whole sessions in virtual time, frame after frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cags_bench.reproduce.methods import METHODS, Method
from support.baseline_checks import (
    LONG_FRAMES,
    UNLIMITED,
    check_everything_is_shown,
    check_labels,
    check_more_is_never_worse,
    check_published,
    play,
)

RATES = ("generated:steady-0.4", "generated:steady-1.5", "generated:steady-6", UNLIMITED)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("bundles"))


@pytest.mark.parametrize("name", METHODS)
def test_a_stream_of_everything_shows_what_the_bundle_decodes_to(name: str, cache: str) -> None:
    """V3-A stood still for months, and was compared with."""
    if METHODS[name].client.get("restore") == "srresnet":
        pytest.importorskip("torch")
    check_everything_is_shown(name, play(METHODS[name], cache))


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_more_bandwidth_is_never_worse(name: str, cache: str) -> None:
    """For one who stands still: pictures that are sharper at a wrong pose are further from the right one."""
    if METHODS[name].client.get("restore") == "srresnet":
        pytest.importorskip("torch")
    played = [
        (link, play(METHODS[name], cache, link=link, poses="synthetic:still", frames=LONG_FRAMES)) for link in RATES
    ]
    check_more_is_never_worse(name, played)


def test_every_method_is_what_its_name_says() -> None:
    check_labels(METHODS)


def test_as_published_is_as_published() -> None:
    check_published(METHODS["cags-paper"])


def test_a_published_session_erodes_restores_by_the_network_and_sends_pictures_alone(
    cache: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not what the settings say, but what was done."""
    pytest.importorskip("torch")
    from cags_client.frame.align.fast import FastAligner
    from cags_research.restore.networks.restorer import PictureRestorer
    from cags_server.fov.lstm import LstmFov

    eroded, gains, restored = [], [], []
    align, made, restore = FastAligner.align, LstmFov.__init__, PictureRestorer.restore

    def aligning(self, *given, colours=False, **named):  # type: ignore[no-untyped-def]
        eroded.append((colours, self._settings.erosion_iterations))
        return align(self, *given, colours=colours, **named)

    def making(self, gain, weights):  # type: ignore[no-untyped-def]
        gains.append(gain)
        made(self, gain, weights)

    def restoring(self, inputs):  # type: ignore[no-untyped-def]
        restored.append(self.name)
        return restore(self, inputs)

    monkeypatch.setattr(FastAligner, "align", aligning)
    monkeypatch.setattr(LstmFov, "__init__", making)
    monkeypatch.setattr(PictureRestorer, "restore", restoring)
    play(METHODS["cags-paper"], cache, link="generated:steady-0.3")
    assert set(restored) == {"srresnet"}
    assert eroded
    assert all(colours and rounds > 0 for colours, rounds in eroded)
    assert set(gains) == {1.0}


def test_kept_results_depend_on_the_code_of_every_method(monkeypatch: pytest.MonkeyPatch) -> None:
    """Codecs, policies and networks of the baselines were no part of a result's key: a repaired one changed nothing."""
    from cags_bench.reproduce.cache import PACKAGES

    parts = {Path(name.replace(".", "/")).parts[0] for name in PACKAGES}
    assert {"cags_research", "cags_server", "cags_client", "cags_common", "cags_encoder"} <= parts


CODECS = {
    "layered": {},
    "as published": {"quantiser": "paper-66"},
    "density": {"codec": "density"},
    "video": {"codec": "video"},
}


@pytest.mark.slow
@pytest.mark.parametrize("codec", CODECS)
def test_only_the_effects_needed_show_what_all_of_them_do(codec: str, cache: str) -> None:
    """Either way: what is left out must neither have been worth something nor have done harm."""
    needed, always = (
        play(Method(codec, "", encode=CODECS[codec], client={"effects": effects}), cache)
        for effects in ("needed", "always")
    )
    assert np.mean(needed.shown_db) == pytest.approx(np.mean(always.shown_db), abs=0.05)
