"""What a job draws: the reference with what is seen, or a look at what is seen alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from cags_common.geometry import Camera
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.splats import Splats
from cags_protocol.wire.messages import ReferenceKind
from cags_server.reference.coder import Coded, ReferenceCoder
from cags_server.reference.job import NOTHING, FrameJob
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


@dataclass
class Held:
    """A mirror that holds all of a frame's splats, as changed by ``change``."""

    job: FrameJob
    change: Callable[[Splats, np.ndarray[Any, Any]], None]

    def scene_at(self, frame: int, basis: int) -> Any:
        with self.job.library.scenes.at(frame) as scene:
            return scene

    @property
    def splats(self) -> Splats:
        alive = self.job.library.owners(self.job.plan.frame) >= 0
        logits = np.where(alive, np.float32(2), ABSENT_LOGIT).astype(np.float32)
        shapes = {"means": 3, "quats": 4, "log_scales": 3, "sh0": 3}
        parts = {name: np.zeros((len(alive), width), np.float32) for name, width in shapes.items()}
        splats = Splats(**parts, logit_opacities=logits, sh_rest=np.zeros((len(alive), 0, 3), np.float32))
        self.change(splats, alive)
        return splats


def nothing(splats: Splats, alive: np.ndarray[Any, Any]) -> None:
    del splats, alive


def lacks_all(splats: Splats, alive: np.ndarray[Any, Any]) -> None:
    splats.logit_opacities[alive] = ABSENT_LOGIT


@pytest.mark.parametrize(
    ("change", "new", "expected"), [(nothing, True, False), (lacks_all, False, False), (lacks_all, True, True)]
)
def test_the_coder_hears_where_splats_appear_that_the_client_lacks(
    change: Callable[[Splats, np.ndarray[Any, Any]], None], new: bool, expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = planned()
    heard: list[bool] = []
    code = ReferenceCoder.code_views

    def noted(coder: ReferenceCoder, *views: Any, appeared: Any, **options: Any) -> Any:
        heard.append(appeared is not None and appeared.any())
        return code(coder, *views, appeared=appeared, **options)

    def changed(scenes: SourceScenes, frame: int, wanted: Any) -> Splats:
        source = job.library.reader.source(frame)
        return source.splats.take(np.flatnonzero(wanted[source.ids]) if new else slice(0, 0))

    monkeypatch.setattr(ReferenceCoder, "code_views", noted)
    monkeypatch.setattr(SourceScenes, "changed", changed)
    mirror: Any = Held(job, change)
    replace(job, mirror=mirror).run()
    assert heard == [expected]


def test_the_scene_of_a_frame_is_kept_while_the_one_ahead_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that moved ahead could not go back: where splats appear in the frame would take another to tell."""
    job, at = planned(), SourceScenes.at
    job = replace(job, plan=replace(job.plan, ahead=replace(job.plan.ahead, frame=job.plan.frame + 2)), mirror=None)
    frames: list[int] = []

    def noted(scenes: SourceScenes, frame: int) -> Any:
        frames.append(frame)
        return at(scenes, frame)

    def code(coder: ReferenceCoder, *args: Any, **options: Any) -> Coded:
        loaded = len(job.library.scenes)
        with job.library.scenes.at(job.plan.frame):
            assert len(job.library.scenes) == loaded
        return NOTHING

    monkeypatch.setattr(SourceScenes, "at", noted)
    monkeypatch.setattr(FrameJob, "_contribution_ahead", lambda job, _, options: job._seen_ahead(options))
    monkeypatch.setattr(ReferenceCoder, "code_views", code)
    job.run()
    assert frames == [job.plan.frame, job.plan.ahead.frame, job.plan.frame]
