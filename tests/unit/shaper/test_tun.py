"""Packets through TUN devices: needs root, Linux and network namespaces, and says so where they are missing."""

import json
import os
import socket
import subprocess
import sys

import pytest

from cags_shaper import tun
from cags_shaper.cli import main
from cags_shaper.plot import read_log

REASON = tun.why_unavailable()
needs_tun = pytest.mark.skipif(REASON is not None, reason=f"packets cannot be shaped here: {REASON}")

TRANSFER = """
import os, socket, subprocess, sys
server = socket.create_server(("0.0.0.0", 0))
inside = f'''
import os, socket
s = socket.create_connection((os.environ["CAGS_SHAPER_HOST"], {server.getsockname()[1]}))
got = 0
while data := s.recv(65536):
    got += len(data)
print(got)
'''
command = [sys.executable, "-m", "cags_shaper", "--tun", *sys.argv[1:], "--", sys.executable, "-c", inside]
shaper = subprocess.Popen(command)
peer, _ = server.accept()
peer.sendall(bytes(300_000))
peer.close()
sys.exit(shaper.wait())
"""


def transfer(*flags):
    return subprocess.run(
        [sys.executable, "-c", TRANSFER, *flags], capture_output=True, text=True, timeout=60, check=False
    )


@needs_tun
@pytest.mark.parametrize("flags", [(), ("--loss", "0.05", "--seed", "3"), ("--queue-packets", "5", "--delay-ms", "5")])
def test_tcp_gets_every_byte_through_delay_loss_and_short_queues(flags):
    done = transfer("--trace", "generated:steady-50", *flags)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "300000"


@needs_tun
def test_nothing_is_left_behind_and_the_exit_status_is_the_commands(capfd):
    assert main(["--tun", "--", sys.executable, "-c", "raise SystemExit(7)"]) == 7
    left = subprocess.run(["ip", "netns", "list"], capture_output=True, text=True, check=True).stdout.split()
    assert f"cags{os.getpid()}" not in left
    assert capfd.readouterr().err == ""


ASKED = """
import json, os, socket, time
s = socket.create_connection((os.environ["CAGS_SHAPER_HOST"], int(os.environ["CONTROL"])))
s.sendall(b'{"cap_mbps": 7}\\n')
print(s.makefile().readline())
time.sleep(0.3)
"""


@needs_tun
def test_packets_have_a_log_and_a_control_port_too(tmp_path, capfd, monkeypatch):
    with socket.create_server(("0.0.0.0", 0)) as free:
        port = free.getsockname()[1]
    monkeypatch.setenv("CONTROL", str(port))
    log = tmp_path / "s.jsonl"
    flags = ["--trace", "generated:steady-30", "--log", str(log), "--control", f"0.0.0.0:{port}"]
    assert main(["--tun", *flags, "--", sys.executable, "-c", ASKED]) == 0
    out, err = capfd.readouterr()
    assert json.loads(out)["capacity_mbps"] == 7
    assert err == f"cags-shaper: control on port {port}\n"
    down = [row for row in read_log(log) if row["direction"] == "down"]
    assert sum(row["delivered_bytes"] for row in down) > 100
    assert down[-1]["capacity_bytes"] * 8 / (down[-1]["t_us"] - down[-2]["t_us"]) == pytest.approx(7, rel=0.01)


@needs_tun
def test_a_log_that_cannot_be_written_is_said_before_the_command_runs(tmp_path, capfd):
    assert main(["--tun", "--log", "/nowhere/at/all", "--", "touch", str(tmp_path / "ran")]) == 2
    assert "--log /nowhere/at/all: cannot be written" in capfd.readouterr().err
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--tun"], "--tun and a COMMAND go together"),
        (["--", "true"], "--tun and a COMMAND go together"),
        (["--tun", "--", "no-such-program"], "COMMAND 'no-such-program' is no program here"),
        (["--loss", "0.1"], "--loss and --queue-packets act on packets"),
        (["--tun", "--loss", "1.5", "--", "true"], "loss = 1.5 must lie in"),
        (["--tun", "--listen", "127.0.0.1:0", "--", "true"], "--listen is of the proxy"),
        (["--tun", "--to", "127.0.0.1:8765", "--json", "--", "true"], "leave out --to and --json"),
        (["--tun", "--json", "--", "true"], "--json is of the proxy"),
    ],
)
def test_wrong_use_is_one_line(capsys, arguments, says):
    assert main(arguments) == 2
    assert says in capsys.readouterr().err


def test_what_a_settings_file_says_of_the_proxy_is_refused_too(tmp_path, capsys):
    (tmp_path / "shaper.toml").write_text('to = "10.0.0.1:9000"\n')
    assert main(["--config", str(tmp_path / "shaper.toml"), "--tun", "--", "true"]) == 2
    assert "leave out --to" in capsys.readouterr().err


def test_without_root_the_reason_is_named(monkeypatch, capsys):
    monkeypatch.setattr(tun.os, "geteuid", lambda: 1000)
    assert main(["--tun", "--", "true"]) == 2
    assert "needs root" in capsys.readouterr().err


def test_pairs_do_not_share_addresses():
    pairs = [tun.TunNames(n) for n in range(1000)]
    assert len({address for pair in pairs for address in pair.addresses}) == 2000
    assert all(len(device) <= 15 for device in tun.TunNames(4194304).devices)
