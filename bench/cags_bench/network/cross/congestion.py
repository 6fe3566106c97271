"""Congestion control of TCP: models of CUBIC and BBR, without sockets or clocks.

:class:`Cubic` follows RFC 9438: the cubic window, the Reno-friendly region, fast convergence, and exclusion of
times in which the application sent too little. Slow start is the plain one: HyStart++ (RFC 9406) is not modelled, so a
flow leaves it with a full queue and losses.

:class:`Bbr` follows version 1 (draft-cardwell-iccrg-bbr-congestion-control-00), which Linux ships: startup, drain, the
cycle of eight pacing gains, and a probe of the round trip every ten seconds. Like version 1 it
ignores losses, but its first round trip of a recovery (no more is sent than delivered) is not modelled.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

from cags_shaper.link import SEGMENT_BYTES

INITIAL_SEGMENTS = 10
"""Initial window in segments (RFC 6928)."""

CUBIC_C, CUBIC_BETA = 0.4, 0.7
"""RFC 9438, sections 4.1 and 4.6."""

CUBIC_ALPHA = 3 * (1 - CUBIC_BETA) / (1 + CUBIC_BETA)
"""RFC 9438, section 4.3: a Reno flow with it and the same beta has CUBIC's mean window."""

STARTUP_GAIN = 2 / math.log(2)
CYCLE = (1.25, 0.75, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
WINDOW_GAIN = 2.0
PACING_MARGIN = 0.99
"""Linux paces by this factor below the measured rate, so that queues drain."""

LEAST_SEGMENTS = 4
BANDWIDTH_ROUNDS = 10
FULL_GROWTH, FULL_ROUNDS = 1.25, 3
"""The pipe is full if bandwidth has not grown by this factor in this number of round trips."""

ROUND_TRIP_S, PROBE_S = 10.0, 0.2
"""Validity of the shortest round trip, and duration of a probe for it."""


@dataclass(frozen=True, slots=True)
class Ack:
    """Information from an acknowledgement. Bytes are payload bytes."""

    now_us: int
    acked_bytes: int
    rtt_us: int
    in_flight_bytes: int
    """Before this acknowledgement."""
    rate_bps: float
    """Delivery rate since the acknowledged segment was sent."""
    app_limited: bool
    """Whether the application limited the rate at that time."""
    round_began: bool
    """Whether this ends a round trip."""


class Congestion(Protocol):
    """A rule for one flow."""

    @property
    def window_bytes(self) -> float:
        """Largest unacknowledged payload."""

    @property
    def pacing_bps(self) -> float | None:
        """Pacing rate of segments; None: limited by the window alone."""

    def on_ack(self, ack: Ack) -> None:
        """A segment has arrived."""

    def on_loss(self) -> None:
        """Segments were lost; called at most once per round trip."""

    def on_timeout(self) -> None:
        """A retransmission timeout has expired."""


class Cubic:
    """CUBIC. Windows are in segments."""

    pacing_bps: float | None = None

    def __init__(self) -> None:
        self._window, self._threshold = float(INITIAL_SEGMENTS), math.inf
        self._most = self._prior = 0.0
        self._epoch_us: int | None = None
        self._k_s = self._friendly = 0.0
        self._heard_us = 0

    @property
    def window_bytes(self) -> float:
        """See :class:`Congestion`, as all of these."""
        return self._window * SEGMENT_BYTES

    def on_ack(self, ack: Ack) -> None:
        """Grow if the window limited the flow."""
        since_us, self._heard_us = ack.now_us - self._heard_us, ack.now_us
        starting = self._window < self._threshold
        in_use = ack.in_flight_bytes / SEGMENT_BYTES
        if in_use * (2 if starting else 1) < self._window - 1:
            if self._epoch_us is not None:  # idle time does not count
                self._epoch_us += since_us
            return
        segments = ack.acked_bytes / SEGMENT_BYTES
        if starting:
            self._window += segments
        else:
            self._avoid(segments, ack)

    def on_loss(self) -> None:
        """Reduce the window by three tenths."""
        converging = self._window < self._most
        self._most = self._window * (1 + CUBIC_BETA) / 2 if converging else self._window
        self._prior = self._window
        self._threshold = max(self._window * CUBIC_BETA, 2.0)
        self._window, self._epoch_us = self._threshold, None

    def on_timeout(self) -> None:
        """Begin again with one segment."""
        self.on_loss()
        self._window = 1.0

    def _avoid(self, segments: float, ack: Ack) -> None:
        if self._epoch_us is None:
            self._epoch_us, self._friendly = ack.now_us, self._window
            self._k_s = math.cbrt(max(self._most - self._window, 0.0) / CUBIC_C)
        alpha = CUBIC_ALPHA if self._friendly < self._prior else 1.0
        self._friendly += alpha * segments / self._window
        time_s = (ack.now_us - self._epoch_us) / 1e6
        if self._cubic(time_s) < self._friendly:
            self._window = max(self._window, self._friendly)
            return
        target = min(max(self._cubic(time_s + ack.rtt_us / 1e6), self._window), 1.5 * self._window)
        self._window += (target - self._window) / self._window * segments

    def _cubic(self, time_s: float) -> float:
        return float(CUBIC_C * (time_s - self._k_s) ** 3 + max(self._most, 0.0))


class Bbr:
    """BBR, version 1."""

    def __init__(self) -> None:
        self._window_bytes = float(INITIAL_SEGMENTS * SEGMENT_BYTES)
        self._mode, self._gain = "startup", STARTUP_GAIN
        self._rates: deque[tuple[int, float]] = deque()  # (round, bps), falling
        self._round = 0
        self._full_bps, self._full_rounds, self._full = 0.0, 0, False
        self._rtt_us, self._rtt_at_us = math.inf, 0
        self._phase, self._phase_us = 0, 0
        self._lost = False
        self._probe_ends_us: int | None = None

    @property
    def window_bytes(self) -> float:
        """See :class:`Congestion`, as all of these."""
        return LEAST_SEGMENTS * SEGMENT_BYTES if self._mode == "probe" else self._window_bytes

    @property
    def pacing_bps(self) -> float | None:
        """Bandwidth times the gain of the phase; None before it is known."""
        return PACING_MARGIN * self._gain * self._rates[0][1] if self._rates else None

    def on_ack(self, ack: Ack) -> None:
        """Update bandwidth and round trip, and enter the next phase when it is due."""
        self._round += ack.round_began
        self._learn_rate(ack)
        expired = ack.now_us - self._rtt_at_us > ROUND_TRIP_S * 1e6
        if ack.rtt_us <= self._rtt_us or expired:
            self._rtt_us, self._rtt_at_us = float(ack.rtt_us), ack.now_us
        if ack.round_began and not ack.app_limited:
            self._judge_full()
        self._advance(ack, expired)
        self._grow(ack)
        self._lost = False

    def on_loss(self) -> None:
        """A loss only ends a probing phase earlier."""
        self._lost = True

    def on_timeout(self) -> None:
        """Restart with one segment; the window grows again with acknowledgements."""
        self._window_bytes = float(SEGMENT_BYTES)

    def _product(self, gain: float) -> float:
        """Payload bytes that fill the path, times ``gain``."""
        if not self._rates or math.isinf(self._rtt_us):
            return gain * INITIAL_SEGMENTS * SEGMENT_BYTES
        return gain * self._rates[0][1] * self._rtt_us / 8e6

    def _learn_rate(self, ack: Ack) -> None:
        if ack.app_limited and self._rates and ack.rate_bps < self._rates[0][1]:
            return
        while self._rates and self._rates[-1][1] <= ack.rate_bps:
            self._rates.pop()
        self._rates.append((self._round, ack.rate_bps))
        while self._rates[0][0] <= self._round - BANDWIDTH_ROUNDS and len(self._rates) > 1:
            self._rates.popleft()

    def _judge_full(self) -> None:
        if self._full:
            return
        if self._rates[0][1] >= FULL_GROWTH * self._full_bps:
            self._full_bps, self._full_rounds = self._rates[0][1], 0
        else:
            self._full_rounds += 1
            self._full = self._full_rounds >= FULL_ROUNDS

    def _advance(self, ack: Ack, expired: bool) -> None:
        left_bytes = ack.in_flight_bytes - ack.acked_bytes
        if self._mode == "startup" and self._full:
            self._mode, self._gain = "drain", 1 / STARTUP_GAIN
        if self._mode == "drain" and left_bytes <= self._product(1.0):
            self._cruise(ack.now_us, 2)
        if self._mode == "cycle":
            self._turn(ack, left_bytes)
        if expired and self._mode != "probe":
            self._mode, self._gain, self._probe_ends_us = "probe", 1.0, None
        if self._mode == "probe":
            self._probe(ack.now_us, left_bytes)

    def _turn(self, ack: Ack, left_bytes: int) -> None:
        """Enter the next phase of the cycle if this one is complete."""
        over = ack.now_us - self._phase_us > self._rtt_us
        if self._gain > 1:
            over = over and (self._lost or ack.in_flight_bytes >= self._product(self._gain))
        elif self._gain < 1:
            over = over or left_bytes <= self._product(1.0)
        if over:
            self._cruise(ack.now_us, (self._phase + 1) % len(CYCLE))

    def _cruise(self, now_us: int, phase: int) -> None:
        self._mode, self._phase, self._phase_us, self._gain = "cycle", phase, now_us, CYCLE[phase]

    def _probe(self, now_us: int, left_bytes: int) -> None:
        if self._probe_ends_us is None:
            if left_bytes <= LEAST_SEGMENTS * SEGMENT_BYTES:
                self._probe_ends_us = now_us + round(max(PROBE_S * 1e6, self._rtt_us))
        elif now_us >= self._probe_ends_us:
            self._rtt_at_us = now_us
            if self._full:
                self._cruise(now_us, 2)
            else:
                self._mode, self._gain = "startup", STARTUP_GAIN

    def _grow(self, ack: Ack) -> None:
        gain = WINDOW_GAIN if self._full else STARTUP_GAIN
        target = self._product(gain) + 3 * SEGMENT_BYTES
        grown = self._window_bytes + ack.acked_bytes
        if self._full:
            grown = min(grown, target)
        elif self._window_bytes >= target:
            grown = self._window_bytes
        self._window_bytes = max(grown, LEAST_SEGMENTS * SEGMENT_BYTES)


RULES: dict[str, type[Cubic] | type[Bbr]] = {"cubic": Cubic, "bbr": Bbr}
