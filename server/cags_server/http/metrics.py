"""Counters of the server for Prometheus."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from prometheus_client import CollectorRegistry, Gauge, Metric, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, SummaryMetricFamily
from prometheus_client.registry import Collector

from cags_server.http.shortage import RESOURCES, shortage
from cags_server.records import StreamStats, Totals


def exposition(ended: Totals, live: Iterable[StreamStats], *, tasks: int = 0, decoded_bytes: int = 0) -> str:
    """The metrics page in Prometheus' text format: sessions that have ended, those that go on, and the process, whose
    event loop has ``tasks``, and which keeps ``decoded_bytes`` of tiles.
    """
    registry = CollectorRegistry()
    registry.register(_Sessions(ended, tuple(live)))
    Gauge("cags_tasks", "Tasks of the event loop.", registry=registry).set(tasks)
    kept = Gauge("cags_decoded_bytes", "Decoded tiles kept for the viewers of all scenes.", registry=registry)
    kept.set(decoded_bytes)
    ProcessCollector(registry=registry)
    return generate_latest(registry).decode()


class _Sessions(Collector):
    def __init__(self, ended: Totals, live: Sequence[StreamStats]) -> None:
        self._live, self._sums = live, Totals(**vars(ended))
        for stats in live:
            self._sums.add(stats)

    def collect(self) -> Iterator[Metric]:
        """One family after the other."""
        live, sums, count = self._live, self._sums, max(len(self._live), 1)
        yield GaugeMetricFamily("cags_sessions", "Clients connected now.", len(live))
        short = GaugeMetricFamily("cags_sessions_short", "Clients short of a resource.", labels=("of",))
        of = [shortage(stats).of for stats in live]
        for resource in RESOURCES:
            short.add_metric((resource,), of.count(resource))
        yield short
        yield CounterMetricFamily("cags_sessions_total", "Clients that ever joined.", sums.sessions)
        yield CounterMetricFamily("cags_frames_total", "Frames planned.", sums.frames)
        for name, what, total in (
            ("frames_skipped", "Frames that were due and not planned, the server being late.", sums.frames_skipped),
            ("frames_in_time", "Frames whose data the client had when they were due.", sums.frames_in_time),
            ("frames_late", "Frames whose data came after they were due, or not at all.", sums.frames_late),
            ("stalls", "Runs of such frames.", sums.stalls),
            ("references_late", "Reference pictures that came too late, or never.", sums.references_late),
        ):
            yield CounterMetricFamily(f"cags_{name}_total", what, total)
        sent = CounterMetricFamily(
            "cags_sent_bytes_total", "Payload bytes of messages sent to their end, by kind.", labels=("kind",)
        )
        for kind in ("tiles", "reference", "other"):
            sent.add_metric((kind,), getattr(sums, f"bytes_{kind}"))
        yield sent
        costs = sums.careful + sums.light
        for name, total_ns in (("render", costs.render_ns), ("encode", costs.encode_ns)):
            yield SummaryMetricFamily(
                f"cags_{name}_seconds", f"Time to {name} reference pictures.", costs.references, total_ns / 1e9
            )
        rate = sum(stats.bandwidth_bps for stats in live) / count
        yield GaugeMetricFamily("cags_bandwidth_estimate_bps", "Mean bandwidth estimate of the clients.", rate)
        rtt = sum(stats.rtt_us for stats in live) / count / 1e6
        yield GaugeMetricFamily("cags_rtt_seconds", "Mean round trip of the clients.", rtt)
