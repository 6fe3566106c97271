"""What a job draws: the reference with what is seen, or a look at what is seen alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cags_common.geometry import Camera
from cags_protocol.wire.messages import ReferenceKind
from cags_server.reference.job import FrameJob
from cags_server.scene.source_scenes import SourceScenes
from support.server_scene import FakeScene
from support.streamer_rig import Rig


def planned() -> FrameJob:
    """The job of a frame, not run."""
    rig = Rig()
    rig.play()
    rig.step()
    due_us = rig.streamer.next_due_us()
    assert due_us is not None
    job = rig.streamer.begin(due_us)
    assert job is not None and job.plan.speaks
    return job


def test_a_look_sees_what_a_reference_sees_and_says_nothing() -> None:
    job = planned()
    look = replace(job, plan=replace(job.plan, speaks=False), mirror=None)
    spoken, silent = job.run(), look.run()
    assert spoken.coded.kind is not ReferenceKind.NOTHING
    assert (silent.coded.kind, silent.coded.access_unit) == (ReferenceKind.NOTHING, b"")
    assert {(t.frame, t.tile) for t in silent.visible} == {(t.frame, t.tile) for t in spoken.visible}
    seen = spoken.contribution > 1
    assert seen.any()
    np.testing.assert_allclose(silent.contribution[seen], spoken.contribution[seen], rtol=0.35)


def test_a_look_draws_a_quarter_of_the_pixels_of_the_frame_whose_tiles_are_planned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    job = planned()
    look = replace(job, plan=replace(job.plan, speaks=False), mirror=None)
    drawn: list[tuple[int, int]] = []
    frames: list[int] = []
    render, at = FakeScene.render, SourceScenes.at

    def noted_render(scene: FakeScene, camera: Camera, options: Any) -> Any:
        drawn.append((camera.intrinsics.width_px, camera.intrinsics.height_px))
        return render(scene, camera, options)

    def noted_at(scenes: SourceScenes, frame: int) -> Any:
        frames.append(frame)
        return at(scenes, frame)

    monkeypatch.setattr(FakeScene, "render", noted_render)
    monkeypatch.setattr(type(job.library.scenes), "at", noted_at)
    look.run()
    whole = job.camera.intrinsics
    assert drawn == [(whole.width_px // 2, whole.height_px // 2)]
    assert frames == [job.plan.ahead.frame]
