"""The client with a page: the real-time shell around an :class:`InteractivePlayer`, and what the page may change."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cags_client.app import Playback, Shell, now_us
from cags_client.frame.restore import switchable
from cags_client.interrupts import interrupts
from cags_client.net.endpoints import Endpoints
from cags_client.output.page.controls import SplatDetail
from cags_client.output.page.server import LiveView
from cags_client.output.page.settings import ViewSettings
from cags_client.output.page.sink import ViewSink, scene_info
from cags_client.output.page.window import windowed
from cags_client.output.sinks import FrameSink
from cags_client.playback.interactive import InteractivePlayer
from cags_client.playback.viewpoint import PoseSource
from cags_client.settings import ClientSettings, LiveSettings
from cags_common.bundle.manifest import Manifest
from cags_common.geometry import F32, Camera
from cags_protocol.sessions.client import ClientSession

KEPT_RECORDS = 9000
"""Frames whose figures a live view keeps for the report: the last five minutes."""

PAGE_PATIENCE_S = 86_400.0

Truth = Callable[[int, Camera], tuple[F32, F32]]
"""Picture and alpha of a frame of the unquantised scene."""


class PlayerControls:
    """A page's :class:`~cags_client.output.page.controls.Controls` over a player; ``wake`` has the shell look again."""

    def __init__(
        self, player: InteractivePlayer, live: LiveSettings, truth: Truth | None, wake: Callable[[], None]
    ) -> None:
        self._player, self._live, self._truth, self._wake = player, live, truth, wake
        self._asked = player.settings

    @property
    def playing(self) -> bool:
        """Whether the clip's clock runs."""
        return self._player.playing

    @property
    def loop(self) -> bool:
        """Whether the clip starts again at its end."""
        return self._player.loop

    @property
    def rate(self) -> float:
        """Speed."""
        return self._player.rate

    @property
    def restorer(self) -> str:
        """Restoration in use."""
        return self._live.restore

    @property
    def restorers(self) -> tuple[str, ...]:
        """Restorations to choose from."""
        return switchable(self._player.settings.restore)

    @property
    def away(self) -> bool:
        """Whether the connection is lost and not yet restored."""
        return self._player.away and not self._player.rejoining

    @property
    def exactness(self) -> str:
        """How exactly is drawn."""
        return self._live.exactness

    @property
    def resolution(self) -> str:
        """The pixels that a frame is worked out at."""
        return self._live.resolution

    @property
    def has_truth(self) -> bool:
        """Whether the unquantised scene is at hand."""
        return self._truth is not None

    def play(self) -> None:
        """Let the clock run."""
        self._player.play(now_us())
        self._wake()

    def pause(self) -> None:
        """Hold the frame."""
        self._player.pause(now_us())
        self._wake()

    def seek(self, frame: int) -> None:
        """Go to a frame."""
        self._player.seek(frame)
        self._wake()

    def set_rate(self, rate: float) -> None:
        """Change the speed."""
        self._player.set_rate(rate, now_us())
        self._wake()

    def set_loop(self, on: bool) -> None:
        """Start again at the end, or hold."""
        self._player.set_loop(on, now_us())
        self._wake()

    def set_restorer(self, name: str) -> None:
        """Restore in another way from the next frame on."""
        self._live.restore = name

    def set_exactness(self, name: str) -> None:
        """Draw more or less exactly from the next frame on."""
        self._live.exactness = name

    def set_resolution(self, name: str) -> None:
        """Work frames out at other pixels from the next one on."""
        self._live.resolution = name

    def set_window(self, width: int, height: int) -> None:
        """Draw for a window of so many pixels."""
        shape = windowed(self._asked, width, height)
        if shape != (self._player.settings.width, self._player.settings.height, self._player.settings.fov):
            self._player.reshape(*shape, now_us())
            self._wake()

    def truth(self, frame: int, camera: Camera) -> F32:
        """The unquantised scene [H, W, 3] in [0, 1]."""
        assert self._truth is not None
        return np.clip(self._truth(frame, camera)[0], 0.0, 1.0)

    def detail(self) -> SplatDetail | None:
        """What is held of the splats on display."""
        pipeline = self._player.pipeline
        store = pipeline.on_display if pipeline is not None else None
        if pipeline is None or store is None:
            return None
        shown = store.shown
        owner = shown.owner.copy()
        lods = np.zeros(len(shown.tiles) + 1, np.float32)  # the last one is of rows without a splat, -1
        np.maximum(shown.lods(), 0, out=lods[:-1])
        top = max(pipeline.info.lods - 1, 1)
        return SplatDetail(store.splats.means.copy(), owner, lods[owner] / np.float32(top))


def patient(settings: ClientSettings) -> ClientSettings:
    """A page that somebody has open stays, and waits for its server for a day, unless the first loss is to end it."""
    return replace(settings, reconnect_s=PAGE_PATIENCE_S) if settings.reconnect_s else settings


async def watch_live(
    url: str,
    settings: ClientSettings,
    view_settings: ViewSettings,
    info: Manifest,
    *,
    walk: PoseSource,
    sinks: Sequence[FrameSink],
    truth: Truth | None,
    on_ready: Callable[[str], None],
    on_frame: Callable[[dict[str, Any]], None] | None = None,
) -> Playback:
    """Play with a page until interrupted or ``settings.duration`` is over; results as of
    :func:`cags_client.app.play`. Raises :class:`CagsError`.

    ``on_ready`` is given the page's address.
    """
    settings = patient(settings)
    view = LiveView(view_settings, walk)
    on_ready(await view.start())
    try:
        endpoints = Endpoints(url, settings.token, settings.ca)
        transport = await endpoints.first()
        live = LiveSettings(settings)
        live.depth_shown = True  # the page can show it at any time
        player = InteractivePlayer(
            ClientSession(now_us=now_us()),
            settings,
            view.poses,
            now_us=now_us(),
            near=info.near,
            live=live,
            clock=time.perf_counter,
            rng=random.Random(),  # noqa: S311 - spreads attempts in time
            others=endpoints.others,
        )

        def kept(record: dict[str, Any]) -> None:
            del shell.records[:-KEPT_RECORDS]
            if on_frame is not None:
                on_frame(record)

        shell = Shell(transport, player, [ViewSink(view), *sinks], kept, endpoints.again)
        view.attach(scene_info(info), PlayerControls(player, live, truth, shell.wake))

        with interrupts(shell.leave):
            try:
                await shell.run()
            finally:
                shell.close()
    finally:
        await view.stop()
    return Playback(player, shell.records).checked()
