"""The supplement's table of precision: errors of the shipped predictor and coverage of the shipped field of view."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from cags_bench.confidence import Interval, interval
from cags_bench.predict import coverage, precision
from cags_common.poses.walks import Walk
from cags_server.fov import create_fov_policy
from cags_server.predict import create_predictor
from cags_server.settings import ServerSettings

LEAD_US = 200_000
"""Six frames, as the server plans ahead."""

EVERY_US = 1_000_000
"""Time between predictions."""

SECONDS = 8.0
"""Part of each walk that the field of view is measured on."""


@dataclass(frozen=True)
class PrecisionRow:
    """The walks through one scene, each walk one observation."""

    scene: str
    walks: int
    position_m: Interval
    angle_deg: Interval
    coverage_pct: Interval
    area: float
    """Reference area over the client's."""

    def figures(self) -> dict[str, Any]:
        """The row as an entry of a JSON line."""
        return {
            "dataset": self.scene,
            "position_mae_m": self.position_m.mean,
            "angular_mae_deg": self.angle_deg.mean,
            "fov_coverage_pct": self.coverage_pct.mean,
            "fov_area": self.area,
        }


def table(walks: Sequence[Walk]) -> Iterator[PrecisionRow]:
    """One row per scene that people walked through."""
    defaults = ServerSettings()
    predictor = create_predictor(defaults.predictor)
    policy = {"default": lambda: create_fov_policy(defaults.fov)}
    for scene in sorted({_scene(walk) for walk in walks}):
        metres, degrees, covered, areas = [], [], [], []
        for walk in (one for one in walks if _scene(one) == scene):
            (_, _, errors), *_ = precision.measure([walk], {"default": predictor}, [LEAD_US], EVERY_US)
            metres.append(float(errors.distances_m.mean()))
            degrees.append(float(errors.angles_deg.mean()))
            curve = coverage.measure([walk], predictor, policy, LEAD_US, SECONDS)["default"].figures([])
            covered.append(curve["coverage_pct"])
            areas.append(curve["area"])
        area = sum(areas) / len(areas)
        yield PrecisionRow(scene, len(metres), interval(metres), interval(degrees), interval(covered), area)


def _scene(walk: Walk) -> str:
    return walk.name.rsplit("_user", 1)[0]
