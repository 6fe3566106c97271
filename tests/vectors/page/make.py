"""Write what a page and its client say to each other: ``PYTHONPATH=tests python tests/vectors/page/make.py``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cags_client.output.page.messages import pack
from cags_client.output.page.server import scene_text, state_text
from support.live_page import SCENE, FakeControls

FILE = Path(__file__).with_name("messages.json")

OF_THE_PAGE: list[tuple[str, dict[str, Any]]] = [
    ("hello", {"type": "hello", "h264": True, "raw": False}),
    ("hello with a token", {"type": "hello", "h264": True, "raw": True, "token": "sesame"}),
    (
        "pose",
        {"type": "pose", "at_us": 1_700_000_000_123_456, "position": [1, 2, 3], "rotation": [0.6, 0, -0.8, 0]},
    ),
    ("window", {"type": "window", "width": 1280, "height": 720}),
    ("look", {"type": "look", "pictures": ["restored", "truth"], "overlays": ["tiles", "score"]}),
    ("pause", {"type": "set", "name": "playing", "value": False}),
    ("seek", {"type": "set", "name": "frame", "value": 12}),
    ("speed", {"type": "set", "name": "rate", "value": 0.5}),
    ("loop", {"type": "set", "name": "loop", "value": True}),
    ("release", {"type": "set", "name": "held", "value": False}),
    ("choice", {"type": "set", "name": "restorer", "value": "none"}),
    ("cap", {"type": "set", "name": "cap_mbps", "value": 4.5}),
    ("no cap", {"type": "set", "name": "cap_mbps", "value": None}),
    ("delay", {"type": "set", "name": "delay_ms", "value": 60}),
    ("drawn", {"type": "shown", "number": 9, "key": False}),
    ("lost", {"type": "shown", "number": 10, "key": True}),
]

HEAD: dict[str, Any] = {
    "number": 4,
    "pose_at_us": 1_700_000_000_123_456,
    "pictures": [{"name": "restored", "codec": "i420", "key": True, "width": 2, "height": 2, "bytes": 6}],
    "overlays": {
        "grids": [{"name": "detail", "width": 2, "height": 1, "bytes": 2}],
        "tiles": [{"detail": 0.5, "lines": [[0, 0, 1, 1]]}],
        "reference": [[0, 0.5, 1, 0.5]],
    },
    "missing": ["truth"],
    "frame": 7,
    "missed": False,
    "resolution": "full",
    "camera": {"position": [1, 2, 3], "rotation": [1, 0, 0, 0], "fov_y": 0.8},
    "stages_ms": {"raster": 12.5},
    "stats": {"lod_mean": 3.5, "buffer_ms": None},
}
PAYLOADS = [bytes(range(6)), b"\x01\xff"]


def said() -> dict[str, Any]:
    """All of it, as JSON has it."""
    controls = FakeControls()
    shaper = {"ok": True, "cap_mbps": None, "delay_ms": 20, "capacity_mbps": 9.5}
    told = {
        "scene": scene_text(SCENE, controls, shaper=True),
        "state": state_text(controls, held=True, steers=False, shaper=shaper),
        "error": {"type": "error", "text": "another page steers this client; this one watches"},
    }
    frame = {"head": HEAD, "payloads": [part.hex() for part in PAYLOADS], "data": pack(HEAD, PAYLOADS).hex()}
    page = [{"name": name, "fields": fields} for name, fields in OF_THE_PAGE]
    whole = {"page": page, "client": told, "frame": frame}
    return dict(json.loads(json.dumps(whole)))


if __name__ == "__main__":
    FILE.write_text(json.dumps(said(), indent=1) + "\n", encoding="utf-8")
