"""The event trace of one session: every step of sending as a record that describes itself. Written by the owner.

The first record is a header that names the fields. ``sink`` takes each record (a JSON-able dict); it is called from
within the session, so it must be quick and must not call back.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cags_protocol.delivery.flow import FlowControl
from cags_protocol.delivery.send_queue import Entry
from cags_protocol.events import AckSample, Outgoing

Record = dict[str, Any]

FIELDS = {
    "t_us": "time by the server's clock, microseconds",
    "event": "queued, sent (a packet), acked, delivered, dropped or closed",
    "type": "type of the message",
    "frame": "media frame of the message, where it has one",
    "bytes": "size: of the payload (queued, delivered), of the packet (sent), of what was newly acknowledged (acked)",
    "seq": "packet number",
    "queued_bytes": "bytes that wait in the queue",
    "in_flight_bytes": "bytes sent and not acknowledged",
    "window_bytes": "credit: bytes that may be in flight",
    "rtt_us": "round trip of the newest acknowledged packet",
    "min_rtt_us": "shortest round trip of the last ten seconds",
    "delivery_rate_bps": "rate sample of the acknowledgement",
    "app_limited": "the server had nothing to send during that sample",
    "reason": "why the message was dropped",
    "sent_bytes": "bytes of it that had been sent for nothing",
}


class EventTrace:
    """Turns the steps of one session into records."""

    def __init__(self, sink: Callable[[Record], None], name: str) -> None:
        self._sink = sink
        sink({"trace": "cags-session", "version": 1, "session": name, "fields": FIELDS})

    def queued(self, now_us: int, outgoing: Outgoing, queued_bytes: int) -> None:
        """A message entered the queue."""
        self._message(now_us, "queued", outgoing, bytes=len(outgoing.payload), queued_bytes=queued_bytes)

    def sent(self, now_us: int, seq: int, entry: Entry, size: int, flow: FlowControl) -> None:
        """A packet was handed to the transport; ``flow`` is as it was before."""
        in_flight = flow.in_flight_bytes + size
        limits = {"in_flight_bytes": in_flight, "window_bytes": flow.window_bytes}
        self._message(now_us, "sent", entry.outgoing, seq=seq, bytes=size, **limits)

    def acknowledged(self, sample: AckSample) -> None:
        """New packets were acknowledged."""
        record = {
            "bytes": sample.newly_delivered_bytes,
            "rtt_us": sample.rtt_us,
            "min_rtt_us": sample.shortest_rtt_us,
            "delivery_rate_bps": sample.delivery_rate_bps,
            "app_limited": sample.app_limited,
            "in_flight_bytes": sample.in_flight_bytes,
            "queued_bytes": sample.queued_bytes,
        }
        self._sink({"t_us": sample.now_us, "event": "acked", **record})

    def delivered(self, now_us: int, outgoing: Outgoing) -> None:
        """A message arrived whole."""
        self._message(now_us, "delivered", outgoing, bytes=len(outgoing.payload))

    def dropped(self, now_us: int, entry: Entry, reason: str) -> None:
        """A message will not arrive."""
        self._message(now_us, "dropped", entry.outgoing, reason=reason, sent_bytes=entry.sent)

    def closed(self, now_us: int) -> None:
        """The session is over."""
        self._sink({"t_us": now_us, "event": "closed"})

    def _message(self, now_us: int, event: str, outgoing: Outgoing, **more: Any) -> None:
        record = {"t_us": now_us, "event": event, "type": outgoing.message.TAG}
        frame = getattr(outgoing.message, "frame", None)
        self._sink({**record, **({} if frame is None else {"frame": frame}), **more})
