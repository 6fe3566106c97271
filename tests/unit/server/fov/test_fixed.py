import math

import pytest

from cags_common.errors import ConfigError
from cags_common.geometry import Intrinsics, Pose
from cags_server.fov import MAX_REFERENCE_FOV_RAD, FovObservation, FovOptions, create_fov_policy, widened
from cags_server.predict import PoseDistribution

CLIENT = Intrinsics.of_fov(1600, 1200, 1.48, 1.20)


def test_the_margin_is_the_share_of_the_clients_angle() -> None:
    wide = widened(CLIENT, (0.1, 0.25), 400, 300)
    assert wide.fov_rad == pytest.approx((1.48 * 1.1, 1.20 * 1.25))
    assert (wide.width_px, wide.height_px, wide.cx_px, wide.cy_px) == (400, 300, 200, 150)


def test_no_margin_is_the_clients_view_and_margins_below_zero_count_as_none() -> None:
    assert widened(CLIENT, (0, 0), 400, 300).fov_rad == pytest.approx(CLIENT.fov_rad)
    assert widened(CLIENT, (-1, -1), 400, 300).fov_rad == pytest.approx(CLIENT.fov_rad)


@pytest.mark.parametrize("margin", [1.0, 10.0, 1e9])
@pytest.mark.parametrize("fov", [0.1, 1.5, 2.5, 3.1])
def test_the_reference_never_reaches_half_a_turn(margin: float, fov: float) -> None:
    wide = widened(Intrinsics.of_fov(400, 300, fov, fov), (margin, margin), 400, 300)
    assert all(f <= max(fov, MAX_REFERENCE_FOV_RAD) + 1e-9 < math.pi for f in wide.fov_rad)


def test_a_client_off_centre_is_covered_on_its_wide_side() -> None:
    shifted = Intrinsics(100, 100, 50, 50, 80, 50)
    assert math.tan(widened(shifted, (0, 0), 64, 64).fov_rad[0] / 2) == pytest.approx(80 / 50)


def test_fixed_is_fixed() -> None:
    policy = create_fov_policy("fixed", FovOptions(margin=0.15))
    distribution = PoseDistribution(Pose.identity(), (0.3,) * 3, (0.3,) * 3)
    assert policy.scale(FovObservation(3, distribution, CLIENT)) == (0.15, 0.15)


def test_an_unknown_policy_is_named() -> None:
    with pytest.raises(ConfigError, match="'wide' is unknown"):
        create_fov_policy("wide")
