"""The shaper's log: JSON lines that describe themselves. The first line names the units and the settings."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import logging
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from cags_common.errors import ConfigError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from cags_shaper.shaped import Shaped, ShapedLink

LOG = logging.getLogger("cags_shaper")

INTERVAL_US = 100_000

FIELDS = {
    "t_us": "end of the interval since the link began, microseconds",
    "direction": "down (towards the client) or up",
    "capacity_bytes": "what trace and cap allowed in the interval (null: no limit)",
    "accepted_bytes": "bytes that entered the link in the interval, TCP/IP headers included",
    "delivered_bytes": "bytes that left it in the interval",
    "queued_bytes": "bytes in its queue at the end of the interval",
    "next_delivery_us": "how long until the next delivery, microseconds (null: none on its way)",
}


class LogWriter:
    """Writes one line a direction and interval."""

    def __init__(self, file: TextIO, settings: DataclassInstance) -> None:
        self._file, self._ended = file, False
        self._last: dict[str, tuple[int, int, int]] = {}
        header = {"log": "cags-shaper", "version": 1, "interval_us": INTERVAL_US, "fields": FIELDS}
        self._line({**header, "settings": dataclasses.asdict(settings)})

    def sample(self, name: str, direction: ShapedLink) -> None:
        """Write what passed ``direction`` since the last sample."""
        link, now_us = direction.link, direction.now_us()
        before_us, accepted, delivered = self._last.get(name, (0, 0, 0))
        counts, coming_us = link.counts, link.next_delivery_us()
        allowed_bps = link.capacity_bps(before_us, now_us)
        self._line(
            {
                "t_us": now_us,
                "direction": name,
                "capacity_bytes": None if allowed_bps is None else round(allowed_bps * (now_us - before_us) / 8e6),
                "accepted_bytes": counts.accepted_bytes - accepted,
                "delivered_bytes": counts.delivered_bytes - delivered,
                "queued_bytes": link.queued_bytes(now_us),
                "next_delivery_us": None if coming_us is None else coming_us - now_us,
            }
        )
        self._last[name] = now_us, counts.accepted_bytes, counts.delivered_bytes

    async def follow(self, shaped: Shaped, stop: asyncio.Event) -> None:
        """Sample both directions every :data:`INTERVAL_US` until ``stop``, once the link has begun."""
        while not stop.is_set():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(INTERVAL_US / 1e6):
                    await stop.wait()
            if not shaped.downlink.clock.begun:
                continue
            self.sample("down", shaped.downlink)
            self.sample("up", shaped.uplink)

    def _line(self, record: dict[str, object]) -> None:
        if self._ended:
            return
        try:
            self._file.write(json.dumps(record) + "\n")
        except OSError as error:  # a full disk is no reason to stop the link
            self._ended = True
            LOG.warning("the log cannot be written (%s) and ends here", error.strerror or error)


def open_log(path: str) -> TextIO:
    """A new log file. Raises :class:`ConfigError` when it cannot be written."""
    try:
        return Path(path).open("w", encoding="utf-8", buffering=1)
    except OSError as error:
        raise ConfigError(f"--log {path}: cannot be written ({error.strerror}); give another file") from error


def close_log(file: TextIO) -> None:
    """Close it; what a full disk does not take is lost."""
    with contextlib.suppress(OSError):
        file.close()
