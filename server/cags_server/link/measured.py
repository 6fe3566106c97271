"""Bandwidth from acknowledgements alone.

Every acknowledgement carries a delivery-rate sample (draft-cheng-iccrg-delivery-rate-estimation). A sample taken
while the server had nothing more to send shows what was sent, not what the link can do: it may raise the estimate,
never lower it, so the estimate cannot spiral down with the traffic it causes. Samples that had a queue behind them
are the link's own rate; their mean over two round trips replaces the estimate, in both directions.

A link that falls silent says something, too: while bytes are on their way, and no packet has arrived for longer than
round trips take and jump about, it carries less than a packet in that time. Without that, the estimate of a link in an
outage stays where it was, and what is sent by it waits in front of all that comes later.

Only sending more shows that a link has become faster. Until a queue is first seen a session may send twice what was
measured (as in BBR's start-up); later, while no queue stands, a fixed rate more, within bounds that are shares of what
was measured; and while one stands, a share less, unless another flow holds it
(:mod:`cags_protocol.delivery.competition`). Additive increase and multiplicative decrease bring sessions that share a
link to equal rates (Chiu and Jain 1989). With shares in both directions the first session kept 88 % of the link and the
second 8 %.
"""

from __future__ import annotations

import math
from collections import deque

from cags_protocol.events import AckSample, Stance
from cags_protocol.wire.limits import PACKET_BYTES
from cags_server.link.state import LinkState

INITIAL_BPS = 8e6
"""Planned for until the first acknowledgement."""

MIN_BPS, MAX_BPS = 64e3, 10e9

STARTUP_GAIN = 2.0

LOADED_GAINS = {Stance.GIVE_WAY: 0.95, Stance.TRY: 0.7, Stance.COMPETE: 1.25}
"""What may be sent while a queue stands, over what is measured."""

PROBE_BPS, LEAST_PROBE, MOST_PROBE = 450e3, 0.03, 0.6
"""What may be sent above the estimate while no queue stands, and its bounds, shares of the estimate."""

QUIET_US, DOUBLES_US, MOST_GROWN = 600_000, 250_000, 0.4
"""After ``QUIET_US`` without a queue the lower bound doubles every ``DOUBLES_US``, up to ``MOST_GROWN``: the link is
much faster than the estimate, or idle.
"""

MIN_WINDOW_US, MAX_WINDOW_US = 120_000, 200_000
"""Bounds of the time over which samples are averaged, otherwise two round trips. After a fall what is in flight makes
round trips so long that samples from before it would count for seconds.
"""

QUEUE_US = 15_000
"""A round trip longer than the shortest by this much has a queue in it, unless round trips jump about by as much.

Without regard to jitter a busy machine, whose round trips come late at random, would look like a loaded link for ever:
each sample of what little was sent would replace the estimate, and nothing would raise it again.
"""

BACKED_UP_US = 100_000
"""A queue so long shows the link even if the server had nothing more to send when it was filled: it is a fall that
came while little was sent. The credit window never lets so much wait on a link that is as fast as it is believed to be.
"""


class MeasuredLink(LinkState):
    """One link, its rate estimated from its acknowledgements."""

    def __init__(self, initial_bps: float = INITIAL_BPS) -> None:
        super().__init__()
        self._rate_bps = initial_bps
        self._startup = True
        self._loaded = False
        self._queued_us = 0  # when a queue was last seen
        self._samples: deque[tuple[int, int, float]] = deque()  # (time, bytes, rate) of samples that show the link
        self._stance, self._tried_bps = Stance.GIVE_WAY, 0.0  # the rate before a trial
        self._tried_until_us = 0

    def on_ack(self, sample: AckSample) -> None:
        """See :class:`~cags_server.link.state.LinkState`."""
        super().on_ack(sample)
        rate = sample.delivery_rate_bps
        if rate is None or rate <= 0 or sample.newly_delivered_bytes <= 0:
            return
        queued = sample.queue_us > QUEUE_US + sample.jitter_us
        self._take_stance(sample)
        backed_up = sample.app_limited and sample.queue_us > BACKED_UP_US and sample.stance is Stance.GIVE_WAY
        if backed_up:  # the link was busy all that time, and may have been idle only before
            rate = min(rate * sample.rtt_us / sample.queue_us, max(rate, self._rate_bps))
        self._loaded = shows_link = queued and (backed_up or not sample.app_limited)
        if shows_link:
            self._queued_us = sample.now_us
        tried = sample.now_us < self._tried_until_us
        if (tried or not shows_link) and rate <= self._rate_bps:
            return
        self._startup = self._startup and not shows_link
        self._samples.append((sample.now_us, sample.newly_delivered_bytes, rate))
        window_us = min(max(MIN_WINDOW_US, 2 * sample.rtt_us), MAX_WINDOW_US)
        while self._samples[0][0] < sample.now_us - window_us:
            self._samples.popleft()
        total = sum(size for _, size, _ in self._samples)
        self._rate_bps = total / sum(size / each for _, size, each in self._samples)

    def estimate_bps(self, now_us: int) -> float:
        """See :class:`~cags_server.link.state.LinkState`."""
        return min(max(min(self._rate_bps, self._silence_bps(now_us)), MIN_BPS), MAX_BPS)

    def allowance_bps(self, now_us: int) -> float:
        """See :class:`~cags_server.link.state.LinkState`."""
        if self._loaded or self._stance is not Stance.GIVE_WAY:
            gain = LOADED_GAINS[self._stance]
        else:
            gain = STARTUP_GAIN if self._startup else self._probe_gain(now_us)
        return min(max(min(self._rate_bps, self._silence_bps(now_us)) * gain, MIN_BPS), MAX_BPS)

    def _probe_gain(self, now_us: int) -> float:
        doublings = max(now_us - self._queued_us - QUIET_US, 0) / DOUBLES_US
        least = LEAST_PROBE * math.exp2(min(doublings, math.log2(MOST_GROWN / LEAST_PROBE)))
        return 1.0 + min(max(PROBE_BPS / max(self._rate_bps, MIN_BPS), least), MOST_PROBE)

    def _take_stance(self, sample: AckSample) -> None:
        """If a trial shows that another flow holds the queue, what was measured during it says nothing of the link."""
        if sample.stance is Stance.TRY and self._stance is not Stance.TRY:
            self._tried_bps = self._rate_bps
        elif sample.stance is Stance.COMPETE and self._stance is Stance.TRY:
            self._rate_bps, self._tried_until_us = max(self._rate_bps, self._tried_bps), sample.now_us + sample.rtt_us
            self._samples.clear()
        self._stance = sample.stance

    def _silence_bps(self, now_us: int) -> float:
        """The most that the link can carry if nothing has arrived since the newest acknowledgement."""
        newest = self.newest
        if not newest.in_flight_bytes:
            return MAX_BPS
        silent_us = now_us - newest.now_us - newest.shortest_rtt_us - newest.jitter_us
        return PACKET_BYTES * 8e6 / silent_us if silent_us > 0 else MAX_BPS
