"""The live page: a small web server beside the client that shows what the client shows, and lets people take part.

The page needs no build step and no outside host. Pictures travel as H.264 for WebCodecs, or as JPEG where the browser
has none. :class:`LiveView` is a frame sink and a pose source at once; see ``docs/how-to/live-page.md``.
"""

from cags_client.view.controls import Controls, SceneInfo, ShownFrame, SplatDetail
from cags_client.view.live import LiveView
from cags_client.view.poses import LivePoses
from cags_client.view.settings import ViewSettings
from cags_client.view.sink import ViewSink, scene_info

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
