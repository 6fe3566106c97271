"""A bundle in a store that takes its time: nobody waits for what somebody else asked for."""

from __future__ import annotations

import threading

from cags_protocol import events as ev
from support.live_server import Client, serving
from support.server_scene import FakeReader, library

GROUP = 6
"""First frame of the second group of frames."""


class SlowReader(FakeReader):
    """The second group of frames is read once the gate is open."""

    def __init__(self) -> None:
        self.asked, self.gate = threading.Event(), threading.Event()
        self.readers = set[threading.Thread]()
        self.gate.set()
        super().__init__(gof=GROUP)
        self.gate.clear()

    def at_hand(self, frame: int) -> bool:
        return frame < GROUP or self.gate.is_set()

    def removed_ids(self, frame: int):
        self._read(frame)
        return super().removed_ids(frame)

    def _read(self, frame: int) -> None:
        if not self.at_hand(frame):
            self.readers.add(threading.current_thread())
            self.asked.set()
            assert self.gate.wait(10), "the event loop waits for the store"


async def test_a_client_whose_frames_take_long_to_read_holds_up_nobody() -> None:
    reader = SlowReader()
    async with serving(library(reader)) as (_, server):
        late = await Client.join(server, start_frame=GROUP + 2)
        await late.until(ev.Welcomed)
        prompt = await Client.join(server)
        await prompt.until(ev.FrameEnded)
        assert reader.asked.is_set()
        assert not [e for e in late.events if isinstance(e, ev.FrameEnded)]
        reader.gate.set()
        ended = await late.until(ev.FrameEnded)
        assert ended[0].message.frame == GROUP
    assert threading.main_thread() not in reader.readers
