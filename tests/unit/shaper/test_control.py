import asyncio
import json
import time

import pytest

from cags_shaper.control import MAX_LINE_BYTES, ControlPort
from cags_shaper.link import Link, LinkSettings
from cags_shaper.proxy import ShaperProxy
from cags_shaper.trace import open_trace


@pytest.fixture
async def control():
    proxy = ShaperProxy(("127.0.0.1", 1), Link(open_trace("generated:steady-30")), Link(None))
    await proxy.start("127.0.0.1", 0, lambda: time.monotonic_ns() // 1000)
    port = ControlPort(proxy)
    port.address = await port.start("127.0.0.1", 0)
    yield port
    await port.close()
    await proxy.close()


async def ask(control, *lines):
    reader, writer = await asyncio.open_connection(*control.address)
    writer.write(b"".join(line + b"\n" for line in lines))
    writer.write_eof()
    answers = (await reader.read()).splitlines()
    writer.close()
    return [json.loads(answer) for answer in answers]


async def test_asking_changes_nothing(control):
    first, second = await ask(control, b"{}", b"{}")
    assert first["ok"]
    assert first["cap_mbps"] is None
    assert first["delay_ms"] == 0
    assert first["capacity_mbps"] == pytest.approx(30, rel=0.01)
    assert set(first) == set(second)


async def test_cap_and_delay_hold_for_both_directions(control):
    (state,) = await ask(control, b'{"cap_mbps": 5, "delay_ms": 40.0}')
    assert (state["cap_mbps"], state["delay_ms"], state["capacity_mbps"]) == (5, 40, 5)
    assert control._shaped.uplink.link.settings.cap_bps == 5e6
    (state,) = await ask(control, b'{"cap_mbps": null}')
    assert (state["cap_mbps"], state["delay_ms"]) == (None, 40)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b"", "not a JSON object"),
        (b"[]", "not a JSON object"),
        (b"\xff", "not a JSON object"),
        (b"[" * 4000, "not a JSON object"),
        (b'{"colour": 1}', "unknown key 'colour'"),
        (b'{"cap_mbps": 0}', "cap_mbps = 0 must be"),
        (b'{"cap_mbps": true}', "cap_mbps = True must be"),
        (b'{"cap_mbps": NaN}', "cap_mbps = nan must be"),
        (b'{"delay_ms": null}', "delay_ms = None must be"),
        (b'{"delay_ms": "40"}', "delay_ms = '40' must be"),
    ],
)
async def test_wrong_lines_are_answered_and_change_nothing(control, line, says):
    wrong, state = await ask(control, line, b"{}")
    assert not wrong["ok"]
    assert says in wrong["error"]
    assert state["cap_mbps"] is None


async def test_an_endless_line_ends_the_conversation(control):
    assert await ask(control, b"x" * (3 * MAX_LINE_BYTES)) == []


def test_a_cap_holds_whatever_the_trace_allows():
    link = Link(open_trace("generated:steady-100"), LinkSettings(cap_bps=8e6))
    for i in range(100):
        link.push(0, i, 1000)
    times = []
    while (t := link.next_delivery_us()) is not None:
        times.append(t)
        link.pop_due(t)
    assert times[-1] == 100_000
    link.change(cap_bps=None)
    link.push(times[-1], 0, 1000)
    assert link.next_delivery_us() <= times[-1] + 1000
