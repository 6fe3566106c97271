"""Pause, play, seek, speed and loop, in session time without sockets."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cags_client.frame.painting import StagedPictures
from cags_client.frame.presented import PresentedFrame
from cags_client.live_app import patient
from cags_client.output.page.poses import LivePoses
from cags_client.playback.interactive import SEEK_PATIENCE_US, InteractivePlayer
from cags_client.playback.jobs import Decode, DecodeResult, Present
from cags_client.playback.startup import QUIET_US
from cags_client.settings import ClientSettings
from cags_common.geometry import Pose
from cags_common.passes import PassPlan
from cags_protocol import events as ev
from cags_protocol.timeline import Timeline
from cags_protocol.wire.messages import Control, FrameEnd, TileLayers, Welcome
from support.live_page import StillWalk

FRAMES, FPS, DELAY_US = 30, 30.0, 250_000
FRAME_US = 1e6 / FPS
TILE = ev.TileReceived(TileLayers(0, 0, 0, 1, (10,), (0,)), memoryview(bytes(10)))


class FakeSession:
    """Keeps what the player says."""

    def __init__(self) -> None:
        self.controls: list[Control] = []
        self.gone = False

    def hello(self, hello: Any, *, now_us: int) -> None: ...

    def control(self, control: Control, *, now_us: int) -> None:
        self.controls.append(control)

    def send_poses(self, samples: Any, *, now_us: int, cadence_permille: int) -> None: ...

    def report_evictions(self, tiles: Any) -> None: ...

    def handle_timer(self, *, now_us: int) -> None: ...

    def next_event(self) -> None:
        return None

    def next_timer_us(self) -> None:
        return None

    def bye(self, *, now_us: int) -> None:
        self.gone = True


class FakePipeline:
    """Draws nothing, and remembers when it was emptied."""

    def __init__(self) -> None:
        self.resets: list[int] = []
        self.jumps = 0
        self.settings = ClientSettings()
        self.kept = range(0)
        self.held: set[int] = set()

    def holds(self, frame: int) -> bool:
        return frame in self.held

    def reset(self, frame: int) -> None:
        self.resets.append(frame)

    references_received = 0
    opens_tiles = True

    def jump(self, frame: int) -> None:
        self.jumps += 1


def shown(frame: int) -> PresentedFrame:
    """An empty picture of ``frame``."""
    blank = np.zeros((2, 2, 3), np.float32)
    pictures, plan = StagedPictures(blank, blank, blank), PassPlan(frozenset())
    return PresentedFrame(frame, None, pictures, None, None, 0.0, False, {}, plan)  # type: ignore[arg-type]


class Stage:
    """A player with its first frame decoded, and a clock of the test's own."""

    def __init__(self, *, moves: bool = False, draw_us: int = 0, **settings: Any) -> None:
        """``moves``: the bundle has motion; ``draw_us`` are what a picture takes."""
        self.session, self.pipeline, self.draw_us = FakeSession(), FakePipeline(), draw_us
        self.between: list[float] = []
        """Times, in media frames, of the pictures between them."""
        self.poses = LivePoses(StillWalk())
        self.now_us = 0
        at_once = ClientSettings(**{"startup_ms": 0, **settings})
        self.player = InteractivePlayer(self.session, at_once, self.poses, now_us=0)  # type: ignore[arg-type]
        self.player.info = SimpleNamespace(fps=FPS, frames=FRAMES, gof_starts=(0,), motion=moves or None)  # type: ignore[assignment]
        self.player.pipeline = self.pipeline  # type: ignore[assignment]
        self.player._timeline = Timeline(FPS, FRAMES)
        self.player._codebooks = b""
        self.end(0)

    def end(self, frame: int) -> None:
        """Frame ``frame`` has been decoded whole."""
        action = Decode((ev.FrameEnded(FrameEnd(frame), memoryview(b"")),), self.pipeline)  # type: ignore[arg-type]
        self.player.done(action, DecodeResult((), False, frame), self.now_us)

    def turn(self) -> int | None:
        """Draw what is due; the frame that was drawn."""
        action = self.player.next_action(self.now_us)
        if not isinstance(action, Present):
            return None
        self.now_us += self.draw_us
        self.player.done(action, shown(action.frame), self.now_us)
        if action.share:
            self.between.append(action.frame + action.share)
            return None
        return action.frame

    def run(self, microseconds: float, step_us: int = 5_000) -> list[int]:
        """Let time pass; the frames that were drawn."""
        drawn, end_us = [], self.now_us + microseconds
        while self.now_us < end_us:
            self.now_us += step_us
            frame = self.turn()
            if frame is not None:
                drawn.append(frame)
        return drawn


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_the_first_frame_is_held_while_more_of_it_comes() -> None:
    stage = Stage(startup_ms=700)
    assert stage.player.next_timer_us() <= QUIET_US
    stage.player.handle_timer(QUIET_US - 1)
    assert stage.session.controls == [Control("pause", 0, 0)]
    stage.player.handle_timer(QUIET_US)
    assert stage.session.controls[1:] == [Control("play", 0, QUIET_US + DELAY_US, 1.0)]


def test_plays_in_time_and_starts_again_at_the_end(stage: Stage) -> None:
    assert stage.run(DELAY_US + FRAMES * FRAME_US + 20_000) == list(range(FRAMES))
    stage.turn()
    assert [(control.action, control.frame) for control in stage.session.controls[-2:]] == [("seek", 0), ("pause", 0)]
    assert stage.pipeline.resets == [0]
    assert stage.run(DELAY_US + 100_000) == []
    stage.end(0)
    assert stage.session.controls[-1] == Control("play", 0, stage.now_us + DELAY_US, 1.0)
    assert stage.run(DELAY_US + 4 * FRAME_US)[:4] == [0, 1, 2, 3]
    assert not stage.player.finished


def test_holds_the_last_frame_without_loop_and_plays_again_when_asked(stage: Stage) -> None:
    stage.player.loop = False
    stage.run(DELAY_US + FRAMES * FRAME_US + 200_000)
    assert not stage.player.playing
    assert stage.player.frame == FRAMES - 1
    assert stage.session.controls[-1].action == "pause"
    stage.player.play(stage.now_us)
    stage.turn()
    assert [control.action for control in stage.session.controls[-3:]] == ["play", "seek", "pause"]
    assert stage.pipeline.resets == [0]


def test_a_paused_frame_is_drawn_again_only_when_there_is_something_new(stage: Stage) -> None:
    stage.run(DELAY_US + 10 * FRAME_US)
    stage.player.pause(stage.now_us)
    held = stage.player.frame
    assert stage.session.controls[-1] == Control("pause", held, stage.now_us, 1.0)
    assert set(stage.run(500_000)) <= {held}
    assert stage.run(500_000) == []
    stage.poses.hold(Pose((1, 2, 3), (1, 0, 0, 0)), 1)
    assert stage.run(100_000) == [held]
    stage.player._decode_queue.add(TILE)
    assert stage.run(100_000) == [held]
    stage.player.play(stage.now_us)
    assert stage.session.controls[-1] == Control("play", held, stage.now_us + DELAY_US, 1.0)
    assert stage.run(DELAY_US + 3 * FRAME_US + 10_000)[:2] == [held, held + 1]


def test_a_paused_frame_is_drawn_again_as_its_viewer_wishes(stage: Stage) -> None:
    stage.run(DELAY_US + 10 * FRAME_US)
    stage.player.pause(stage.now_us)
    stage.run(500_000)
    stage.player.live.restore = "none"
    assert stage.run(500_000) == [stage.player.frame]
    stage.player.live.exactness = "exact"
    assert stage.run(500_000) == [stage.player.frame]
    stage.player.live.resolution = "half"
    assert stage.run(500_000) == [stage.player.frame]


def test_a_paused_picture_begun_while_the_last_batch_is_decoded_is_followed_by_one_that_shows_it(stage: Stage) -> None:
    stage.run(DELAY_US + 10 * FRAME_US)
    stage.player.pause(stage.now_us)
    stage.run(500_000)
    stage.player._decode_queue.add(TILE)
    batch = stage.player.next_action(stage.now_us)
    assert isinstance(batch, Decode)
    held = stage.player.frame
    assert stage.run(100_000) == [held], "drawn beside its decoding"
    stage.player.done(batch, DecodeResult((), False, -1), stage.now_us)
    assert stage.run(100_000) == [held]
    assert stage.run(500_000) == []


def test_a_seek_waits_for_work_under_way_and_then_for_its_frame(stage: Stage) -> None:
    stage.run(DELAY_US + 5 * FRAME_US)
    stage.player._decode_queue.add(TILE)
    assert isinstance(stage.player.next_action(stage.now_us), Decode)
    stage.player.seek(20)
    assert stage.player.next_action(stage.now_us) is None
    assert stage.pipeline.resets == []
    stage.player._decode_queue.decoded()
    stage.turn()
    assert stage.pipeline.resets == [20]
    assert stage.session.controls[-1].frame == 20
    stage.end(7)
    assert stage.run(400_000) == []
    stage.end(20)
    assert stage.run(DELAY_US + 3 * FRAME_US)[:3] == [20, 21, 22]


def test_a_seek_whose_frame_never_comes_shows_what_there_is(stage: Stage) -> None:
    stage.player.loop = False
    stage.run(DELAY_US + 5 * FRAME_US)
    stage.player.seek(3)
    stage.turn()
    assert stage.run(SEEK_PATIENCE_US - 50_000, step_us=50_000) == []
    assert stage.run(DELAY_US + 100_000)[0] == 3


def test_seeking_while_paused_shows_that_frame(stage: Stage) -> None:
    stage.run(DELAY_US + 5 * FRAME_US)
    stage.player.pause(stage.now_us)
    stage.run(100_000)
    stage.player.seek(999)
    stage.turn()
    stage.end(FRAMES - 1)
    assert stage.run(100_000) == [FRAMES - 1]
    assert not stage.player.playing


def test_who_asks_to_play_while_a_frame_is_sought_sees_that_frame_first(stage: Stage) -> None:
    stage.run(DELAY_US + 5 * FRAME_US)
    stage.player.pause(stage.now_us)
    stage.player.seek(20)
    stage.turn()
    stage.player.play(stage.now_us)
    stage.run(500_000)
    assert stage.session.controls[-1].action == "seek", "the server holds there"
    stage.end(20)
    assert stage.session.controls[-1] == Control("play", 20, stage.now_us + DELAY_US, 1.0)
    assert stage.run(DELAY_US + 2 * FRAME_US + 10_000)[:2] == [20, 21]


def test_what_is_held_loops_without_a_break_and_without_a_word(stage: Stage) -> None:
    stage.pipeline.kept = range(FRAMES)
    stage.player.set_rate(1.0, stage.now_us)
    said = len(stage.session.controls)
    assert stage.session.controls[-1].loop
    assert stage.session.controls[-1].keeps
    drawn = stage.run(DELAY_US + 2.5 * FRAMES * FRAME_US)
    assert drawn[: 2 * FRAMES] == [*range(FRAMES), *range(FRAMES)]
    assert len(stage.session.controls) == said
    assert stage.pipeline.resets == []
    stage.player.set_loop(False, stage.now_us)
    assert not stage.session.controls[-1].loop
    stage.run(FRAMES * FRAME_US)
    assert not stage.player.playing


def test_a_speed_that_was_wished_at_the_last_frame_of_a_round_holds_in_the_next(stage: Stage) -> None:
    stage.pipeline.kept = range(FRAMES)
    stage.player.set_rate(1.0, stage.now_us)
    while stage.turn() != FRAMES - 2:
        stage.now_us += 5_000
    stage.now_us += round(FRAME_US)
    action = stage.player.next_action(stage.now_us)
    assert isinstance(action, Present)
    stage.player.set_rate(0.5, stage.now_us)  # while the last frame is drawn: there is none to tell it of
    assert stage.session.controls[-1].rate == 1.0
    stage.player.done(action, shown(action.frame), stage.now_us)
    stage.run(DELAY_US + 5 * FRAME_US)
    assert stage.session.controls[-1].rate == stage.player._timeline.rate == 0.5


def test_what_is_wished_while_a_connection_is_opened_is_told_once_it_is_there(stage: Stage) -> None:
    stage.run(DELAY_US + 5 * FRAME_US)
    player, now_us = stage.player, stage.now_us
    player._resume_at, player._asked_by = player._state_of_play(now_us), player._timeline
    player.pause(now_us)
    player._on_welcome(Welcome("s-1", FPS, FRAMES), now_us + 1000)
    assert [control.action for control in stage.session.controls[-2:]] == ["pause", "pause"]
    assert not player._timeline.playing


def test_a_play_that_was_taken_over_goes_on_where_it_stood(stage: Stage) -> None:
    stage.run(DELAY_US + 5.5 * FRAME_US)
    player, now_us = stage.player, stage.now_us
    due_us = player._timeline.display_us(player._next_tick)
    player._resume_at, player._asked_by = player._state_of_play(now_us), player._timeline
    assert player._resume_at is not None
    ahead = player._resume_at.frame - player.frame
    assert ahead > 5, "a server needs time"
    player._on_welcome(Welcome("s-1", FPS, FRAMES), now_us + 1000)
    assert player._next_tick == 1 - ahead
    assert abs(player._timeline.display_us(player._next_tick) - due_us) <= 1
    assert stage.run(3 * FRAME_US) == [6, 7, 8]


def test_rounds_that_were_slept_through_are_not_made_up_for(stage: Stage) -> None:
    stage.pipeline.kept = range(FRAMES)
    stage.player.set_rate(1.0, stage.now_us)
    stage.run(DELAY_US + 0.5 * FRAMES * FRAME_US)
    stage.now_us += 11 * 86_400 * 1_000_000
    stage.turn()  # the last frame of the round that was under way
    drawn = stage.run(DELAY_US + 0.5 * FRAMES * FRAME_US)
    assert len(drawn) < FRAMES, "at the clip's own speed again"


def test_a_store_that_can_keep_no_more_loops_by_a_seek(stage: Stage) -> None:
    stage.pipeline.kept = range(FRAMES)
    stage.player.set_rate(1.0, stage.now_us)
    stage.run(DELAY_US + 0.5 * FRAMES * FRAME_US)
    stage.pipeline.kept = range(0)
    stage.run(0.6 * FRAMES * FRAME_US)
    assert stage.pipeline.resets == [0]
    assert not stage.session.controls[-1].keeps


def test_a_jump_to_what_is_held_does_not_wait(stage: Stage) -> None:
    stage.pipeline.kept, stage.pipeline.held = range(FRAMES), {3}
    stage.run(DELAY_US + 5 * FRAME_US)
    stage.player.seek(3)
    assert stage.run(DELAY_US + 2.5 * FRAME_US)[:2] == [3, 4]
    assert stage.pipeline.resets == []
    assert stage.pipeline.jumps == 1, "references of the pass before are of no use"


def test_half_speed_takes_twice_as_long(stage: Stage) -> None:
    stage.run(DELAY_US + 5 * FRAME_US)
    before = stage.player.frame
    stage.player.set_rate(0.5, stage.now_us)
    assert stage.session.controls[-1].rate == 0.5
    drawn = stage.run(10 * FRAME_US)
    assert drawn[0] == before + 1
    assert 4 <= len(drawn) <= 6


def test_wishes_before_the_first_frame_do_no_harm() -> None:
    session = FakeSession()
    player = InteractivePlayer(session, ClientSettings(), LivePoses(StillWalk()), now_us=0)  # type: ignore[arg-type]
    player.pause(0)
    player.seek(5)
    player.set_rate(2.0, 0)
    player.set_loop(False, 0)
    player.play(0)
    assert player.playing
    assert session.controls == []
    assert player.next_action(10) is None
    player.leave(20)
    assert session.gone
    player.leave(30)


def test_the_duration_ends_it() -> None:
    stage = Stage(duration=1.0)
    stage.run(DELAY_US + 900_000)
    stage.player.handle_timer(stage.now_us)
    assert not stage.player.finished
    stage.run(200_000)
    stage.player.handle_timer(stage.now_us)
    assert stage.player.finished
    assert stage.session.gone


def test_between_media_frames_what_moves_is_drawn_at_the_rate_of_the_display() -> None:
    stage = Stage(moves=True, interpolate="on", display_rate=90)
    drawn = stage.run(DELAY_US + 5.9 * FRAME_US, step_us=1_000)
    assert drawn == list(range(6)), "media frames are as many as ever, and in time"
    assert stage.between == pytest.approx([k / 3 for k in range(16) if k % 3] + [16 / 3, 17 / 3], abs=1e-4)
    assert (stage.player.stats.frames, stage.player.stats.interpolated) == (6, 12)
    assert len(stage.session.controls) == 1, "nothing is asked of the server"


@pytest.mark.parametrize(("moves", "mode"), [(False, "on"), (True, "off")])
def test_nothing_is_drawn_between_where_nothing_moves_or_nobody_wants_it(moves: bool, mode: str) -> None:
    stage = Stage(moves=moves, interpolate=mode)
    stage.run(DELAY_US + 5 * FRAME_US, step_us=1_000)
    assert stage.between == []


def test_a_machine_that_needs_most_of_a_frame_draws_nothing_between_and_drops_nothing() -> None:
    slow, fast = (Stage(moves=True, draw_us=us) for us in (20_000, 5_000))
    for stage in (slow, fast):
        stage.run(DELAY_US + 30 * FRAME_US, step_us=1_000)
        assert stage.player.stats.dropped == 0
    assert slow.between == []
    assert len(fast.between) >= 15


def test_a_pause_or_a_jump_ends_what_is_between() -> None:
    stage = Stage(moves=True, interpolate="on")
    stage.run(DELAY_US + 4 * FRAME_US + 5_000, step_us=1_000)
    stage.player.pause(stage.now_us)
    stage.between.clear()
    stage.run(500_000)
    assert stage.between == []
    stage.player.play(stage.now_us)
    stage.run(DELAY_US + 3 * FRAME_US)
    assert stage.between
    stage.player.seek(20)
    stage.between.clear()
    stage.run(300_000)
    assert stage.between == []


def test_a_page_waits_for_its_server() -> None:
    assert patient(ClientSettings()).reconnect_s == 86_400
    assert patient(ClientSettings(reconnect_s=0)).reconnect_s == 0
