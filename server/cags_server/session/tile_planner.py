"""Chooses the tiles that go out with each planned frame of one client, and between two frames.

What a frame needs is what the viewer sees of it, what has come into view since it was planned, and, while the viewer is
paused, what begins next. The rate policy chooses among these within the byte budget. What is left of it goes to
the first frame of the next group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from cags_common.tiles.kinds import TileKind
from cags_protocol import events as ev
from cags_server.link import LinkState
from cags_server.link.byte_budget import MESSAGE_OVERHEAD_BYTES
from cags_server.link.pace import MARGIN_US
from cags_server.ratecontrol import Decision, Observation, create_rate_policy
from cags_server.ratecontrol.base import TileView, mean_level, motion_density
from cags_server.ratecontrol.outlook import Supply, lacking_bytes, supply
from cags_server.records import Ahead, FrameRecord
from cags_server.reference.job import FramePlan
from cags_server.reference.worth import Worth
from cags_server.scene.library import SceneLibrary
from cags_server.scene.visible_tiles import VisibleTile
from cags_server.session.dispatch import Dispatch
from cags_server.session.schedule import Schedule
from cags_server.session.tile_sender import TileSender
from cags_server.session.viewer import Viewer
from cags_server.settings import ServerSettings
from cags_server.visibility.visibility import Visibility

FEW_PASSED = 2
"""Largest number of passed frames that are planned by themselves in a bundle with motion: single attributes may change
in every frame.
"""

RESERVED_SPLATS = 1 << 20
"""Largest number of splats that appear within the reserve: the client holds them decoded, up to 240 bytes each."""

FOLLOWED_AT_ONCE = 4
"""Number of frames after the paused one that are looked at in one plan; each takes some milliseconds."""

LOOK_BACK_EVERY = 4
"""Planned frames until what the reserve has passed over is looked for again; every frame where splats are sent whole.
"""


class TilePlanner:
    """From planned frames to messages that bring tiles, and the ends of the frames."""

    def __init__(
        self,
        library: SceneLibrary,
        settings: ServerSettings,
        *,
        viewer: Viewer,
        schedule: Schedule,
        link: LinkState,
        visibility: Visibility,
        tiles: TileSender,
        dispatch: Dispatch,
        worth: Worth,
        fetches: bool = False,
    ) -> None:
        """``fetches``: what is to be read from the store is asked for by :attr:`to_fetch`, and not read here."""
        self._library, self._settings = library, settings
        self._viewer, self._schedule, self._link = viewer, schedule, link
        self._visibility, self._tiles, self._dispatch, self._worth = visibility, tiles, dispatch, worth
        self._policy = create_rate_policy(settings.abr)
        self._newest: FrameRecord | None = None  # the frame that was served last, while the client lacks some of it
        self._decided_us = 0  # when tiles were chosen last
        self._fetches = fetches
        self._opening: Ahead | None = None  # of the next group of frames, where it is near
        self._held_is_good = False  # the frame that the viewer is paused at, about as good as it will be
        self._followers: tuple[VisibleTile, ...] = ()  # what begins after it and was not sent, as far as looked at
        self._followed: int | None = None  # the last frame looked at for that
        self._sent_ahead: int | None = None  # the last frame of which everything was sent before the play

    def restart(self, *, goes_on: bool) -> None:
        """The viewer has played, paused or jumped: what was planned before says nothing any more.

        ``goes_on``: the media goes on where it was, so that what was sent ahead in a pause is of use.
        """
        whole = goes_on and self._followed is not None and not self._lacking(self._followers)
        self._sent_ahead = self._followed if whole else None
        self._newest = self._followed = self._opening = None
        self._followers, self._held_is_good = (), False

    @property
    def to_fetch(self) -> int | None:
        """The media frame to be read for what opens the next group; None for none. Plans do not wait for it."""
        if self._opening is None or not self._fetches or self._library.at_hand(self._opening.frame):
            return None
        return self._opening.frame

    def beginning(self, plan: FramePlan, now_us: int) -> list[ev.Outgoing]:
        """The first tiles of a picture, for a client that holds nothing."""
        if not self._tiles.from_nothing:
            return []
        return self._dispatch.queue(self._tiles.beginning(plan.frame, self._viewer.camera(plan.predicted.pose)), now_us)

    def passed_over(self, plan: FramePlan, record: FrameRecord, now_us: int) -> list[ev.Outgoing]:
        """Tiles and ends of the frames before the one planned ahead that no earlier plan served.

        Where they are many, as at the beginning, a bundle with motion brings only what begins in them: splats that
        appear, and motion and updates. Whatever else these frames show has its turn with the one planned ahead.
        What was sent before the play is not looked at again: the first frames are due at once, and wait for their ends.
        """
        sent, self._sent_ahead = -1 if self._sent_ahead is None else self._sent_ahead, None
        many = self._library.manifest.motion is not None and len(plan.before) > FEW_PASSED
        out: list[ev.Outgoing] = []
        for ahead in plan.before:
            ended = -1 if self._tiles.ended is None else self._tiles.ended
            if not max(ended, sent) < ahead.frame < plan.ahead.frame or not self._visibility.tells_of(ahead.frame):
                continue
            tiles = self._visibility.tiles(ahead.frame)
            if many:
                tiles = tuple(tile for tile in tiles if tile.frame == ahead.frame)
                if not tiles:
                    continue
            step = replace(record, ahead=ahead, tile_bytes=0)
            out += self._chosen(tiles, step, now_us)
            record.tile_bytes += step.tile_bytes
        return out

    def frame(self, visible: tuple[VisibleTile, ...], record: FrameRecord, now_us: int) -> list[ev.Outgoing]:
        """The tiles for the frame ahead of ``record``, of which ``visible`` are in view, and the frame's end."""
        wanted = visible + self._come_into_view(record, visible)
        wanted += self._following(record, wanted)
        out = self._chosen(wanted, record, now_us, newest=True) + self._next_group(record, now_us)
        self._dispatch.budget.end_frame()
        return out

    def detail_due_us(self) -> int | None:
        """Time to choose more tiles for the frame that was served last; None if it lacks none, or nobody has seen it.

        Where the lead has become shorter, the next frame is not due for longer than a frame, and the link would idle.
        """
        if self._newest is None or self._schedule.rendering or not self._visibility.tells_of(self._newest.ahead.frame):
            return None
        return self._decided_us + round(self._schedule.planned_period_us)

    def more_detail(self, now_us: int) -> list[ev.Outgoing]:
        """Tiles for the frame that was served last, if they are due."""
        record, due_us = self._newest, self.detail_due_us()
        if record is None or due_us is None or now_us < due_us:
            return []
        step = replace(record, tile_bytes=0, reference_bytes=0, ticks_covered=1)
        out = self._chosen(self._visibility.tiles(record.ahead.frame), step, now_us)
        record.tile_bytes += step.tile_bytes
        record.budget_bytes += step.budget_bytes
        return out

    # --------------------------------------------------------------------------------------------- what a frame needs

    def _come_into_view(self, record: FrameRecord, visible: tuple[VisibleTile, ...]) -> tuple[VisibleTile, ...]:
        """Tiles of a nearer frame than the reserve has reached, of which the client holds nothing: when that frame was
        planned, the viewer did not see them.
        """
        every = 1 if self._library.manifest.motion is None else LOOK_BACK_EVERY
        if not self._schedule.reserve.grown or record.tick % every:
            return ()
        near = self._schedule.media_frame(self._schedule.ahead(record.tick, self._settings.tiles_ahead))
        if near is None or near >= record.ahead.frame or not self._visibility.tells_of(near):
            return ()
        tiles = _others(self._visibility.tiles(near), visible)
        return tuple(tile for tile in tiles if not self._tiles.inventory.depth(tile.frame, tile.tile))

    def _following(self, record: FrameRecord, visible: tuple[VisibleTile, ...]) -> tuple[VisibleTile, ...]:
        """What begins in the frames after the one that the viewer is paused at, once that one is about as good as it
        will be: the first frames of a play would otherwise all be due at once. A few frames at a time, the next ones
        when these have been sent, as far as the reserve may reach. Their ends come with the play.
        """
        frame = record.ahead.frame
        if self._schedule.timeline.playing or not self._held_is_good or not self._visibility.tells_of(frame):
            return ()
        self._followers = self._lacking(self._followers)
        if not self._followers:
            followed = frame if self._followed is None else self._followed
            last = min(followed + FOLLOWED_AT_ONCE, self._last_to_follow(frame))
            self._followers = self._lacking(self._beginning_after(followed, last))
            self._followed = max(followed, last)
        return _others(self._followers, visible)

    def _lacking(self, tiles: Sequence[VisibleTile]) -> tuple[VisibleTile, ...]:
        return tuple(tile for tile in tiles if not self._tiles.view(tile, tile.frame, 0.0).complete)

    def _last_to_follow(self, frame: int) -> int:
        """The last frame after ``frame``, at which the viewer is paused, whose tiles may be sent meanwhile."""
        manifest, ahead = self._library.manifest, self._settings.tiles_ahead
        while self._schedule.reserve.covers((ahead + 1) * self._schedule.timeline.period_us):
            ahead += 1
        return min(frame + ahead, manifest.gof_frames(manifest.gof_of(frame))[-1])

    def _beginning_after(self, frame: int, last: int) -> tuple[VisibleTile, ...]:
        """Tiles in view that begin after ``frame`` and up to ``last``, of its group, each as seen in the first of these
        frames.
        """
        found: dict[tuple[int, int], VisibleTile] = {}
        for later in range(frame + 1, last + 1):
            for tile in self._visibility.tiles(later):
                if tile.frame > frame:
                    found.setdefault((tile.frame, tile.tile), tile)
        return tuple(found.values())

    def _next_group(self, record: FrameRecord, now_us: int) -> list[ev.Outgoing]:
        """Tiles of the first frame of the next group, from what is left of the budget: all its splats are due then, and
        the link may be idle now. What will be in view is guessed from bounds.
        """
        opening = self._opening = self._opening_of_next_group(record)
        lacks = self._newest is not None  # the frame of the record does
        if opening is None or lacks or self.to_fetch is not None:
            return []
        camera = self._viewer.camera(record.predicted)
        pixels = camera.intrinsics.width_px * camera.intrinsics.height_px
        tiles = self._visibility.guessed_tiles(opening.frame, camera, pixels)
        step = replace(record, ahead=opening, ticks_covered=0, reference_bytes=0)  # which earn no budget again
        observation, earned_bytes = self._observed(tiles, step, now_us)
        decision = self._policy.decide(observation)
        record.tile_bytes += decision.bytes
        self._dispatch.budget.close(earned_bytes - decision.bytes, now_us)
        return self._dispatch.queue(
            self._tiles.upgrades(record.ahead.frame, decision.upgrades, self._deadline_us(opening)), now_us
        )

    def _opening_of_next_group(self, record: FrameRecord) -> Ahead | None:
        """The first frame of the group after that of ``record``, in a loop after the last one the clip's; None where
        the reserve would not reach it yet.
        """
        manifest, timeline = self._library.manifest, self._schedule.timeline
        group = manifest.gof_of(record.frame)
        end = manifest.gof_frames(group)[-1] + 1
        first = end % manifest.frames if timeline.loop else end
        if not timeline.playing or manifest.gof_of(record.ahead.frame) != group or first == manifest.frames:
            return None
        if manifest.gof_of(first) == group or manifest.capacity[manifest.gof_of(first)] > RESERVED_SPLATS:
            return None
        display_us = record.ahead.display_us + round((end - record.ahead.frame) * timeline.period_us)
        return Ahead(first, display_us) if self._schedule.reserve.covers(display_us - record.display_us) else None

    # ------------------------------------------------------------------------------------------------ what it is given

    def _chosen(
        self, wanted: tuple[VisibleTile, ...], record: FrameRecord, now_us: int, *, newest: bool = False
    ) -> list[ev.Outgoing]:
        """Those of ``wanted`` that the rate policy chooses, and the end of the frame; ``newest``: it is the last frame
        planned at this time, and no step between. Ghosts are looked for in that frame only.
        """
        ahead, camera, tiles = record.ahead, self._viewer.camera(record.predicted), wanted
        if newest:
            tiles = self._visibility.with_ghosts(wanted, ahead.frame, camera, self._tiles.inventory, self._tiles.age)
        observation, earned_bytes = self._observed(tiles, record, now_us)
        decision = self._policy.decide(observation)
        lacking = lacking_bytes(observation)
        coming_bytes = self._dispatch.budget.outstanding_bytes + lacking
        self._worth.observe(coming_bytes, record.estimate_bps, self._schedule.timeline.period_us, now_us)
        self._decided_us = now_us
        if newest:
            self._held_is_good |= not lacking
            self._served(supply(observation, decision), record, now_us)
        record.tile_bytes += decision.bytes
        self._dispatch.budget.close(earned_bytes - decision.bytes, now_us)
        record.visible_tiles, record.upgrades = len(tiles), len(decision.upgrades)
        return self._messages(decision, record, now_us)

    def _observed(self, visible: tuple[VisibleTile, ...], record: FrameRecord, now_us: int) -> tuple[Observation, int]:
        """What the rate policy is told of the frame ahead of ``record``; and the bytes that were earned for it."""
        schedule, budget = self._schedule, self._dispatch.budget
        record.estimate_bps = self._link.estimate_bps(now_us)
        frame, display_us = record.ahead.frame, record.ahead.display_us
        to_display_us = self._viewer.clock.to_server(display_us) - now_us
        longest_us = schedule.lead_us + self._settings.tiles_ahead * schedule.planned_period_us
        lead_frames = min(to_display_us, longest_us) / schedule.timeline.period_us
        views = [self._tiles.view(tile, frame, lead_frames) for tile in visible]
        record.level = mean_level(views)
        tiles = tuple(view for view in views if view.kind == TileKind.LOOKS or not view.complete)
        period_us = schedule.planned_period_us
        earned_bytes = budget.open(record, schedule.timeline.period_us, now_us)
        timely_bytes = budget.timely(float(to_display_us - MARGIN_US), period_us, _dearest(tiles, frame), now_us)
        record.budget_bytes = min(earned_bytes, max(budget.room(period_us, now_us), timely_bytes))
        observation = Observation(
            frame=frame,
            budget_bytes=record.budget_bytes,
            tiles=tiles,
            lod_gains_db=self._library.manifest.lod_gains_db,
            still_errors=self._library.still_errors,
            motion_density=motion_density(views),
            outdated_errors=self._library.outdated_errors,
            message_overhead_bytes=MESSAGE_OVERHEAD_BYTES,
            layered=self._tiles.layered,
            waiting_us=budget.waiting_us(now_us),
            timely_bytes=timely_bytes,
            alone_bytes=budget.alone(earned_bytes, period_us, now_us),
            frame_bytes=record.estimate_bps * schedule.timeline.period_us / 8e6,
        )
        return observation, earned_bytes

    def _served(self, found: Supply, record: FrameRecord, now_us: int) -> None:
        """The frame of ``record`` has been planned: more detail may follow, and the reserve may grow."""
        self._newest = None if found is Supply.COMPLETE else record
        if self._reserve_is_full(record):
            self._schedule.reserve.hold()
        elif self._is_out_of_reach(record, now_us):
            self._schedule.reserve.reach_on(self._schedule.planned_period_us)
        else:
            self._schedule.reserve.planned(found, period_us=self._schedule.planned_period_us)

    def _is_out_of_reach(self, record: FrameRecord, now_us: int) -> bool:
        """Whether nothing, however small, could arrive before the display of the frame ahead: over a path of so long a
        delay every frame would be late, and for want of its first levels the reserve would never grow.
        """
        to_display_us = self._viewer.clock.to_server(record.ahead.display_us) - now_us
        return self._schedule.timeline.playing and to_display_us - MARGIN_US <= self._link.newest.shortest_rtt_us

    def _reserve_is_full(self, record: FrameRecord) -> bool:
        """Whether what a larger reserve would reach next is not to be reached yet: because of what the client would
        hold, or because it is in another group of frames than the displayed one, of which nothing was seen.
        """
        schedule, gof_of = self._schedule, self._library.manifest.gof_of
        after = schedule.media_frame(schedule.ahead(record.tick, schedule.reserve.frames + 2))
        if after is None:  # the clip ends
            return False
        if gof_of(after) != gof_of(record.frame):
            return True
        if after <= record.frame:  # the group begins again
            return False
        return self._library.tile_map(after).new_splats(record.frame, after) > RESERVED_SPLATS

    def _messages(self, decision: Decision, record: FrameRecord, now_us: int) -> list[ev.Outgoing]:
        ahead = record.ahead
        out = self._tiles.upgrades(ahead.frame, decision.upgrades, self._deadline_us(ahead))
        return self._dispatch.queue_frame(out, ahead.display_us, now_us)

    def _deadline_us(self, ahead: Ahead) -> int:
        """Until when tiles for a frame are worth sending."""
        return self._viewer.clock.to_server(ahead.display_us) + int(self._settings.tile_deadline_ms * 1000)


def _dearest(tiles: tuple[TileView, ...], frame: int) -> int:
    """Bytes of the largest new tile that shows in ``frame``; 0 if there is none."""
    now = (tile for tile in tiles if not tile.depth and tile.frame <= frame)
    return max((tile.lod_bytes[0] + MESSAGE_OVERHEAD_BYTES for tile in now), default=0)


def _others(tiles: tuple[VisibleTile, ...], known: tuple[VisibleTile, ...]) -> tuple[VisibleTile, ...]:
    """Those of ``tiles`` that are not among ``known``."""
    keys = {(tile.frame, tile.tile) for tile in known}
    return tuple(tile for tile in tiles if (tile.frame, tile.tile) not in keys)
