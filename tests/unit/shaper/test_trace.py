import pytest

from cags_common.errors import TraceError
from cags_shaper.generate import MODELS, generate
from cags_shaper.trace import NEVER_US, OPPORTUNITY_BYTES, open_trace, read_trace, trace_of_rates, trace_of_times


def write(tmp_path, text, name="t.txt"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_mahimahi_file_is_its_lines(tmp_path):
    trace = read_trace(write(tmp_path, "0\n5\n5\n\n# note\n9\n"))
    assert trace.opportunities == 4
    assert trace.period_ms == 9
    assert [trace.time_of(k) // 1000 for k in range(1, 10)] == [0, 5, 5, 9, 9, 14, 14, 18, 18]
    assert [trace.count_until(t * 1000) for t in (-1, 0, 4, 5, 8, 9, 10, 14, 18)] == [0, 1, 1, 3, 3, 5, 5, 7, 9]
    assert trace.to_mahimahi() == "0\n5\n5\n9\n"


def test_without_loop_nothing_comes_after_the_end(tmp_path):
    trace = read_trace(write(tmp_path, "3\n7\n"), loop=False)
    assert trace.time_of(2) == 7000
    assert trace.time_of(3) == NEVER_US
    assert trace.count_until(10**9) == 2


def test_a_rate_table_becomes_its_bytes(tmp_path):
    trace = read_trace(write(tmp_path, "time_s,mbps\n0,12.032\n1,0\n2,24.064\n"))
    assert trace.period_ms == 3000
    assert trace.count_until(1_000_000) == 1000
    assert trace.count_until(2_000_000) == 1000
    assert trace.count_until(3_000_000) == 3000
    assert trace.mean_bps(0, 3_000_000) == pytest.approx(12.032e6)
    assert trace.mean_bps(1_000_000, 2_000_000) == 0
    assert trace.mean_bps(2_500_000, 3_500_000) == pytest.approx((12.032e6 + 24.064e6) / 2, rel=1e-3)


def test_a_rate_table_may_start_late_and_lack_its_heading(tmp_path):
    trace = read_trace(write(tmp_path, "100.5,12.032\n101.5,12.032\n"))
    assert trace.period_ms == 2000
    assert trace.opportunities == 2000


def test_pensieve_files_are_read(tmp_path):
    assert read_trace(write(tmp_path, "0.0 12.032\n0.5\t12.032\n")).opportunities == 1000


def test_5gophers_and_lumos5g_tables_are_read(tmp_path):
    heading = "protocol,num_tcp_conn,seq_num,anonymized_mCid,radio_type,throughput_mbps,nrStatus,primitive_handoff_type"
    gophers = f"{heading}\nTCP,8,1,3,4G,12.032,NOT_RESTRICTED,\nTCP,8,2,3,5G,24.064,CONNECTED,P2\n"
    lumos = "run_num,seq_num,latitude,Throughput,tower_id\n1,7,44.97,12.032,0\n1,8,44.97,24.064,1\n"
    for text in (gophers, lumos):
        trace = read_trace(write(tmp_path, text))
        assert trace.period_ms == 2000
        assert (trace.count_until(1_000_000), trace.count_until(2_000_000)) == (1000, 3000)
    with pytest.raises(TraceError, match=":2: 'TCP,8,1' is not a row"):
        read_trace(write(tmp_path, f"{heading}\nTCP,8,1\n"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("# only a comment\n\n", "is empty"),
        ("5\n4\n", ":2: time 4 ms comes after 5 ms"),
        ("5\nx\n", ":2: 'x' is not a time"),
        ("5\n-6\n", ":2: '-6' is not a time"),
        ("5\n9999999999\n", ":2:"),
        ("0\n0\n", "lasts 0 ms"),
        ("0,1\n", "has 1 rows"),
        ("time_s,mbps\n0,1\n0,2\n", ":3: time 0 s comes after 0 s"),
        ("time_s,mbps\n0,1\n1,nan\n", ":3:"),
        ("time_s,mbps\n0,1\n1,-2\n", ":3:"),
        ("time_s,mbps\n0,1\n1,two\n", ":3: '1,two' is not a row"),
        ("time_s,mbps\n0,1\n1,2,3\n", ":3: '1,2,3' is not a row"),
        ("0,0\n1,0\n", "no delivery opportunity"),
        ("0,1\n99999,1\n", ":2:"),
        ("hello\n", ":1: 'hello' is not a row"),
        (b"\xff\xfe0\x001", "not ASCII"),
    ],
)
def test_bad_files_are_refused_with_their_line(tmp_path, text, says):
    path = write(tmp_path, text)
    with pytest.raises(TraceError) as error:
        read_trace(path)
    assert says in str(error.value)
    assert str(path.name) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TraceError, match=r"nowhere\.csv: cannot be read"):
        read_trace(tmp_path / "nowhere.csv")
    with pytest.raises(TraceError, match="cannot be read"):
        read_trace(tmp_path)


@pytest.mark.parametrize("name", [*MODELS, "steady-30", "steady-2.5"])
def test_generated_traces_are_the_same_every_time(name):
    first, again = open_trace(f"generated:{name}"), open_trace(f"generated:{name}")
    assert first.times_ms == again.times_ms
    assert first.mean_bps(0, first.duration_us) > 0


@pytest.mark.parametrize("name", [*MODELS, "steady-30"])
def test_a_generated_table_survives_its_file(tmp_path, name):
    spec = f"{name}:duration_s=30"
    from_file = read_trace(write(tmp_path, generate(spec).to_csv()))
    direct = open_trace(f"generated:{spec}")
    assert from_file.period_ms == direct.period_ms
    assert from_file.opportunities == pytest.approx(direct.opportunities, abs=1)


def test_seeds_and_lengths_of_generated_traces():
    assert generate("lte-driving:seed=1").mbps != generate("lte-driving:seed=2").mbps
    assert generate("lte-driving:seed=3:duration_s=10").end_s == 10
    assert open_trace("generated:steady-12.032").mean_bps(0, 10**6) == pytest.approx(12.032e6)


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("mars", "unknown trace 'mars'; known: 5g-mmwave"),
        ("step:colour=1", "unknown option 'colour=1'"),
        ("step:seed=x", "'x' must be a number"),
        ("steady-0", "'0' must be a number"),
        ("steady-nan", "'nan' must be a number"),
        ("step:duration_s=1e9", "must be a number in"),
    ],
)
def test_unknown_generated_traces_are_refused(spec, says):
    with pytest.raises(TraceError) as error:
        open_trace(f"generated:{spec}")
    assert says in str(error.value)


def test_the_blackout_has_three_silent_seconds():
    trace = open_trace("generated:blackout")
    assert trace.mean_bps(10_000_000, 13_000_000) == 0
    assert trace.mean_bps(0, 10_000_000) == pytest.approx(60e6, rel=1e-3)


def test_times_and_rates_agree_on_capacity():
    rates = trace_of_rates("r", [0.0], [30.0], 1.0)
    times = trace_of_times("t", [int(line) for line in rates.to_mahimahi().split()])
    assert times.opportunities == rates.opportunities == int(30e6 / 8 / OPPORTUNITY_BYTES)


@pytest.mark.parametrize("start_s", [0.25, 5.0, 12.9, 30.0, 31.5])
def test_a_trace_may_begin_within_its_period(start_s):
    whole, turned = open_trace("generated:blackout"), open_trace(f"generated:blackout:start_s={start_s}")
    assert turned.period_ms == whole.period_ms
    assert abs(turned.opportunities - whole.opportunities) <= 1
    for at_us in range(0, 60_000_000, 700_000):
        there = at_us + round(start_s * 1e6)
        assert turned.mean_bps(at_us, at_us + 700_000) == pytest.approx(
            whole.mean_bps(there, there + 700_000), abs=2 * 1504 * 8 / 0.7
        )
