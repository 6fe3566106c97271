"""Ramps keep what a table of one entry a splat keeps, whatever is asked of them and in which order."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from cags_common.tiles.ramps import LONGEST_RAMP, OF_LOOKS, Ramps, share_of

IDS = st.lists(st.integers(0, 40) | st.integers(990, 1_000), max_size=12, unique=True)
FRAMES = st.integers(0, 12)


@dataclass
class Entry:
    begin: int
    frames: int
    since: int
    start: float
    end: float


@dataclass
class Table:
    """The definition, splat by splat."""

    of: dict[int, Entry] = field(default_factory=dict)

    def at(self, time: float) -> dict[int, tuple[np.float32, int]]:
        out = {}
        for splat, entry in list(self.of.items()):
            share = share_of(time, np.array([entry.begin], np.int32), np.array([entry.frames], np.uint8))[0]
            start, end = np.float32(entry.start), np.float32(entry.end)
            out[splat] = end if share >= 1 else start + (end - start) * share, entry.begin
            if share >= 1:
                del self.of[splat]
        return out


class RampsMachine(RuleBasedStateMachine):
    """Everything that may be asked of ramps; values are numbers that never come again."""

    @initialize()
    def begin(self) -> None:
        self.ramps, self.table, self.values = Ramps((1,)), Table(), 0

    def _fresh(self, count: int) -> np.ndarray:
        self.values += count
        return np.arange(self.values - count, self.values, dtype=np.float32)[:, None]

    @rule(ids=IDS, begin=FRAMES, frames=st.integers(2, LONGEST_RAMP), since=st.integers(OF_LOOKS, 12))
    def put(self, ids: list[int], begin: int, frames: int, since: int) -> None:
        count, starts, ends = len(ids), self._fresh(len(ids)), self._fresh(len(ids))
        lengths, sources = np.full(count, frames, np.uint8), np.full(count, since, np.int32)
        self.ramps.put(np.array(ids, np.intp), begin, lengths, (starts, ends), sources)
        for splat, start, end in zip(ids, starts, ends, strict=True):
            self.table.of[splat] = Entry(begin, frames, since, float(start[0]), float(end[0]))

    @rule(ids=IDS)
    def drop(self, ids: list[int]) -> None:
        self.ramps.drop(np.array(ids, np.intp))
        for splat in ids:
            self.table.of.pop(splat, None)

    @rule()
    def clear(self) -> None:
        self.ramps.clear()
        self.table.of.clear()

    @rule(ids=IDS, begin=FRAMES, frames=st.integers(2, LONGEST_RAMP), since=st.integers(OF_LOOKS, 12))
    def take_over(self, ids: list[int], begin: int, frames: int, since: int) -> None:
        count, shown, ends = len(ids), self._fresh(len(ids)), self._fresh(len(ids))
        lengths, sources = np.full(count, frames, np.uint8), np.full(count, since, np.int32)
        self.ramps.take_over(np.array(ids, np.intp), begin, lengths, (shown, ends), sources)
        for splat, value, end in zip(ids, shown, ends, strict=True):
            entry = self.table.of.get(splat)
            if entry is not None and entry.begin == begin:
                entry.end = float(end[0])
                continue
            start = float(value[0]) if entry is None else entry.end
            self.table.of[splat] = Entry(begin, frames, since, start, float(end[0]))

    @rule(ids=IDS, frame=FRAMES, looks=st.booleans())
    def begin_elsewhere(self, ids: list[int], frame: int, looks: bool) -> None:
        values = self._fresh(len(ids))
        (self.ramps.stand_on if looks else self.ramps.precede)(np.array(ids, np.intp), frame, values)
        for splat, value in zip(ids, values, strict=True):
            entry = self.table.of.get(splat)
            if entry is None:
                continue
            if entry.since < frame if looks else entry.since <= frame < entry.begin:
                entry.start, entry.since = float(value[0]), OF_LOOKS if looks else frame

    @rule(ids=IDS, frame=FRAMES)
    def ask(self, ids: list[int], frame: int) -> None:
        rows = np.array(ids, np.intp)
        known = [self.table.of[splat] for splat in ids if splat in self.table.of]
        assert self.ramps.follows(rows, frame) == any(entry.since == frame for entry in known)
        ends = self.ramps.ends(rows, np.full((len(ids), 1), -1, np.float32))[:, 0].tolist()
        assert ends == [self.table.of[splat].end if splat in self.table.of else -1 for splat in ids]

    @rule(time=st.sampled_from([0.0, 2.5, 5.0, 9.0, 30.0]))
    def show(self, time: float) -> None:
        ids, values, began = self.ramps.at(time)
        found = {int(i): (v, int(b)) for i, v, b in zip(ids, values[:, 0], began, strict=True)}
        assert found == self.table.at(time) and len(ids) == len(found)

    @invariant()
    def count(self) -> None:
        assert len(self.ramps) == len(self.table.of)


RampsMachine.TestCase.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)
TestRamps = RampsMachine.TestCase
