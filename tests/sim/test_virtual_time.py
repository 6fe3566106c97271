"""Virtual time: deterministic, and true to what a scene needs."""

from dataclasses import replace
from pathlib import Path

import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import dump
from cags_bench.sim.session import Scenario, simulate, simulate_together
from cags_bench.stream.experiment import stream_lines
from cags_bench.stream.settings import StreamSettings
from cags_client.settings import ClientSettings
from cags_common.errors import ConfigError
from cags_encoder import EncodeSettings

MOVING = "procedural:size=1500,frames=12"
CLIENT = ClientSettings(width=160, height=120)


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> str:
    return str(tmp_path_factory.mktemp("bundles"))


@pytest.fixture(scope="module")
def scenario(cache) -> Scenario:
    bundle = cached_bundle(MOVING, cache, EncodeSettings(frames=12))
    return Scenario(bundle, "generated:steady-30", "synthetic:walking", client=CLIENT)


def settings(cache: str, **changes: object) -> StreamSettings:
    small = StreamSettings(scene=MOVING, frames=12, client=CLIENT, cache=cache, video_metrics="none")
    return replace(small, **changes)


def stream(of: StreamSettings) -> dict:
    [line] = stream_lines(of)
    return line


def test_two_runs_print_the_same(cache):
    assert dump(stream(settings(cache))) == dump(stream(settings(cache)))


def test_threads_do_not_change_the_result(scenario):
    one, two = (simulate(replace(scenario, client=replace(CLIENT, threads=n))) for n in (1, 2))
    assert dump({"frames": one.frames}) == dump({"frames": two.frames})


def test_sessions_beside_each_other_are_what_each_is_alone(scenario):
    """They share the server's library, and nothing else."""
    other = replace(scenario, poses="synthetic:walking:seed=5", trace="generated:steady-2")
    together = simulate_together([scenario, other])
    for mine, alone in zip(together, map(simulate, (scenario, other)), strict=True):
        assert dump({"frames": mine.frames, "summary": mine.summary}) == dump(
            {"frames": alone.frames, "summary": alone.summary}
        )


def test_sessions_that_join_apart_are_what_each_is_alone(scenario):
    late = simulate_together([scenario, scenario], 200_000)[1]
    alone = simulate(scenario)
    assert dump({"frames": late.frames}) == dump({"frames": alone.frames})
    assert late.spent.playing.began_us == alone.spent.playing.began_us  # by its own clock
    assert late.spent.serving_ms > 0
    assert late.spent.mirror_bytes > 0


def test_sessions_of_several_bundles_are_not_played_together(scenario, tmp_path):
    with pytest.raises(ConfigError, match="2 bundles"):
        simulate_together([scenario, replace(scenario, bundle=tmp_path)])


def test_both_sides_processor_time_is_counted(scenario):
    spent = simulate(scenario).spent
    assert spent.frames >= 12
    assert len(spent.references) >= 6
    assert all(one.truth_ms > 0 and one.mirror_ms > 0 and one.coding_ms > 0 for one in spent.references[2:])
    assert spent.server_ms_a_frame > 0
    assert spent.client_ms_a_frame > 0


def test_every_frame_is_shown_and_scored(scenario):
    result = simulate(scenario)
    assert [frame["frame"] for frame in result.frames] == list(range(12))
    assert result.summary["frames"] == 12
    assert all("psnr_restored_db" in frame for frame in result.frames)


def test_the_summary_holds_what_reports_promise(cache):
    promised = {"frames", "goodput_mbps", "psnr_distorted_db", "psnr_restored_db", "ssim_restored"}
    promised |= {"bytes_tiles", "bytes_reference", "frames_missed", "machine", "commit", "settings"}
    assert promised <= set(stream(settings(cache)))


def test_a_static_scene_sends_no_deltas(cache, tmp_path):
    from cags_common.bundle import BundleReader
    from cags_encoder import encode
    from cags_encoder.pipeline import SplatSequence
    from cags_encoder.scenes import open_scene

    still = open_scene(MOVING).frame(0)
    encode(SplatSequence((still,) * 12), EncodeSettings(), str(tmp_path / "still"))
    reader = BundleReader.open(str(tmp_path / "still"))
    assert [len(reader.frame(i).tiles) for i in range(1, 12)] == [0] * 11
    result = simulate(Scenario(tmp_path / "still", "generated:steady-30", "synthetic:still", client=CLIENT))
    whole = sum(sum(tile.lod_bytes) for tile in reader.frame(0).tiles)
    assert result.summary["bytes_tiles"] <= whole
    assert result.frames[-1]["bytes_tiles"] == 0, "everything was there long before the end"


def test_more_bandwidth_never_makes_the_picture_worse(scenario):
    slow, fast = (simulate(replace(scenario, trace=f"generated:steady-{rate}")) for rate in (2, 60))
    assert fast.summary["psnr_distorted_db"] >= slow.summary["psnr_distorted_db"]


def test_a_report_is_written_where_asked(cache, tmp_path):
    stream(settings(cache, out=str(tmp_path / "report")))
    assert {"frames.jsonl", "timeline.png", "strip.png"} <= {p.name for p in Path(tmp_path / "report").iterdir()}
