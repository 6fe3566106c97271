"""The viewer in the browser, as a server hands it out: built files, or why there are none."""

from __future__ import annotations

from pathlib import Path

HOW_TO_BUILD = "python -m cags_web.build"

_HERE = Path(__file__).resolve().parent
_PLACES = (_HERE / "dist", _HERE.parent / "dist")
"""In a wheel; in a checkout."""

FILES = {
    "index.html": "text/html; charset=utf-8",
    "gallery.html": "text/html; charset=utf-8",
    "gallery.js": "text/javascript; charset=utf-8",
    "gallery.css": "text/css; charset=utf-8",
    "page.js": "text/javascript; charset=utf-8",
    "page.css": "text/css; charset=utf-8",
    "worker.js": "text/javascript; charset=utf-8",
    "icon.svg": "image/svg+xml",
    "kernels.wasm": "application/wasm",
    "draco_decoder.wasm": "application/wasm",
}
"""What the page is made of, with content types; nothing else is handed out."""


def page_folder() -> Path | None:
    """The folder of the built files; None where they are not built."""
    for place in _PLACES:
        if all((place / name).is_file() for name in FILES):
            return place
    return None
