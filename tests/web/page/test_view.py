"""The page opens a scene as its author wants, or as Python's thumbnail shows it; hostile views are refused alike."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from cags_common.bundle import Manifest
from cags_common.bundle.first_view import first_pose
from cags_common.bundle.view import AuthorView
from cags_common.geometry import Pose
from support.author_views import HOSTILE
from support.node import run_tests

BARE = Manifest("clip", 30.0, 1, (0,), (9,), 0, ((-1, -2, -1), (1, 2, 1)), (), (), up=(0, -1, 0))
ROOM = replace(BARE, bounds=((-4, -1, -4), (4, 3, 4)))
FAR = replace(BARE, bounds=((-9, -2, -1), (90, 2, 1)), focus_centre=(0.1, 0.2, 0.3), up=(0, 0, 1))


POINT = replace(BARE, bounds=((1, -2, 3), (1, -2, 3)), focus_centre=(1, -2, 3), focus_radius=0.2)
NO_SIZE = replace(POINT, focus_radius=0.0)
FAR_POINT = replace(BARE, bounds=((1e5, 0, 0), (1e5, 0, 0)), focus_centre=(1e5, 0, 0), focus_radius=1e-3)
SMALL = replace(BARE, bounds=((-0.001, -0.002, -0.001), (0.001, 0.002, 0.001)), focus_radius=0.001)
MANIFESTS = (BARE, ROOM, FAR, POINT, NO_SIZE, FAR_POINT, SMALL)


def test_views_are_pythons(tmp_path: Path) -> None:
    cases = []
    target = AuthorView(target=(1.0, 2.0, 3.0), radius=0.7)
    level = Pose.looking_at((1.0, -0.5, -3.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0))
    for manifest in (*MANIFESTS, replace(BARE, view=target), replace(ROOM, view=AuthorView(radius=3.0))):
        for tangents in ((0.577, 0.325), (0.3, 0.577)):
            pose = first_pose(manifest, *tangents)
            cases.append((manifest, tangents, pose))
    cases.append((replace(BARE, view=AuthorView(pose=level)), (0.5, 0.5), level))
    told = [
        {"manifest": json.loads(m.to_json()), "tangents": t, "pose": np.concatenate([p.position, p.rotation]).tolist()}
        for m, t, p in cases
    ]
    faults = [(name, value) for name, values in HOSTILE.items() for value in values]
    run_tests("view", tmp_path, cases=told, hostile={"bare": json.loads(BARE.to_json()), "faults": faults})
