"""What every streaming method must do before it is compared with: checks that raise :class:`AssertionError`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from cags_bench.bundles import cached_bundle
from cags_bench.reproduce.methods import METHODS, Method
from cags_bench.sim.session import Scenario, simulate
from cags_client.settings import ClientSettings
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.geometry import F32, Camera
from cags_common.metrics import psnr
from cags_common.raster.base import RenderOptions
from cags_encoder import EncodeSettings
from cags_server.settings import ServerSettings

FRAMES, SIZE = 10, (160, 120)
SCENE = "procedural:size=1200,frames={frames}"

UNLIMITED = "generated:steady-1000"
"""A link that brings a whole frame within a millisecond."""

DECODED_DB = 55.0
"""What a client holds is at least so near to what the bundle decodes to: what came after a reference's mark is shown a
frame later."""

BEGUN, BEGINNING_DB = 6, 40.0
"""Frames that are shown within the lead of the first plan; one of them may be shown without its own changes."""

LONG_FRAMES = 40
"""Frames of a longer play, at a natural pace. Ten frames all fall within the start of a play, and squeeze the scene's
whole motion into a third of a second."""

VIDEO_DB = 24.0
"""What remote rendering shows of a scene that is all fine detail, over any link that carries it: a video of so many
pixels as the display has, a tenth wider and in 4:2:0."""

NEVER_WORSE_DB = {"splats": 0.1, "video": 1.0}
"""What more bandwidth may cost in the mean: nothing but the moment at which the play begins, where splats alone are
shown; what one coding of a video differs from another by, where pictures take part."""


@dataclass
class Played:
    """What a session showed, frame by frame."""

    shown_db: list[float] = field(default_factory=list)
    """Against the truth."""
    decoded_db: list[float] = field(default_factory=list)
    """The client's own picture, against what the bundle decodes to from the same camera; 99 where they are equal."""
    changed: list[float] = field(default_factory=list)
    """Root mean square by which what is shown differs from the frame before."""
    truth_changed: list[float] = field(default_factory=list)
    missed: int = 0


class Decoded:
    """What a bundle decodes to at its highest level, frame by frame."""

    def __init__(self, bundle: Path) -> None:
        rasteriser = raster.create("cpu")
        with BundleReader.open(str(bundle)) as reader:
            player = BundlePlayer(reader)
            self._scenes = [rasteriser.load(player.frame(index).splats) for index in range(reader.manifest.frames)]

    def seen(self, frame: int, camera: Camera) -> F32:
        """The frame's picture from ``camera``."""
        return self._scenes[frame].render(camera, RenderOptions(threads=1)).rgb


def play(
    method: Method, cache: str, *, link: str = UNLIMITED, poses: str = "synthetic:walking", frames: int = FRAMES
) -> Played:
    """Play the small scene by ``method``; its encodings are kept in ``cache``. The scene makes the same
    movement however few ``frames`` there are."""
    bundle = cached_bundle(SCENE.format(frames=frames), cache, _encoding(method, frames), progress=False)
    decoded, out = Decoded(bundle), Played()
    before: list[F32] = []

    def watch(presented, record):  # type: ignore[no-untyped-def]
        wanted = decoded.seen(presented.frame, presented.camera)
        same = float(psnr(presented.drawn, wanted)) if not np.array_equal(presented.drawn, wanted) else 99.0
        out.decoded_db.append(min(same, 99.0))
        out.shown_db.append(record["psnr_restored_db"])
        if before:
            out.changed.append(_rms(presented.rgb - before[0]))
            out.truth_changed.append(_rms(wanted - before[1]))
        before[:] = presented.rgb, wanted

    width, height = SIZE
    scenario = Scenario(
        bundle,
        link,
        poses,
        server=replace(ServerSettings(rasteriser="cpu", render_threads=1), **method.server),
        client=replace(ClientSettings(width=width, height=height, raster="cpu", threads=1), **method.client),
        estimator="oracle",
    )
    out.missed = simulate(scenario, watch).summary["frames_missed"]
    return out


def _encoding(method: Method, frames: int) -> EncodeSettings:
    usual = EncodeSettings(frames=frames, train_splats=1024)
    return replace(usual, **{"lod_order": "paper", **method.encode})


def _rms(difference: F32) -> float:
    return float(np.sqrt(np.mean(np.square(difference))))


def sends_splats(name: str) -> bool:
    """Whether a method is more than a video."""
    return METHODS[name].server.get("abr") != "none"


def check_everything_is_shown(name: str, played: Played) -> None:
    """Over a link without limit every frame's splats are those of the bundle, and what is shown moves with them."""
    assert len(played.shown_db) == FRAMES, f"{name}: {len(played.shown_db)} of {FRAMES} frames were shown"
    if sends_splats(name):
        assert played.missed == 0, f"{name}: {played.missed} frames were shown without their data"
        for frame, found in enumerate(played.decoded_db):
            wanted = BEGINNING_DB if frame < BEGUN else DECODED_DB
            assert found >= wanted, f"{name}: frame {frame} holds other splats than the bundle ({found:.1f} dB)"
    else:
        assert np.mean(played.shown_db) >= VIDEO_DB, f"{name}: {np.mean(played.shown_db):.1f} dB over any link"
    for frame, (shown, true) in enumerate(zip(played.changed, played.truth_changed, strict=True), start=1):
        assert shown >= 0.5 * true, f"{name}: frame {frame} changed by {shown:.4f} where the scene did by {true:.4f}"


def check_more_is_never_worse(name: str, by_rate: Sequence[tuple[str, Played]]) -> None:
    """Each faster link, in order, shows at least as much as every slower one."""
    pure = METHODS[name].client.get("restore") == "none"
    allowed = NEVER_WORSE_DB["splats" if pure else "video"]
    best, at = -np.inf, ""
    for link, played in by_rate:
        mean = float(np.mean(played.shown_db))
        assert mean >= best - allowed, f"{name}: {mean:.2f} dB over {link}, {best:.2f} dB over {at}"
        if mean > best:
            best, at = mean, link


def check_published(method: Method) -> None:
    """The way called "as published" is that of the paper, part by part."""
    server, client = dict(method.server), dict(method.client)
    wanted = {
        "quantiser": (method.encode, "paper-66"),
        "lod_order": (method.encode, "paper"),
        "abr": (server, "paper"),
        "fov": (server, "lstm-mean-error"),
        "lead_frames": (server, 6),
        "poor_lead_frames": (server, 6),
        "references": (server, "picture"),
        "reference_footprint": (server, "plain"),
        "restore": (client, "srresnet"),
        "erosion": (client, True),
    }
    for name, (given, value) in wanted.items():
        assert given.get(name) == value, f"as published: {name} is {given.get(name)!r} where the paper has {value!r}"
    extra = (set(method.encode) | set(server) | set(client)) - set(wanted)
    assert not extra, f"as published: {', '.join(sorted(extra))} is set too, of which the paper says nothing"


LABELS: dict[str, dict[str, dict[str, object]]] = {
    "lts-f": {"encode": {"codec": "density"}, "client": {"restore": "none"}},
    "lts-f-even": {"encode": {"codec": "density"}, "server": {"abr": "even"}, "client": {"restore": "none"}},
    "v3-a": {"encode": {"codec": "video"}},
    "v3-a-predicted": {"encode": {"codec": "video"}},
    "sr-align-ref": {"server": {"references": "picture"}, "client": {"restore": "sr-align-ref"}},
    "cr-no-ref": {"client": {"restore": "none"}},
    "reference-only": {"server": {"abr": "none", "lead_frames": 2, "reference_full_size": True}},
    "reference-only-small": {"server": {"abr": "none", "lead_frames": 2, "reference_full_size": False}},
    "pictures": {"server": {"references": "picture"}},
    "no-prpa": {"encode": {"quantiser": "paper-66"}, "client": {"align": "unaligned", "restore": "srresnet"}},
    "paper-no-restoration": {"encode": {"quantiser": "paper-66"}, "client": {"restore": "none"}},
    "paper-no-adaptive-fov": {"encode": {"quantiser": "paper-66"}, "server": {"fov": "fixed"}},
    "one-level": {"server": {"abr": "even"}},
    "whole-splats": {"encode": {"motion": "none"}},
    "all-effects": {"client": {"effects": "always"}},
    "printed-order": {"encode": {"lod_order": "paper"}},
    "no-adaptive-fov": {"server": {"fov": "fixed"}},
    "cags-paper": {"encode": {"quantiser": "paper-66"}},
    "cags": {},
}
"""What makes each method that which its name says, by part and setting."""


def check_labels(methods: Mapping[str, Method]) -> None:
    """Every method has what its name says, no two are the same, and ours is set to nothing."""
    assert set(methods) == set(LABELS), f"not described: {', '.join(sorted(set(methods) ^ set(LABELS)))}"
    for name, parts in LABELS.items():
        for part, wanted in parts.items():
            given = getattr(methods[name], part)
            for key, value in wanted.items():
                assert given.get(key) == value, f"{name}: {key} is {given.get(key)!r} and not {value!r}"
    told = [(dict(m.encode), dict(m.server), dict(m.client), m.predicted) for m in methods.values()]
    faster = [name for name, one in methods.items() if one.predicted]
    assert faster == ["v3-a-predicted"], f"{', '.join(faster)}: a faster link than the others'"
    alike = [name for name, one in zip(methods, told, strict=True) if told.count(one) > 1]
    assert not alike, f"{' and '.join(alike)} are one method"
    assert told[list(methods).index("cags")] == ({}, {}, {}, False), "cags: is not what this program does by default"
