"""The published field of view: what it was trained by, and that it is found by its name."""

import numpy as np

from cags_common.geometry import Intrinsics
from cags_research.configurations import PUBLISHED
from cags_research.fov.mean_error import weights
from cags_server.fov import FOV_POLICIES, FovObservation, FovOptions, FovPolicy, create_fov_policy
from cags_server.fov.lstm import LstmFov, LstmWeights
from cags_server.predict import create_predictor
from support.motion import history_of, swaying_pose

CLIENT = Intrinsics.of_fov(1600, 1200, 1.48, 1.20)
NAME = str(PUBLISHED.server["fov"])


def test_it_is_found_by_name_and_is_not_the_servers_own() -> None:
    assert NAME in FOV_POLICIES.names() and NAME not in FOV_POLICIES
    assert isinstance(create_fov_policy(NAME), LstmFov)
    assert "--quantile 0.5 " in weights().provenance["command"]
    assert "--quantile 0.9 " in LstmWeights.shipped().provenance["command"]


def test_nobody_was_trained_on_who_is_kept_for_tests() -> None:
    seen = {*weights().provenance["data"], *weights().provenance["validation"]}
    assert seen and not any(name.endswith(("_user09", "_user10", "_user11", "_user12")) for name in seen)


def margins(policy: FovPolicy) -> list[tuple[float, float]]:
    """Of a viewer who sways, fifty frames; each frame's true pose is told six frames later."""
    predictor, begun_us, period_us = create_predictor("autoregressive"), 1_000_000, 33_333
    predicted, found = [], []
    for frame in range(50):
        now_us = begun_us + frame * period_us
        predicted.append(predictor.predict(history_of(swaying_pose, end_us=now_us), 6 * period_us))
        found.append(policy.scale(FovObservation(frame, predicted[frame], CLIENT)))
        if frame >= 6:
            policy.truth(frame - 6, predicted[frame - 6].pose, swaying_pose(now_us), CLIENT)
    return found


def test_its_margins_are_below_those_that_cover_nine_frames_in_ten() -> None:
    published, ours = margins(create_fov_policy(NAME)), margins(LstmFov(1.0))
    assert np.isfinite(published).all() and np.min(published) >= 0
    assert np.mean(published) < np.mean(ours)


def test_no_option_changes_its_answer() -> None:
    scaled = create_fov_policy(NAME, FovOptions(margin=1.0, quantile=0.99, gain=10.0))
    assert margins(scaled) == margins(create_fov_policy(NAME))
