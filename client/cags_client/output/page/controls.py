"""What the live page asks of the client: small value types and one protocol.

The client's shell implements :class:`Controls`; tests and examples do with a few lines.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cags_client.settings import FULL
from cags_common.geometry import F32, Camera, Vec3


@dataclass(frozen=True, slots=True)
class SceneInfo:
    """What the page must know of a clip before its first picture."""

    name: str
    frames: int
    fps: float
    up: Vec3
    focus_centre: Vec3
    focus_radius: float
    lods: int
    """Number of levels of detail, the base layer included."""
    near: float = 0.2
    bounds: tuple[Vec3, Vec3] = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
    """Smallest and largest corner of all positions."""
    view: Mapping[str, Any] = field(default_factory=dict)
    """How the author wants the scene to be opened, as :meth:`cags_common.bundle.view.AuthorView.table` gives it."""


@dataclass(frozen=True, eq=False)
class SplatDetail:
    """What the client holds of the splats on display, for the overlays. N rows; rows without a splat have tile -1."""

    means: F32  # [N, 3] world, metres
    tiles: NDArray[np.int32]  # [N] which tile a splat came with
    detail: F32  # [N] share of its layers that the client holds, 0 (base only) to 1


@dataclass(frozen=True, eq=False)
class ShownFrame:
    """One displayed frame with all its intermediate pictures. Arrays must not change after they are handed over."""

    frame: int
    camera: Camera
    pictures: Mapping[str, F32]
    """``restored`` [H, W, 3] and what else there is: ``distorted``, ``correction``, ``reference`` (any size)."""
    planes: Mapping[str, Callable[[], F32 | None]] = field(default_factory=dict)
    """What gives ``depth`` and ``confidence`` when somebody looks at them."""
    occluded: NDArray[np.bool_] | None = None  # [H, W] seen here, hidden from the reference
    reference_camera: Camera | None = None
    stages_ms: Mapping[str, float] = field(default_factory=dict)
    """Time of each stage of the display path."""
    stats: Mapping[str, float | None] = field(default_factory=dict)
    """Further figures by name, such as ``goodput_mbps``, ``lod_mean``, ``buffer_ms``, ``prediction_error_deg``."""
    missed: bool = False
    resolution: str = FULL
    """What the frame was worked out at, ``full`` or ``half``: with ``auto``, what was chosen."""

    @property
    def depth(self) -> F32 | None:
        """[H, W] camera-space z; non-finite is void. None where there is none."""
        return self._plane("depth")

    @property
    def confidence(self) -> F32 | None:
        """[H, W] in [0, 1]: how much the reference says. None where it says nothing."""
        return self._plane("confidence")

    def _plane(self, name: str) -> F32 | None:
        make = self.planes.get(name)
        return None if make is None else make()


class Controls(Protocol):
    """What a viewer may change while the clip runs. Called from the event loop unless a method says otherwise."""

    @property
    def playing(self) -> bool:
        """Whether the clip's clock runs."""
        ...

    @property
    def loop(self) -> bool:
        """Whether the clip starts again at its end."""
        ...

    @property
    def rate(self) -> float:
        """Speed, 1 being the clip's own."""
        ...

    @property
    def restorer(self) -> str:
        """Name of the colour restoration in use."""
        ...

    @property
    def restorers(self) -> tuple[str, ...]:
        """Names that :meth:`set_restorer` takes."""
        ...

    @property
    def away(self) -> bool:
        """Whether the server is gone and looked for: the picture stands on what is held."""
        ...

    @property
    def exactness(self) -> str:
        """``fast``, ``balanced`` or ``exact``."""
        ...

    @property
    def resolution(self) -> str:
        """``full``, ``half`` or ``auto``: the pixels that a frame is worked out at."""
        ...

    @property
    def has_truth(self) -> bool:
        """Whether :meth:`truth` can answer."""
        ...

    def play(self) -> None:
        """Let the clip's clock run."""

    def pause(self) -> None:
        """Hold the frame; the camera still moves."""

    def seek(self, frame: int) -> None:
        """Go to a frame of the clip."""

    def set_rate(self, rate: float) -> None:
        """Change the speed."""

    def set_loop(self, on: bool) -> None:
        """Start again at the end, or hold the last frame."""

    def set_restorer(self, name: str) -> None:
        """Change the colour restoration from the next frame on."""

    def set_exactness(self, name: str) -> None:
        """Change how exact the display path is from the next frame on."""

    def set_resolution(self, name: str) -> None:
        """Change the pixels that a frame is worked out at, from the next frame on."""

    def set_window(self, width: int, height: int) -> None:
        """The page that steers shows pictures on so many pixels of its screen."""

    def truth(self, frame: int, camera: Camera) -> F32:
        """The unquantised scene [H, W, 3]. Called from the page's worker thread, only while somebody looks."""
        ...

    def detail(self) -> SplatDetail | None:
        """What is held of the splats on display. Called from the page's own worker thread, only for an overlay."""
        ...
