"""A whole session in which one splat veils the picture: a small room over a slow link, in virtual time."""

from pathlib import Path

import pytest

from cags_bench.sim.session import Scenario, simulate
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene
from cags_server.settings import ServerSettings

SCENE = "procedural:size=3000,seed=11,frames=24"


@pytest.mark.nightly
def test_no_frame_of_a_room_under_a_veil_loses(tmp_path: Path) -> None:
    """Both cameras stand inside of one splat, most of the room is at full LoD, and parts that move are not.

    A frame lost 9 dB while a veil was looked for by the difference of the client's two views alone.
    """
    encode(open_scene(SCENE), EncodeSettings(frames=24), str(tmp_path / "room"))
    link = tmp_path / "link.csv"
    link.write_text("time_s,mbps\n0,2\n60,2\n")
    server = ServerSettings(reference_width=240, reference_height=180, render_threads=1)
    client = ClientSettings(width=480, height=360, threads=1)
    played = simulate(Scenario(tmp_path / "room", str(link), "synthetic:walking:seed=4", server=server, client=client))
    gains = [f["psnr_covered_restored_db"] - f["psnr_covered_distorted_db"] for f in played.frames]
    assert len(gains) == 24
    assert any("restoration" in f["effects"] for f in played.frames[12:])
    assert min(gains) > -0.1
