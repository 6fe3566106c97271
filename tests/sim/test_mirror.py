"""A whole session: what the server drew for each reference is what its client holds when it shows that reference."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Cut, Scenario, simulate
from cags_client.frame.pipeline import ClientPipeline
from cags_client.frame.presented import PresentedFrame
from cags_client.playback.player import Player
from cags_client.settings import ClientSettings
from cags_common.geometry import Camera
from cags_encoder import EncodeSettings
from cags_server.settings import ServerSettings
from support.compared_mirror import Compared

FRAMES, GROUP = 24, 8
MOVING = f"procedural:size=900,frames={FRAMES}"


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    encoding = EncodeSettings(frames=FRAMES, gof_frames=GROUP)
    bundle = cached_bundle(MOVING, str(tmp_path_factory.mktemp("bundles")), encoding)
    client = ClientSettings(width=96, height=72)
    server = ServerSettings(reference_width=64, reference_height=48, references="difference")
    return Scenario(bundle, "generated:steady-8", "synthetic:walking", server=server, client=client, scored=False)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"tiles_ahead": 1},
        {"reference_every": 3},
        {"abr": "paper"},
    ],
)
def test_the_mirror_is_the_client_at_every_difference(
    scenario: Scenario, changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    compared = Compared(monkeypatch)
    simulate(replace(scenario, server=replace(scenario.server, **changes)))
    assert compared.frames == sorted(compared.frames)
    assert len(compared.frames) >= 0.8 * FRAMES / changes.get("reference_every", 1)
    assert {frame // GROUP for frame in compared.frames} == set(range(FRAMES // GROUP))


@pytest.mark.parametrize("mbps", [1, 60])
def test_on_any_link_the_mirror_is_the_client(scenario: Scenario, mbps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    compared = Compared(monkeypatch)
    simulate(replace(scenario, trace=f"generated:steady-{mbps}"))
    assert len(compared.frames) >= FRAMES / 3


def test_a_client_that_came_back_is_mirrored_again(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    compared = Compared(monkeypatch)
    result = simulate(replace(scenario, cuts=(Cut(500_000, 600_000),)))
    assert result.summary["reconnects"] == 1
    assert max(compared.frames) == FRAMES - 1
    assert len(compared.frames) >= FRAMES / 3


def test_a_display_of_another_shape_in_mid_session_is_mirrored_again(
    scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A window that is turned, and made wide: other pixels, other angles, and nothing that is held is sent again."""
    compared, shapes, seen = Compared(monkeypatch), deque([(500_000, 72, 96, 45.0), (800_000, 128, 48, 100.0)]), set()
    handle_timer, present = Player.handle_timer, ClientPipeline.present

    def handled(player: Player, now_us: int) -> None:
        handle_timer(player, now_us)
        if shapes and now_us >= shapes[0][0]:
            _, width, height, fov = shapes.popleft()
            player.reshape(width, height, fov, now_us)

    def presented(pipeline: ClientPipeline, frame: int, camera: Camera, *more: Any, **named: Any) -> PresentedFrame:
        shown = present(pipeline, frame, camera, *more, **named)
        if shown.reference is not None:
            made = shown.reference.camera.intrinsics
            seen.add((shown.rgb.shape[:2], made.width_px / made.fx_px > made.height_px / made.fy_px))
        return shown

    monkeypatch.setattr(Player, "handle_timer", handled)
    monkeypatch.setattr(ClientPipeline, "present", presented)
    result = simulate(scenario)
    assert not shapes
    assert seen >= {((72, 96), True), ((96, 72), False), ((48, 128), True)}, "pictures and references of each shape"
    assert result.summary["reconnects"] == 0
    assert result.summary["decode_errors"] == 0
    assert max(compared.frames) == FRAMES - 1
    assert len(compared.frames) >= FRAMES / 3
