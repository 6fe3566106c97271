"""Verification of bundles whose levels add splats, and of those whose levels must not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.bundle.player import DecodedFrame
from cags_common.errors import BundleError
from cags_common.splats import Ids
from cags_encoder import EncodeSettings, encode
from cags_encoder.bundles.verify import verify
from support.codec_scenes import cloud, with_changes

FRAMES = 5


def bundle(codec: str, out: Path) -> BundleReader:
    """Two groups of frames; a part of the splats changes, and another comes in the second frame."""
    frames = []
    for i in range(FRAMES):
        some = (np.arange(400) < 80)[:, None]
        splats = cloud(400, 1)
        frames.append(with_changes(splats, sh0=splats.sh0 + np.float32(0.3 * i) * some).take(slice(60 * (i < 1), 400)))
    encode(frames, EncodeSettings(train_splats=1000, lod_order="paper", gof_frames=3, codec=codec), str(out))
    return BundleReader.open(str(out))


@pytest.mark.parametrize("codec", ["density", "video", "svq"])
def test_good_bundles_of_every_codec_verify(codec: str, tmp_path: Path) -> None:
    with bundle(codec, tmp_path / "a.cags") as reader:
        base, top = BundlePlayer(reader, 0).frame(0), BundlePlayer(reader).frame(0)
        assert (len(base.ids) < len(top.ids)) == (codec == "density")
        assert verify(reader, "a.cags", lambda done, total: None) > FRAMES


def with_base_ids(monkeypatch: pytest.MonkeyPatch, at: int, changed: Callable[[Ids], Ids]) -> None:
    """Let LoD 0 of frame ``at`` have other ids."""
    whole = BundlePlayer.frame

    def frame(self: Any, index: int) -> DecodedFrame:
        found = whole(self, index)
        return found if index != at or self._lod else replace(found, ids=changed(found.ids))

    monkeypatch.setattr(BundlePlayer, "frame", frame)


@pytest.mark.parametrize(
    ("codec", "at", "changed"),
    [
        ("svq", 0, lambda ids: ids[:-1]),
        ("svq", 1, lambda ids: ids[1:]),
        ("svq", 4, lambda ids: ids[:-1]),
        ("svq", 4, lambda ids: np.append(ids, 1 << 20)),
        ("density", 1, lambda ids: np.append(ids, 1 << 20)),
    ],
)
def test_a_splat_that_one_level_lacks_is_found(
    codec: str, at: int, changed: Callable[[Ids], Ids], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a codec whose levels add no splats, or one that the highest level lacks."""
    with bundle(codec, tmp_path / "a.cags") as reader:
        with_base_ids(monkeypatch, at, changed)
        with pytest.raises(BundleError, match=f"frame {at}: LoD 0 and the highest LoD have different splats"):
            verify(reader, "a.cags", lambda done, total: None)
