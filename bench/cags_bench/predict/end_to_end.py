"""Effect of predictors and field-of-view policies on the picture: whole sessions in virtual time."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cags_bench.sim.session import Scenario, simulate
from cags_client.settings import ClientSettings
from cags_common.poses import write_poses
from cags_common.poses.walks import Walk
from cags_server.fov import FOV_POLICIES
from cags_server.predict import PREDICTORS
from cags_server.settings import ServerSettings

FIGURES = ("psnr_distorted_db", "psnr_restored_db", "ssim_restored", "prediction_error_deg", "bytes_reference")


def stream_all(bundles: Sequence[str], walk: Walk, trace: str, frames: int) -> Iterator[dict[str, Any]]:
    """Every predictor with the default policy, and every policy with the default predictor, over each bundle."""
    defaults = ServerSettings()
    choices = [(name, defaults.fov) for name in PREDICTORS]
    choices += [(defaults.predictor, name) for name in FOV_POLICIES if name != defaults.fov]
    with tempfile.TemporaryDirectory() as folder:
        poses = Path(folder) / f"{walk.name}.csv"
        # The stream begins in the middle of the walk because people stand still at the start.
        write_poses(walk.trace.window(walk.trace.duration_us // 3, walk.trace.duration_us), poses)
        for bundle in bundles:
            for predictor, fov in choices:
                server = replace(defaults, predictor=predictor, fov=fov)
                client = ClientSettings(width=400, height=300, duration=frames / 30.0)
                scenario = Scenario(Path(bundle), trace, str(poses), server, client)
                summary = simulate(scenario).summary
                figures = {name: summary.get(name) for name in FIGURES}
                yield {"case": "stream", "bundle": Path(bundle).name, "predictor": predictor, "fov": fov, **figures}
