"""What every command does about signals, full disks, closed pipes and poor terminals."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cags_common.cli import command_parser, run_command
from cags_common.errors import CagsError, ConfigError

FULL = Path("/dev/full")

SCRIPT = """
import signal, sys, time
from cags_common.cli import run_command
signal.signal(signal.SIGHUP, signal.{hangup})
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it for what runs in the background
def body(argv):
    {body}
sys.exit(run_command("cags-try", body, []))
"""


def start(body: str, hangup: str = "SIG_DFL", **named: object) -> subprocess.Popen[str]:
    """A command of its own; ``hangup`` is what it finds when it starts, whatever these tests were started under."""
    text = SCRIPT.format(body=body.replace("\n", "\n    "), hangup=hangup)
    return subprocess.Popen([sys.executable, "-c", text], text=True, stderr=subprocess.PIPE, **named)  # type: ignore[call-overload,no-any-return]


@pytest.mark.parametrize(
    ("error", "code"), [(CagsError("a: b; c"), 1), (ConfigError("a: b; c"), 2), (KeyboardInterrupt(), 130)]
)
def test_errors_are_one_line(error, code, capsys):
    def body(_):
        raise error

    assert run_command("cags-try", body, []) == code
    assert capsys.readouterr().err == f"cags-try: {str(error) or 'interrupted'}\n"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EACCES, errno.EMFILE])
def test_what_the_system_refuses_is_one_line_with_a_way_out(number, capsys):
    def body(_):
        raise OSError(number, os.strerror(number), "/some/where")

    assert run_command("cags-try", body, []) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"cags-try: /some/where: {os.strerror(number).lower()}; ")
    assert said.count("\n") == 1


def test_other_errors_of_the_system_are_faults_and_keep_their_traceback():
    def body(_):
        raise OSError(errno.EBADF, "bad file descriptor")

    with pytest.raises(OSError, match="bad file"):
        run_command("cags-try", body, [])


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_request_to_end_tidies_up(number, tmp_path):
    left = tmp_path / "left"
    body = f"try:\n    print('up', flush=True)\n    time.sleep(60)\nfinally:\n    open({str(left)!r}, 'w').close()"
    with start(body, stdout=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "up\n"
        running.send_signal(number)
        _, said = running.communicate(timeout=20)
    assert running.returncode == 128 + number
    assert said == ""
    assert left.exists()


@pytest.mark.parametrize(
    ("number", "said"), [(signal.SIGINT, "cags-try: interrupted\n"), (signal.SIGTERM, ""), (signal.SIGHUP, "")]
)
def test_a_signal_within_a_callback_of_a_weak_reference_is_not_lost(number, said):
    body = f"""import weakref
class Gone: pass
gone = Gone()
reference = weakref.ref(gone, lambda _: signal.raise_signal({number:d}))
del gone
time.sleep(60)"""
    with start(body) as running:
        _, heard = running.communicate(timeout=20)
    assert running.returncode == 128 + number
    assert heard == said


def test_other_errors_that_python_drops_are_still_told():
    with start("class Gone:\n    def __del__(self): raise KeyError('dropped')\nGone()") as running:
        _, heard = running.communicate(timeout=20)
    assert running.returncode == 0
    assert "KeyError: 'dropped'" in heard


def test_nohup_is_respected():
    with start("print('up', flush=True)\ntime.sleep(0.2)", "SIG_IGN", stdout=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "up\n"
        running.send_signal(signal.SIGHUP)
        assert running.wait(timeout=20) == 0


def test_a_reader_that_goes_away_is_no_error():
    with start("print('first', flush=True)\ntime.sleep(0.3)\nprint('x' * 100)", stdout=subprocess.PIPE) as running:
        assert running.stdout is not None
        running.stdout.readline()
        running.stdout.close()
        assert running.stderr is not None
        assert running.stderr.read() == ""
    assert running.returncode == 0


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_that_were_closed_before_the_start_lead_nowhere(closed):
    body = "import os; print(1); print(2, file=sys.stderr)\nkinds = [os.fstat(number) for number in range(3)]"
    text = SCRIPT.format(body=body.replace("\n", "\n    "), hangup="SIG_DFL")
    ended = subprocess.run(["sh", "-c", f'exec "$0" -c "$1" {closed}', sys.executable, text], timeout=60, check=False)
    assert ended.returncode == 0


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
def test_a_full_disk_is_told_even_where_it_shows_at_the_end():
    with FULL.open("w") as full, start("print('a few words')", stdout=full) as running:
        _, said = running.communicate(timeout=20)
    assert said == "cags-try: output: no space left on device; make room or choose another place\n"
    assert running.returncode == 1


def test_a_terminal_without_the_letters_gets_others():
    plain = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    with start("print('4\\u00b0 \\u2026')", stdout=subprocess.PIPE, env=plain) as running:
        out, said = running.communicate(timeout=20)
    assert (out, said, running.returncode) == ("4? ?\n", "", 0)


def test_every_parser_tells_the_version(capsys):
    with pytest.raises(SystemExit) as end:
        command_parser("cags-try", "what", "  none").parse_args(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith("cags-try ")
