"""One open page: what it looks at, its video streams, and how far behind it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from cags_client.output.page.controls import SceneInfo, SplatDetail
from cags_client.output.page.messages import PageHello, PageLook, PageWindow, pack
from cags_client.output.page.overlays import (
    Grid,
    confidence_grid,
    detail_grid,
    occlusion_grid,
    reference_outline,
    tile_boxes,
)
from cags_client.output.page.pictures import Gallery
from cags_client.output.page.settings import ViewSettings
from cags_client.output.page.video import H264, JPEG, RAW, PictureStream

MAX_IN_FLIGHT = 2
"""Messages that a page may not have drawn yet; beyond them it skips frames rather than falling behind."""

SLOW_WRITE_S = 0.05
SLOW_WRITES = 5
"""A line on which so many pictures in a row took so long to write is not a memory's: what it carries is coded from then
on. (A tunnel from another machine looks like this one.)
"""

DEFAULT_LOOK = PageLook(("restored",), frozenset())


def kind_of(hello: PageHello, settings: ViewSettings, *, local: bool) -> str:
    """How pictures are coded for a page; ``local``: it is on this machine."""
    if not hello.h264:
        return JPEG
    return RAW if hello.raw and local and settings.view_raw else H264


@dataclass(eq=False)
class Page:
    """State of one page. ``compose`` runs in the worker thread, the rest in the event loop."""

    kind: str
    """How its pictures are coded: one of :data:`cags_client.output.page.video.KINDS`."""
    settings: ViewSettings
    scene: SceneInfo
    look: PageLook = DEFAULT_LOOK
    window: PageWindow | None = None
    """What its pictures are shown on, once it has said."""
    sent: int = 0
    drawn: int = 0
    _wants_key: bool = False
    _streams: dict[str, PictureStream] = field(default_factory=dict)
    _slow_writes: int = 0

    @property
    def ready(self) -> bool:
        """Whether the page has drawn enough of what it was sent to be given more."""
        return self.sent - self.drawn < MAX_IN_FLIGHT

    def shown(self, number: int, key: bool) -> None:
        """The page has drawn message ``number``."""
        self.drawn = max(self.drawn, min(number, self.sent))
        self._wants_key = self._wants_key or key

    def wrote(self, seconds: float) -> None:
        """How long the newest message took to write."""
        self._slow_writes = self._slow_writes + 1 if seconds > SLOW_WRITE_S else 0
        if self.kind == RAW and self._slow_writes >= SLOW_WRITES:
            self.kind = H264
            self._streams.clear()

    def compose(self, gallery: Gallery, detail: SplatDetail | None, pose_at_us: int | None) -> bytes:
        """The binary message for one displayed frame: pictures, grids, lines and figures."""
        if "score" in self.look.overlays:
            gallery.truth()
        payloads: list[bytes] = []
        pictures = self._pictures(gallery, payloads)
        self.sent += 1
        header = {
            "number": self.sent,
            "pose_at_us": pose_at_us,
            "pictures": pictures,
            "overlays": self._overlays(gallery, detail, payloads),
            "missing": [name for name in self.look.pictures if name not in {p["name"] for p in pictures}],
            **frame_figures(gallery),
        }
        return pack(header, payloads)

    def _pictures(self, gallery: Gallery, payloads: list[bytes]) -> list[dict[str, Any]]:
        wanted, self._wants_key = self._wants_key, False
        for name in [n for n in self._streams if n not in self.look.pictures]:
            del self._streams[name]
        described = []
        for name in self.look.pictures:
            image = gallery.picture(name)
            if image is None:
                continue
            coded = self._stream(name).encode(image, key=wanted)
            payloads.append(coded.data)
            size = {"width": coded.width, "height": coded.height, "bytes": len(coded.data)}
            described.append({"name": name, "codec": coded.codec, "key": coded.key, **size})
        return described

    def _stream(self, name: str) -> PictureStream:
        if name not in self._streams:
            self._streams[name] = PictureStream(
                kind=self.kind,
                fps=max(self.scene.fps, 1.0),
                crf=self.settings.view_crf,
                jpeg_quality=self.settings.view_jpeg,
            )
        return self._streams[name]

    def _overlays(self, gallery: Gallery, detail: SplatDetail | None, payloads: list[bytes]) -> dict[str, Any]:
        shown, wanted = gallery.shown, self.look.overlays
        grids: list[Grid | None] = [
            occlusion_grid(shown) if "occlusion" in wanted else None,
            confidence_grid(shown) if "confidence" in wanted else None,
            detail_grid(detail, shown) if "detail" in wanted and detail is not None else None,
        ]
        out: dict[str, Any] = {"grids": []}
        for grid in grids:
            if grid is not None:
                height, width = grid.values.shape
                out["grids"].append({"name": grid.name, "width": width, "height": height, "bytes": grid.values.size})
                payloads.append(grid.values.tobytes())
        if "tiles" in wanted and detail is not None:
            out["tiles"] = tile_boxes(detail, shown.camera)
        if "reference" in wanted:
            out["reference"] = reference_outline(shown, reference_depth(gallery, self.scene))
        return out

    def needs_detail(self) -> bool:
        """Whether an overlay is on that looks at the splats."""
        return bool(self.look.overlays & {"detail", "tiles"})


def reference_depth(gallery: Gallery, scene: SceneInfo) -> float:
    """Depth at which the reference's border is drawn: that of the scene's focus, in front of the reference camera."""
    reference = gallery.shown.reference_camera
    if reference is None:
        return scene.focus_radius
    rotation, translation = reference.world_to_camera
    depth = float(rotation[2] @ scene.focus_centre + translation[2])
    return max(depth, scene.focus_radius * 0.25, scene.near)


def frame_figures(gallery: Gallery) -> dict[str, Any]:
    """The figures of a frame that every page plots."""
    shown = gallery.shown
    pose = shown.camera.pose
    return {
        "frame": shown.frame,
        "missed": shown.missed,
        "resolution": shown.resolution,
        "camera": {"position": pose.position, "rotation": pose.rotation, "fov_y": shown.camera.intrinsics.fov_rad[1]},
        "stages_ms": dict(shown.stages_ms),
        "stats": {**shown.stats, **gallery.scores()},
    }
