"""Motion that is hard to code, from clip to bundle and back: who is there is exact, and where they are within bounds.

The bound on positions is what docs/motion.md says of the finest level: half a unit of motion beside half a step of the
tile's grid, at any frame, joined anywhere.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.errors import CagsError
from cags_common.splats import Splats
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.payloads import decode_base
from cags_common.tiles.svq import CodebookSet
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import Focus
from support.codec_scenes import cloud, with_changes

FAST = EncodeSettings(train_splats=1000, lod_order="paper")
FRAMES = 24
SPLATS = 200


@dataclass(frozen=True)
class Clip:
    """Frames and whose rows they are."""

    frames: tuple[tuple[Splats, np.ndarray], ...]
    name = "clip"
    fps = 30.0
    up = (0.0, 1.0, 0.0)
    focus = Focus((0.0, 0.0, 0.0), 1.0)

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, index: int) -> Splats:
        return self.frames[index][0]

    def ids(self, index: int) -> np.ndarray:
        return self.frames[index][1]


def clip(change: Callable[[Splats, int], Splats], alive: Callable[[int], np.ndarray] | None = None) -> Clip:
    """``change(first, frame)`` of a cloud; rows ``alive(frame)`` of it."""
    first = cloud(SPLATS, 7)
    out = []
    for k in range(FRAMES):
        rows = np.arange(SPLATS) if alive is None else np.flatnonzero(alive(k))
        out.append((change(first, k).take(rows).checked(f"frame {k}"), rows.astype(np.int32)))
    return Clip(tuple(out))


def shifted(amount: Callable[[int], np.ndarray]) -> Callable[[Splats, int], Splats]:
    return lambda first, k: with_changes(first, means=first.means + amount(k))


def spun(first: Splats, k: int) -> Splats:
    """A quarter turn every two frames, through every multiple of 180 degrees."""
    half = np.pi / 8 * k
    w, x, y, z = first.quats.astype(np.float64).T
    a, b = np.cos(half), np.sin(half)
    quats = np.stack([a * w - b * x, a * x + b * w, a * y - b * z, a * z + b * y], axis=1)
    quats *= np.where(quats[:, :1] < 0, -1.0, 1.0)
    return with_changes(first, quats=quats)


def fading(last: int) -> Callable[[Splats, int], Splats]:
    """Half of them fade by a Gaussian of the time until frame ``last``, and stay as they are then."""

    def change(first: Splats, k: int) -> Splats:
        falls = 0.9 * np.exp(-0.5 * (min(k, last) / (0.6 * last)) ** 2)
        alpha = np.where(np.arange(SPLATS) % 2, 0.9, falls)
        return with_changes(first, logit_opacities=np.log(alpha / (1 - alpha)))

    return change


CASES: dict[str, Clip] = {
    "still": clip(lambda first, k: first),
    "one frame twice": clip(shifted(lambda k: np.array([0.01 * (k // 2), 0, 0]))),
    "as little as nothing": clip(shifted(lambda k: np.array([1e-9 * k, 0, 0]))),
    "slow and linear": clip(shifted(lambda k: np.array([0.003 * k, 0, 0]))),
    "far in one frame": clip(shifted(lambda k: np.array([5.0 * (k > 9), 0, 0]))),
    "a million sizes": clip(shifted(lambda k: np.array([2e4 * (k > 9), 0, 0]))),
    "one leaves for good": clip(shifted(lambda k: np.where(np.arange(SPLATS)[:, None] == 1, 90.0 * k, 0.001 * k))),
    "back and forth": clip(shifted(lambda k: np.array([0.3 * (-1) ** k, 0.1 * (k % 3), 0]))),
    "spinning": clip(spun),
    "one place": clip(lambda first, k: with_changes(first, means=np.zeros_like(first.means) + np.float32(0.01 * k))),
    "lives of one frame": clip(lambda first, k: first, lambda k: np.arange(SPLATS) % FRAMES == k),
    "comes and goes": clip(shifted(lambda k: np.array([0.01 * k, 0, 0])), lambda k: (np.arange(SPLATS) + k) % 7 > 1),
    "half goes at once": clip(
        shifted(lambda k: np.array([0.01 * k, 0, 0])), lambda k: np.arange(SPLATS) % 2 <= (k < 11)
    ),
    "all but one go": clip(lambda first, k: first, lambda k: np.arange(SPLATS) < (SPLATS if k < 12 else 1)),
}


def covariances(splats: Splats) -> np.ndarray:
    w, x, y, z = splats.quats.astype(np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    turn = np.moveaxis(np.array(rows), -1, 0)
    return np.einsum("nij,nj,nkj->nik", turn, np.exp(2 * splats.log_scales.astype(np.float64)), turn)


def errors(reader: BundleReader, player: BundlePlayer, frame: int) -> tuple[float, float, float]:
    """Largest error of positions (in units of motion), of opacities, and of covariances (relative)."""
    shown, true = player.frame(frame), reader.source(frame)
    assert np.array_equal(shown.ids, true.ids), f"frame {frame}: others are there"
    assert reader.manifest.motion is not None
    unit = max(reader.manifest.motion.moves)
    away = np.abs(shown.splats.means.astype(np.float64) - true.splats.means).max(initial=0.0) / unit
    alpha = [1 / (1 + np.exp(-s.logit_opacities.astype(np.float64))) for s in (shown.splats, true.splats)]
    a, b = covariances(shown.splats), covariances(true.splats)
    size = np.linalg.norm(b, axis=(1, 2))
    shape = float((np.linalg.norm(a - b, axis=(1, 2)) / size).max(initial=0.0))
    return float(away), float(np.abs(alpha[0] - alpha[1]).max(initial=0.0)), shape


@pytest.mark.parametrize("name", CASES)
def test_everybody_is_where_they_should_be(name: str, tmp_path: Path) -> None:
    encode(CASES[name], FAST, str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        through = BundlePlayer(reader)
        first = errors(reader, through, 0)
        for frame in range(1, FRAMES):
            away, opacity, shape = errors(reader, through, frame)
            assert away <= 4.0, frame  # units: half a unit, on a line within one, and the grid of the looks
            assert opacity <= max(first[1], 0.01) + 0.07, frame  # fades are told to 0.06
            assert shape <= first[2] + 0.35, frame


@pytest.mark.parametrize("name", CASES)
def test_who_joins_in_the_middle_sees_what_others_see(name: str, tmp_path: Path) -> None:
    encode(CASES[name], FAST, str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        through = BundlePlayer(reader)
        for frame in (0, 5, 17, FRAMES - 1):
            seen, joined = through.frame(frame), BundlePlayer(reader).frame(frame)
            for (what, a), (_, b) in zip(seen.splats.arrays(), joined.splats.arrays(), strict=True):
                assert np.array_equal(a, b), (frame, what)


def test_what_stands_still_sends_nothing(tmp_path: Path) -> None:
    encode(CASES["still"], FAST, str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        assert [len(reader.frame(k).tiles) for k in range(FRAMES)] == [1] + [0] * (FRAMES - 1)


def test_splats_that_have_gone_cost_nothing_more(tmp_path: Path) -> None:
    encode(clip(lambda first, k: first, lambda k: np.arange(SPLATS) >= (k > 2)), FAST, str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        assert [len(reader.frame(k).tiles) for k in range(FRAMES)] == [2] + [0] * (FRAMES - 1)
        assert len(BundlePlayer(reader).frame(FRAMES - 1).ids) == SPLATS - 1


def test_linear_motion_is_told_once_a_span(tmp_path: Path) -> None:
    encode(CASES["slow and linear"], FAST, str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        kinds = [tile.kind for k in range(FRAMES) for tile in reader.frame(k).tiles]
        assert kinds.count(TileKind.LOOKS) == 1 and kinds.count(TileKind.UPDATE) == 0
        assert 2 <= kinds.count(TileKind.MOTION) <= 3


def test_new_splats_that_move_come_with_coarse_positions_and_their_chunk_makes_them_exact(tmp_path: Path) -> None:
    first = cloud(SPLATS, 7)
    frames = []
    for k in range(6):
        rows = np.arange(SPLATS if k else SPLATS // 2)
        frames.append(
            (with_changes(first, means=first.means + np.float32([0.01 * k, 0, 0])).take(rows), rows.astype(np.int32))
        )
    encode(Clip(tuple(frames)), FAST, str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        looks = next(tile for tile in reader.frame(1).tiles if tile.kind == TileKind.LOOKS)
        base = decode_base(reader.payload(1, looks.tile, 0), CodebookSet.from_bytes(reader.codebooks()))
        true, shown = reader.source(1), BundlePlayer(reader).frame(1)
        rows = np.searchsorted(true.ids, base.ids)
        off = [np.median(np.abs(means - true.splats.means[rows])) for means in (base.means, shown.splats.means[rows])]
        assert off[0] > 2 * off[1]
        assert errors(reader, BundlePlayer(reader), 1)[0] <= 2.0


def test_an_attribute_that_changes_is_sent_by_itself(tmp_path: Path) -> None:
    def coloured(first: Splats, k: int) -> Splats:
        sh0 = first.sh0.copy()
        sh0[:50] += np.float32(1.0 if k >= 9 else 0.0)
        return with_changes(first, sh0=sh0)

    encode(clip(coloured), FAST, str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        tiles = [(k, tile) for k in range(1, FRAMES) for tile in reader.frame(k).tiles]
        assert [(k, tile.kind) for k, tile in tiles] == [(9, TileKind.UPDATE)]
        update = reader.open_tile(9, 0)
        changed = {name: int(mask.sum()) for name, mask in update.changed.items() if mask.any()}
        assert changed.keys() == {"sh0"} and 45 <= changed["sh0"] <= 50  # a faint one's may not be worth it


@pytest.mark.parametrize("speed", [0.006, 0.025])
def test_splats_whose_axes_change_their_order_are_never_shown_as_they_will_be(speed: float, tmp_path: Path) -> None:
    """Codes list the longest axis first, so such splats are sent whole, without a ramp: what a ramp would have reached
    many frames later was seen at once, in every other frame.
    """
    rng = np.random.default_rng(5)
    sizes = np.stack([rng.normal(-3.45, 0.15, SPLATS), rng.normal(-3.0, 0.1, SPLATS), np.full(SPLATS, -4.5)], axis=1)

    def growing(first: Splats, k: int) -> Splats:
        scales = sizes + np.array([speed * k, 0.0, 0.0])
        sh0 = first.sh0 + np.float32(0.02 * k)
        opaque = np.full(SPLATS, 3.0)
        return with_changes(first, log_scales=scales, sh0=sh0, logit_opacities=opaque)

    encode(clip(growing), EncodeSettings(train_splats=4800, lod_order="paper"), str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        player = BundlePlayer(reader)
        for frame in range(FRAMES):
            shown, true = player.frame(frame), reader.source(frame)
            a, b = covariances(shown.splats), covariances(true.splats)
            off = np.linalg.norm(a - b, axis=(1, 2)) / np.linalg.norm(b, axis=(1, 2))
            assert off.mean() < 0.03, f"frame {frame}"
            assert np.abs(shown.splats.sh0 - true.splats.sh0).mean() < 0.08, f"frame {frame}"


def test_a_scene_that_no_bundle_can_hold_leaves_the_bundle_before_in_its_place(tmp_path: Path) -> None:
    out, first = str(tmp_path / "out"), cloud(SPLATS, 7)
    encode([first], FAST, out)
    with pytest.raises(CagsError, match=r"focus has a radius of .* larger units"):
        encode([with_changes(first, means=first.means * np.float32(1e14))], FAST, out)
    encode([with_changes(first, log_scales=first.log_scales + 40)], FAST, str(tmp_path / "large"))
    with BundleReader.open(out) as reader:
        assert len(BundlePlayer(reader).frame(0).ids) == SPLATS


def test_how_wrong_old_attributes_are_is_measured_by_how_long_updates_are_lacked(tmp_path: Path) -> None:
    """Colours that go on changing are the more wrong the longer; those that change once stay as wrong as they are."""

    def coloured(of: Callable[[int], float]) -> Callable[[Splats, int], Splats]:
        return lambda first, k: with_changes(first, sh0=first.sh0 + np.float32(of(k)))

    found = []
    for number, of in enumerate((lambda k: 0.2 * k, lambda k: 1.0 if k >= 9 else 0.0)):
        encode(clip(coloured(of)), EncodeSettings(train_splats=4800), str(tmp_path / f"{number}"))
        with BundleReader.open(str(tmp_path / f"{number}")) as reader:
            found.append(dict(reader.manifest.outdated_psnr_db))
    more, once = found
    assert more[1] - more[4] > 6.0 and more[4] > more[8], "four times as far off"
    assert max(once.values()) - min(once.values()) < 1.0
    encode(clip(lambda first, _: first), EncodeSettings(train_splats=4800), str(tmp_path / "still"))
    with BundleReader.open(str(tmp_path / "still")) as reader:
        assert reader.manifest.outdated_psnr_db == ()


def test_ids_of_the_source_that_swap_are_two_splats_that_cross(tmp_path: Path) -> None:
    first = cloud(SPLATS, 7)
    swapped = np.arange(SPLATS, dtype=np.int32)
    swapped[[3, 4]] = 4, 3
    frames = tuple((first, np.arange(SPLATS, dtype=np.int32) if k < 8 else swapped) for k in range(FRAMES))
    encode(Clip(frames), FAST, str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        player = BundlePlayer(reader)
        for frame in (7, 8, 20):
            assert errors(reader, player, frame)[0] <= 4.0


def test_a_cut_begins_a_group(tmp_path: Path) -> None:
    one, other = cloud(SPLATS, 7), cloud(SPLATS, 8)
    encode([one] * 5 + [other] * 5, replace(FAST, frames=10), str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        assert reader.manifest.gof_starts == (0, 5)


@pytest.mark.parametrize("last", [9, 14])
def test_a_fade_that_is_over_leaves_the_opacity_that_there_is(last: int, tmp_path: Path) -> None:
    encode(clip(fading(last)), FAST, str(tmp_path / "out"))
    with BundleReader.open(str(tmp_path / "out")) as reader:
        chunks = [(k, t) for k in range(FRAMES) for t in reader.frame(k).tiles if t.kind == TileKind.MOTION]
        fades = [reader.open_tile(k, t.tile).chunk.fades is not None for k, t in chunks]
        assert fades[0], "it fades by its motion"
        over = chunks[len(fades) - fades[::-1].index(True) - 1]
        player = BundlePlayer(reader)
        for frame in range(over[0] + over[1].span + 1, FRAMES):
            assert errors(reader, player, frame)[1] <= 0.03, frame
