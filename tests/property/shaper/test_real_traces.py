"""On recorded traces every packet leaves in the millisecond in which mahimahi would let it go."""

import itertools
import random
from pathlib import Path

import pytest

from cags_shaper.link import Link, LinkSettings
from cags_shaper.trace import OPPORTUNITY_BYTES, read_trace
from support.mahimahi import MahimahiQueue

SHARED = Path(__file__).parents[4] / "shared" / "network"
TRACES = [
    "5gophers/paper_segment_3249_3549.csv",
    "5gophers/mobility_car-driving-trace-1.csv",
    "oboe/oboe_trace_1.csv",
    "puffer/*_2.csv",
]


@pytest.fixture(params=TRACES)
def path(request):
    found = sorted(SHARED.glob(request.param))
    if not found:
        pytest.skip(f"recorded traces are not here ({SHARED / request.param})")
    return found[0]


def test_delivery_times_are_mahimahis_to_the_millisecond(path, tmp_path):
    table = read_trace(path)
    lines = table.to_mahimahi().splitlines(keepends=True)[:60_000]
    file = tmp_path / "trace.mahi"
    file.write_text("".join(lines))
    rng = random.Random(1)
    ours = Link(read_trace(file), LinkSettings(queue_bytes=60_000))
    theirs = MahimahiQueue([int(line) for line in lines], queue_bytes=60_000)
    mean_gap_us = 1e6 * int(lines[-1]) / 1000 / len(lines)  # offers as much as the link carries, in bursts
    now_us, out, accepted = 0, [], 0
    for number in range(30_000):
        now_us += round(rng.choice([0, 0, 0, 4]) * mean_gap_us * rng.expovariate(1.0))
        size = rng.randrange(40, 1505)
        while (t := ours.next_delivery_us()) is not None and t <= now_us:
            out += [(t // 1000, data) for data in ours.pop_due(t)]
        taken = ours.push(now_us, number, size)
        assert taken == theirs.push(now_us // 1000, number, size)
        accepted += taken
    while (t := ours.next_delivery_us()) is not None:
        out += [(t // 1000, data) for data in ours.pop_due(t)]
    while theirs.waiting or theirs.left:
        theirs.rationalize(theirs.next_ms())
    assert out == theirs.out
    assert len(out) == accepted > 10_000


def test_a_table_carries_its_own_bytes(path):
    trace = read_trace(path)
    rows = [tuple(map(float, row.split(","))) for row in path.read_text().splitlines()[1:]]
    start = rows[0][0]
    for (t, mbps), (end, _) in itertools.pairwise(rows):
        counted = trace.count_until(round((end - start) * 1e6)) - trace.count_until(round((t - start) * 1e6))
        wanted = mbps * 1e6 * (end - t) / 8 / OPPORTUNITY_BYTES
        assert abs(counted - wanted) <= 1.01 + mbps * 125 / OPPORTUNITY_BYTES  # a millisecond's worth at the edges
