"""``auto``: the dearest tier that fits, under load and after it, on a clock that the test turns."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_client import restore
from cags_client.restore.auto import LADDER, Tier, TierController, measured
from cags_common.errors import ConfigError
from cags_common.geometry import Intrinsics

FRAME_MS = 33.0
TIERS = (Tier("none", 0.0), Tier("affine", 5.0), Tier("lite", 15.0), Tier("srresnet", 400.0))


class Machine:
    """Shows frames: each takes ``rest_ms`` and its tier's cost, ``slow`` times as much under load."""

    def __init__(self, rest_ms=8.0, tiers=TIERS):
        self.controller = TierController(tiers, FRAME_MS, rest_ms=rest_ms)
        self.rest_ms, self.slow, self.now_s = rest_ms, 1.0, 0.0
        self._cost_ms = {tier.name: tier.cost_ms for tier in tiers}

    def play(self, seconds):
        """Names of the tiers that frames were shown with."""
        shown, end = [], self.now_s + seconds
        while self.now_s < end:
            name = self.controller.name
            restore_ms = self.slow * self._cost_ms[name]
            frame_ms = self.slow * self.rest_ms + restore_ms
            self.now_s += max(frame_ms, FRAME_MS) / 1e3
            self.controller.observe(self.now_s, restore_ms, frame_ms)
            shown.append(name)
        return shown


def switches(names):
    return sum(a != b for a, b in itertools.pairwise(names))


def test_the_dearest_tier_that_fits_is_picked_at_the_start():
    assert Machine().controller.name == "lite"
    assert Machine(rest_ms=20).controller.name == "affine"
    assert Machine(rest_ms=200).controller.name == "none"


def test_it_stays_where_it_fits():
    assert set(Machine().play(60)) == {"lite"}


def test_it_steps_down_under_load_within_a_second_and_up_again_when_it_is_over():
    machine = Machine()
    machine.play(5)
    machine.slow = 2.0
    loaded = machine.play(5)
    assert loaded[40:] == ["affine"] * len(loaded[40:])
    machine.slow = 1.0
    after = machine.play(10)
    assert after[-1] == "lite"
    assert after.index("lite") * FRAME_MS > 1500, "not before there was room for a while"
    assert switches(after) == 1


def test_one_slow_frame_changes_nothing():
    machine = Machine()
    machine.play(2)
    machine.controller.observe(machine.now_s + 0.033, 15.0, 120.0)
    machine.now_s += 0.033
    assert set(machine.play(5)) == {"lite"}


def test_a_machine_at_the_edge_does_not_flicker():
    """A load that comes and goes every three seconds: each step back doubles the wait."""
    machine = Machine()
    shown = []
    for i in range(40):
        machine.slow = 2.0 if i % 2 else 1.0
        shown += machine.play(3)
    assert switches(shown) <= 12  # 40 without patience


def test_frames_without_restoration_say_nothing_about_its_cost():
    machine = Machine(rest_ms=20)
    for i in range(300):
        machine.controller.observe(i / 30, None, 20.0)
    assert machine.controller.name == "affine"


@given(st.lists(st.tuples(st.floats(0, 1), st.none() | st.floats(0, 1e4), st.floats(0, 1e4)), max_size=60))
def test_whatever_is_observed_the_tier_is_one_of_them_and_moves_by_one(observed):
    controller, now_s = TierController(TIERS, FRAME_MS), 0.0
    places = {tier.name: i for i, tier in enumerate(TIERS)}
    before = places[controller.name]
    for step_s, restore_ms, frame_ms in observed:
        now_s += step_s
        place = places[controller.observe(now_s, restore_ms, frame_ms)]
        assert abs(place - before) <= 1
        before = place


def test_no_tiers_are_refused():
    with pytest.raises(ConfigError, match="no tier"):
        TierController((), FRAME_MS)


def test_measuring_leaves_out_what_is_missing_and_what_comes_after_the_far_too_slow():
    ticks = itertools.count(step=0.05)  # every look at the clock is 50 ms later
    asked = []

    def make(name):
        asked.append(name)
        if name == "none":
            raise ConfigError("no weights")
        return restore.create("none")

    auto = measured(make, Intrinsics.of_fov(32, 24, 1.0, 0.8), 10.0, lambda: next(ticks))
    assert asked == ["none", "affine"]
    assert [tier.name for tier in auto.controller.tiers] == ["affine"]
    assert auto.controller.tiers[0].cost_ms == pytest.approx(50.0)


def test_auto_restores_with_its_tier():
    auto = measured(restore.create, Intrinsics.of_fov(64, 48, 1.0, 0.8), 1e6, itertools.count().__next__)
    assert set(LADDER[:2]) <= {tier.name for tier in auto.controller.tiers}
    assert auto.needs == restore.create(auto.tier).needs
    picture = np.zeros((48, 64, 3), np.float32)
    from cags_client.restore.auto import _picture

    inputs = _picture(Intrinsics.of_fov(64, 48, 1.0, 0.8))
    assert auto.restore(inputs).shape == picture.shape
