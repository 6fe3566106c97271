"""A device that goes away: the CPU draws meanwhile, a new device is made, and the scene is on it again."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from cags_client.frame.painting import Canvas, Painter
from cags_client.stats import Stopwatch
from cags_common.errors import ConfigError
from cags_common.raster import Exactness, RenderOptions, create
from cags_gpu import keeper as keeping
from cags_gpu.device import Gpu
from cags_gpu.keeper import Keeper
from cags_gpu.raster import GpuRasteriser, GpuScene
from cags_gpu.scene import ResidentScene
from support.gpu import any_gpu, needs_adapter
from support.raster_scenes import camera, psnr_db, random_splats

pytestmark = needs_adapter

OPTIONS = RenderOptions(exactness=Exactness.EXACT, contribution=True)


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> Iterator[Keeper]:
    monkeypatch.setattr(keeping, "FIRST_DELAY_S", 0.01)
    made = Keeper(any_gpu)
    yield made
    made.close()


def awaited(kept: Keeper) -> None:
    deadline = time.monotonic() + 20
    while kept.current() is None:
        assert time.monotonic() < deadline, "no new device"
        time.sleep(0.01)


def on_device(scene: GpuScene) -> bool:
    return scene._resident is not None


def test_a_device_lost_in_mid_frame(own: Keeper, monkeypatch: pytest.MonkeyPatch, caplog: Any) -> None:
    splats = random_splats(500)
    scene = GpuRasteriser(own).load(splats)
    before = scene.render(camera(), OPTIONS)
    real = ResidentScene.record

    def destroyed(self: ResidentScene, *arguments: Any, **named: Any) -> Any:
        target = real(self, *arguments, **named)
        self.gpu.device.destroy()
        return target

    monkeypatch.setattr(ResidentScene, "record", destroyed)
    with caplog.at_level(logging.WARNING):
        meanwhile = scene.render(camera(), OPTIONS)
    assert "drawing on the CPU until it is back" in caplog.text
    monkeypatch.setattr(ResidentScene, "record", real)
    assert not on_device(scene)
    np.testing.assert_array_equal(meanwhile.rgb, create("cpu").load(splats).render(camera(), OPTIONS).rgb)
    awaited(own)
    np.testing.assert_array_equal(scene.render(camera(), OPTIONS).rgb, before.rgb)
    assert on_device(scene)


def test_a_device_lost_in_a_frame_that_is_made_in_one_go(own: Keeper, monkeypatch: pytest.MonkeyPatch) -> None:
    """The player draws that very frame step by step; the server's comparison likewise."""
    truth, held = (GpuRasteriser(own).load(random_splats(300, seed=seed)) for seed in (1, 2))
    before = truth.frame(camera(), OPTIONS, None)
    assert before is not None
    painter, canvas = Painter(1), Canvas(truth, 0, camera(), False, OPTIONS)
    real = ResidentScene.put_in_order

    def destroyed(self: ResidentScene, *arguments: Any, **named: Any) -> None:
        real(self, *arguments, **named)
        self.gpu.device.destroy()

    monkeypatch.setattr(ResidentScene, "put_in_order", destroyed)
    meanwhile = painter.paint(canvas, None, Stopwatch(lambda: 0.0))
    assert np.abs(meanwhile.rgb - before.rgb).max() <= 0.5 / 255 + 1e-4
    assert truth.compared(held, camera(), OPTIONS, knee=0.1, looks=()) is None
    awaited(own)
    assert truth.compared(held, camera(), OPTIONS, knee=0.1, looks=()) is None, "lost in mid-comparison"
    monkeypatch.setattr(ResidentScene, "put_in_order", real)
    awaited(own)
    assert truth.compared(held, camera(), OPTIONS, knee=0.1, looks=()) is not None
    after = truth.frame(camera(), OPTIONS, None)
    assert after is not None
    np.testing.assert_array_equal(after.rgb, before.rgb)


def test_what_changes_while_there_is_no_device_is_on_the_next_one(own: Keeper) -> None:
    splats, rows = random_splats(300), np.arange(0, 300, 2)
    scene = GpuRasteriser(own).load(splats)
    scene.render(camera(), OPTIONS)
    new = random_splats(len(splats), seed=3)
    own.current().gpu.destroy()
    scene.update(rows, new)  # the loss is found here
    scene.render(camera(), OPTIONS)
    moved = random_splats(300)
    moved.means[rows[:9]] += np.float32(0.1)
    scene.move(rows[:9], moved)
    meanwhile = scene.render(camera(), OPTIONS)
    awaited(own)
    after = scene.render(camera(), OPTIONS)
    assert on_device(scene)
    assert psnr_db(after.rgb, meanwhile.rgb) > 100
    assert psnr_db(after.rgb, create("cpu").load(splats).render(camera(), OPTIONS).rgb) < 60


def test_making_a_device_is_tried_until_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keeping, "FIRST_DELAY_S", 0.01)
    tries: list[int] = []

    def make() -> Gpu:
        tries.append(1)
        if 1 < len(tries) < 4:
            raise ConfigError("not yet")
        return any_gpu()

    kept = Keeper(make)
    kept.lost(kept.current(), "gone")
    awaited(kept)
    assert len(tries) == 4
    kept.close()


def test_two_devices_draw_the_same_bytes_at_the_same_time(own: Keeper) -> None:
    other = Keeper(any_gpu)
    splats = random_splats(1000, degree=1)
    scenes = [GpuRasteriser(kept).load(splats) for kept in (own, other)]
    views = [scene.render(camera(), OPTIONS) for scene in scenes + scenes]
    for view in views[1:]:
        np.testing.assert_array_equal(view.rgb, views[0].rgb)
    own.current().gpu.destroy()
    np.testing.assert_array_equal(scenes[1].render(camera(), OPTIONS).rgb, views[0].rgb)
    other.close()


def test_a_defect_of_ours_is_not_taken_for_a_loss(own: Keeper) -> None:
    with pytest.raises(Exception, match=r"(?i)validation"), own.current().gpu.used():
        own.current().gpu.device.create_shader_module(code="no WGSL")
    assert not own.current().gpu.lost
