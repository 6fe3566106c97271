"""The link's own trace as the estimate."""

from __future__ import annotations

from cags_server.link.oracle import OracleLink


def test_the_oracle_reads_the_trace_ahead() -> None:
    class Step:
        def mean_bps(self, start_us: int, end_us: int) -> float:
            return float(start_us)

    oracle = OracleLink(Step(), origin_us=1_000_000, share=0.5)
    assert oracle.estimate_bps(5_000_000) == 2_000_000
    assert oracle.estimate_bps(0) == 1000  # before the trace, and never zero
