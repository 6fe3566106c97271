"""Parts of ``cags-bench network`` that need no scene."""

import asyncio
import json
from types import SimpleNamespace

import pytest

from cags_bench.cli import main
from cags_bench.network import clients
from cags_bench.network.checks import checks
from cags_bench.network.clients import margins_us, missed
from cags_bench.network.command import NetworkSettings
from cags_bench.network.content import around, black_frames, freezes, outage_ends, recovery_ms, together
from cags_bench.network.crowd import crowd_line
from cags_bench.network.load import run_load
from cags_bench.network.plot import plot_session
from cags_bench.network.sending import estimate_error, figures
from cags_bench.network.sockets import direct_lines, kernel_bps, run_direct
from cags_bench.parallel import in_parallel
from cags_bench.traces import scaled_trace
from cags_common.errors import ConfigError, TraceError
from cags_common.transport.base import ConnectionEndedError
from cags_protocol import ServerSession
from cags_protocol.sessions.tracing import EventTrace
from cags_server.link import MeasuredLink, OracleLink
from cags_shaper.link import LinkSettings
from cags_shaper.trace import open_trace, trace_of_rates
from cags_shaper.tun import why_unavailable
from support.server_scene import CLIENT
from support.wire_pair import Pair, tile

LINK = LinkSettings(delay_us=10_000)


@pytest.mark.parametrize("estimator", [MeasuredLink, lambda: OracleLink(open_trace("generated:steady-20"))])
def test_a_steady_link_is_used_without_a_long_queue(estimator):
    trace = open_trace("generated:steady-20")
    log = run_load(trace, estimator(), 6_000_000, LINK)
    found = figures(log, trace, 2_000_000, 6_000_000)
    assert 0.85 < found["utilisation"] < 1
    assert found["latency_ms"] < 100
    assert found["reference_latency_ms"] < found["latency_ms"]
    assert found["wasted_share"] < 0.01


def test_after_a_fall_latency_comes_back():
    fall = trace_of_rates("fall", [0.0, 3.0], [20.0, 1.5], 60.0)
    found = figures(run_load(fall, MeasuredLink(), 9_000_000, LINK), fall, 5_000_000, 9_000_000)
    assert found["latency_ms"] <= 120


def test_two_loads_are_the_same():
    trace = open_trace("generated:lte-driving")
    assert run_load(trace, MeasuredLink(), 2_000_000, LINK) == run_load(trace, MeasuredLink(), 2_000_000, LINK)


def test_a_crowd_is_served_whole():
    line = crowd_line(10, 500_000, 10_000)
    assert line["silent_sessions"] == 0
    assert line["messages"] > 100


def test_outages_and_recovery():
    trace = trace_of_rates("t", [0, 1, 4, 5], [10, 0, 10, 10], 6)
    assert [round(t / 1e6) for t in outage_ends(trace, 6_000_000)] == [4]
    records = [{"time_us": t * 100_000, "missed": 11 <= t < 43} for t in range(60)]
    assert recovery_ms(records, trace) == pytest.approx(300, abs=10)
    assert freezes(records) == 1
    assert recovery_ms(records, open_trace("generated:steady-10")) is None
    never = [{"time_us": t * 100_000, "missed": t >= 11} for t in range(60)]
    assert recovery_ms(never, trace) == pytest.approx(1900, abs=10), "at least until the last frame"


def test_checks_name_target_and_value():
    (found, *_) = checks([{"case": "crowd", "seconds": 200.0, "silent_sessions": 0}])
    assert (found["ok"], found["value"], found["target"]) == (False, 200.0, "<= 120")
    lines = [
        {
            "case": "content",
            "trace": "generated:steady-30",
            "policy": policy,
            "psnr_db_by_play": [db],
            "black_frames": 0,
        }
        | {"recovery_ms": None, "first_picture_ms": 300.0}
        for policy, db in (("paper", 30.0), ("utility", 30.6))
    ]
    gains = [c for c in checks(lines) if "utility" in c["name"]]
    assert [c["ok"] for c in gains] == [True, True]


@pytest.mark.parametrize(("gain", "ok"), [(-0.11, False), (-0.09, True)])
def test_a_policy_that_loses_anywhere_is_seen(gain, ok):
    lines = [
        {"case": "content", "trace": trace, "policy": policy, "black_frames": 0, "recovery_ms": None}
        | {"psnr_db_by_play": [30.0 + db + (gain if policy == "utility" and trace == "b" else 0.0) for db in (-4, 4)]}
        for trace in ("a", "b")
        for policy in ("paper", "utility")
    ]
    (worst,) = [c for c in checks(lines) if "at worst" in c["name"]]
    assert worst["value"] == f"{gain:+.2f} [{gain:+.2f}, {gain:+.2f}] on b", "paired by play"
    assert worst["ok"] is ok


def test_content_checks_judge_the_worst_trace():
    line = {
        "case": "content",
        "trace": "a",
        "policy": "paper",
        "psnr_db_by_play": [30.0],
        "black_frames": 0,
        "recovery_ms": 900.0,
    }
    found = {c["name"]: c for c in checks([line, line | {"black_frames": 2, "recovery_ms": 1100.0}])}
    assert (found["black frames"]["value"], found["black frames"]["ok"]) == (2, False)
    assert (found["recovery after an outage, ms"]["value"], found["recovery after an outage, ms"]["ok"]) == (
        1100,
        False,
    )


@pytest.mark.parametrize("value", [None, float("nan"), "missing"])
@pytest.mark.parametrize("first", [True, False])
def test_a_target_is_missed_where_any_value_is_missing(value, first):
    """max and min pass over such values, depending on where they stand."""
    good = {"case": "crowd", "seconds": 1.0, "silent_sessions": 0}
    bad = {"case": "crowd", "seconds": value, "silent_sessions": 0}
    if value == "missing":
        del bad["seconds"]
    seconds, silent = checks([bad, good] if first else [good, bad])
    assert (seconds["ok"], silent["ok"]) == (False, True)
    least = {"case": "sending", "latency_ms": 1.0, "estimate_error": 0.0, "trace": "generated:steady-2"}
    lines = [least | {"utilisation": 0.9}, least | ({} if value == "missing" else {"utilisation": value})]
    assert not checks(lines if first else lines[::-1])[0]["ok"]


def test_a_policy_whose_quality_is_unknown_anywhere_is_not_said_to_gain():
    lines = [
        {"case": "content", "trace": trace, "policy": policy, "black_frames": 0, "recovery_ms": None}
        | {"psnr_db_by_play": [None if (trace, policy) == ("b", "utility") else 30.0, 31.0]}
        for trace in ("a", "b", "c")
        for policy in ("paper", "utility")
    ]
    (worst,) = [c for c in checks(lines) if "at worst" in c["name"]]
    assert (worst["ok"], worst["value"]) == (False, "+nan on b")


@pytest.mark.parametrize(("share", "ok"), [(0.11, False), (0.10, True)])
def test_missed_frames_of_falling_links_have_a_limit(share, ok):
    line = {"case": "content", "psnr_db_by_play": [30.0], "black_frames": 0, "recovery_ms": None}
    falls = line | {"trace": "generated:lte-driving:start_s=10", "policy": "utility", "missed_share": share}
    steady = falls | {"trace": "generated:steady-10", "missed_share": 1.0}
    (found,) = [c for c in checks([falls, steady, falls | {"policy": "paper"}]) if "missed" in c["name"]]
    assert (found["name"], found["ok"]) == ("share of frames missed with utility on lte-driving", ok)


def test_incidents_are_played_from_several_starts_around_them():
    assert around("generated:step:start_s=12", 5) == [
        f"generated:step:start_s={start}" for start in ("11", "11.5", "12", "12.5", "13")
    ]
    assert around("generated:step:start_s=0", 3) == [f"generated:step:start_s={start}" for start in ("0", "0", "0.5")]
    assert around("generated:steady-30", 5) == ["generated:steady-30"]
    assert around("generated:step:start_s=12:seed=3", 1) == ["generated:step:start_s=12:seed=3"]
    wrong = "generated:step:start_s=abc"
    assert around(wrong, 5) == [wrong], "whoever opens it tells what is wrong"


def test_plays_are_told_as_one_with_the_spread():
    play = {"frames": 10, "frames_missed": 1, "missed_share": 0.1, "psnr_db": 40.0, "recovery_ms": None}
    other = play | {"frames_missed": 3, "missed_share": 0.3, "psnr_db": 44.0, "recovery_ms": 200.0}
    found = together([play, other, play | {"recovery_ms": 500.0, "psnr_db": 42.0}])
    assert (found["plays"], found["frames"], found["frames_missed"], found["recovery_ms"]) == (3, 30, 5, 500.0)
    assert found["psnr_db"] == pytest.approx(42.0)
    assert found["missed_share"] == pytest.approx(0.5 / 3)
    assert found["psnr_db_by_play"] == [40.0, 44.0, 42.0]
    low, high = found["psnr_db_95"]
    assert low < 40 and high > 44, "three plays say little"
    single = together([play])
    assert (single["psnr_db"], single["recovery_ms"]) == (40.0, None)
    assert "psnr_db_95" not in single


def test_first_pictures_have_a_limit_by_link():
    lines = [{"case": "first", "trace": f"generated:steady-{mbps}", "first_picture_ms": 600.0} for mbps in (2, 30)]
    lines.append({"case": "first", "trace": "generated:steady-10", "first_picture_ms": 400.0})
    found = {c["name"]: c["ok"] for c in checks(lines)}
    assert found == {"first picture at 2 Mbps, ms": False, "first picture at 10 Mbps, ms": True}


def test_first_pictures_must_be_recognisable():
    line = {"case": "first", "trace": "generated:steady-30", "first_picture_ms": 1.0}
    found = [checks([line | {"first_lpips_restored": lpips}])[0] for lpips in (0.29, 0.31)]
    assert [(c["name"], c["ok"]) for c in found] == [
        ("LPIPS of the first picture at 30 Mbps", True),
        ("LPIPS of the first picture at 30 Mbps", False),
    ]


def test_a_picture_of_next_to_nothing_is_black():
    records = [{"drawn_share": share} for share in (0.5, 0.6, 0.5, 0.04, 0.0, 0.5)]
    assert black_frames(records) == 2
    assert black_frames([]) == 0


def test_links_are_scaled_by_the_scenes_splats(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    trace = open_trace(str(scaled_trace("generated:steady-30", 0.1, seconds=4)))
    assert trace.mean_bps(0, 3_000_000) == pytest.approx(3e6, rel=0.01)


@pytest.mark.parametrize("workers", [1, 2])
def test_cases_side_by_side_come_in_their_order(workers):
    assert list(in_parallel(abs, [-3, 2, -1], workers)) == [3, 2, 1]


def test_deadlines_of_headless_clients():
    client = SimpleNamespace(started_us=1_000_000, due_us=lambda frame: 1_000_000 + 200_000 * frame)
    margins = [margins_us(client, {0: 900_000, 1: 1_200_001}, 3)]
    assert margins == [[100_000, -1, None]]
    assert missed(margins) == 2
    assert margins_us(SimpleNamespace(started_us=None), {}, 2) == [None, None]


def test_an_unknown_part_is_refused():
    with pytest.raises(ConfigError, match="'dance' is unknown"):
        NetworkSettings(parts="sending,dance")


def test_a_session_trace_is_drawn(tmp_path):
    path = tmp_path / "s1.jsonl"
    with path.open("w") as file:
        pair = Pair()
        pair.server = ServerSession(now_us=0, trace=EventTrace(lambda r: file.write(json.dumps(r) + "\n"), "s1"))
        pair.open()
        pair.queue(*(tile(0, i, 20_000, deadline_us=pair.now_us + 90_000) for i in range(10)))
        pair.run(2_000_000)
    assert plot_session(path).read_bytes().startswith(b"\x89PNG")
    path.write_text("{}\n")
    with pytest.raises(TraceError, match="is not an event trace"):
        plot_session(path)
    with pytest.raises(TraceError, match=r"gone.jsonl: cannot be read \(No such file.*--event-traces"):
        plot_session(tmp_path / "gone.jsonl")


def test_estimates_are_judged_where_the_link_carries_anything():
    trace = trace_of_rates("t", [0, 1, 2], [10, 20, 0], 6)
    early, late, never = (100_000, 11e6), (1_100_000, 10e6), (3_000_000, 5e6)
    assert estimate_error([early], trace, 0, 6_000_000) == pytest.approx(0.1, rel=0.02)
    assert estimate_error([late, never], trace, 0, 6_000_000) == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize(("rate_bps", "known"), [(None, None), (0.0, None), (5e6, 5e6)])
def test_tcp_knows_a_rate_only_once_it_has_measured_one(rate_bps, known):
    info = None if rate_bps is None else SimpleNamespace(delivery_rate_bps=rate_bps)
    assert kernel_bps(SimpleNamespace(tcp_info=lambda: info)) == known


def test_without_packets_a_direct_path_is_left_out_with_its_reason(monkeypatch):
    monkeypatch.setattr("cags_bench.network.sockets.why_unavailable", lambda: "no root")
    assert list(direct_lines(1_000_000, 0)) == [{"case": "direct", "skipped": "no root"}]


@pytest.mark.skipif(why_unavailable() is not None, reason=f"packets cannot be shaped here: {why_unavailable()}")
def test_a_direct_path_shows_both_estimates():
    log = asyncio.run(run_direct(open_trace("generated:steady-20"), 1_500_000, 5_000))
    assert len(log.estimates) > 5
    assert log.kernel
    assert all(rate_bps > 0 for _, rate_bps in log.kernel)


class OneMessage:
    """A transport that brings one message and ends."""

    def __init__(self, data: bytes) -> None:
        self._left = [data]

    async def recv(self) -> bytes:
        if not self._left:
            raise ConnectionEndedError("over")
        return self._left.pop()


async def test_what_a_headless_client_is_sent_counts_when_its_link_delivers_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """25,000 bytes over 1 Mbps take 0.2 s and what TCP adds, and then they travel."""
    clock, received = [0], []
    monkeypatch.setattr(clients, "now_us", lambda: clock[0])
    for mbps, there_us in ((1.0, 200_000 + clients.DELAY_US), (None, 0)):
        client = clients.HeadlessClient(OneMessage(bytes(25_000)), CLIENT, "synthetic:walking", mbps)
        monkeypatch.setattr(client._session, "receive", lambda data, now_us: received.append((len(data), now_us)))
        clock[0] = 0
        await client._read()
        for clock[0] in range(0, 300_000, 1000):
            client._receive()
        (size, at_us), received[:] = received[0], []
        assert size == 25_000
        assert there_us <= at_us <= 1.06 * there_us


def test_weights_that_cannot_be_read_are_reported_before_anything_is_encoded(tmp_path, capsys):
    words = ["network", "--parts", "first", "--lpips", str(tmp_path / "none.npz"), "--cache", str(tmp_path / "cache")]
    assert main(words) == 2
    assert "none.npz" in capsys.readouterr().err
    assert not (tmp_path / "cache").exists()
