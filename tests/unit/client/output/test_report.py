"""The record of a frame."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from cags_client.output.report import frame_stats, summary
from cags_client.playback.jobs import Present, Traffic
from cags_client.stats import PlayStats
from cags_common.bundle import BundleReader
from cags_common.geometry import Pose
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene
from support.client_stage import Stage, walk


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> BundleReader:
    folder: Path = tmp_path_factory.mktemp("bundle") / "room"
    encode(open_scene("procedural:size=1000,frames=2"), EncodeSettings(frames=2, quantiser="paper-66"), str(folder))
    return BundleReader.open(str(folder))


def test_a_reference_of_an_earlier_frame_tells_nothing_of_the_prediction(reader: BundleReader) -> None:
    """Once the viewer's own motion since then counted as the prediction's error."""
    stage, there = Stage(reader), walk(reader)
    x, y, z = there.position
    here = Pose((x + 0.1, y, z), there.rotation)
    stage.send(0)
    stage.refer(0, there)

    def record(frame: int) -> dict[str, object]:
        shown = stage.show(frame, here)
        assert shown.reference is not None
        return frame_stats(shown, Present(frame, 0, here, stage.pipe, Traffic()), 0)

    own = record(0)
    assert math.isclose(float(str(own["prediction_error_m"])), 0.1, rel_tol=1e-6)
    stage.end(1)
    later = record(1)
    assert later["reference_frame"] == 0
    assert "prediction_error_m" not in later
    assert "prediction_error_deg" not in later


def test_a_summary_counts_from_when_the_first_frame_was_due(reader: BundleReader) -> None:
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    shown = stage.show(0, pose)
    record = frame_stats(shown, Present(0, 500_000, pose, stage.pipe, Traffic()), 520_000)
    assert summary([record], PlayStats(frames=1, dropped=14, started_us=100_000))["gap_p95_ms"] == 420
    assert "gap_p95_ms" not in summary([record], PlayStats(frames=1, started_us=500_000))


def test_a_summary_says_how_long_the_first_frame_took_from_the_connection_on() -> None:
    assert summary([], PlayStats(made_us=70_000_000, started_us=71_250_000))["first_frame_ms"] == 1250
    assert summary([], PlayStats(made_us=70_000_000))["first_frame_ms"] is None


def test_the_bytes_of_a_summary_make_up_its_goodput() -> None:
    """Codebooks, half of what a short play gets, were in the goodput alone."""
    stats = PlayStats(first_byte_us=1_000_000, last_byte_us=3_000_000)
    stats.bytes_tiles, stats.bytes_reference, stats.bytes_other = 40_000, 7_000, 60_000
    last = summary([], stats)
    received = last["bytes_tiles"] + last["bytes_reference"] + last["bytes_other"]
    assert received * 8 / 2 / 1e6 == pytest.approx(last["goodput_mbps"])


def test_frames_at_half_resolution_are_named_and_counted(reader: BundleReader) -> None:
    """Quality fell by 11 dB in mid-play, and no figure said why."""
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    camera = stage.pipe.camera(pose)
    records = [
        frame_stats(stage.pipe.present(0, camera, half=half), Present(0, 0, pose, stage.pipe, Traffic()), 0)
        for half in (False, True, True)
    ]
    assert [record["half"] for record in records] == [False, True, True]
    assert summary(records, PlayStats(frames=3))["frames_half"] == 2
