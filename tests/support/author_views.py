"""Views that no author would give."""

from __future__ import annotations

from typing import Any

HOSTILE: dict[str, list[Any]] = {
    "title": [7, "two\nlines", "x" * 121, "turned \u202e round", ["a"]],
    "background": ["red", "#12345", "#12345g", "url(http://a)", 5, "#1234567"],
    "pose": [[0, 0, 0], [0, 0, 0, 0, 0, 0, 0], [0, 0, 1e12, 1, 0, 0, 0], "0,0,0", [0, 0, 0, 3, 0, 0, 0], [0] * 8],
    "target": [[1, 2], [1, 2, "3"], {"x": 1}, [0, 0, 1e10], [True, 0, 0]],
    "radius": [0, -1, 1e10, "1", True],
}
