"""Work is counted as it is: entries against the definition, bytes by what improves, times by the device's clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_common.raster import Exactness, RenderOptions
from cags_common.raster.definition import ALPHA_CUT
from cags_common.raster.oracle import footsteps, project
from cags_gpu.timing import frame_counts, frame_times_ms
from cags_gpu.work import (
    DEVICES,
    PROTOTYPE,
    STEPS,
    Design,
    FrameCounts,
    compared_bytes,
    estimated_ms,
    operations,
    pass_bytes,
    read_back_bytes,
    visits,
)
from support.gpu import keeper, needs_adapter, rasteriser
from support.raster_scenes import camera, random_splats, tilted_camera

COUNTS = FrameCounts(150_000, 61_800, 1_800_000, 1_000_000, 2_700_000, 1600 * 1200)
EXACT = RenderOptions(exactness=Exactness.EXACT)


def touched(splats, cam) -> tuple[int, int, int]:
    """Tiles, and quarters of tiles, with a pixel of alpha over the cut, summed over the splats; splats with any
    (float64).
    """
    entries = quarters = seen = 0
    for step in footsteps(project(splats, cam, EXACT), cam):
        rows, columns = np.nonzero(step.alpha >= ALPHA_CUT)
        pixels = np.stack([rows + step.window[0].start, columns + step.window[1].start], axis=1)
        entries += len(np.unique(pixels // 16, axis=0))
        quarters += len(np.unique(pixels // 8, axis=0))
        seen += bool(len(pixels))
    return entries, quarters, seen


@needs_adapter
@pytest.mark.parametrize("exactness", [Exactness.EXACT, Exactness.BALANCED])
def test_no_tile_with_a_pixel_is_left_out_and_few_without_one_are_kept(exactness: Exactness) -> None:
    splats, cam = random_splats(1500, log_scale=-2.0), tilted_camera(160, 120)
    scene = rasteriser().load(splats)
    options = RenderOptions(exactness=exactness)
    counts = scene.on_device(lambda resident: frame_counts(resident, cam, options, camera(48, 36)), lambda _: None)
    right, quarters, seen = touched(splats, cam)
    assert right <= counts.entries <= 1.1 * right
    assert 0.999 * quarters <= counts.quarters <= 1.1 * quarters
    assert seen <= counts.visible <= seen + 0.02 * len(splats)
    assert counts.entries < 0.85 * counts.box_entries
    assert counts.reference_pixels == 48 * 36


@needs_adapter
def test_passes_are_timed_where_there_is_a_clock() -> None:
    scene = rasteriser().load(random_splats(500))
    times = scene.on_device(lambda resident: frame_times_ms(resident, camera(), EXACT), lambda _: {})
    if not keeper().current().gpu.timestamps:
        assert times == {}
        return
    assert {"project.project", "radix.scatter order", "bin.emit", "radix.scatter tile", "blend.blend"} <= set(times)
    assert all(ms >= 0 for ms in times.values())
    assert times["blend.blend"] > 0


def test_every_improvement_saves_and_the_last_is_what_runs() -> None:
    moved = [sum(pass_bytes(COUNTS, design).values()) for _, design in STEPS]
    assert moved == sorted(moved, reverse=True)
    assert STEPS[0][1] == PROTOTYPE
    assert STEPS[-1][1] == Design()
    whole_tiles = Design(quarters=False)
    assert visits(COUNTS) == 64 * COUNTS.quarters < visits(COUNTS, whole_tiles) == 256 * COUNTS.entries
    assert visits(COUNTS, whole_tiles) < visits(COUNTS, PROTOTYPE)
    worked = [operations(COUNTS, design) for design in (PROTOTYPE, whole_tiles, Design())]
    assert worked == sorted(worked, reverse=True)


def test_estimates_follow_work_and_device() -> None:
    slow, fast = DEVICES[1], DEVICES[2]
    assert estimated_ms(COUNTS, slow) > estimated_ms(COUNTS, DEVICES[0]) > estimated_ms(COUNTS, fast) > 0
    assert estimated_ms(COUNTS, slow, PROTOTYPE) > estimated_ms(COUNTS, slow)
    half = replace(COUNTS, splats=75_000)
    assert half.scaled(150_000).entries == 2 * COUNTS.entries


def test_what_is_made_in_one_go_brings_down_less() -> None:
    assert read_back_bytes(COUNTS, in_one_go=True) * 5 == read_back_bytes(COUNTS, in_one_go=False)
    of_splats = 4 * COUNTS.splats
    one, two = (compared_bytes(COUNTS, in_one_go=way) - of_splats for way in (True, False))
    assert 9 * one == 7 * two > 0
