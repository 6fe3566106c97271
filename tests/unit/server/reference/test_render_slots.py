"""Places at a renderer that has more to do than it can."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cags_protocol.wire.messages import FrameEnd, ReferenceFrame, TileLayers
from cags_server.reference.coder import INVISIBLE
from cags_server.reference.render_slots import LEAST_PLACES, PATIENCE_US, RenderSlots
from support.streamer_rig import Rig, of

MS, WAIT_US = 1000, 60_000


class Renderer:
    """Workers that take a given time, by a clock of milliseconds, and clients that ask."""

    def __init__(self, workers: int, work_ms: float, *, light_ms: float | None = None) -> None:
        self.slots, self.served, self.now_ms = RenderSlots(workers), Counter[str](), 0
        self.busy_ms = self.light_ms = 0
        self._workers, self._work_ms = workers, {False: work_ms, True: light_ms or work_ms}
        self._out: list[tuple[float, float, bool]] = []  # ends at, took, light

    def run(self, asks: dict[str, tuple[int, int]], seconds: float, lacking: dict[str, float] | None = None) -> None:
        """Each client asks every so many milliseconds, after so many at first."""
        for _ in range(round(seconds * 1e3)):
            self._finish()
            self.busy_ms += min(len(self._out), self._workers)
            self.light_ms += self.slots.light
            for name, (every_ms, after_ms) in asks.items():
                if self.now_ms >= after_ms and (self.now_ms - after_ms) % every_ms == 0:
                    self._ask(name, None if lacking is None else lacking[name])
            self.now_ms += 1

    def _finish(self) -> None:
        for ended in [each for each in self._out if each[0] <= self.now_ms]:
            self._out.remove(ended)
            self.slots.ended(self.now_ms * MS, ended[1] * MS, light=ended[2])

    def _ask(self, name: str, lacking: float | None) -> None:
        if not self.slots.may(name, self.now_ms * MS, WAIT_US, lacking):
            return
        self.slots.begun(name, self.now_ms * MS, lacking)
        self.served[name] += 1
        ends = sorted(end for end, _, _ in self._out)
        start = self.now_ms if len(ends) < self._workers else ends[len(ends) - self._workers]
        took = self._work_ms[self.slots.light]
        self._out.append((start + took, took, self.slots.light))
        assert start <= self.now_ms + max(WAIT_US / MS, took) + took, "nobody waits for long"


def spread(clients: int, every_ms: int) -> dict[str, tuple[int, int]]:
    """Clients whose frames are due evenly spread over the period."""
    return {f"c{number}": (every_ms, number * every_ms // clients) for number in range(clients)}


def test_only_as_many_are_rendered_as_will_be_done_soon() -> None:
    slots = RenderSlots(workers=2)
    for number in range(2 * LEAST_PLACES):
        assert slots.may(f"c{number}", 0)
        slots.begun(f"c{number}", 0)
    assert not slots.may("late", 0)
    assert not slots.may("later", 0, WAIT_US), "what one takes is not known"
    slots.ended(0, WAIT_US / 3)
    assert slots.places(WAIT_US) == 2 * (1 + 3), "quick ones wait for no longer if there are more of them"
    for number in range(4):
        assert slots.may(f"d{number}", 0, WAIT_US)
        slots.begun(f"d{number}", 0)
    assert not slots.may("in a hurry", 0)


def test_who_was_turned_away_goes_first() -> None:
    slots = RenderSlots(workers=1)
    for name in ("a", "b"):
        slots.begun(name, 0)
    assert not slots.may("c", 1)
    slots.ended(2)
    assert not slots.may("a", 3), "c has had fewer"
    assert slots.may("c", 3)
    slots.begun("c", 3)
    slots.ended(4)
    assert slots.may("a", 4), "nobody else waits any more"


def test_a_turn_that_nobody_takes_is_lost() -> None:
    slots = RenderSlots(workers=1)
    for name in ("a", "b"):
        slots.begun(name, 0)
    assert not slots.may("gone", 0)
    slots.ended(0)
    assert not slots.may("a", PATIENCE_US)
    assert slots.may("a", PATIENCE_US + 1)


def test_time_in_which_nobody_asked_gives_no_credit() -> None:
    renderer = Renderer(1, 100.0)
    renderer.run(spread(2, 200) | {"c2": (200, 6_000)}, 6)
    before = dict(renderer.served)
    renderer.run(spread(2, 200) | {"c2": (200, 6_000)}, 6)
    assert renderer.served["c2"] <= renderer.served["c0"] - before["c0"] + 2


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 3), st.integers(2, 20), st.integers(20, 90), st.integers(1, 10))
def test_under_any_load_everybody_is_rendered_for_about_as_often(
    workers: int, clients: int, work_ms: int, apart_ms: int
) -> None:
    """Clients that are due in the same order every 200 ms, ``apart_ms`` from each other."""
    renderer = Renderer(workers, work_ms)
    renderer.run({f"c{number}": (200, apart_ms * number) for number in range(clients)}, 8)
    counts = [renderer.served[f"c{number}"] for number in range(clients)]
    assert min(counts) >= 0.5 * max(counts) - 2


def busy_share(workers: int, clients: int, work_ms: int) -> float:
    """Share of the workers' time in use, of what there is to do or of all."""
    renderer = Renderer(workers, work_ms)
    renderer.run(spread(clients, 200), 8)
    return renderer.busy_ms / 8000 / workers / min(clients * work_ms / 200 / workers, 1.0)


@pytest.mark.parametrize(("workers", "clients", "work_ms"), [(2, 20, 40), (2, 20, 60), (1, 8, 60), (3, 20, 80)])
def test_where_much_is_to_be_rendered_no_worker_stands_idle(workers: int, clients: int, work_ms: int) -> None:
    """Once workers stood idle half of the time, each kept for a client that was not due yet."""
    assert busy_share(workers, clients, work_ms) >= 0.95


@settings(max_examples=15, deadline=None)
@example(1, 6, 41)  # the worst of a grid of 913: whoever is a turn ahead leaves the place behind a worker's job empty
@given(st.integers(1, 3), st.integers(4, 20), st.integers(20, 90))
def test_workers_are_in_use_for_most_of_the_time_at_any_load(workers: int, clients: int, work_ms: int) -> None:
    assert busy_share(workers, clients, work_ms) >= 0.75


def test_one_that_asks_seldom_holds_up_nobody_for_long() -> None:
    renderer = Renderer(1, 50.0)
    renderer.run(spread(6, 200) | {"seldom": (1000, 7)}, 10)
    assert renderer.served["seldom"] >= 5, "of ten; the others have two of three"
    assert renderer.busy_ms >= 0.85 * 10_000


def test_who_lacks_more_has_more_and_everybody_some() -> None:
    lacking = {f"c{number}": 1e-3 if number < 3 else INVISIBLE for number in range(12)}
    renderer = Renderer(1, 50.0)
    renderer.run(spread(12, 200), 20, lacking)
    poor = [renderer.served[name] for name in lacking if lacking[name] > INVISIBLE]
    good = [renderer.served[name] for name in lacking if lacking[name] == INVISIBLE]
    assert min(good) >= 0.2 * max(poor)
    assert min(poor) >= 1.5 * max(good)
    assert sum(renderer.served.values()) >= 0.85 * 20 * 20


def test_a_renderer_with_too_much_to_do_goes_lightly_until_careful_ones_would_fit() -> None:
    renderer = Renderer(2, 30.0, light_ms=15.0)
    renderer.run(spread(4, 200), 6)
    assert not renderer.light_ms, "0.3 of the workers' time"
    renderer.run(spread(20, 200), 10)
    assert renderer.slots.light
    assert renderer.light_ms >= 6000
    light_ms = renderer.light_ms
    renderer.run(spread(20, 200), 10)
    assert renderer.light_ms - light_ms == 10_000, "0.75 of their time, and careful ones would take 1.5"
    renderer.run(spread(8, 200), 10)
    assert not renderer.slots.light, "careful ones take 0.6"


def test_a_lone_client_on_a_slow_machine_has_careful_ones() -> None:
    renderer = Renderer(1, 150.0)
    renderer.run(spread(1, 100), 10)
    assert not renderer.light_ms


def test_a_frame_without_a_place_is_served_by_what_was_seen() -> None:
    rig = Rig()
    room = [True]
    rig.streamer._may_render = lambda now_us: room[0]
    rig.play()
    rig.step()
    room[0] = False
    out = []
    for _ in range(2):
        due_us = rig.streamer.next_due_us()
        some = rig.streamer.catch_up(due_us)
        assert rig.streamer.begin(due_us) is None or not some
        rig.deliver(some)
        out += some
    assert [e.frame for e in of(FrameEnd, out)] == [2, 3]
    assert of(TileLayers, out)
    assert of(ReferenceFrame, out) == []
    room[0] = True
    assert [r.frame for r in of(ReferenceFrame, rig.step())] == [3]
