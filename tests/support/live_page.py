"""A little clip for the live page without server and client: coloured balls that bob up and down, drawn by OpenCV."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from cags_client.output.page import LiveView, SceneInfo, ShownFrame, SplatDetail, ViewSettings
from cags_common.geometry import F32, Camera, Intrinsics, Pose

WIDTH, HEIGHT, FRAMES, FPS = 640, 480, 60, 30.0
INTRINSICS = Intrinsics.of_fov(WIDTH, HEIGHT, math.radians(60), math.radians(46))
SCENE = SceneInfo("bobbing balls", FRAMES, FPS, (0.0, 1.0, 0.0), (0.0, 0.0, 0.0), 2.0, 6)


class StillWalk:
    """A viewer who stands still and looks at the balls."""

    def pose_at(self, t_us: int) -> Pose:
        return Pose.looking_at((3.0, 1.5, 4.0), (0.0, 0.0, 0.0))


class FakeControls:
    """Keeps what the page asks for, and plays the balls."""

    def __init__(self, has_truth: bool = True) -> None:
        self.playing, self.loop, self.rate = True, True, 1.0
        self.restorer, self.restorers = "correct", ("correct", "none")
        self.exactness, self.resolution = "balanced", "full"
        self.away = False
        self.has_truth = has_truth
        self.frame = 0
        self.windows: list[tuple[int, int]] = []
        self.truths = 0
        self.details = 0

    def play(self) -> None:
        self.playing = True

    def pause(self) -> None:
        self.playing = False

    def seek(self, frame: int) -> None:
        self.frame = frame

    def set_rate(self, rate: float) -> None:
        self.rate = rate

    def set_loop(self, on: bool) -> None:
        self.loop = on

    def set_restorer(self, name: str) -> None:
        self.restorer = name

    def set_resolution(self, name: str) -> None:
        self.resolution = name

    def set_exactness(self, name: str) -> None:
        self.exactness = name

    def set_window(self, width: int, height: int) -> None:
        self.windows.append((width, height))

    def truth(self, frame: int, camera: Camera) -> F32:
        self.truths += 1
        return draw(frame, camera)[0]

    def detail(self) -> SplatDetail:
        self.details += 1
        means = ball_centres(self.frame).astype(np.float32)
        tiles = np.arange(len(means), dtype=np.int32) // 9
        return SplatDetail(means, tiles, (tiles / max(int(tiles.max()), 1)).astype(np.float32))


def ball_centres(frame: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Centres [27, 3] of the balls."""
    grid = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=np.float64)
    grid[:, 1] += 0.35 * np.sin(2 * np.pi * frame / FRAMES + grid[:, 0] * 2 + grid[:, 2])
    return grid


def draw(frame: int, camera: Camera) -> tuple[F32, F32]:
    """The balls seen by a camera: picture [H, W, 3] in [0, 1] and depth [H, W]."""
    i = camera.intrinsics
    image = np.full((i.height_px, i.width_px, 3), (28, 30, 38), np.uint8)
    depth = np.full((i.height_px, i.width_px), np.inf, np.float32)
    rotation, translation = camera.world_to_camera
    points = ball_centres(frame) @ rotation.T + translation
    for index in np.argsort(-points[:, 2]):
        x, y, z = points[index]
        if z < camera.near:
            continue
        centre = (round(x / z * i.fx_px + i.cx_px), round(y / z * i.fy_px + i.cy_px))
        radius = max(1, round(0.3 / z * i.fx_px))
        hue = np.uint8([[[int(index) * 6, 170, 235]]])
        colour = tuple(int(c) for c in cv2.cvtColor(hue, cv2.COLOR_HSV2RGB)[0, 0])
        cv2.circle(image, centre, radius, colour, -1, cv2.LINE_AA)
        cv2.circle(image, (centre[0] - radius // 3, centre[1] - radius // 3), max(1, radius // 4), (255, 255, 255), -1)
        cv2.circle(depth, centre, radius, float(z), -1)
    return image.astype(np.float32) / 255, depth


def shown_frame(frame: int, pose: Pose) -> ShownFrame:
    """One displayed frame with everything a page may ask for."""
    camera = Camera(INTRINSICS, pose)
    picture, depth = draw(frame, camera)
    distorted = np.asarray(np.round(picture * 6) / 6, dtype=np.float32)
    wide = Intrinsics.of_fov(400, 300, math.radians(68), math.radians(54))
    reference = Camera(wide, Pose.looking_at((3.05, 1.5, 4.0), (0.0, 0.0, 0.0)))
    occluded = np.zeros(depth.shape, bool)
    occluded[180:260, 200:240] = True
    t = frame / FPS
    return ShownFrame(
        frame,
        camera,
        {"restored": picture, "distorted": distorted, "aligned": picture, "reference": draw(frame, reference)[0]},
        {"depth": lambda: depth, "confidence": lambda: np.clip(1 - occluded.astype(np.float32), 0, 1)},
        occluded,
        reference,
        {"update": 1.5, "raster": 12 + 3 * math.sin(t * 3), "align": 4.0, "restore": 5.0},
        {
            "goodput_mbps": 12 + 4 * math.sin(t * 2),
            "capacity_mbps": 18.0,
            "lod_mean": 3 + math.sin(t),
            "buffer_ms": 66.0 + 20 * math.sin(t * 5),
            "prediction_error_deg": 2 + abs(math.sin(t * 4)) * 3,
        },
    )


class BallShow:
    """A live view with its player, inside a running event loop."""

    def __init__(self, settings: ViewSettings | None = None) -> None:
        self.view = LiveView(settings or ViewSettings(view_port=0), StillWalk())
        self.controls = FakeControls()

    async def __aenter__(self) -> BallShow:
        await self.view.start()
        self.view.attach(SCENE, self.controls)
        self._player = asyncio.create_task(self._play())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._player.cancel()
        await asyncio.gather(self._player, return_exceptions=True)
        await self.view.stop()

    async def _play(self) -> None:
        due = time.monotonic()
        while True:
            self.view.show(shown_frame(self.controls.frame, self.view.poses.pose_at(0)))
            if self.controls.playing:
                self.controls.frame = (self.controls.frame + 1) % FRAMES
            due = max(due + 1 / FPS, time.monotonic())
            await asyncio.sleep(due - time.monotonic())


def frames_around(count: int) -> Iterator[ShownFrame]:
    """Frames of the clip seen from one place, for tests that need no clock."""
    pose = StillWalk().pose_at(0)
    return (replace(shown_frame(k, pose), missed=False) for k in range(count))
