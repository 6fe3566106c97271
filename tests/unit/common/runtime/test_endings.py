"""A second request to end a process ends it at once, with its code and without a word."""

import signal
import subprocess
import sys
import time

import pytest

from cags_common.runtime.endings import HEARD_TWICE_S

IN_ORDER = """
import sys, time
from cags_common.cli import run_command
def body(argv):
    try:
        print("up", flush=True)
        time.sleep(60)
    finally:
        print("tidying up", flush=True)
        time.sleep(60)
run_command("cags-try", body)
"""

IN_A_LOOP = """
import asyncio, time
from cags_common.cli import run_command
from cags_common.runtime.endings import on_first_request
async def main():
    stop = asyncio.Event()
    on_first_request(lambda _: stop.set())
    print("up", flush=True)
    await stop.wait()
    print("tidying up", flush=True)
    time.sleep(60)
run_command("cags-try", lambda argv: asyncio.run(main()))
"""

WITH_A_CHILD = """
import subprocess, sys
from cags_common.cli import run_command
def body(argv):
    with subprocess.Popen([sys.executable, "-c", "import time; print('up', flush=True); time.sleep(60)"]) as child:
        try:
            child.wait()
        finally:
            print("tidying up", flush=True)
            child.wait()
run_command("cags-try", body)
"""


@pytest.mark.parametrize("again", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("first", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("text", [IN_ORDER, IN_A_LOOP, WITH_A_CHILD], ids=["in order", "in a loop", "with a child"])
def test_the_second_request_ends_at_once(text: str, first: signal.Signals, again: signal.Signals) -> None:
    command = [sys.executable, "-c", f"import signal\nfor n in (1, 2): signal.signal(n, {USUAL}[n])\n{text}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "up\n"
        running.send_signal(first)
        assert running.stdout.readline() == "tidying up\n"
        running.send_signal(again)  # the same request, by way of a shell
        time.sleep(HEARD_TWICE_S)
        assert running.poll() is None
        time.sleep(0.1)
        running.send_signal(again)
        out, said = running.communicate(timeout=20)  # its children, too, have let go of its output
    assert (running.returncode, out, said) == (128 + again, "", "")


USUAL = "{1: signal.SIG_DFL, 2: signal.default_int_handler}"
"""Whatever these tests were started under."""


def test_another_request_while_python_ends_changes_nothing() -> None:
    """It was ended by the second signal itself, with no code of its own."""
    text = """import asyncio, time
from cags_common.cli import run_command
from cags_common.runtime.endings import on_first_request
class Slow:
    def __del__(self): time.sleep(5)
slow = Slow()
async def main():
    stop = asyncio.Event()
    on_first_request(lambda _: stop.set())
    print("up", flush=True)
    await stop.wait()
run_command("cags-try", lambda argv: asyncio.run(main()))"""
    with subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "up\n"
        for _ in range(8):
            running.send_signal(signal.SIGTERM)
            time.sleep(0.1)
        assert running.wait(timeout=20) == 0


def test_threads_do_not_keep_a_command_that_was_asked_to_end() -> None:
    body = "threading.Thread(target=time.sleep, args=[60]).start(); print('up', flush=True); time.sleep(60)"
    text = f"""import threading, time
from cags_common.cli import run_command
def body(argv):
    {body}
run_command("cags-try", body)"""
    with subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "up\n"
        running.send_signal(signal.SIGTERM)
        assert running.wait(timeout=20) == 143


def test_a_signal_while_python_ends_is_no_traceback() -> None:
    text = """import sys, threading, time
from cags_common.cli import run_command
def body(argv):
    threading.Thread(target=time.sleep, args=[60]).start()
    print("up", flush=True)
sys.exit(run_command("cags-try", body))"""
    text = f"import signal; signal.signal(2, signal.default_int_handler)\n{text}"
    with subprocess.Popen(
        [sys.executable, "-c", text], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "up\n"
        time.sleep(0.1)
        running.send_signal(signal.SIGINT)
        assert running.communicate(timeout=20)[1] == ""
        assert running.returncode == 130
