"""Network traces: when a link may deliver, as mahimahi writes it.

A trace is a list of delivery opportunities: at each, the link carries up to 1,504 bytes (Netravali et al., "Mahimahi",
USENIX ATC 2015). A mahimahi file has one line an opportunity, its time in whole milliseconds, never falling; the trace
repeats after its last line. Rate tables (``time_s,mbps``, Pensieve's ``time mbps``, 5Gophers' and Lumos5G's tables of
many columns) are converted: an opportunity comes in the millisecond in which the integral of the rate has brought
another 1,504 bytes.
"""

from __future__ import annotations

import bisect
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cags_common.errors import TraceError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

OPPORTUNITY_BYTES = 1504
"""Bytes that one delivery opportunity carries: mahimahi's PACKET_SIZE, an Ethernet payload and the TUN header."""

NEVER_US = 2**62
"""A time after everything: what a trace that does not repeat cannot deliver comes then."""

MAX_FILE_BYTES = 256 * 1024 * 1024
MAX_DURATION_S = 3 * 3600.0
HEADINGS = (("time_s", "mbps"), ("seq_num", "throughput_mbps"), ("seq_num", "throughput"))
"""Columns of time (seconds) and rate (Mbps) in a table with a heading: our own, 5Gophers' (Narayanan et al., WWW 2020),
Lumos5G's (the same authors, IMC 2020). Their tables of several runs must be cut into files of one.
"""
MAX_MBPS = 100_000.0


@dataclass(frozen=True, eq=False)
class Trace:
    """Delivery opportunities of one period, which repeats.

    ``times_ms`` are the milliseconds (0 .. ``period_ms``, rising) that have opportunities, ``until`` their count up to
    and including each. With ``loop`` false nothing is delivered after the first period.
    """

    name: str
    times_ms: array[int]
    until: array[int]
    period_ms: int
    loop: bool = True

    def __post_init__(self) -> None:
        if not len(self.times_ms):
            raise TraceError(f"{self.name}: holds no delivery opportunity; a link that never delivers is of no use")
        if self.period_ms < max(self.times_ms[-1], 1):
            raise TraceError(f"{self.name}: lasts {self.period_ms} ms; a trace must last at least 1 ms")

    @property
    def opportunities(self) -> int:
        """Number of opportunities in one period."""
        return self.until[-1]

    @property
    def duration_us(self) -> int:
        """Length of one period."""
        return self.period_ms * 1000

    def count_until(self, t_us: int) -> int:
        """Opportunities at times <= ``t_us`` since 0."""
        if t_us < 0:
            return 0
        cycles, rest_ms = divmod(t_us // 1000, self.period_ms)
        if cycles and not self.loop:
            return self.opportunities
        return cycles * self.opportunities + self._count_in_period(rest_ms)

    def time_of(self, number: int) -> int:
        """When opportunity ``number`` (1, 2, ..) comes, microseconds since 0; :data:`NEVER_US` after the end."""
        cycles, rest = divmod(number - 1, self.opportunities)
        if cycles and not self.loop:
            return NEVER_US
        return (cycles * self.period_ms + self.times_ms[bisect.bisect_left(self.until, rest + 1)]) * 1000

    def mean_bps(self, start_us: int, end_us: int) -> float:
        """Capacity in (start_us, end_us], bits a second."""
        if end_us <= start_us:
            raise ValueError(f"interval {start_us}..{end_us} us is empty")
        count = self.count_until(end_us) - self.count_until(start_us)
        return count * OPPORTUNITY_BYTES * 8e6 / (end_us - start_us)

    def to_mahimahi(self) -> str:
        """The lines of a mahimahi file. A silent end of the period is lost: mahimahi repeats after the last line."""
        counts = [b - a for a, b in zip([0, *self.until[:-1]], self.until, strict=True)]
        return "".join(f"{t}\n" * n for t, n in zip(self.times_ms, counts, strict=True))

    def _count_in_period(self, t_ms: int) -> int:
        index = bisect.bisect_right(self.times_ms, t_ms)
        return self.until[index - 1] if index else 0


def trace_of_times(name: str, times_ms: Sequence[int], *, loop: bool = True) -> Trace:
    """A trace of mahimahi's lines: one opportunity each, milliseconds, never falling."""
    unique, until = array("q"), array("q")
    for count, t in enumerate(times_ms, start=1):
        if unique and unique[-1] == t:
            until[-1] = count
        else:
            unique.append(t)
            until.append(count)
    return Trace(name, unique, until, times_ms[-1] if len(times_ms) else 0, loop)


def trace_of_rates(
    name: str, times_s: Sequence[float], mbps: Sequence[float], end_s: float, *, loop: bool = True
) -> Trace:
    """A trace of a rate table: ``mbps[i]`` holds from ``times_s[i]`` (from 0, rising) to the next or ``end_s``."""
    import numpy as np

    edges_ms = np.append(np.asarray(times_s, dtype=np.float64), end_s) * 1e3
    sums = np.concatenate(([0.0], np.cumsum(np.diff(edges_ms) * np.asarray(mbps, dtype=np.float64) * 125.0)))
    period_ms = max(round(float(edges_ms[-1])), 1)
    bytes_until = np.interp(np.arange(period_ms + 1, dtype=np.float64), edges_ms, sums)
    until: NDArray[np.int64] = np.floor(bytes_until / OPPORTUNITY_BYTES + 1e-9).astype(np.int64)
    times: NDArray[np.int64] = np.flatnonzero(np.diff(until, prepend=0))
    return Trace(name, array("q", times.tobytes()), array("q", until[times].tobytes()), period_ms, loop)


def open_trace(spec: str, *, loop: bool = True) -> Trace:
    """The trace that ``spec`` names: a file, or ``generated:NAME[:seed=N][:duration_s=N][:start_s=N]``.

    Raises :class:`TraceError`. The names are those of :data:`cags_shaper.generate.MODELS` and ``steady-N`` (N Mbps).
    """
    if not spec.startswith("generated:"):
        return read_trace(spec, loop=loop)
    from cags_shaper.generate import generate

    table = generate(spec.removeprefix("generated:"))
    return trace_of_rates(table.name, table.times_s, table.mbps, table.end_s, loop=loop)


def read_trace(path: str | Path, *, loop: bool = True) -> Trace:
    """Read a trace file; its kind is told by its content. Raises :class:`TraceError` with the line number."""
    file = Path(path)
    lines = _lines(file)
    first = next(((n, line) for n, line in lines if line), None)
    if first is None:
        raise TraceError(f"{file}: is empty; give a mahimahi file or one of rows `time_s,mbps`")
    content = [first, *((n, line) for n, line in lines if line)]
    if first[1].isdecimal():
        return trace_of_times(file.name, _mahimahi_times(file, content), loop=loop)
    return _read_rates(file, content, loop)


def _lines(file: Path) -> Iterable[tuple[int, str]]:
    """Numbered lines without comments and outer blanks."""
    try:
        if file.stat().st_size > MAX_FILE_BYTES:
            raise TraceError(f"{file}: larger than {MAX_FILE_BYTES} bytes; no trace is")
        text = file.read_bytes().decode("ascii")
    except OSError as error:
        raise TraceError(f"{file}: cannot be read ({error.strerror}); give an existing trace file") from error
    except UnicodeDecodeError as error:
        raise TraceError(f"{file}: byte {error.start} is not ASCII; a trace is a text file of numbers") from error
    return ((n, line.split("#", 1)[0].strip()) for n, line in enumerate(text.splitlines(), start=1))


def _mahimahi_times(file: Path, lines: Iterable[tuple[int, str]]) -> array[int]:
    times, last = array("q"), 0
    for number, line in lines:
        if not line.isdecimal() or len(line) > 9:
            raise TraceError(f"{file}:{number}: {line!r:.40} is not a time in whole milliseconds")
        time = int(line)
        if time < last:
            raise TraceError(f"{file}:{number}: time {time} ms comes after {last} ms; times must not fall")
        times.append(time)
        last = time
    if last == 0:
        raise TraceError(f"{file}: lasts 0 ms; the last line must be later than 0")
    return times


def _read_rates(file: Path, lines: Sequence[tuple[int, str]], loop: bool) -> Trace:
    times: list[float] = []
    rates: list[float] = []
    columns = _columns(lines[0][1])
    for number, line in lines if columns is None else lines[1:]:
        time, rate = _rate_row(file, number, line, columns)
        if times and time <= times[-1]:
            raise TraceError(f"{file}:{number}: time {time:g} s comes after {times[-1]:g} s; times must rise")
        if time - (times[0] if times else time) > MAX_DURATION_S:
            raise TraceError(f"{file}:{number}: time {time:g} s; a trace may last {MAX_DURATION_S:g} s")
        times.append(time)
        rates.append(rate)
    if len(times) < 2:
        raise TraceError(f"{file}: has {len(times)} rows; at least two are needed to tell how long a rate holds")
    start = times[0]
    end = times[-1] - start + (times[-1] - times[-2])  # the last rate holds as long as the one before it
    return trace_of_rates(file.name, [t - start for t in times], rates, end, loop=loop)


def _columns(heading: str) -> tuple[int, int, int] | None:
    """Where a table's heading puts time and rate, and its number of columns; None: it has no heading that is known."""
    names = heading.replace(" ", "").lower().split(",")
    for time, rate in HEADINGS:
        if names.count(time) == names.count(rate) == 1:
            return names.index(time), names.index(rate), len(names)
    return None


def _rate_row(file: Path, number: int, line: str, columns: tuple[int, int, int] | None) -> tuple[float, float]:
    at_time, at_rate, count = columns or (0, 1, 2)
    parts = line.split(",") if "," in line else line.split()
    try:
        if len(parts) != count:
            raise ValueError(f"{len(parts)} columns, not {count}")
        time, rate = float(parts[at_time]), float(parts[at_rate])
    except ValueError:
        raise TraceError(f"{file}:{number}: {line!r:.40} is not a row `time_s,mbps`") from None
    if not 0 <= time < 1e12 or not 0 <= rate <= MAX_MBPS:  # NaN fails too
        raise TraceError(f"{file}:{number}: {line!r:.40}: time must be >= 0 s and the rate in [0, {MAX_MBPS:g}] Mbps")
    return time, rate
