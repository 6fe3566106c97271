"""Keeps a device at hand: shared by all scenes of a process, and made anew in the background after it was lost."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import cache

from cags_common.errors import ConfigError
from cags_gpu.device import Gpu
from cags_gpu.difference import Comparisons
from cags_gpu.workspace import Workspace

FIRST_DELAY_S = 0.5
LAST_DELAY_S = 30.0
"""Between two attempts to make a lost device anew; doubled each time."""

_log = logging.getLogger(__name__)


class Keeper:
    """Holds a device and its working memory. Raises :class:`ConfigError` where no device is to be had."""

    def __init__(self, make: Callable[[], Gpu] = Gpu) -> None:
        self._make = make
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._workspace: Workspace | None = Workspace(make())
        self.comparisons = Comparisons()
        """What waits for the device, of all its scenes."""

    def current(self) -> Workspace | None:
        """The device's working memory; None while a new device is being made."""
        with self._lock:
            return self._workspace

    def lost(self, workspace: Workspace, reason: str) -> None:
        """Say that a device is gone. A new one is made in the background; frames come from the CPU until then."""
        with self._lock:
            if self._workspace is not workspace:
                return  # somebody else said so
            self._workspace = None
        _log.warning("%s; drawing on the CPU until it is back", reason)
        threading.Thread(target=self._remake, name="gpu-keeper", daemon=True).start()

    def close(self) -> None:
        """Make no more devices."""
        self._stopped.set()

    def _remake(self) -> None:
        delay = FIRST_DELAY_S
        while not self._stopped.wait(delay):
            try:
                made = Workspace(self._make())
            except ConfigError as error:
                _log.info("no device yet: %s", error)
                delay = min(2 * delay, LAST_DELAY_S)
                continue
            with self._lock:
                self._workspace = made
            _log.warning("drawing on %s again", made.gpu.info)
            return


@cache
def shared_keeper() -> Keeper:
    """The process's keeper. Raises :class:`ConfigError` where no device is to be had; tried anew at the next call."""
    return Keeper()
