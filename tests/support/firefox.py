"""A headless Firefox ESR for tests (Debian's ``firefox-esr``), driven by WebDriver BiDi, which needs no driver."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

READY = re.compile(r"WebDriver BiDi listening on (ws://\S+)")
START_S, ANSWER_S = 60.0, 300.0
WEBGPU = {"dom.webgpu.enabled": True, "gfx.webgpu.ignore-blocklist": True}
"""What Firefox ESR keeps behind preferences on Linux."""

LEVELS = {"error": "SEVERE", "warn": "WARNING"}


class Firefox:
    """The part of selenium's driver that tests ask for."""

    def __init__(self, address: str) -> None:
        from websocket import create_connection

        self._socket = create_connection(f"{address}/session", timeout=ANSWER_S, suppress_origin=True)
        self._asked = 0
        self._log: list[dict[str, str]] = []
        self._ask("session.new", capabilities={})
        self._ask("session.subscribe", events=["log.entryAdded"])
        self._context = self._ask("browsingContext.getTree")["contexts"][0]["context"]

    def get(self, url: str) -> None:
        self._ask("browsingContext.navigate", context=self._context, url=url, wait="complete")

    def before_each_page(self, script: str) -> None:
        """Run ``script`` in every page from now on, before the page's own scripts."""
        self._ask("script.addPreloadScript", functionDeclaration=f"() => {{ {script} }}")

    def execute_script(self, script: str, *arguments: Any) -> Any:
        return self._run(f"(function () {{ {script} }}).apply(null, {json.dumps(arguments)})")

    def execute_async_script(self, script: str, *arguments: Any) -> Any:
        given = json.dumps(arguments)
        return self._run(f"new Promise((done) => (function () {{ {script} }}).apply(null, [...{given}, done]))")

    def get_log(self, _: str) -> list[dict[str, str]]:
        """Errors and warnings since the last call."""
        entries, self._log = self._log, []
        return entries

    def close(self) -> None:
        self._socket.close()

    def _run(self, expression: str) -> Any:
        asked = (
            f"Promise.resolve({expression}).then((value) => JSON.stringify(value, (_, part) => part ?? null) ?? null)"
        )
        answer = self._ask("script.evaluate", expression=asked, target={"context": self._context}, awaitPromise=True)
        assert answer["type"] == "success", answer
        return json.loads(answer["result"]["value"])

    def _ask(self, method: str, **params: Any) -> dict[str, Any]:
        self._asked += 1
        self._socket.send(json.dumps({"id": self._asked, "method": method, "params": params}))
        while True:
            told = json.loads(self._socket.recv())
            if told.get("method") == "log.entryAdded":
                entry = told["params"]
                level = LEVELS.get(entry["level"], "")
                self._log.append({"level": level, "message": entry["text"], "source": entry["type"]})
            if told.get("id") == self._asked:
                assert told["type"] == "success", told
                return dict(told["result"])


@contextmanager
def firefox(profile: Path, preferences: dict[str, Any] | None = None, **environment: str) -> Iterator[Firefox]:
    """A running browser with an empty ``profile``; skips the test where there is none."""
    program = shutil.which("firefox-esr") or shutil.which("firefox")
    if program is None:
        pytest.skip("no Firefox here: apt-get install firefox-esr")
    profile.mkdir(parents=True, exist_ok=True)
    lines = [f'user_pref("{name}", {json.dumps(value)});' for name, value in (preferences or {}).items()]
    (profile / "user.js").write_text("\n".join(lines))
    output = profile / "output"
    command = [program, "--headless", "--no-remote", "--profile", str(profile), "--remote-debugging-port", "0"]
    with output.open("w") as to:
        process = subprocess.Popen(
            [*command, "about:blank"],
            stdout=to,
            stderr=subprocess.STDOUT,
            env={**os.environ, "HOME": str(profile), **environment},
        )
    try:
        browser = Firefox(_address(output, process))
        try:
            yield browser
        finally:
            browser.close()
    finally:
        process.terminate()
        process.wait(30)


def _address(output: Path, process: subprocess.Popen[bytes]) -> str:
    ends = time.monotonic() + START_S
    while time.monotonic() < ends and process.poll() is None:
        if found := READY.search(output.read_text()):
            return found[1]
        time.sleep(0.1)
    raise AssertionError(f"Firefox did not start: {output.read_text()[-2000:]}")
