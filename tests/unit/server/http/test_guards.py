"""Who may come in, how much they may send, and what is counted."""

import json
import re
import sys

import pytest

from cags_common.errors import ConfigError
from cags_protocol.events import Closed
from cags_server.http.admission import header_allowed, origin_allowed, tls_context, token_allowed
from cags_server.http.metrics import exposition
from cags_server.records import ReferenceCosts, StreamStats, Totals, write_session
from cags_server.session.quota import MESSAGE_S, ClientQuota, Quotas, ReadingShare, TokenBucket
from cags_server.settings import ServeSettings
from support.server_scene import hello


@pytest.mark.parametrize(
    ("origin", "host", "allowed", "expected"),
    [
        (None, "a:1", "", True),
        ("http://127.0.0.1:1", "127.0.0.1:1", "", True),
        ("http://localhost:1", "localhost:1", "", True),
        ("http://a:1", "a:1", "", True),
        ("http://rebound:1", "rebound:1", "", False),
        ("http://b", "a:1", "", False),
        ("http://b", "a:1", "http://c, http://b/", True),
        ("http://b.evil", "a:1", "http://b", False),
        ("null", None, "", False),
        ("http://b", "a:1", "*", True),
        ("http://[", "[", "", False),
    ],
)
def test_origins(origin: str | None, host: str | None, allowed: str, expected: bool) -> None:
    assert origin_allowed(origin, host, allowed, frozenset({"a"})) is expected


def test_tokens() -> None:
    assert token_allowed("", hello(), None)
    assert token_allowed("s", hello(token="s"), None)
    assert token_allowed("s", hello(), "Bearer s")
    assert not token_allowed("s", hello(), None)
    assert not token_allowed("s", hello(token="S"), "Basic s")
    assert token_allowed("old, new", hello(token="old"), None)
    assert token_allowed("old, new", hello(), "Bearer new")
    assert not token_allowed("old, new", hello(token="old, new"), None)
    assert not token_allowed("old, new", hello(token=""), None)
    with pytest.raises(ConfigError, match="token has an empty part"):
        ServeSettings(bundle="x", token="old,")
    assert not token_allowed("s", hello(), "Bearer \udcff")  # a byte that is not UTF-8, as aiohttp hands it on


def test_a_token_of_any_letters_opens_as_aiohttp_hands_its_header_on() -> None:
    for token in ("ключ", "schlüssel", "鍵"):
        header = f"Bearer {token}".encode().decode("utf-8", "surrogateescape")
        assert header_allowed(token, header)
        assert not header_allowed(token, f"Bearer {token}x")
    latin = "Bearer schlüssel".encode("latin-1").decode("utf-8", "surrogateescape")
    assert not header_allowed("schlüssel", latin), "it is sent as UTF-8"


@pytest.mark.parametrize("token", ["se\ncret", "secret\r\n", "a,b\x00", "\x1b[0m", "sec\udcffret"])
def test_a_token_with_control_characters_is_refused_and_not_repeated(token: str) -> None:
    with pytest.raises(ConfigError, match=r"token has the character U\+[0-9A-F]{4}, which") as refused:
        ServeSettings(bundle="x", token=token)
    assert str(refused.value).isprintable()
    assert "sec" not in str(refused.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"host": ""}, r"host = '' is no address; give 127\.0\.0\.1"),
        ({"host": "a..b"}, "host = 'a..b' is no address"),
        ({"origins": "foo bar"}, "origins: 'foo bar' is no origin; give ones such as https://viewer.example"),
        ({"origins": "https://a.example, *"}, r"origins: '\*' is no origin"),
        ({"origins": "https://a.example/page"}, "origins: 'https://a.example/page' is no origin"),
        ({"hosts": "http://x"}, "hosts: 'http://x' is no host name; give ones such as viewer.example"),
        ({"hosts": "a.example, b.example:8443"}, "hosts: 'b.example:8443' is no host name"),
        ({"reference_share": 0.5, "reference_most": 0.2}, "reference_share = 0.5 is above reference_most = 0.2"),
    ],
)
def test_settings_that_can_do_nothing_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ServeSettings(bundle="x", **changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"origins": "*"},
        {"origins": "https://a.example, http://127.0.0.1:8000/,null,"},
        {"origins": "http://[::1]:8765"},
        {"hosts": "Viewer.example, 10.0.0.1, localhost"},
        {"reference_share": 1.0, "reference_most": 1.0},
    ],
)
def test_origins_hosts_and_shares_that_are_taken(changes: dict) -> None:
    ServeSettings(bundle="x", **changes)


def test_tls_needs_both_files_and_readable_ones(tmp_path) -> None:
    assert tls_context("", "") is None
    with pytest.raises(ConfigError, match="belong together"):
        tls_context("a", "")
    bad = tmp_path / "cert.pem"
    bad.write_text("nonsense")
    told = (
        f"--tls-cert {bad}, --tls-key {bad}: cannot be used (they are not PEM); give a certificate and its private key"
    )
    with pytest.raises(ConfigError, match=re.escape(told)):
        tls_context(str(bad), str(bad))
    absent = tmp_path / "absent.key"
    told = f"--tls-key {absent}: cannot be read (No such file or directory); give a PEM file"
    with pytest.raises(ConfigError, match=f"^{re.escape(told)}$"):
        tls_context(str(bad), str(absent))
    with pytest.raises(ConfigError, match=r"--tls-cert .*: cannot be read \(Is a directory\)"):
        tls_context(str(tmp_path), str(bad))


def test_a_bucket_lets_its_rate_through() -> None:
    bucket = TokenBucket(10.0, 5.0, 0)
    assert [bucket.take(1, 0) for _ in range(6)] == [True] * 5 + [False]
    assert bucket.take(1, 100_000)
    assert not bucket.take(1, 100_000)
    assert not bucket.take(6, 10_000_000)  # more than a burst at once


def test_quotas_name_what_is_broken() -> None:
    quota = ClientQuota(Quotas(messages=1.0, bytes=100.0, poses=5.0), 0)
    assert quota.message(150, 0) is None
    assert quota.message(100, 0) == "bytes"
    assert quota.message(1, 0) == "messages"
    assert quota.poses(10, 0) is None
    assert quota.poses(1, 0) == "poses"


def test_the_metrics_page_adds_ended_and_running_sessions() -> None:
    ended = Totals()
    costs = ReferenceCosts(2, render_ns=2 * 10**9)
    ended.add(StreamStats(frames=3, frames_in_time=2, frames_late=1, stalls=1, bytes_tiles=100, light=costs))
    live = StreamStats(frames=4, frames_skipped=5, bytes_tiles=11, bandwidth_bps=2e6, rtt_us=40_000, stalls=2)
    page = exposition(ended, [live], tasks=9, decoded_bytes=77)
    lines = (line.rsplit(" ", 1) for line in page.splitlines() if not line.startswith("#"))
    values = {series: float(value) for series, value in lines}
    assert values["cags_sessions"] == 1
    assert values["cags_sessions_total"] == 2
    assert values["cags_frames_total"] == 7
    assert (values["cags_frames_in_time_total"], values["cags_frames_late_total"]) == (2, 1)
    assert (values["cags_frames_skipped_total"], values["cags_stalls_total"], values["cags_tasks"]) == (5, 3, 9)
    assert values["cags_decoded_bytes"] == 77
    assert values['cags_sent_bytes_total{kind="tiles"}'] == 111
    assert values["cags_render_seconds_sum"] == pytest.approx(2.0)
    assert values["cags_render_seconds_count"] == 2, "looks without a reference are not counted"
    assert values["cags_rtt_seconds"] == pytest.approx(0.04)
    if sys.platform == "linux":
        assert values["process_resident_memory_bytes"] > 1e6
    described = {line.split()[2] for line in page.splitlines() if line.startswith("# TYPE")}
    assert {name.split("{")[0].removesuffix("_sum").removesuffix("_count") for name in values} == described


def test_the_metrics_page_without_anybody() -> None:
    assert "cags_sessions 0.0" in exposition(Totals(), [])


def test_a_session_log_of_a_session_that_never_began(tmp_path) -> None:
    path = write_session(tmp_path / "logs", "run", "s1", StreamStats(), Closed("lost", "reset"))
    head, end = (json.loads(line) for line in path.read_text().splitlines())
    assert head["session"] == "s1"
    assert end["ending"] == {"code": "lost", "reason": "reset"}


def test_reading_is_shared_by_the_time_that_it_takes() -> None:
    """1,000 messages of 4.7 ms a second are read as fast as 40 % of the loop allows, 10 % where four share it."""
    for clients, share in ((1, 0.4), (4, 0.1)):
        reading, now_s, read = ReadingShare(lambda clients=clients: clients, 0.0), 0.0, 0
        while now_s < 20:
            now_s += 0.0047
            now_s += reading.took(0.0047, now_s)
            read += 1
        assert read * (0.0047 + MESSAGE_S) / now_s == pytest.approx(share, rel=0.1)


def test_who_says_as_much_as_a_viewer_says_never_waits() -> None:
    reading = ReadingShare(lambda: 20, 0.0)
    assert [reading.took(50e-6, number * 0.01) for number in range(1000)] == [0.0] * 1000
