"""The schedule of one client: each frame is planned a lead before its display, with or without a reference render.

Frames are counted by *ticks* of the timeline. A client that cannot draw all frames reports how many it displays, and
the others are skipped, because nobody would see them. One reference render is pending at a time. A frame whose render
is overdue is served *blind*, so that media never waits for the renderer. This happens early if its group of frames was
rendered before, and later if not, because tiles are then chosen by bounds alone. A server that is slow to plan passes
over a few frames at once, by what the reserve holds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from cags_protocol.cadence import EVERY_FRAME, last_displayed, next_displayed
from cags_protocol.timeline import Timeline
from cags_protocol.wire.messages import Control
from cags_server.link import LinkState
from cags_server.link.pace import Pace
from cags_server.session.clock import ClientClock
from cags_server.session.reserve import Reserve
from cags_server.settings import ServerSettings

RENDER_GRACE, SEEN_GRACE, UNSEEN_GRACE = (2.0, 0.4), (1.0, 0.25), (4.0, 0.5)
"""Longest wait for a pending render before a frame is served without it: for the rendered frame, for the next one, and
for either in a group without any render. In frame periods, limited by a share of the lead.
"""

POOR, FAIR = 10**-2.8, 10**-3.2
"""Squared error of the client's own picture above which it is poor, and below which it no longer is. The lead is then
shorter: references are most of what the client shows, its depths are wrong, and a picture that was predicted further is
aligned worse.
"""

LONGEST_LEAD_US = 600_000
"""Largest lead: a slow renderer or link makes the server plan earlier, up to this; beyond it frames are skipped."""

MOST_PASSED = 2
"""Largest number of displayed frames whose tiles one plan passes over, beyond what the reserve holds."""

JUMP_US = 1_000_000
"""Frames of a pause that are due later than this from now indicate that a clock has jumped."""


class Schedule:
    """The ticks of one client. Times are the server's clock unless named otherwise."""

    def __init__(self, settings: ServerSettings, timeline: Timeline, clock: ClientClock, link: LinkState) -> None:
        self.timeline = timeline
        self.generation = 0
        """Number of controls; plans from before a control are void after it."""
        self.cadence_permille = EVERY_FRAME
        """Displayed frames per 1,000 media frames (:mod:`cags_protocol.cadence`)."""
        self.rendering = False
        """Whether a reference render is pending."""
        self.pace = Pace(link)
        """Duration of reference renders."""
        self._lead_frames, self._reference_every = settings.lead_frames, settings.reference_every
        self._poor_lead_frames = min(settings.poor_lead_frames, settings.lead_frames)
        self.reserve = Reserve(settings.tiles_ahead, settings.reserve_s)
        """By how many frames tiles precede references."""
        self._poor = False  # the client's own picture
        self._clock = clock
        self._controlled = False
        self._from_tick = 0  # first tick neither planned nor skipped
        self._passed = range(0)  # ticks that the newest planned one completes beside itself, not counted yet
        self._planned_us = 0  # when a tick was planned last, or a control arrived
        self._planned_lead_us: float | None = None  # the lead then; None: a control arrived
        self._excused_us = 0  # displays up to then, client clock, became due at once: no server could plan them all
        self._blind_tick = -1  # newest frame that was served without a render
        self._rendered_tick: int | None = None  # newest frame that a render was begun for
        self._render_covers = 1
        self._served_ahead = 0  # newest tick whose tiles were chosen
        self.between: tuple[int, ...] = ()
        """Ticks that the client displays before :meth:`ahead` of the newest planned tick, and that no earlier plan
        served: the first ones after a control, and some where the client begins to display more frames.
        """

    def controlled(self, control: Control, now_us: int) -> None:
        """The viewer plays, pauses, seeks or changes speed: restart the count of ticks."""
        # Until a pose tells the time: a frame is asked for about a lead before its display.
        self._clock.guess(control.at_us - round(self.lead_us), now_us)
        self.timeline = self.timeline.controlled(control)
        self._controlled = True
        self.generation += 1
        self._planned_us, self._planned_lead_us = now_us, None
        self._count_anew()

    def client_lacks(self, squared_error: float) -> None:
        """The client's own picture has this mean squared error, RGB in [0, 1]."""
        self._poor = squared_error > (FAIR if self._poor else POOR)

    @property
    def lead_us(self) -> float:
        """The larger of the requested lead and the time from planning to arrival; longer after late references, shorter
        while the client's own picture is poor.
        """
        frames = self._poor_lead_frames if self._poor else self._lead_frames
        wanted_us = frames * 1e6 / self.timeline.fps
        needed_us = max(wanted_us, self.pace.needed_us) + self.pace.caution_us
        return max(wanted_us, min(needed_us, LONGEST_LEAD_US))

    def follow_clock(self, now_us: int) -> None:
        """A pose has told the client's time: a clock that was set back leaves ticks of a pause far in the future."""
        t = self.timeline
        if self._controlled and not t.playing and not self.rendering:
            due_us = self._clock.to_server(t.display_us(self.next_tick))
            if due_us - now_us > JUMP_US + max(LONGEST_LEAD_US, self._lead_frames * t.period_us):
                self.timeline = replace(t, at_us=self._clock.to_client(now_us))
                self._count_anew()

    def _count_anew(self) -> None:
        self._from_tick, self._blind_tick, self._rendered_tick, self._served_ahead = 0, -1, None, 0
        self._passed = range(0)
        self.reserve.restart()

    def media_frame(self, tick: int) -> int | None:
        """A paused viewer still moves, so the same frame is planned repeatedly. None after the end."""
        return self.timeline.media_frame(tick)

    @property
    def next_tick(self) -> int:
        """The next tick to plan: one that the client displays; the clip's last tick is always displayed."""
        return self._up_to_the_end(next_displayed(self._from_tick, self.cadence_permille))

    def _up_to_the_end(self, tick: int) -> int:
        """``tick``, or the tick of the clip's last frame if that is earlier."""
        t = self.timeline
        last = tick if t.loop or not t.playing else t.round_end(tick) - 1
        return min(tick, last) if last >= self._from_tick else tick

    def ahead(self, tick: int, frames: int | None = None) -> int:
        """The tick whose tiles go out with the reference of ``tick``, ``frames`` later (None: by the reserve); at most
        the last one of the clip.

        It never falls; otherwise a client that displays more frames than before would seem to have gone back.
        """
        t, after = self.timeline, tick
        for _ in range(self.reserve.frames if frames is None else frames):
            after = next_displayed(after + 1, self.cadence_permille)
        after = max(after, self._served_ahead if frames is None else 0)
        return after if t.loop or not t.playing else max(tick, min(after, t.round_end(tick) - 1))

    @property
    def reference_period_us(self) -> float:
        """Interval between frames with references."""
        return self.planned_period_us * self._reference_every

    @property
    def planned_period_us(self) -> float:
        """Interval between planned frames."""
        return self.timeline.period_us * EVERY_FRAME / self.cadence_permille

    @property
    def _unserved_render(self) -> int | None:
        """The tick of the pending render, while nothing has been sent for it."""
        out = self.rendering and self._rendered_tick is not None and self._rendered_tick > self._blind_tick
        return self._rendered_tick if out else None

    @property
    def serves(self) -> int:
        """The next tick to serve: that of the pending render, while nothing has been sent for it."""
        unserved = self._unserved_render
        return self.next_tick if unserved is None else unserved

    @property
    def next_frame(self) -> int | None:
        """Media frame of the next tick to serve; None for none."""
        return self.media_frame(self.serves) if self._controlled else None

    def next_due_us(self, seen: Callable[[], bool]) -> int | None:
        """Time to plan the next frame or to serve it blind; None for none.

        ``seen()`` says whether its group of frames has been rendered.
        """
        if self.next_frame is None:
            return None
        due_us = self._clock.to_server(round(self.timeline.display_us(self.serves) - self.lead_us))
        if not self.rendering:
            return due_us
        seen_grace = SEEN_GRACE if self._unserved_render is None else RENDER_GRACE
        return due_us + round(self.grace_us(seen_grace if seen() else UNSEEN_GRACE))

    def grace_us(self, grace: tuple[float, float] = RENDER_GRACE) -> float:
        """Longest wait of a frame for its render."""
        periods, leads = grace
        return min(periods * self.timeline.period_us, leads * self.lead_us)

    def between_renders(self, every: int, *, seen: bool) -> bool:
        """Whether the next frame is not rendered, given that one of ``every`` frames is."""
        if self.rendering or self._rendered_tick is None or self.next_frame is None:
            return False
        return seen and self.next_tick < self._rendered_tick + every

    @property
    def begun(self) -> bool:
        """Whether the viewer has started playback."""
        return self._controlled

    def begin_render(self, late_us: int) -> tuple[int, int, int]:
        """Begin to render the newest due frame, or one before it; returns its tick, media frame and the number of ticks
        that it covers.

        The oldest due frame became due ``late_us`` ago. Frames between are skipped, because their references would be
        late; only a few, because tiles of as many later frames, which are in time, would be passed over.
        """
        tick = self._newest_due(late_us, self._last_in_turn if self._planned_lead_us is not None else None)
        frame = self.media_frame(tick)
        assert frame is not None, "a render begins at a frame that is due"
        self._render_covers = self._cover(tick)
        self._rendered_tick, self.rendering = tick, True
        return tick, frame, self._render_covers

    def go_blind(self, late_us: float = 0.0, *, slow: bool = False) -> tuple[int, int]:
        """Serve the next frame without a render; returns its tick and the number of ticks that it covers.

        It may be the frame of the pending render, whose reference follows later. The frame became due ``late_us`` ago.
        A ``slow`` server (:meth:`is_slow`) passes over a few; after a jump of the clock the newest due frame covers all
        earlier ones.
        """
        unserved = self._unserved_render
        if unserved is not None:
            self._blind_tick = unserved
            return unserved, self._render_covers
        self._blind_tick = self._newest_due(late_us, self._last_in_turn if slow else self.next_tick)
        return self._blind_tick, self._cover(self._blind_tick)

    def is_slow(self, late_us: float, now_us: int) -> bool:
        """Whether the frame that became due ``late_us`` ago is late because planning takes so long, and not because a
        longer lead has made many frames due at once.
        """
        return min(late_us, now_us - self._planned_us) > self.timeline.period_us

    def _newest_due(self, late_us: float, last: int | None) -> int:
        """The newest due tick, where the oldest became due ``late_us`` ago; at most ``last`` while tiles for the oldest
        are in time.
        """
        newest = last_displayed(self.next_tick + int(late_us // self.timeline.period_us), self.cadence_permille)
        if last is not None and late_us - self.lead_us < self.reserve.least * self.planned_period_us:
            newest = min(newest, last)
        return max(self.next_tick, self._up_to_the_end(newest))

    @property
    def _last_in_turn(self) -> int:
        """The last tick to plan next if tiles of no more than ``MOST_PASSED`` displayed frames are to be passed over,
        once the reserve has made up for the skipped ones.
        """
        tick = self.next_tick
        for _ in range(self.reserve.frames - self.reserve.least + MOST_PASSED):
            tick = next_displayed(tick + 1, self.cadence_permille)
        return tick

    def _cover(self, tick: int) -> int:
        """``tick`` is planned, which completes all earlier ones; returns their number, including ``tick``."""
        covered = tick - self._from_tick + 1
        self._passed, self._from_tick = range(self._from_tick, tick), tick + 1
        self.reserve.hold(self._displayed(self._passed))  # else as many frames ahead would be passed over at once
        served, self._served_ahead = max(self._served_ahead, tick), self.ahead(tick)
        between = range(served + 1, self._served_ahead)
        self.between = tuple(at for at in between if next_displayed(at, self.cadence_permille) == at)
        return covered

    def planned(self, now_us: int) -> int:
        """A tick is planned now; returns how many displayed ticks it passes over because the server was late.

        Those that a longer lead has made due since the plan before it are not counted, and those that were due when the
        control arrived: it came late. Neither are those of a pause, in which nothing moves on.
        """
        lead_us = self.lead_us
        if self._planned_lead_us is None or lead_us > self._planned_lead_us:
            self._excused_us = self._clock.to_client(self._planned_us) + round(lead_us)
        self._planned_us, self._planned_lead_us = now_us, lead_us
        passed, self._passed = self._passed, range(0)
        first = max(passed.start, self.timeline.first_tick(self._excused_us + 1))
        if not self.timeline.playing or first >= passed.stop:
            return 0
        return self._displayed(range(first, passed.stop))

    def _displayed(self, ticks: range) -> int:
        """How many of ``ticks`` are displayed."""
        before, last = ((tick - 1) * self.cadence_permille // EVERY_FRAME for tick in (ticks.start, ticks.stop))
        return last - before

    def is_out(self, tick: int) -> bool:
        """Whether the render of ``tick`` is pending."""
        return self.rendering and tick == self._rendered_tick

    def overtaken(self, tick: int) -> bool:
        """Whether the frame of a render, or a later one, was served while the render was pending."""
        return tick <= self._blind_tick
