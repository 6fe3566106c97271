"""``--restore auto``: the dearest tier that this machine can afford, chosen by measurement and kept to while it lasts.

:class:`TierController` is pure: times go in, the tier to use comes out. It knows what each tier costs on this machine
(measured before play) and what the rest of a frame takes (measured while playing). It steps down at once when frames
take longer than they may, and up only after frames would have had room for the dearer tier for a while; each step up
that had to be taken back doubles that while, so that a machine at the edge does not flicker between two looks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cags_client import align
from cags_client.align import ReferencePicture
from cags_client.restore.base import RestoreInput, Restorer
from cags_common.effects import Effect
from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera, Intrinsics, Pose
from cags_common.raster.base import RenderedView

NAME = "auto"

LADDER = ("none", "affine", "lite")
"""Tiers to choose from, cheapest first; none is both dearer and worse than another."""

DOWN_SHARE = 1.0
"""Of the frame time: frames that take longer are late, and the tier is stepped down."""

UP_SHARE = 0.8
"""Of the frame time: what a frame with the dearer tier may take, by what is known, to step up."""

DOWN_AFTER_S = 0.25
UP_AFTER_S = 2.0
UP_AFTER_MOST_S = 32.0
SMOOTHING_S = 0.3
"""Time constant of the running means of what frames take."""

SHORTEST_MS = 0.5
"""Tiers that take less say nothing about the machine's load."""

FORGETTING = 0.1
"""How much slower than others' means the load is forgotten."""

SLOWEST_SHARE = 4.0
"""Of the frame time: a tier that took longer once is not timed again."""

REFERENCE_PX = (400, 300)


@dataclass(frozen=True)
class Tier:
    """A restorer by name, and the milliseconds that one picture takes it on this machine."""

    name: str
    cost_ms: float


@dataclass(eq=False)
class TierController:
    """Chooses among ``tiers``, cheapest first, for frames of ``frame_ms``."""

    tiers: Sequence[Tier]
    frame_ms: float
    rest_ms: float = 0.0
    """What a frame takes beside restoring, as far as it is known."""
    _place: int = field(default=-1, init=False)
    _load: float = field(default=1.0, init=False)
    """What tiers take now over what they took when they were measured."""
    _last_s: float | None = field(default=None, init=False)
    _over_since_s: float | None = field(default=None, init=False)
    _room_since_s: float | None = field(default=None, init=False)
    _stepped_up_s: float | None = field(default=None, init=False)
    _patience_s: float = field(default=UP_AFTER_S, init=False)

    def __post_init__(self) -> None:
        if not self.tiers:
            raise ConfigError("restore = 'auto': no tier to choose from")
        self._place = self._dearest_that_fits()

    @property
    def name(self) -> str:
        """The tier in use."""
        return self.tiers[self._place].name

    def observe(self, now_s: float, restore_ms: float | None, frame_ms: float) -> str:
        """A frame was shown at ``now_s``; it took ``frame_ms``, ``restore_ms`` of it to restore (None: nothing was).

        Returns the tier for the next frame.
        """
        share = self._share(now_s)
        self.rest_ms += share * (frame_ms - (restore_ms or 0.0) - self.rest_ms)
        usual_ms = self.tiers[self._place].cost_ms
        if restore_ms is None or usual_ms < SHORTEST_MS:  # nothing is known of the load: it is forgotten, slowly
            self._load += share * FORGETTING * (1.0 - self._load)
        else:
            self._load += share * (restore_ms / usual_ms - self._load)
        if self._over(now_s):
            self._step_down(now_s)
        elif self._room(now_s):
            self._step_up(now_s)
        return self.name

    def _share(self, now_s: float) -> float:
        passed = SMOOTHING_S if self._last_s is None else max(now_s - self._last_s, 0.0)
        self._last_s = now_s
        return 1.0 - float(np.exp(-passed / SMOOTHING_S))

    def _takes(self, place: int) -> float:
        return self.rest_ms + self.tiers[place].cost_ms * self._load

    def _dearest_that_fits(self) -> int:
        fitting = [i for i in range(len(self.tiers)) if self._takes(i) <= UP_SHARE * self.frame_ms]
        return max(fitting, default=0)

    def _over(self, now_s: float) -> bool:
        if self._place == 0 or self._takes(self._place) <= DOWN_SHARE * self.frame_ms:
            self._over_since_s = None
            return False
        self._over_since_s = now_s if self._over_since_s is None else self._over_since_s
        return now_s - self._over_since_s >= DOWN_AFTER_S

    def _room(self, now_s: float) -> bool:
        above = self._place + 1
        if above >= len(self.tiers) or self._takes(above) > UP_SHARE * self.frame_ms:
            self._room_since_s = None
            return False
        self._room_since_s = now_s if self._room_since_s is None else self._room_since_s
        return now_s - self._room_since_s >= self._patience_s

    def _step_down(self, now_s: float) -> None:
        hasty = self._stepped_up_s is not None and now_s - self._stepped_up_s < 2 * self._patience_s
        self._patience_s = min(2 * self._patience_s, UP_AFTER_MOST_S) if hasty else UP_AFTER_S
        self._place -= 1
        self._over_since_s = self._room_since_s = self._stepped_up_s = None

    def _step_up(self, now_s: float) -> None:
        self._place += 1
        self._over_since_s = self._room_since_s = None
        self._stepped_up_s = now_s


class AutoRestorer:
    """The restorer that :class:`TierController` points at."""

    name = NAME

    def __init__(self, restorers: Sequence[Restorer], controller: TierController) -> None:
        self._restorers = {tier.name: one for tier, one in zip(controller.tiers, restorers, strict=True)}
        self.controller = controller

    @property
    def tier(self) -> str:
        """Name of the restorer in use."""
        return self.controller.name

    @property
    def needs(self) -> frozenset[Effect]:
        """See :class:`cags_client.restore.base.Restorer`."""
        return self._restorers[self.tier].needs

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.restore.base.Restorer`."""
        return self._restorers[self.tier].restore(inputs)


def measured(
    make: Callable[[str], Restorer],
    intrinsics: Intrinsics,
    frame_ms: float,
    clock: Callable[[], float] = time.perf_counter,
) -> AutoRestorer:
    """Time the tiers of :data:`LADDER` that ``make`` can give on pictures of the display's size.

    Tiers whose weights or packages are missing, and those that come after one that is far too slow, are left out.
    ``clock`` is in seconds.
    """
    inputs = _picture(intrinsics)
    tiers: list[Tier] = []
    restorers: list[Restorer] = []
    for name in LADDER:
        try:
            restorer = make(name)
        except ConfigError:
            continue
        cost_ms = _cost_ms(restorer, inputs, SLOWEST_SHARE * frame_ms, clock)
        tiers.append(Tier(name, cost_ms))
        restorers.append(restorer)
        if cost_ms > SLOWEST_SHARE * frame_ms:
            break
    return AutoRestorer(restorers, TierController(tiers, frame_ms, rest_ms=frame_ms / 4))


def _cost_ms(restorer: Restorer, inputs: RestoreInput, enough_ms: float, clock: Callable[[], float]) -> float:
    """The least of three, after one to warm up; one alone where that took ``enough_ms`` already."""
    times: list[float] = []
    while len(times) < 4 and (not times or times[0] <= 2 * enough_ms):
        given = inputs.afresh()
        start = clock()
        restorer.restore(given)
        times.append((clock() - start) * 1e3)
    return min(times)


def _picture(intrinsics: Intrinsics) -> RestoreInput:
    """A frame with something to do everywhere: noise on a flat wall, a reference from a step aside."""
    rng = np.random.default_rng(0)
    (w, h), size = REFERENCE_PX, (intrinsics.height_px, intrinsics.width_px)
    fx, fy = intrinsics.fx_px * w / intrinsics.width_px, intrinsics.fy_px * h / intrinsics.height_px
    pose = Pose.identity()
    seen = Camera(Intrinsics(w, h, fx, fy, w / 2, h / 2), replace(pose, position=(0.02, 0.0, 0.0)))
    distorted = rng.random((*size, 3), dtype=np.float32)
    reference = ReferencePicture(rng.random((h, w, 3), dtype=np.float32), seen, 0)
    depth = np.full(size, 2.0, np.float32)
    aligned = align.create("auto").align(reference, depth, Camera(intrinsics, pose))
    own = RenderedView(rng.random((h, w, 3), dtype=np.float32), np.ones((h, w), np.float32), None, None)
    return RestoreInput(distorted, np.ones(size, np.float32), aligned, reference, own)
