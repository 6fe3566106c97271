"""``cags-server`` as a process: one clear line for everything that can be wrong."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest


def run(*flags: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "cags_server", *flags], capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize(
    ("flags", "code", "words"),
    [
        ((), 2, "bundle is not given"),
        (("--bundle", "/nowhere/at-all"), 1, "no such folder"),
        (("--bundle", "x", "--predictor", "psychic"), 2, "predictor = 'psychic' is unknown"),
        (("--bundle", "x", "--fov", "fisheye"), 2, "fov = 'fisheye' is unknown"),
        (("--bundle", "x", "--port", "99999"), 2, "port = 99999 must lie in"),
        (("--bundle", "x", "--tls-cert", "cert.pem"), 2, "belong together"),
        (("--bundle", "x", "--reference-width", "401", "--reference-chroma", "yuv420p"), 2, "must be even"),
    ],
)
def test_wrong_use_is_one_line(flags: tuple[str, ...], code: int, words: str) -> None:
    result = run(*flags)
    assert result.returncode == code
    assert words in result.stderr
    assert "Traceback" not in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert result.stdout == ""


def test_a_bundle_of_another_version_is_refused(tmp_path) -> None:
    (tmp_path / "manifest.json").write_text('{"format": "cags-bundle", "version": 99}')
    result = run("--bundle", str(tmp_path))
    assert result.returncode == 1
    assert "version 99" in result.stderr


def test_the_ready_line_is_an_address_with_brackets_where_it_must_have_them() -> None:
    from cags_common.transport.hosts import host_port

    assert host_port("::1", 8765) == "[::1]:8765"
    assert host_port("127.0.0.1", 8765) == "127.0.0.1:8765"


async def test_a_port_in_use_is_named() -> None:
    from cags_common.errors import NetworkError
    from cags_server.http.app import serve
    from cags_server.scene.collection import Collection
    from cags_server.settings import ServeSettings
    from support.server_scene import library

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        settings = ServeSettings(bundle="in memory", port=port)
        with pytest.raises(NetworkError, match=rf"cannot listen on 127\.0\.0\.1:{port} \(address already in use\)"):
            await serve(Collection.of(library()), settings, lambda host, port, app: None)
