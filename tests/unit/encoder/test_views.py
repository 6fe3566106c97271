"""Views around scenes of any size, and the near plane that players are told."""

import logging

import numpy as np
import pytest

from cags_common.errors import ProtocolError
from cags_common.geometry import DEFAULT_NEAR
from cags_encoder.scenes import Focus
from cags_encoder.views import LEAST_PLAYED_NEAR, cameras_around, near_plane
from cags_protocol.wire.encoding import encode
from support.wire_pair import hello

UP = (0.0, 1.0, 0.0)


@pytest.mark.parametrize("unit", [1e-9, 1e-5, 1e-3, 1.0])
def test_the_ball_of_interest_is_behind_the_near_plane(unit: float) -> None:
    for camera in cameras_around(Focus((0.0, 0.0, 0.0), unit), UP, 4):
        assert camera.near < np.linalg.norm(camera.pose.position) - unit


@pytest.mark.parametrize(("radius", "near"), [(5.0, DEFAULT_NEAR), (0.1, 0.01), (2e-5, 2e-6)])
def test_near_planes_fit_the_scene(radius: float, near: float, caplog: pytest.LogCaptureFixture) -> None:
    assert near_plane(Focus((0.0, 0.0, 0.0), radius)) == pytest.approx(near)
    assert not caplog.records


def test_a_near_plane_is_one_that_servers_take(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        near = near_plane(Focus((0.0, 0.0, 0.0), 2e-9))
    assert near == LEAST_PLAYED_NEAR
    assert "scene of radius 2e-09: players cut off" in caplog.text and "1e-05 or more" in caplog.text
    assert encode(hello(near=near))
    with pytest.raises(ProtocolError, match="near"):
        encode(hello(near=near / 2))
