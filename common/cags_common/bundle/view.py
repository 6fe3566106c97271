"""How the author of a scene wants it to be opened: title, background, first view, what to turn around."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cags_common.bundle.fields import Fields
from cags_common.errors import BundleError, ConfigError
from cags_common.geometry import Pose, Vec3

MAX_TITLE = 120
MAX_VIEW_BYTES = 1 << 16
FARTHEST_M = 1e9
NAMES = ("title", "background", "pose", "target", "radius")
_COLOUR = re.compile(r"#[0-9a-fA-F]{6}", re.ASCII)


@dataclass(frozen=True, slots=True)
class AuthorView:
    """All of it is optional; what is left out, players choose."""

    title: str = ""
    """Title to display; if empty, the scene's name."""
    background: str = ""
    """Colour behind the splats, ``#rrggbb``; black where there is none."""
    pose: Pose | None = None
    """T_world_camera (metres, OpenCV axes) that a play begins at."""
    target: Vec3 | None = None
    """Point to turn around, world frame, metres."""
    radius: float | None = None
    """Radius of the sphere around the target that the first view shows whole, metres."""

    def table(self) -> dict[str, Any]:
        """What is given, as JSON's values: the pose is position and quaternion ``wxyz`` in one list of seven."""
        pose = None if self.pose is None else [*self.pose.position, *self.pose.rotation]
        target = None if self.target is None else list(self.target)
        values = (self.title, self.background, pose, target, self.radius)
        return {name: value for name, value in zip(NAMES, values, strict=True) if value not in (None, "")}

    @staticmethod
    def read(fields: Fields) -> AuthorView:
        """Check what :meth:`table` gives. Raises :class:`BundleError` naming the field."""
        fields.names()
        return AuthorView(
            title=_title(fields) if fields.has("title") else "",
            background=_background(fields) if fields.has("background") else "",
            pose=_pose(fields) if fields.has("pose") else None,
            target=_target(fields) if fields.has("target") else None,
            radius=fields.number("radius", 1e-6, FARTHEST_M) if fields.has("radius") else None,
        )


WAY_OUT = "give a file as the page in the browser saves it"


def read_view(path: str) -> AuthorView:
    """The view in a JSON file. Raises :class:`ConfigError` in one line; a name that is not known is refused."""
    try:
        data = Path(path).read_bytes()[: MAX_VIEW_BYTES + 1]
    except OSError as error:
        raise ConfigError(f"view = {path}: cannot be read ({error.strerror or error}); {WAY_OUT}") from error
    if len(data) > MAX_VIEW_BYTES:
        raise ConfigError(f"view = {path}: is larger than {MAX_VIEW_BYTES} bytes, and no view; {WAY_OUT}")
    try:
        fields = Fields(json.loads(data), source=f"view = {path}")
        unknown = sorted(fields.names() - set(NAMES))
        if unknown:
            raise ConfigError(f"view = {path}: {unknown[0][:40]!r} is unknown; known: {', '.join(NAMES)}")
        return AuthorView.read(fields)
    except BundleError as error:
        raise ConfigError(str(error)) from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"view = {path}: is not JSON ({error}); {WAY_OUT}") from error


def _title(fields: Fields) -> str:
    title = fields.text("title")
    if len(title) > MAX_TITLE or not title.isprintable():
        raise fields.fault("title", f"one line of at most {MAX_TITLE} characters")
    return title


def _background(fields: Fields) -> str:
    colour = fields.text("background")
    if not _COLOUR.fullmatch(colour):
        raise fields.fault("background", "a colour such as #1a2b3c")
    return colour.lower()


def _pose(fields: Fields) -> Pose:
    parts = fields.many("pose", lambda f: f.number("", -FARTHEST_M, FARTHEST_M), 7)
    if len(parts) != 7 or not 0.5 < math.hypot(*parts[3:]) < 2.0:
        raise fields.fault("pose", "x, y, z and a unit quaternion w, x, y, z")
    x, y, z, qw, qx, qy, qz = parts
    return Pose((x, y, z), (qw, qx, qy, qz))


def _target(fields: Fields) -> Vec3:
    parts = fields.many("target", lambda f: f.number("", -FARTHEST_M, FARTHEST_M), 3)
    if len(parts) != 3:
        raise fields.fault("target", "three numbers")
    return parts[0], parts[1], parts[2]
