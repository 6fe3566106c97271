"""A server's processor in virtual time, shared by the sessions that are played together.

Each core runs one job at a time. A job takes its measured processor time, plus the session's other costs on the server
since its previous job. Results therefore describe an otherwise idle machine, even if this one is busy.
"""

from __future__ import annotations

from dataclasses import replace

from cags_bench.sim.spent import Spent
from cags_server.reference.job import FrameJob, FrameRender
from cags_server.reference.render_slots import RenderSlots


class Cores:
    """A number of cores, and the render slots that they provide."""

    def __init__(self, count: int) -> None:
        self.slots = RenderSlots(count)
        self._free_us = [0.0] * count

    def taken_until_us(self, now_us: int, took_us: float) -> int:
        """Completion time of work that takes a core ``took_us`` and begins no earlier than ``now_us``."""
        first = min(range(len(self._free_us)), key=self._free_us.__getitem__)
        self._free_us[first] = max(self._free_us[first], now_us) + took_us
        return round(self._free_us[first])


class SharedRenderer(RenderSlots):
    """The render slots as seen by one session, whose clock began ``later_us`` after the server's."""

    def __init__(self, cores: Cores, later_us: int, spent: Spent) -> None:
        self._cores, self._shared, self._later_us, self._spent = cores, cores.slots, later_us, spent
        self._charged_ms = 0.0

    def run(self, job: FrameJob, now_us: int) -> tuple[int, FrameRender]:
        """The result of a job, and its completion time on the session's clock."""
        render = self._spent.job(job, now_us)
        beside_ms, self._charged_ms = self._spent.serving_ms - self._charged_ms, self._spent.serving_ms
        took_us = self._spent.references[-1].total_ms * 1e3
        render = replace(render, render_ns=round(took_us * 1e3), mirror_ns=0, encode_ns=0)
        done_us = self._cores.taken_until_us(now_us + self._later_us, took_us + beside_ms * 1e3)
        return done_us - self._later_us, render

    @property
    def light(self) -> bool:  # type: ignore[override]
        """See :class:`RenderSlots`; so for all methods here."""
        return self._shared.light

    def may(self, name: str, now_us: int, wait_us: float = 0.0, lacking: float | None = None) -> bool:
        """Whether a reference may be rendered for a client."""
        return self._shared.may(name, now_us + self._later_us, wait_us, lacking)

    def begun(self, name: str, now_us: int, lacking: float | None = None, *, look: bool = False) -> None:
        """Rendering of a reference begins."""
        self._shared.begun(name, now_us + self._later_us, lacking, look=look)

    def ended(self, now_us: int, took_us: float | None = None, *, light: bool = False) -> None:
        """Rendering of a reference has ended."""
        self._shared.ended(now_us + self._later_us, took_us, light=light)

    def left(self, name: str) -> None:
        """A client has left."""
        self._shared.left(name)
