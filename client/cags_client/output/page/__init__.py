"""The live page: a small web server beside the client that shows what the client shows, and lets people take part.

The page is the viewer's (``web/``, found by ``cags_web``), told that a client stands behind it. Pictures travel as they
are, as H.264 for WebCodecs, or as JPEG where the browser has none. :class:`LiveView` is a pose source and takes frames
through :class:`ViewSink`; see ``docs/how-to/live-page.md``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cags_client.output.page.settings import ViewSettings

if TYPE_CHECKING:
    from cags_client.output.page.controls import Controls, SceneInfo, ShownFrame, SplatDetail
    from cags_client.output.page.poses import LivePoses
    from cags_client.output.page.server import LiveView
    from cags_client.output.page.sink import ViewSink, scene_info

__all__ = [
    "Controls",
    "LivePoses",
    "LiveView",
    "SceneInfo",
    "ShownFrame",
    "SplatDetail",
    "ViewSettings",
    "ViewSink",
    "scene_info",
]

_HOMES = {
    "Controls": "controls",
    "LivePoses": "poses",
    "LiveView": "server",
    "SceneInfo": "controls",
    "ShownFrame": "controls",
    "SplatDetail": "controls",
    "ViewSink": "sink",
    "scene_info": "sink",
}


def __getattr__(name: str) -> Any:
    """Load the server, the codecs and OpenCV only when they are used: ``--help`` needs the settings alone."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
